"""``biobot-sim render``: pictures, films and a page of a run that is on disk."""

import argparse
import contextlib
import os
import re
import signal
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from firmware_protocol.errors import ConfigurationError
from simulator.config_sources import load_config
from simulator.errors import OutputError, ParameterError
from simulator.log import EventLog, set_up_logging
from simulator.pictures.film import plan_film, write_gif, write_mp4
from simulator.pictures.instant import render_instant
from simulator.pictures.page import render_page
from simulator.pictures.picture import ImageFormat, PictureSize, render_overview
from simulator.pictures.recorded_run import RUN_FILES, RecordedRun, read_run
from simulator.pictures.track import Floats

log = EventLog(__name__)

_KINDS = ("png", "svg", "gif", "mp4", "html")
_MIN_PIXELS, _MAX_PIXELS = 200, 8_000
# Without --trail: this share of the run, but not longer than this share of the arena.
_TRAIL_SHARE, _TRAIL_LENGTH = 0.02, 0.1
_MAX_CHOSEN_PATHS = 5
_LEGIBLE_CROSSINGS = 40.0

_Positive = Annotated[float, msgspec.Meta(gt=0, le=1e9)]


class RenderConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of ``biobot-sim render``.

    Keys
    ----
    directory
        The run: what ``biobot-sim run`` or ``biobot-sim serve`` wrote.
    png, svg, gif, mp4, html
        Where each kind of picture goes; a file there is replaced. At least one must be given.
    at_s
        Draw this instant [s], from 0 at the setting of the landmarks; without it, PNG and SVG show the whole run.
    trail_s
        How far back the ways just walked are drawn [s]; without it, a fiftieth of the run, but no longer than a tenth of
        the arena's side at the speed they walk.
    paths
        Paths of how many biobots the picture of a whole run shows, evenly chosen from all ids; 0 for none. Without it, at most
        five, and fewer where they walked so far that they would hide all else.
    ids
        Instead: ids of the biobots whose paths it shows, with commas between.
    fps
        Frames a second of film.
    seconds, film_speed
        How long a film is [s], 10 without either; or how many times faster than life.
    size
        Width and height, as in ``960x900`` [pixel].
    dpi
        Pixels an inch: more makes letters and lines larger.
    """

    directory: str | None = None
    png: str | None = None
    svg: str | None = None
    gif: str | None = None
    mp4: str | None = None
    html: str | None = None
    at_s: Annotated[float, msgspec.Meta(ge=0)] | None = None
    trail_s: Annotated[float, msgspec.Meta(ge=0)] | None = None
    paths: Annotated[int, msgspec.Meta(ge=0)] | None = None
    ids: str | None = None
    fps: Annotated[float, msgspec.Meta(gt=0, le=120)] = 20.0
    seconds: _Positive | None = None
    film_speed: _Positive | None = None
    size: str = "960x900"
    dpi: Annotated[float, msgspec.Meta(ge=30, le=1_200)] = 120.0

    def __post_init__(self) -> None:
        problems = []
        if self.seconds is not None and self.film_speed is not None:
            problems.append(f"both seconds ({self.seconds:g}) and film_speed ({self.film_speed:g}) are given; give one of them")
        match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", self.size)
        if match is None or not all(_MIN_PIXELS <= int(one) <= _MAX_PIXELS for one in match.groups()):
            problems.append(f"size is {self.size!r}; wanted WIDTHxHEIGHT, each from {_MIN_PIXELS} to {_MAX_PIXELS} pixels")
        if self.ids is not None and re.fullmatch(r"\d{1,19}(,\d{1,19})*", self.ids) is None:
            problems.append(f"ids is {self.ids!r}; wanted ids with commas between, as in 3,17")
        if problems:
            raise ValueError("; ".join(problems))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``render``."""
    parser.add_argument("directory", nargs="?", metavar="DIR", help="the run, as run or serve wrote it")
    parser.add_argument("--png", metavar="FILE", help="paths, landmarks and encounters of the whole run; with --at, one instant")
    parser.add_argument("--svg", metavar="FILE", help="the same, to be scaled")
    parser.add_argument("--gif", metavar="FILE", help="a film that any browser shows")
    parser.add_argument("--mp4", metavar="FILE", help="a film, smaller; needs the extra 'video'")
    parser.add_argument("--html", metavar="FILE", help="a page to play and search the run, complete in one file")
    parser.add_argument("--at", dest="at_s", type=float, metavar="S", help="draw this instant, counted from the landmarks' setting")
    parser.add_argument("--at-s", dest="at_s", type=float, help=argparse.SUPPRESS)  # the key's name, as messages have it
    parser.add_argument("--trail", dest="trail_s", type=float, metavar="S", help="seconds of way drawn behind each insect")
    parser.add_argument("--trail-s", dest="trail_s", type=float, help=argparse.SUPPRESS)  # the key's name, as messages have it
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--paths", type=int, metavar="N", help="paths of how many biobots, whole run (default: up to 5)")
    which.add_argument("--ids", metavar="ID,ID", help="paths of these biobots")
    parser.add_argument("--fps", type=float, metavar="N", help="frames a second of film (default: 20)")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--seconds", type=float, metavar="S", help="length of the film (default: 10)")
    length.add_argument("--speed", dest="film_speed", type=float, metavar="X", help="the film is X times faster than life")
    parser.add_argument("--size", metavar="WxH", help="pixels (default: 960x900)")
    parser.add_argument("--dpi", type=float, metavar="N", help="larger letters and lines with more (default: 120)")


