"""A map beside the truth it should show: where its points really were, and one picture of both."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from firmware_protocol.contract.records import Cause, Mode
from mapper.encounter_csv import read_modes
from studies.truth import RunTruth, find_encounters

FloatArray = npt.NDArray[np.float64]

_COLOURS = {"hole": "#d55e00", "obstacle": "#8a8a8a", "triangle": "#56b4e9", "noise": "#0072b2", "component": "#999999"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedMap:
    """A map of a simulated run, laid onto the truth.

    ``true_xy``, shape (n, 2) [the run's unit]: where each point's two biobots met; ``map_xy``, shape (n, 2): the map's own
    coordinates, moved, turned, scaled and if need be mirrored onto the truth, each component for itself; ``outlines``: the holes',
    moved with their component.
    """

    document: Mapping[str, Any]
    truth: RunTruth
    true_xy: FloatArray
    map_xy: FloatArray
    outlines: tuple[FloatArray, ...]


def fit_map(document: Mapping[str, Any], truth: RunTruth) -> FittedMap:
    """Find every point of a map in the truth of the run it was made of, and lay the map onto it.

    Parameters
    ----------
    document
        The mapper's JSON object; each point is known by its two biobots and its time.

    Raises
    ------
    OtherRunError
        This map is of another run.
    """
    points = document["points"]
    columns = {name: np.array([point[name] for point in points]) for name in ("x", "y", "t", "id1", "id2", "component")}
    rows, _ = find_encounters(truth, t_s=columns["t"], id1=columns["id1"], id2=columns["id2"])
    true_xy = truth.encounter_position[rows]
    map_xy = np.column_stack([columns["x"], columns["y"]]).astype(np.float64)
    for component in np.unique(columns["component"]):
        members = columns["component"] == component
        map_xy[members] = fit_similarity(map_xy[members], true_xy[members])(map_xy[members])
    return FittedMap(
        document=document,
        truth=truth,
        true_xy=true_xy,
        map_xy=map_xy,
        outlines=tuple(map_xy[hole["points"]] for hole in document["holes"]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Similarity:
    """Shift, turn or mirror, and scale: ``y = scale * (x - centre) @ rotation + target``."""

    centre: FloatArray
    rotation: FloatArray
    scale: float
    target: FloatArray

    def __call__(self, points: FloatArray) -> FloatArray:
        """Return ``points``, shape (n, 2), moved."""
        return np.asarray(self.scale * (points - self.centre) @ self.rotation + self.target, dtype=np.float64)


def fit_similarity(points: FloatArray, target: FloatArray) -> Similarity:
    """Return the similarity, mirror images allowed, that brings ``points`` nearest to ``target`` in the mean square ([Gow75]).

    Both have shape (n, 2); fewer than two different points are only shifted.
    """
    centre, goal = points.mean(axis=0), target.mean(axis=0)
    moved = points - centre
    u, singular, vt = np.linalg.svd(moved.T @ (target - goal))
    size = float((moved**2).sum())
    return Similarity(centre=centre, rotation=u @ vt, scale=float(singular.sum()) / size if size > 0 else 1.0, target=goal)


def draw_comparison(fitted: FittedMap, path: Path, *, title: str) -> None:
    """Draw truth, map and persistence diagram side by side into a PNG or SVG file, by its ending."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  # half a second, wanted only here
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(16, 6), layout="constrained")
    FigureCanvasAgg(figure)
    truth_axes, map_axes, diagram_axes = figure.subplots(1, 3)
    figure.suptitle(title)
    colours = _place_colours(fitted.true_xy)
    _draw_truth(truth_axes, fitted, colours)
    _draw_map(map_axes, fitted, colours)
    _draw_diagram(diagram_axes, fitted.document)
    figure.savefig(path, dpi=110)


