"""Films of a recorded run: GIF through Pillow, MP4 through the encoder that imageio-ffmpeg brings along."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simulator.errors import MissingLibraryError, OutputError, ParameterError
from simulator.pictures.instant import InstantPainter
from simulator.pictures.picture import MEETING, RESTING, SOLID, WALKING, PictureSize, drawing_style

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from simulator.pictures.recorded_run import RecordedRun

# A GIF tells how long a frame stays in hundredths of a second, and viewers slow down what is shorter than two.
_GIF_TICK_S = 0.01
MAX_GIF_FPS = 50.0
# Pillow keeps all frames of a GIF in memory; an MP4 is written as it is made.
_MAX_GIF_FRAMES = 2_000
_MAX_MP4_FRAMES = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmPlan:
    """Which instants of a run become frames.

    Parameters
    ----------
    fps
        Frames a second of film.
    n_frames
        How many, at least 2, from the first instant to the last, evenly.
    """

    fps: float
    n_frames: int


def plan_film(run: RecordedRun, *, fps: float, seconds: float | None, speed: float | None) -> FilmPlan:
    """Choose the frames of a film.

    Parameters
    ----------
    seconds
        How long the film is [s].
    speed
        Instead: how many times faster than life it is.

    Raises
    ------
    ParameterError
        The run lasts no time, so that nothing moves.
    """
    lasts_s = run.end_s - float(run.t_s[0])
    if lasts_s <= 0:
        raise ParameterError(name="duration of the run", got=lasts_s, wanted="some seconds, for a film; --png draws the instant there is")
    length_s = lasts_s / speed if speed is not None else seconds or 10.0
    return FilmPlan(fps=fps, n_frames=max(2, round(fps * min(length_s, 1e9))))


def write_gif(run: RecordedRun, path: Path, *, plan: FilmPlan, size: PictureSize, trail_s: float) -> None:
    """Write an endless GIF; all frames share one table of colours, so that none flickers.

    Raises
    ------
    ParameterError
        Too many frames, or too fast for the format.
    OSError
        The file cannot be written.
    """
    from PIL import Image  # noqa: PLC0415  # comes with matplotlib, see picture.drawing_style

    if plan.fps > MAX_GIF_FPS:
        raise ParameterError(name="fps", got=plan.fps, wanted=f"at most {MAX_GIF_FPS:g} in a GIF, whose clock ticks in 1/100 s; or --mp4")
    _check_count(plan, limit=_MAX_GIF_FRAMES, remedy="fewer --seconds, a higher --speed, a lower --fps, or --mp4")
    palette = Image.new("P", (1, 1))
    palette.putpalette(_palette().tobytes())
    pictures = (
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in _frames(run, plan=plan, size=size, trail_s=trail_s)
    )
    # Rounding each frame's end, not its length, keeps the film as long as asked.
    ends = np.rint(np.arange(plan.n_frames + 1) / plan.fps / _GIF_TICK_S)
    durations_ms = (np.diff(ends) * _GIF_TICK_S * 1000.0).round().astype(int).tolist()
    next(pictures).save(
        path, format="GIF", save_all=True, append_images=pictures, duration=durations_ms, loop=0, optimize=False, disposal=1
    )


def write_mp4(run: RecordedRun, path: Path, *, plan: FilmPlan, size: PictureSize, trail_s: float) -> None:
    """Write an MP4 (H.264, 4:2:0), without sound.

    Raises
    ------
    MissingLibraryError
        imageio-ffmpeg, or the encoder in it, is not installed.
    ParameterError
        Too many frames, or an odd number of pixels, which 4:2:0 cannot have.
    OutputError
        The file cannot be written.
    """
    if size.width % 2 or size.height % 2:
        raise ParameterError(name="size", got=f"{size.width}x{size.height}", wanted="even numbers of pixels for MP4")
    _check_count(plan, limit=_MAX_MP4_FRAMES, remedy="fewer --seconds, a higher --speed or a lower --fps")
    try:
        import imageio_ffmpeg  # noqa: PLC0415  # optional: its encoder is as large as all else together

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        remedy = "pip install 'biobot-gateway[video]', or make a --gif"
        raise MissingLibraryError(library="imageio-ffmpeg", needed_for="MP4", remedy=remedy) from error
    writer = imageio_ffmpeg.write_frames(
        str(path),
        (size.width, size.height),
        fps=plan.fps,
        codec="libx264",
        pix_fmt_out="yuv420p",
        quality=None,
        macro_block_size=2,
        ffmpeg_log_level="error",
        # bitexact: no date and no name of the encoder's build in the file. crf 20: letters stay sharp.
        output_params=["-f", "mp4", "-crf", "20", "-movflags", "+faststart", "-fflags", "+bitexact", "-flags:v", "+bitexact"],
    )
    try:
        try:
            writer.send(None)
            for frame in _frames(run, plan=plan, size=size, trail_s=trail_s):
                writer.send(np.ascontiguousarray(frame))
        finally:
            writer.close()  # waits for the encoder, which would go on alone
        n_written, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    except (OSError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise OutputError(path=path, problem=f"the encoder failed ({reason}); is there room for the film?") from error
    if n_written != plan.n_frames:  # the encoder does not tell its exit status
        raise OutputError(path=path, problem=f"the encoder wrote {n_written} frames of {plan.n_frames}; is there room for the film?")


def _palette() -> NDArray[np.uint8]:
    """Return the colours of a GIF: all that is drawn, and the ways from each to white and to what it may lie on.

    Fewer than 256, shape (k, 3): Pillow needs one more to leave out what did not change since the frame before.
    """
    from matplotlib.colors import to_rgb  # noqa: PLC0415  # see picture.drawing_style

    inks = np.array([to_rgb(one) for one in (WALKING, MEETING, RESTING)])
    grounds = np.array([to_rgb(one) for one in ("white", "black", SOLID)])
    share = np.linspace(0.0, 1.0, 18)[:, None]
    ways = [ground + share * (ink - ground) for ink in inks for ground in grounds]
    ways += [inks[0] + share * (inks[1] - inks[0]), np.linspace(0.0, 1.0, 36)[:, None] * np.ones(3)]
    return np.unique(np.rint(255.0 * np.concatenate(ways)).astype(np.uint8), axis=0)


def _check_count(plan: FilmPlan, *, limit: int, remedy: str) -> None:
    if plan.n_frames > limit:
        raise ParameterError(name="number of frames", got=plan.n_frames, wanted=f"at most {limit:,}: {remedy}")


def _frames(run: RecordedRun, *, plan: FilmPlan, size: PictureSize, trail_s: float) -> Iterator[NDArray[np.uint8]]:
    """Paint the frames of a film, one by one: each of shape (height, width, 3)."""
    t_s = np.linspace(float(run.t_s[0]), run.end_s, plan.n_frames)
    painter: InstantPainter | None = None
    for at_s in t_s.tolist():
        # The style holds only while something is drawn, not while whoever takes the frames does its own work.
        with drawing_style():
            painter = painter or InstantPainter(run, size=size, trail_s=trail_s, step_s=float(t_s[1] - t_s[0]))
            frame = painter.pixels(at_s)
        yield frame
