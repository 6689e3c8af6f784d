"""Draw a recorded run at one instant: who is where, the ways just walked, and who meets whom."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.pictures.picture import (
    LANDMARK,
    MEETING,
    RESTING,
    WALKING,
    ImageFormat,
    PictureSize,
    draw_arena,
    draw_legend,
    drawing_style,
    make_figure,
    save,
    set_title,
    summary,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.collections import PathCollection
    from numpy.typing import NDArray

    from simulator.pictures.recorded_run import RecordedRun
    from simulator.pictures.track import Floats

# An encounter that is over leaves a dot; where thousands lie, they must not hide the insects.
_PAST_ALPHA = 0.35


class InstantPainter:
    """Paints one instant after another into a single figure; make and use it within ``drawing_style``.

    Parameters
    ----------
    run
        What to paint.
    trail_s
        How far back the ways of walking biobots are drawn [s]; 0 for none.
    step_s
        Time from one picture to the next [s]; the clock shows enough digits to tell two of them apart.
    """

    def __init__(self, run: RecordedRun, *, size: PictureSize, trail_s: float, step_s: float) -> None:
        from matplotlib.collections import LineCollection  # noqa: PLC0415  # see drawing_style

        self._run = run
        self._size = size
        self._trail_s = trail_s
        self._digits = min(9, max(1, int(np.ceil(-np.log10(step_s)))) if step_s > 0 else 1)
        self._figure, canvas, self._axes = make_figure(run, size=size)
        self._canvas: Any = canvas  # whose methods matplotlib left without types
        self._arena = run.track.arena_at(float(run.t_s[0]))
        self._floor_artists: list[Artist] = []
        self._draw_floor()
        crowd = float(np.clip(150.0 / run.ids.size, 0.05, 1.0))
        past_area = float(np.clip(12_000.0 / max(1, run.met_start_s.size), 1.5, 5.0))
        self._past = self._dots("o", past_area, MEETING, label="past encounter", zorder=1.5, linewidths=0, alpha=_PAST_ALPHA)
        self._trails = LineCollection([], colors=WALKING, linewidths=0.9, alpha=0.45, zorder=2)
        self._axes.add_collection(self._trails)
        self._walking = self._dots("o", 20 * crowd, WALKING, label="walking", zorder=4, linewidths=0)
        self._resting = self._dots("s", 22 * crowd, RESTING, label="resting", zorder=4.1, edgecolors="black", linewidths=0.4)
        self._landmarks = self._dots("^", 46 * crowd, LANDMARK, label="landmark", zorder=4.2, edgecolors="white", linewidths=0.6)
        self._meeting = self._dots("o", 95 * crowd, "none", label="meeting now", zorder=5, edgecolors=MEETING, linewidths=1.5)
        landmarks, _ = run.standing_at(run.end_s)
        self._clock = self._axes.annotate(
            "", (1.0, 0.0), xycoords="axes fraction", xytext=(-4, 6), textcoords="offset points", ha="right", va="bottom", fontsize=10
        )
        set_title(
            self._figure,
            f"{run.name}, {run.preset}, seed {run.seed}",
            summary(run, met=run.met_start_s.size, landmarks=int(landmarks.sum())),
        )
        draw_legend(self._figure, self._axes)
        self._background: Any = None  # a region of Agg's own type

    def still(self, at_s: float, *, image_format: ImageFormat) -> bytes:
        """Return the picture of an instant [s] as a file."""
        self._set(at_s)
        return save(self._figure, image_format=image_format, size=self._size)

    def pixels(self, at_s: float) -> NDArray[np.uint8]:
        """Return the picture of an instant [s]: shape (height, width, 3), red, green, blue."""
        canvas = self._canvas
        if self._run.track.arena_at(at_s) is not self._arena:
            self._arena = self._run.track.arena_at(at_s)
            self._draw_floor()
            self._background = None
        if self._background is None:
            for artist in self._moving():
                artist.set_animated(True)
            canvas.draw()
            # Everything has its place now; it is not to be found anew for every frame.
            self._figure.set_layout_engine("none")
            self._background = canvas.copy_from_bbox(self._figure.bbox)
        canvas.restore_region(self._background)
        self._set(at_s)
        for artist in self._moving():
            self._axes.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()

    def _moving(self) -> list[Artist]:
        return [self._past, self._trails, self._walking, self._resting, self._landmarks, self._meeting, self._clock]

    def _dots(self, marker: str, area: float, colour: str, **style: Any) -> PathCollection:
        return self._axes.scatter([], [], marker=marker, s=area, facecolors=colour, **style)

    def _draw_floor(self) -> None:
        for artist in self._floor_artists:
            artist.remove()
        before = set(self._axes.get_children())
        draw_arena(self._axes, self._arena)
        self._floor_artists = [artist for artist in self._axes.get_children() if artist not in before]

    def _set(self, at_s: float) -> None:
        run = self._run
        if run.track.arena_at(at_s) is not self._arena:
            self._arena = run.track.arena_at(at_s)
            self._draw_floor()
        places = run.track.at(at_s)
        landmark, resting = run.standing_at(at_s)
        walking = ~(landmark | resting)
        self._walking.set_offsets(places[walking])
        self._resting.set_offsets(places[resting])
        self._landmarks.set_offsets(places[landmark])
        self._past.set_offsets(run.met_place[run.met_end_s < at_s])
        self._meeting.set_offsets(self._meeting_places(at_s, places))
        from_s = max(float(run.t_s[0]), at_s - self._trail_s)
        trails = run.track.lines(rows=np.flatnonzero(walking), from_s=from_s, to_s=at_s) if from_s < at_s else ()
        self._trails.set_segments(list(trails))
        met = int((run.met_start_s <= at_s).sum())
        self._clock.set_text(f"t = {at_s:.{self._digits}f} s, {met:,} encounters so far")

    def _meeting_places(self, at_s: float, places: Floats) -> Floats:
        now = self._run.meeting_at(at_s)
        return (places[self._run.met_first[now]] + places[self._run.met_second[now]]) / 2.0


def render_instant(run: RecordedRun, at_s: float, *, size: PictureSize, trail_s: float, image_format: ImageFormat) -> bytes:
    """Draw a run at one instant [s]; return the image file."""
    with drawing_style():
        return InstantPainter(run, size=size, trail_s=trail_s, step_s=0.1).still(at_s, image_format=image_format)
