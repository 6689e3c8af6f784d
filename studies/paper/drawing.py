"""How the figures of the paper's experiments look. Matplotlib is imported only when something is drawn."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from simulator.arenas.arena import Arena
    from studies.truth import Floats, Indices, Intervals

# Colours that the common colour vision deficiencies keep apart (Wong 2011).
BLUE, ORANGE, GREEN, SKY, PURPLE, GREY = "#0072b2", "#d55e00", "#009e73", "#56b4e9", "#cc79a7", "#8a8a8a"
SERIES = (BLUE, ORANGE, GREEN, PURPLE)
METHOD_COLOURS = {"paper": ORANGE, "default": BLUE}

_MAX_TRIANGLES = 6_000
_EDGE_INK = 1_000.0  # the more edges, the fainter each, or they hide the triangles
_DPI = 100
_COLOURS = 128
_STYLE: dict[Any, Any] = {"svg.hashsalt": "biobot", "svg.fonttype": "none", "font.size": 9, "axes.titlesize": 9, "legend.fontsize": 8}


def new_figure(n_rows: int, n_columns: int, *, size: tuple[float, float]) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure of ``size`` [inches], and its axes row by row."""
    import matplotlib as mpl  # noqa: PLC0415  # half a second that commands without figures need not wait
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  # same
    from matplotlib.figure import Figure  # noqa: PLC0415  # same

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(n_rows, n_columns, squeeze=False)
    return figure, [list(row) for row in axes]


def save_figure(figure: Figure, *, svg: Path, png: Path) -> None:
    """Write a figure twice; equal figures give equal bytes with one version of matplotlib and Pillow. The PNG has 128 colours."""
    import matplotlib as mpl  # noqa: PLC0415  # see new_figure
    from PIL import Image  # noqa: PLC0415  # same

    with mpl.rc_context(_STYLE):
        figure.savefig(svg, dpi=_DPI, metadata={"Date": None})
        figure.set_layout_engine("none")  # what was laid out stays as it is, and need not be found again
        content = io.BytesIO()
        figure.savefig(content, dpi=_DPI, format="png", metadata={"Software": None})
    Image.open(content).convert("RGB").quantize(_COLOURS).save(png, optimize=True)


def draw_arena(axes: Axes, arena: Arena) -> None:
    """Draw the walls, and fill the obstacles."""
    for polygon in arena.polygon.geoms if arena.polygon.geom_type == "MultiPolygon" else [arena.polygon]:
        axes.plot(*np.asarray(polygon.exterior.coords).T, color="black", linewidth=1.2)
        for ring in polygon.interiors:
            axes.fill(*np.asarray(ring.coords).T, facecolor="#d0d0d0", edgecolor="black", linewidth=1.0)
    axes.set_aspect("equal")


def draw_complex(axes: Axes, xy: Floats, *, edges: Indices, triangles: Indices) -> None:
    """Draw a Rips complex: its triangles filled, its edges thin, its points on top; of many triangles an even selection."""
    from matplotlib.collections import LineCollection, PolyCollection  # noqa: PLC0415  # see new_figure

    step = max(1, -(-len(triangles) // _MAX_TRIANGLES))
    faces = PolyCollection(list(xy[triangles[::step]]), facecolors=SKY, edgecolors="none", alpha=0.1, rasterized=True)
    axes.add_collection(faces)
    alpha = min(0.5, _EDGE_INK / max(1, len(edges)))
    lines = LineCollection(list(xy[edges]), colors=GREY, linewidths=0.25, alpha=alpha, rasterized=True)
    axes.add_collection(lines)
    axes.scatter(xy[:, 0], xy[:, 1], s=5, color=BLUE, zorder=3)
    axes.set_aspect("equal", adjustable="datalim")


def draw_diagrams(axes: Axes, found: Intervals, true: Intervals, *, limit: float, names: tuple[str, str]) -> None:
    """Draw a diagram on top of the true one: filled and hollow marks, dimensions 0 and 1 in blue and orange.

    Parameters
    ----------
    limit
        End of both axes [length]; what never dies stands there.
    names
        Of the two, for the legend.
    """
    axes.plot([0, limit], [0, limit], color=GREY, linewidth=0.8)
    for diagram, name, is_true in ((true, names[1], True), (found, names[0], False)):
        for dimension, marker, colour in ((0, "s", BLUE), (1, "o", ORANGE)):
            births, deaths = diagram[dimension].T
            axes.scatter(
                births,
                np.minimum(deaths, limit),
                marker=marker,
                s=34 if is_true else 9,
                facecolors="none" if is_true else colour,
                edgecolors=colour,
                linewidths=0.8 if is_true else 0.0,
                label=f"{name}, H{dimension}",
                clip_on=False,
            )
    axes.set(xlim=(0, limit), ylim=(0, limit), aspect="equal")


def mark_holes(axes: Axes, loops: Floats) -> None:
    """Put green squares around intervals called holes, shape (m, 2), as [Dir16] does."""
    if len(loops):
        axes.scatter(
            loops[:, 0],
            loops[:, 1],
            marker="s",
            s=110,
            facecolors="none",
            edgecolors=GREEN,
            linewidths=1.6,
            label="called a hole",
            clip_on=False,
        )


def draw_spread(
    axes: Axes, x: Sequence[float], groups: Sequence[Sequence[float]], *, label: str, colour: str, dashed: bool = False
) -> None:
    """Draw means over x as a line, with the quartiles as bars."""
    means = np.array([np.mean(group) for group in groups])
    low, high = (np.array([np.quantile(group, q) for group in groups]) for q in (0.25, 0.75))
    spread = np.maximum(np.stack([means - low, high - means]), 0.0)
    style = "--" if dashed else "-"
    axes.errorbar(x, means, yerr=spread, color=colour, linestyle=style, marker="o", markersize=4, linewidth=1.2, capsize=2, label=label)


def whole_decades(values: Floats) -> tuple[float, float]:
    """Return limits of a logarithmic axis for positive values that leave labels to powers of ten, which then do not overlap."""
    low, high = np.floor(np.log10([np.min(values), np.max(values)]))
    return float(10.0**low), float(10.0 ** (high + 1.0))
