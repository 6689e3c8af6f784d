"""Draw a recorded run with matplotlib, which is imported only when a picture is asked for.

The same run gives the same bytes with one version of matplotlib: no dates, fixed ids, and no user's style.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import shapely

from simulator.errors import MissingLibraryError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch

    from simulator.arenas.arena import Arena
    from simulator.pictures.recorded_run import RecordedRun
    from simulator.pictures.track import Floats

ImageFormat = Literal["svg", "png"]

# Colours that the common colour vision deficiencies keep apart (Wong 2011); what matters differs in shape as well.
WALKING, RESTING, LANDMARK, MEETING = "#0072b2", "#e69f00", "#000000", "#d55e00"
_PATHS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
SOLID = "#d9d9d9"
"""What lies inside the outline and is no floor."""

_WALL, _FLOOR, _MANY_PATHS = "#404040", "#ffffff", "#5b7f99"
# More dots than this make a vector file slow to open: they go into it as one image.
_MAX_VECTOR_DOTS = 5_000
_LEGEND_COLUMN_INCHES, _LEGEND_DOT_AREA = 1.3, 18.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureSize:
    """How large a picture is.

    Parameters
    ----------
    width, height
        Of the picture [pixel].
    dpi
        Pixels an inch: with more, letters and lines are larger.
    """

    width: int
    height: int
    dpi: float


@contextmanager
def drawing_style() -> Iterator[None]:
    """Draw with matplotlib's own defaults and with what makes equal pictures equal bytes, whatever the user's style."""
    try:
        import matplotlib as mpl  # noqa: PLC0415  # a run without pictures must not wait for it
    except ImportError as error:
        remedy = "pip install 'biobot-gateway[simulator]', or make a page with --html"
        raise MissingLibraryError(library="matplotlib", needed_for="pictures and films", remedy=remedy) from error
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update({"svg.hashsalt": "biobot", "svg.fonttype": "none", "axes.titlesize": 11, "legend.fontsize": 9})
        yield


def render_overview(run: RecordedRun, *, size: PictureSize, rows: list[int], image_format: ImageFormat) -> bytes:
    """Draw a whole run: paths of some biobots, landmarks, and all encounters coloured by their time.

    Parameters
    ----------
    rows
        Rows of the biobots whose paths are drawn; up to six get a colour and their id each.

    Returns
    -------
    bytes
        The image file.
    """
    with drawing_style():
        figure, _, axes = make_figure(run, size=size)
        draw_arena(axes, run.arenas[0][1])
        _draw_changes(axes, run)
        if run.met_start_s.size:
            _draw_encounters(axes, run)
        _draw_paths(axes, run, rows)
        landmarks, _ = run.standing_at(run.end_s)
        places = run.track.at(run.end_s)
        if landmarks.any():
            axes.scatter(
                places[landmarks, 0],
                places[landmarks, 1],
                marker="^",
                s=float(np.clip(4_000.0 / landmarks.sum(), 10.0, 46.0)),
                color=LANDMARK,
                edgecolors="white",
                linewidths=0.7,
                zorder=6,
                label="landmark",
            )
        set_title(
            figure, f"{run.name}, {run.preset}, seed {run.seed}", summary(run, met=run.met_start_s.size, landmarks=int(landmarks.sum()))
        )
        draw_legend(figure, axes)
        return save(figure, image_format=image_format, size=size)


def make_figure(run: RecordedRun, *, size: PictureSize) -> tuple[Figure, FigureCanvasAgg, Axes]:
    """Make a figure whose axes show all of the run's arenas to scale, with a scale bar below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  # see drawing_style
    from matplotlib.figure import Figure  # noqa: PLC0415  # same

    figure = Figure(figsize=(size.width / size.dpi, size.height / size.dpi), dpi=size.dpi, layout="constrained", facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    x_min, y_min, x_max, y_max = run.bounds
    extent = max(x_max - x_min, y_max - y_min)
    pad = 0.03 * extent
    bar = nice_length((x_max - x_min) / 4.0)
    y_bar = y_min - 2.0 * pad
    axes.plot([x_min, x_min + bar], [y_bar, y_bar], color="black", linewidth=2.5, solid_capstyle="butt")
    axes.annotate(length_text(bar, run.unit), (x_min + bar, y_bar), xytext=(5, 0), textcoords="offset points", va="center", fontsize=9)
    axes.set_xlim(x_min - pad, x_max + pad)
    axes.set_ylim(y_min - 3.0 * pad, y_max + pad)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure, canvas, axes


def draw_arena(axes: Axes, arena: Arena) -> None:
    """Draw floor and walls; what is solid inside the outline is grey."""
    from matplotlib.collections import LineCollection  # noqa: PLC0415  # see drawing_style

    parts = shapely.get_parts(arena.polygon)
    for part in parts:
        axes.fill(*np.asarray(part.exterior.coords).T[:2], facecolor=SOLID, edgecolor="none", zorder=0)
    # A part may stand in another's hole: all floors come after all that is solid.
    for part in parts:
        axes.add_patch(_patch(part, facecolor=_FLOOR, edgecolor="none", zorder=0.5))
    walls = np.stack([arena.wall_start, arena.wall_end], axis=1)
    axes.add_collection(LineCollection(list(walls), colors=_WALL, linewidths=1.6, capstyle="round", zorder=3))


def set_title(figure: Figure, first: str, second: str) -> None:
    """Put two lines above the picture, as they are: a dollar sign in a file's name is no formula."""
    figure.suptitle(f"{first}\n{second}", fontsize=11, parse_math=False)


def draw_legend(figure: Figure, axes: Axes) -> None:
    """Put the legend below the picture."""
    from matplotlib.collections import PathCollection  # noqa: PLC0415  # see drawing_style

    handles, labels = axes.get_legend_handles_labels()
    if handles:
        columns = max(1, int(figure.get_figwidth() / _LEGEND_COLUMN_INCHES))
        legend = figure.legend(
            handles, labels, loc="outside lower center", ncols=columns, frameon=False, handletextpad=0.4, columnspacing=1.2
        )
        for handle in legend.legend_handles:
            if isinstance(handle, PathCollection):  # the dots of a crowd are too small to be recognised alone
                handle.set_sizes(np.clip(handle.get_sizes(), _LEGEND_DOT_AREA, None))


def summary(run: RecordedRun, *, met: int, landmarks: int) -> str:
    """Say in one line how many there are and how long it took."""
    named = f"{landmarks} landmark{'' if landmarks == 1 else 's'}"
    return (
        f"{run.ids.size:,} biobot{'' if run.ids.size == 1 else 's'} ({named}), {met:,} encounter{'' if met == 1 else 's'} in "
        f"{round(run.end_s, 1):g} s; lengths in {_plural(run.unit)}"
    )


def save(figure: Figure, *, image_format: ImageFormat, size: PictureSize) -> bytes:
    """Return a figure as the bytes of a file."""
    buffer = io.BytesIO()
    metadata = {"Date": None} if image_format == "svg" else {"Software": None}
    figure.savefig(buffer, format=image_format, dpi=size.dpi, metadata=metadata)
    return buffer.getvalue()


def nice_length(wanted: float) -> float:
    """Return the longest of 1, 2 or 5 times a power of ten that is not above ``wanted``."""
    power = 10.0 ** math.floor(math.log10(wanted))
    return power * max(factor for factor in (1, 2, 5) if factor * power <= wanted * (1 + 1e-9) or factor == 1)


def length_text(length: float, unit: str) -> str:
    """Write a length with its unit."""
    return f"{length:g} {unit if length == 1 else _plural(unit)}"


def _plural(unit: str) -> str:
    return "units" if unit == "unit" else unit


def _patch(part: shapely.Polygon, **style: Any) -> PathPatch:  # style: matplotlib's own open set of keywords

    from matplotlib.patches import PathPatch  # noqa: PLC0415  # see drawing_style
    from matplotlib.path import Path as Outline  # noqa: PLC0415  # same

    rings = [np.asarray(ring.coords)[:, :2] for ring in (part.exterior, *part.interiors)]
    return PathPatch(Outline.make_compound_path(*(Outline(ring, closed=True) for ring in rings)), **style)


def _draw_changes(axes: Axes, run: RecordedRun) -> None:
    for (_, before), (at_s, after) in zip(run.arenas, run.arenas[1:], strict=False):
        changed = before.polygon.symmetric_difference(after.polygon)
        for number, part in enumerate(one for one in shapely.get_parts(changed) if one.geom_type == "Polygon"):
            label = f"walls change at {at_s:g} s" if number == 0 else None
            axes.add_patch(_patch(part, facecolor="none", edgecolor=MEETING, hatch="////", linewidth=0.8, zorder=3.5, label=label))


def _draw_encounters(axes: Axes, run: RecordedRun) -> None:
    count = run.met_start_s.size
    dots = axes.scatter(
        run.met_place[:, 0],
        run.met_place[:, 1],
        c=(run.met_start_s + run.met_end_s) / 2.0,
        cmap="viridis",
        vmin=0.0,
        vmax=run.end_s or 1.0,
        s=float(np.clip(12_000.0 / count, 1.5, 14.0)),
        alpha=0.75,
        linewidths=0,
        zorder=1.5,
        rasterized=count > _MAX_VECTOR_DOTS,
    )
    axes.figure.colorbar(dots, ax=axes, label="time of an encounter (dot) [s]", shrink=0.75, pad=0.02)


def _draw_paths(axes: Axes, run: RecordedRun, rows: list[int]) -> None:
    if not rows:
        return
    lines = run.track.lines(rows=np.array(rows, dtype=np.int64), from_s=float(run.t_s[0]), to_s=run.end_s)
    if len(rows) > len(_PATHS):
        _draw_many_paths(axes, lines)
        return
    for row, line, colour in zip(rows, lines, _PATHS, strict=False):
        axes.plot(*line.T, color=colour, linewidth=1.1, alpha=0.9, zorder=4, label=f"path of {run.ids[row]}")
        axes.scatter(line[0, 0], line[0, 1], s=26, facecolors="white", edgecolors=colour, linewidths=1.4, zorder=5)
        axes.scatter(line[-1, 0], line[-1, 1], s=26, color=colour, linewidths=0, zorder=5)


def _draw_many_paths(axes: Axes, lines: Floats) -> None:
    from matplotlib.collections import LineCollection  # noqa: PLC0415  # see drawing_style

    alpha = float(np.clip(30.0 / len(lines), 0.08, 0.8))
    axes.add_collection(LineCollection(list(lines), colors=_MANY_PATHS, linewidths=0.6, alpha=alpha, zorder=1.2))
    axes.plot([], [], color=_MANY_PATHS, linewidth=1, label=f"paths of {len(lines):,} biobots")
