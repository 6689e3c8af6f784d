"""Draw a map and its persistence diagram, as SVG or PNG. Matplotlib is imported only when a picture is asked for."""

from __future__ import annotations

import io
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from mapper.confidence import holes_text
from mapper.config import RecipeConfig, make_recipe
from mapper.frames import Similarity

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

    from mapper.pins import Pinned
    from mapper.types import FloatArray, Hole, MapResult, Recipe

ImageFormat = Literal["svg", "png"]

# Colours that the common colour vision deficiencies keep apart (Wong 2011).
_TRIANGLE, _EDGE, _HOLE, _NOISE, _LANDMARK, _PIN = "#56b4e9", "#999999", "#d55e00", "#0072b2", "#000000", "#cc79a7"
# More triangles than this hide each other and only make the file large.
_MAX_DRAWN_TRIANGLES = 20_000
# Of a loop that is not called a hole.
_DRAWN_PROBABILITY = 0.1
_CAPTION_NAMES, _CAPTION_NAME_LENGTH = 10, 16


def render_map(result: MapResult, *, image_format: ImageFormat, part: str | None = None, pinned: Pinned | None = None) -> bytes:
    """Draw points, complex and hole outlines beside the persistence diagram.

    Parameters
    ----------
    part
        Of which part of a record the map is, for its title; None for all of it.
    pinned
        The operator's frame, in whose metres the map is drawn then; components without pins stand to the right of it.

    Returns
    -------
    bytes
        The image file. Equal maps give equal bytes with one version of matplotlib.

    Notes
    -----
    Of more than 20,000 triangles only an even selection is drawn.
    """

    def draw(map_axes: Axes, diagram_axes: Axes) -> None:
        _draw_map(map_axes, _in_frame(result, pinned), part=part, pinned=pinned)
        _draw_diagram(diagram_axes, result, title="persistence diagram" + ("" if pinned is None else "\nin lengths of the map itself"))

    return save_figure(draw, size=(11, 5.5), image_format=image_format, widths=(1.2, 1.0), caption=_caption(result))


def save_figure(
    draw: Callable[..., None],
    *,
    size: tuple[float, float],
    image_format: ImageFormat,
    widths: tuple[float, ...] = (1.0,),
    caption: str | None = None,
) -> bytes:
    """Have a figure drawn, and return its file.

    Parameters
    ----------
    draw
        Called with the axes, one for each of the relative ``widths``.
    size
        Width and height [inch].
    caption
        What stands below all of it.
    """
    import matplotlib as mpl  # noqa: PLC0415  # a map without pictures must not wait for it
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  # same
    from matplotlib.figure import Figure  # noqa: PLC0415  # same

    buffer = io.BytesIO()
    # Fixed ids and no date: the same map is the same file.
    with mpl.rc_context({"svg.hashsalt": "biobot", "svg.fonttype": "none"}), warnings.catch_warnings():
        # Names may be in any script: an SVG has them as they are, and a PNG boxes in place of what its font lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        draw(*figure.subplots(1, len(widths), width_ratios=widths, squeeze=False)[0])
        if caption:
            figure.supxlabel(caption, fontsize=7, parse_math=False)
        figure.savefig(buffer, format=image_format, dpi=120, metadata={"Date": None} if image_format == "svg" else None)
    return buffer.getvalue()


def _caption(result: MapResult) -> str | None:
    """Say below the picture who stands still, and whether the count of holes can be trusted; nothing for maps that no log made."""
    standing = result.standing
    if standing is None:
        return None
    lines = []
    if standing.nodes:
        named = [result.node_names.get(node, str(node)) for node in standing.nodes]
        more = f" and {len(named) - _CAPTION_NAMES} more" if len(named) > _CAPTION_NAMES else ""
        lines.append(f"stand still ({standing.source}): {', '.join(name[:_CAPTION_NAME_LENGTH] for name in named[:_CAPTION_NAMES])}{more}")
    lines += [one.text for one in result.assumptions if one.name == "hole_count" and one.holds is False]
    return "\n".join(lines) or None