def main(args: argparse.Namespace) -> int:
    """Make the pictures asked for; return the exit status.

    Raises
    ------
    ConfigurationError
        Nothing is asked for, or a flag is faulty.
    SimulationError
        The directory holds no run, or a picture cannot be made or written.
    """
    config = load_config(RenderConfig, args)
    if args.check_config:
        sys.stdout.write(f"{args.config or 'defaults and environment'}: the configuration is valid\n")
        return 0
    set_up_logging()
    # A polite kill leaves no half-made film behind, as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    render(config)
    return 0


def render(config: RenderConfig) -> None:
    """Make every picture that the configuration names, each whole or not at all. Raises as ``main`` does."""
    targets = {kind: Path(name) for kind in _KINDS if (name := getattr(config, kind)) is not None}
    _check_targets(config, targets)
    directory = Path(config.directory or "")
    run = read_run(directory)
    if config.at_s is not None and config.at_s > run.end_s:
        raise ParameterError(name="at", got=config.at_s, wanted=f"an instant of the run, from 0 to {run.end_s:g} s")
    for kind, target in targets.items():
        _refuse_inputs(directory, target)
        with _fresh_file(target) as fresh:
            _PAINTERS[kind](config, run, fresh)
        log.info("render.written", kind=kind, file=str(target), bytes=target.stat().st_size)


def _check_targets(config: RenderConfig, targets: dict[str, Path]) -> None:
    problems = []
    if config.directory is None:
        problems.append("give DIR, the directory of a run (biobot-sim run --out DIR makes one)")
    if not targets:
        problems.append("give at least one of " + ", ".join(f"--{kind} FILE" for kind in _KINDS))
    if len({target.absolute() for target in targets.values()}) < len(targets):
        problems.append("two kinds of picture would go into one file; give each a name of its own")
    if config.at_s is not None and targets and not {"png", "svg"} & set(targets):
        problems.append(f"at is {config.at_s:g} s, and a film or page shows every instant; give --png or --svg with --at")
    if problems:
        raise ConfigurationError(problems)


def _refuse_inputs(directory: Path, target: Path) -> None:
    place = target.resolve()
    if place.parent == directory.resolve() and (place.name in RUN_FILES or place.suffix == ".geojson"):
        raise ParameterError(name="file", got=str(target), wanted="another name: this is a file of the run itself")


@contextlib.contextmanager
def _fresh_file(target: Path) -> Iterator[Path]:
    """Give a name beside the target to write to; it takes the target's place if nothing went wrong."""
    if target.is_dir():
        raise OutputError(path=target, problem="is a directory; give the name of a file in it")
    if target.exists() and not target.is_file():
        raise OutputError(path=target, problem="is a device or a pipe, and would be replaced; give the name of a file")
    target = target.resolve()  # a link stays one, and what it leads to is replaced
    fresh = target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}.partial")
    try:
        try:
            fresh.touch()
            yield fresh
            fresh.replace(target)
        finally:
            fresh.unlink(missing_ok=True)
    except OutputError as error:
        raise OutputError(path=target, problem=error.problem) from error  # whoever wrote knows only the fresh name
    except OSError as error:
        raise OutputError(path=target, problem=f"cannot be written: {os.strerror(error.errno) if error.errno else error}") from error


