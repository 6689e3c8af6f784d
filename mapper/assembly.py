"""Components that were mapped each by itself, put side by side as one map."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mapper.component_map import PlacedComponent
from mapper.landmark_stands import Stands, make_landmarks
from mapper.types import GAP_SHARE, EncounterTable, FloatArray, Hole, IntArray, MapResult, Points, Recipe, read_only


def assemble(
    table: EncounterTable, placed: Sequence[PlacedComponent], recipe: Recipe, *, n_components: int, warnings: tuple[str, ...]
) -> MapResult:
    """Put components that were drawn side by side, the largest first, as one map.

    Parameters
    ----------
    n_components
        How many there are, those that were not mapped too.
    """
    encounters = np.concatenate([part.encounters for part in placed])
    offsets = np.cumsum([0, *(len(part.encounters) for part in placed)])
    coordinates = _side_by_side(placed)
    summaries = tuple(part.summary for part in placed)
    return MapResult(
        betti_numbers=(sum(s.betti_numbers[0] for s in summaries), sum(s.betti_numbers[1] for s in summaries)),
        points=_make_points(table, encounters, coordinates, component=np.repeat(np.arange(len(placed)), np.diff(offsets))),
        components=summaries,
        holes=tuple(
            _move_hole(hole, first_point=int(offset), shift=coordinates[offset] - part.coordinates[0])
            for part, offset in zip(placed, offsets, strict=False)
            for hole in part.holes
        ),
        edges=read_only(np.concatenate([part.skeleton.edges + offset for part, offset in zip(placed, offsets, strict=False)])),
        triangles=read_only(np.concatenate([part.skeleton.triangles + offset for part, offset in zip(placed, offsets, strict=False)])),
        diameter=max(s.diameter for s in summaries),
        lost_spectrum=max(s.lost_spectrum for s in summaries),
        n_encounters=len(table),
        n_used=sum(s.n_used for s in summaries),
        n_components=n_components,
        length_unit="s" if recipe.speed_mps is None else "m",
        recipe=recipe,
        warnings=warnings,
    )


def add_others(
    result: MapResult, table: EncounterTable, placed: Sequence[PlacedComponent], *, rows: IntArray, component: IntArray, stands: Stands
) -> MapResult:
    """Add landmarks, and the other encounters that were to be placed: the first ``rows`` are those of the stands."""
    coordinates = np.zeros((len(rows), 2))
    for index, part in enumerate(placed):
        first = int(np.searchsorted(result.points.component, index))
        shift = np.array([result.points.x[first], result.points.y[first]]) - part.coordinates[0]
        coordinates[component == index] = part.others + shift
    is_placed = (component < len(placed)) & np.isfinite(coordinates).all(axis=1)
    n_stands = len(stands.rows)
    of_stands, of_others = (np.flatnonzero(is_placed[some]) for some in (slice(n_stands), slice(n_stands, None)))
    landmarks = make_landmarks(stands, is_placed=is_placed[:n_stands], places=coordinates[of_stands], component=component[of_stands])
    of_others += n_stands
    others = _make_points(table, rows[of_others], coordinates[of_others], component=component[of_others])
    return replace(result, landmarks=landmarks, others=others if len(others) else None)


def _make_points(table: EncounterTable, encounters: IntArray, coordinates: FloatArray, *, component: IntArray) -> Points:
    start, end = table.t_start_ns[encounters], table.t_end_ns[encounters]
    return Points(
        x=read_only(coordinates[:, 0].copy()),
        y=read_only(coordinates[:, 1].copy()),
        t_ns=read_only(start + (end - start) // 2),
        id1=read_only(table.id1[encounters]),
        id2=read_only(table.id2[encounters]),
        component=read_only(component),
        encounter=read_only(encounters),
    )


def _move_hole(hole: Hole, *, first_point: int, shift: FloatArray) -> Hole:
    """Put a hole of one component among those of all: its points count from ``first_point``, its places move by ``shift``, shape (2,)."""
    return replace(
        hole,
        outline=read_only(hole.outline + first_point),
        outline_xy=read_only(hole.outline_xy + shift),
        centre=None if hole.centre is None else read_only(hole.centre + shift),
    )


def _side_by_side(placed: Sequence[PlacedComponent]) -> FloatArray:
    """Move each component to the right of the one before; the first stays where it is."""
    gap = GAP_SHARE * max(part.summary.diameter for part in placed)
    moved = [placed[0].coordinates]
    for part in placed[1:]:
        shift = moved[-1][:, 0].max() + gap - part.coordinates[:, 0].min()
        moved.append(part.coordinates + np.array([shift, 0.0]))
    return np.concatenate(moved)