def _in_frame(result: MapResult, pinned: Pinned | None) -> MapResult:
    """Return the map with all that has a place in metres of the operator's frame."""
    if pinned is None:
        return result
    xy = np.column_stack([result.points.x, result.points.y])
    fits = {component: fit.similarity for component, fit in pinned.frame.fits.items()}
    drawn = np.concatenate([fits[component](xy[result.points.component == component]) for component in fits])
    for component in range(len(result.components)):
        own = xy[result.points.component == component]
        if component not in fits:
            # As far away as the others are wide by a tenth, and to their scale: nothing else is known of its place.
            scale = next(iter(fits.values())).scale
            left, low = drawn[:, 0].max() + 0.1 * np.ptp(drawn[:, 0]), drawn[:, 1].min()
            shift = (float(left - scale * own[:, 0].min()), float(low - scale * own[:, 1].min()))
            fits[component] = Similarity(scale=scale, turn_rad=0.0, is_mirrored=False, shift=shift)
            drawn = np.concatenate([drawn, fits[component](own)])
    moved = np.array([fits[component](place[None])[0] for component, place in zip(result.points.component.tolist(), xy, strict=True)])
    return replace(
        result,
        points=replace(result.points, x=moved[:, 0], y=moved[:, 1]),
        holes=tuple(
            replace(hole, outline_xy=fits[hole.component](hole.outline_xy), centre=fits[hole.component](hole.centre[None])[0])
            if hole.centre is not None
            else hole
            for hole in result.holes
        ),
        landmarks=tuple(
            replace(one, **dict(zip("xy", fits[one.component](np.array([[one.x, one.y]]))[0].tolist(), strict=True)))
            for one in result.landmarks
        ),
    )