def _size(config: RenderConfig) -> PictureSize:
    width, height = map(int, config.size.split("x"))
    return PictureSize(width=width, height=height, dpi=config.dpi)


def _trail_s(config: RenderConfig, run: RecordedRun) -> float:
    if config.trail_s is not None:
        return config.trail_s
    speed = float(np.percentile(_ways(run).sum(axis=0), 90)) / run.end_s if run.end_s > 0 else 0.0
    return min(_TRAIL_SHARE * run.end_s, _TRAIL_LENGTH * _extent(run) / speed) if speed > 0 else 0.0


def _extent(run: RecordedRun) -> float:
    x_min, y_min, x_max, y_max = run.bounds
    return max(x_max - x_min, y_max - y_min)


def _ways(run: RecordedRun) -> Floats:
    """Return how far each biobot came from each sample to the next [length]: shape (m - 1, n)."""
    x, y = np.moveaxis(np.diff(run.position, axis=0), 2, 0)
    return np.array(np.hypot(x, y))


def _choose_rows(config: RenderConfig, run: RecordedRun) -> list[int]:
    """Return the rows of the biobots whose paths are drawn."""
    ids = run.ids.tolist()
    if config.ids is None:
        # Landmarks stand still: those who walk have more to show.
        landmarks, _ = run.standing_at(run.end_s)
        walkers, standing = np.flatnonzero(~landmarks).tolist(), np.flatnonzero(landmarks).tolist()
        wanted_count = _legible_paths(run, walkers) if config.paths is None else config.paths
        if wanted_count > len(walkers):
            walkers = sorted(walkers + standing)
        count = min(wanted_count, len(walkers))
        return [walkers[k * len(walkers) // count] for k in range(count)]
    wanted = list(dict.fromkeys(map(int, config.ids.split(","))))
    if unknown := [one for one in wanted if one not in ids]:
        raise ParameterError(name="ids", got=unknown, wanted=f"ids of the run's {len(ids)} biobots, between {ids[0]} and {ids[-1]}")
    return [ids.index(one) for one in wanted]


def _legible_paths(run: RecordedRun, walkers: list[int]) -> int:
    """Return how many paths can be told apart: as many as walk, together, a few dozen times across the arena."""
    longest = float(_ways(run)[:, walkers].sum(axis=0).max(initial=0.0)) / _extent(run)
    return _MAX_CHOSEN_PATHS if longest <= 0 else int(np.clip(_LEGIBLE_CROSSINGS / longest, 1, _MAX_CHOSEN_PATHS))


def _paint_still(config: RenderConfig, run: RecordedRun, path: Path, *, image_format: ImageFormat) -> None:
    if config.at_s is None:
        content = render_overview(run, size=_size(config), rows=_choose_rows(config, run), image_format=image_format)
    else:
        content = render_instant(run, config.at_s, size=_size(config), trail_s=_trail_s(config, run), image_format=image_format)
    path.write_bytes(content)


def _paint_png(config: RenderConfig, run: RecordedRun, path: Path) -> None:
    _paint_still(config, run, path, image_format="png")


def _paint_svg(config: RenderConfig, run: RecordedRun, path: Path) -> None:
    _paint_still(config, run, path, image_format="svg")


def _paint_gif(config: RenderConfig, run: RecordedRun, path: Path) -> None:
    plan = plan_film(run, fps=config.fps, seconds=config.seconds, speed=config.film_speed)
    write_gif(run, path, plan=plan, size=_size(config), trail_s=_trail_s(config, run))


def _paint_mp4(config: RenderConfig, run: RecordedRun, path: Path) -> None:
    plan = plan_film(run, fps=config.fps, seconds=config.seconds, speed=config.film_speed)
    write_mp4(run, path, plan=plan, size=_size(config), trail_s=_trail_s(config, run))


def _paint_page(config: RenderConfig, run: RecordedRun, path: Path) -> None:
    path.write_bytes(render_page(run, trail_s=_trail_s(config, run)))


_PAINTERS: dict[str, Callable[[RenderConfig, RecordedRun, Path], None]] = {
    "png": _paint_png,
    "svg": _paint_svg,
    "gif": _paint_gif,
    "mp4": _paint_mp4,
    "html": _paint_page,
}