def _draw_truth(axes: Any, fitted: FittedMap, colours: FloatArray) -> None:
    truth = fitted.truth
    for ring, is_hole in _rings(truth):
        axes.fill(*ring.T, facecolor=_COLOURS["obstacle"] if is_hole else "none", edgecolor="black", linewidth=1.2, zorder=1)
    axes.scatter(*truth.encounter_position.T, s=2, color="#cccccc", zorder=2)
    axes.scatter(*fitted.true_xy.T, s=22, c=colours, zorder=3, label="sampled encounter")
    axes.scatter(*_landmarks(truth).T, s=60, marker="^", facecolor="white", edgecolor="black", zorder=4, label="landmark")
    axes.set(title="truth: where they met", aspect="equal", xlabel=f"x [{truth.unit}]", ylabel=f"y [{truth.unit}]")
    axes.legend(loc="upper left", fontsize="small")


def _draw_map(axes: Any, fitted: FittedMap, colours: FloatArray) -> None:
    from matplotlib.collections import PolyCollection  # noqa: PLC0415

    triangles = np.array(fitted.document["complex"]["triangles"], dtype=np.int64).reshape(-1, 3)
    axes.add_collection(PolyCollection(list(fitted.map_xy[triangles]), facecolor=_COLOURS["triangle"], alpha=0.12, zorder=1))
    axes.scatter(*fitted.map_xy.T, s=22, c=colours, zorder=3)
    for number, outline in enumerate(fitted.outlines, start=1):
        closed = np.vstack([outline, outline[:1]])
        axes.plot(*closed.T, color=_COLOURS["hole"], linewidth=2.2, zorder=4)
        axes.annotate(str(number), outline.mean(axis=0), color=_COLOURS["hole"], weight="bold", ha="center", va="center", zorder=5)
    axes.autoscale_view()
    axes.set(
        title="map: from who met whom, and when",
        aspect="equal",
        xlabel=f"fitted x [{fitted.truth.unit}]",
        ylabel=f"fitted y [{fitted.truth.unit}]",
    )


def _draw_diagram(axes: Any, document: Mapping[str, Any]) -> None:
    unit = document["parameters"]["length_unit"]
    finite = [(birth, death) for birth, death in document["intervals"]["1"] if death is not None]
    merges = [death for _, death in document["intervals"]["0"] if death is not None]
    top = 1.05 * max([death for _, death in finite] + merges + [1e-9])
    axes.plot([0, top], [0, top], color="black", linewidth=0.8)
    axes.scatter([0] * len(merges), merges, s=14, marker="s", color=_COLOURS["component"], label="components")
    axes.scatter(*(np.array(finite).T if finite else ([], [])), s=20, color=_COLOURS["noise"], label="loops")
    holes = [(hole["birth"], hole["death"]) for hole in document["holes"] if hole["death"] is not None]
    axes.scatter(
        *(np.array(holes).T if holes else ([], [])), s=120, facecolor="none", edgecolor=_COLOURS["hole"], linewidth=2, label="called a hole"
    )
    axes.set(title="persistence diagram", xlabel=f"birth [{unit}]", ylabel=f"death [{unit}]", aspect="equal")
    axes.legend(loc="lower right")


def _rings(truth: RunTruth) -> list[tuple[FloatArray, bool]]:
    polygons = shapely.get_parts(truth.arena.polygon)
    rings = [(ring, index > 0) for polygon in polygons for index, ring in enumerate([polygon.exterior, *polygon.interiors])]
    return [(shapely.get_coordinates(ring), is_hole) for ring, is_hole in rings]


def _place_colours(places: FloatArray) -> FloatArray:
    """One colour a place, so that neighbours in the truth can be found again in the map; shape (n, 3), RGB."""
    low, high = places.min(axis=0), places.max(axis=0)
    u, v = ((places - low) / np.where(high > low, high - low, 1.0)).T
    return np.stack([0.15 + 0.8 * u, 0.25 + 0.55 * v, 0.95 - 0.75 * u * 0.6 - 0.3 * v], axis=1).clip(0, 1)


def _landmarks(truth: RunTruth) -> FloatArray:
    """Where those are that stand still by command at the end of the run; shape (k, 2)."""
    spells = read_modes(truth.directory / "modes.csv")
    last = {spell.node: spell for spell in sorted(spells, key=lambda spell: spell.t_start_ns)}
    landmarks = [node for node, spell in last.items() if spell.mode is Mode.S and spell.cause is Cause.COMMAND]
    standing: FloatArray = truth.position[-1][np.isin(truth.ids, landmarks)]
    return standing