def _draw_map(axes: Axes, result: MapResult, *, part: str | None, pinned: Pinned | None) -> None:
    from matplotlib.collections import LineCollection, PolyCollection  # noqa: PLC0415  # see render_map

    points = result.points
    xy = np.column_stack([points.x, points.y])
    step = max(1, -(-len(result.triangles) // _MAX_DRAWN_TRIANGLES))
    axes.add_collection(PolyCollection(list(xy[result.triangles[::step]]), facecolors=_TRIANGLE, edgecolors="none", alpha=0.12, zorder=1))
    axes.add_collection(LineCollection(list(xy[result.edges]), colors=_EDGE, linewidths=0.3, alpha=0.6, zorder=2))
    _draw_points(axes, result, time_s=(points.t_ns - points.t_ns.min()) / 1e9)
    for number, hole in enumerate(result.holes, start=1):
        _draw_hole(axes, xy, hole, number=number)
    for hole in result.possible_holes:
        if (hole.probability or 0.0) >= _DRAWN_PROBABILITY:
            outline = xy[np.append(hole.outline, hole.outline[0])]
            axes.plot(*outline.T, color=_HOLE, linewidth=1.2, linestyle="--", zorder=4)
            _name(axes, hole, "?", outline[:-1].mean(axis=0))
    if result.landmarks:
        places = np.array([(landmark.x, landmark.y) for landmark in result.landmarks])
        axes.scatter(
            places[:, 0],
            places[:, 1],
            marker="^",
            s=36,
            facecolors="none",
            edgecolors=_LANDMARK,
            linewidths=1.2,
            zorder=4,
            label="landmark",
        )
    if pinned is not None:
        for component in range(len(result.components)):
            own = xy[points.component == component]
            if component not in pinned.frame.fits:
                axes.annotate(
                    f"component {component}: no pins", (float(own[:, 0].mean()), float(own[:, 1].max())), ha="center", va="bottom"
                )
        known = np.array([pin.known_m for pin in pinned.pins])
        axes.scatter(known[:, 0], known[:, 1], marker="x", s=50, color=_PIN, linewidths=2, zorder=5, label="pin, where it is known to be")
    if result.landmarks or pinned is not None:
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=2, fontsize="small", frameon=False)
    b0, b1 = result.betti_numbers
    doubt = "not enough data yet" if result.data is not None and not result.data.is_enough else None
    unusual = ", ".join(filter(None, [doubt, part, _unusual_method(result.recipe)]))
    axes.set_title(
        f"map: b0 = {b0}, {holes_text(b1, result.hole_count)}, {result.n_encounters} encounters" + (f"\n{unusual}" if unusual else "")
    )
    axes.set_aspect("equal", adjustable="datalim")
    if pinned is None:
        axes.set_xlabel(f"x [{result.length_unit}]")
        axes.set_ylabel(f"y [{result.length_unit}]")
    else:
        is_geographic = pinned.frame.plane is not None
        axes.set_xlabel("metres east of the pins' middle" if is_geographic else "x [m], operator's frame")
        axes.set_ylabel("metres north of the pins' middle" if is_geographic else "y [m], operator's frame")
    axes.autoscale_view()


def _draw_points(axes: Axes, result: MapResult, *, time_s: FloatArray) -> None:
    """Draw well-seen points full and the others hollow, in the colour of their time."""
    from matplotlib.cm import ScalarMappable  # noqa: PLC0415  # see render_map
    from matplotlib.colors import Normalize  # noqa: PLC0415  # same

    points = result.points
    colours = ScalarMappable(norm=Normalize(0.0, max(float(time_s.max()), 1e-9)), cmap="viridis")
    is_full = np.ones(len(points), dtype=bool) if points.is_well_seen is None else points.is_well_seen
    edges: FloatArray = np.asarray(colours.to_rgba(time_s))
    axes.scatter(points.x[is_full], points.y[is_full], s=14, c=edges[is_full], edgecolors="none", zorder=3)
    rest = points.x[~is_full], points.y[~is_full]
    axes.scatter(*rest, s=10, facecolors="white", edgecolors=edges[~is_full].tolist(), linewidths=0.8, zorder=3)
    label = "time since the first encounter drawn [s]" if is_full.all() else "time since the first drawn [s]; hollow: badly seen"
    axes.figure.colorbar(colours, ax=axes, label=label, shrink=0.8)


def _draw_hole(axes: Axes, xy: FloatArray, hole: Hole, *, number: int) -> None:
    outline = xy[np.append(hole.outline, hole.outline[0])]
    axes.plot(*outline.T, color=_HOLE, linewidth=1, linestyle=":", zorder=4)
    if hole.centre is not None:
        axes.fill(*hole.outline_xy.T, facecolor="white", edgecolor=_HOLE, linewidth=2, zorder=4)
    _name(axes, hole, str(number), outline[:-1].mean(axis=0) if hole.centre is None else hole.centre)


def _name(axes: Axes, hole: Hole, name: str, place: FloatArray) -> None:
    """Write the name of a hole, and under it how likely it is there."""
    sure = "" if hole.probability is None else f"\n{hole.probability:.0%}"
    axes.annotate(name + sure, (float(place[0]), float(place[1])), color=_HOLE, weight="bold", ha="center", va="center", zorder=5)


def _unusual_method(recipe: Recipe) -> str | None:
    usual = make_recipe(RecipeConfig())
    if (recipe.method, recipe.metric) == (usual.method, usual.metric):
        return None
    return f"method {recipe.method}, metric {recipe.metric}"


def _draw_diagram(axes: Axes, result: MapResult, *, title: str) -> None:
    limit = 1.05 * (result.diameter or 1.0)
    axes.plot([0, limit], [0, limit], color=_EDGE, linewidth=0.8)
    for dimension, marker, colour in ((0, "s", _EDGE), (1, "o", _NOISE)):
        births, deaths = np.concatenate([part.intervals[dimension] for part in result.components]).T
        axes.scatter(births, np.minimum(deaths, limit), marker=marker, s=12, color=colour, label=f"dimension {dimension}")
    if result.holes:
        births, deaths = np.array([(hole.birth, hole.death) for hole in result.holes]).T
        axes.scatter(births, deaths, s=60, facecolors="none", edgecolors=_HOLE, linewidths=2, label="called a hole")
    axes.set_title(title)
    axes.set_xlabel(f"birth [{result.length_unit}]")
    axes.set_ylabel(f"death [{result.length_unit}] (never: at the top)")
    axes.set_aspect("equal")
    axes.legend(loc="lower right")
