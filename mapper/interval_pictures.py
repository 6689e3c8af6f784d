"""Draw the persistence diagram or the barcode of a map by itself, as SVG or PNG, with what separates what counts from the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mapper.confidence import holes_text
from mapper.interval_lists import Bar, Line, list_bars, list_lines, sort_bars
from mapper.render import ImageFormat, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mapper.types import FloatArray, MapResult

# As in the picture of the map (Wong 2011).
_REAL, _LOOP, _MERGE, _LINE = "#d55e00", "#0072b2", "#999999", "#000000"
_SHOWN_BARS = 60
"""Of each dimension, all that count and the longest others: more are a grey wedge."""


def render_diagram(result: MapResult, *, image_format: ImageFormat) -> bytes:
    """Draw birth and death of every interval; equal maps give equal bytes with one version of matplotlib."""

    def draw(axes: Axes) -> None:
        limit = 1.05 * (result.diameter or 1.0)
        axes.plot([0, limit], [0, limit], color=_MERGE, linewidth=0.8)
        for dimension, marker, colour in ((0, "s", _MERGE), (1, "o", _LOOP)):
            bars = list_bars(result, dimension)
            places = np.array([(bar.birth, min(bar.death, limit)) for bar in bars]).reshape(-1, 2)
            axes.scatter(places[:, 0], places[:, 1], marker=marker, s=14, color=colour, label=f"dimension {dimension}")
            counted = places[[bar.is_real for bar in bars]] if dimension == 1 else places[:0]
            if len(counted):
                axes.scatter(counted[:, 0], counted[:, 1], s=70, facecolors="none", edgecolors=_REAL, linewidths=2, label="called a hole")
            for bar, (birth, death) in zip(bars, places.tolist(), strict=True):
                if name := _name(bar):
                    axes.annotate(name, (birth, death), xytext=(7, 4), textcoords="offset points", fontsize=8, color=_REAL)
        _draw_lines(axes, list_lines(result), limit=limit)
        axes.set_xlim(-0.02 * limit, limit)
        axes.set_ylim(-0.02 * limit, 1.03 * limit)
        axes.set_aspect("equal")
        axes.set_title(_title("persistence diagram", result))
        axes.set_xlabel(f"birth [{result.length_unit}]")
        axes.set_ylabel(f"death [{result.length_unit}] (never: at the top)")
        axes.legend(loc="lower right", fontsize="small")

    return save_figure(draw, size=(6.2, 6), image_format=image_format)


def render_barcode(result: MapResult, *, image_format: ImageFormat) -> bytes:
    """Draw every interval as a bar from birth to death, those that count on top, and a line below them."""

    def draw(axes: Axes) -> None:
        limit = 1.05 * (result.diameter or 1.0)
        y = 0
        for dimension, colour in ((1, _LOOP), (0, _MERGE)):
            bars = sort_bars(list_bars(result, dimension))
            n_real = sum(bar.is_real for bar in bars)
            shown = bars[: n_real + _SHOWN_BARS]
            top = y
            for number, bar in enumerate(shown):
                axes.hlines(y, bar.birth, min(bar.death, limit), color=_REAL if bar.is_real and dimension == 1 else colour, linewidth=2)
                if name := _name(bar):
                    axes.annotate(
                        name, (min(bar.death, limit), y), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8, color=_REAL
                    )
                y -= 1
                if number + 1 == n_real:
                    axes.axhline(y + 0.5, color=_LINE, linewidth=1, linestyle="--")
            more = f", {len(bars) - len(shown)} shorter ones left out" if len(bars) > len(shown) else ""
            name = "loops" if dimension == 1 else "merging parts"
            text = f"dimension {dimension}: {name}, {n_real} of {len(bars)} count{more}"
            axes.annotate(text, (0.99, top + 1.2), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=9)
            y -= 4
        axes.set_ylim(y + 2, 5)
        axes.set_xlim(-0.02 * limit, 1.1 * limit)
        axes.set_yticks([])
        axes.set_title(_title("barcode", result))
        axes.set_xlabel(f"scale [{result.length_unit}]; what is above a dashed line counts")

    return save_figure(draw, size=(8, 6), image_format=image_format)


def _draw_lines(axes: Axes, lines: list[Line], *, limit: float) -> None:
    """Draw what the rule asks of loops, and beyond what length they are there in 95 of 100 maps."""
    scale = np.linspace(0.0, limit, 200)
    drawn = set()

    def draw(edge: FloatArray, *, style: str, label: str) -> None:
        axes.plot(scale, edge, color=_LINE, linewidth=1, linestyle=style, label=None if label in drawn else label)
        drawn.add(label)

    for line in lines:
        if line.dimension == 1 and (line.length is not None or line.ratio is not None):
            edge = np.maximum(scale + (line.length or 0.0), scale * (line.ratio or 0.0))
            draw(edge, style="--", label="counts above" if line.probability is None else "threshold of the rule")
        if line.sure_length is not None and line.sure_length < limit:
            draw(scale + line.sure_length, style=":", label="above: there in 95 of 100 maps")


def _name(bar: Bar) -> str:
    """Name a hole by its number and say how likely it is; a possible one by its probability."""
    sure = "" if bar.probability is None else f"{bar.probability:.0%}"
    if bar.hole is not None:
        return f"{bar.hole}: {sure}" if sure else str(bar.hole)
    return f"? {sure}" if bar.possible_hole is not None and sure else ""


def _title(what: str, result: MapResult) -> str:
    b0, b1 = result.betti_numbers
    doubt = "\nnot enough data yet" if result.data is not None and not result.data.is_enough else ""
    return f"{what}: b0 = {b0}, {holes_text(b1, result.hole_count)}, {result.n_encounters} encounters{doubt}"
