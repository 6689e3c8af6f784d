"""A finished map as a JSON object for programs, and as a summary for a person. Nothing in the JSON is nan or infinite."""

from collections.abc import Mapping, Sequence
from math import isfinite

from mapper.certainty import sure_text
from mapper.confidence import describe_count
from mapper.record_columns import to_unsigned
from mapper.types import (
    BettiRule,
    ComponentMap,
    DataVerdict,
    FloatArray,
    Hole,
    HoleCount,
    Landmark,
    MapResult,
    Recipe,
    Scale,
    Standing,
    StandingSource,
)

JsonValue = None | bool | int | float | str | list["JsonValue"] | dict[str, "JsonValue"]
JsonObject = dict[str, JsonValue]

_NS_PER_S = 1e9
_LISTED_INTERVALS = 5
_LEAST_TOLD = 1e-4  # of the probabilities of numbers of holes
_LISTED_PROBABILITY = 0.1  # of a possible hole, for a person
_LISTED_NODES = 12


def to_json_object(result: MapResult) -> JsonObject:
    """Describe a map for programs.

    Returns
    -------
    JsonObject
        ``betti_numbers`` [b0, b1]; ``intervals`` of all components by dimension, death null where it never comes; ``points`` with map
        coordinates, time [s], biobots and ``is_well_seen``; ``holes`` with ``outline`` in map coordinates, ``points`` (indices), birth,
        death, component and ``probability``; of each also ``outline_xy``, the polygon of what stands in it (closed, counter-clockwise),
        ``centre`` inside it, ``area``, ``perimeter`` and their standard errors, null where they are not known; ``possible_holes`` of the
        same form; ``hole_count`` (value, its probability, that of each number, and ``is_known``); ``data`` (is_enough, reasons, remedies);
        ``landmarks`` with their places and times; ``complex`` (edges and triangles as indices of points);
        ``components`` (those mapped, each with its own figures); ``n_components`` (all there are); ``diameter``, ``n_encounters``,
        ``n_used``, ``lost_spectrum``, ``parameters`` (with ``length_unit``) and ``warnings``; ``stationary`` (ids, source,
        reason; null but for a file) and ``assumptions`` (name, holds, text). Ids are numbers, or the names that the log has for them.
        What tells how sure the map is is null where nobody knows.
    """
    points = result.points
    names = result.node_names

    def name(number: int) -> int | str:
        return names.get(number, number)

    xy = [[float(x), float(y)] for x, y in zip(points.x, points.y, strict=True)]
    is_seen = [None] * len(points) if points.is_well_seen is None else points.is_well_seen.tolist()
    rows = zip(xy, points.t_ns.tolist(), points.id1.tolist(), points.id2.tolist(), points.component.tolist(), is_seen, strict=True)
    return {
        "betti_numbers": list(result.betti_numbers),
        "intervals": {
            str(dimension): [interval for part in result.components for interval in _intervals(part.intervals[dimension])]
            for dimension in (0, 1)
        },
        "points": [
            {
                "x": place[0],
                "y": place[1],
                "t": t_ns / _NS_PER_S,
                "id1": name(id1),
                "id2": name(id2),
                "component": component,
                "is_well_seen": seen,
            }
            for place, t_ns, id1, id2, component, seen in rows
        ],
        "holes": [_hole(hole, xy) for hole in result.holes],
        "possible_holes": [_hole(hole, xy) for hole in result.possible_holes],
        "hole_count": _hole_count(result.hole_count),
        "data": _verdict(result.data),
        "landmarks": [_landmark(landmark, name(to_unsigned(landmark.node))) for landmark in result.landmarks],
        "complex": {"edges": result.edges.tolist(), "triangles": result.triangles.tolist()},
        "components": [_component(part, index) for index, part in enumerate(result.components)],
        "n_components": result.n_components,
        "diameter": result.diameter,
        "n_encounters": result.n_encounters,
        "n_used": result.n_used,
        "lost_spectrum": result.lost_spectrum,
        "parameters": _parameters(result.recipe, length_unit=result.length_unit),
        "warnings": list(result.warnings),
        "stationary": None if result.standing is None else _standing(result.standing, names),
        "assumptions": [{"name": one.name, "holds": one.holds, "text": one.text} for one in result.assumptions],
    }


def summarize(result: MapResult, *, part: str | None = None) -> str:
    """Describe a map in a few lines for a person; without the warnings. ``part`` says of which part of a record the map is."""
    b0, b1 = result.betti_numbers
    unit = result.length_unit
    recipe = result.recipe
    doubt = "" if result.data is None or result.data.is_enough else ": NOT ENOUGH DATA YET"
    lines = [
        f"{_counted(b0, 'component')}, {_holes(b1, result.hole_count)}{doubt}",
        *_doubts(result.data),
        f"encounters     {result.n_encounters}, of which {result.n_used} used; {len(result.points)} points drawn",
        *([] if part is None else [f"part           {part}"]),
        f"method         {recipe.method}, metric {recipe.metric}",
        f"diameter       {result.diameter:.6g} {unit}",
        f"lost spectrum  {result.lost_spectrum:.1%} of the shape does not fit the plane",
        *(f"scale          {scale.factor:.3f} of the way walked, give or take {scale.error:.1%}" for scale in _scales(result)),
    ]
    lines += [
        f"hole {number:<9} {_sure(hole)}birth {hole.birth:.6g} {unit}, death {hole.death:.6g} {unit}, component {hole.component}"
        f"{_size(hole, unit)}"
        for number, hole in enumerate(result.holes, start=1)
    ]
    lines += [
        f"possible hole  {_sure(hole)}birth {hole.birth:.6g} {unit}, death {hole.death:.6g} {unit}, component {hole.component}"
        for hole in result.possible_holes
        if (hole.probability or 0.0) >= _LISTED_PROBABILITY
    ]
    lines += [
        f"component {index:<4} encounters {part.n_encounters}, landmarks {part.n_landmarks}, holes {part.betti_numbers[1]}"
        + ("" if part.stability_band is None else f", loops within {part.stability_band:.3g} {unit}")
        for index, part in enumerate(result.components)
    ]
    longest = ", ".join(
        f"{birth:.4g}-{death:.4g}" for part in result.components for birth, death in part.intervals[1][:_LISTED_INTERVALS].tolist()
    )
    lines.append(f"longest loops  {longest or 'none'} [{unit}]")
    if result.standing is not None:
        lines.append(f"stand still    {_named(result.standing, result.node_names)}: {result.standing.reason}")
    broken = [one.text for one in result.assumptions if one.holds is False]
    return "\n".join([*lines, *([] if not broken else ["what cannot be concluded:", *(f"- {text}" for text in broken)])])


def _holes(number: int, count: HoleCount | None) -> str:
    if count is None:
        return _counted(number, "hole")
    told = describe_count(count)
    return f"{_counted(number, 'hole')} ({told})" if count.is_known else f"holes: {told}"


def _standing(standing: Standing, names: Mapping[int, str]) -> JsonObject:
    ids: list[JsonValue] = [names.get(node, node) for node in standing.nodes]
    return {"ids": ids, "source": str(standing.source), "reason": standing.reason}


def _named(standing: Standing, names: Mapping[int, str]) -> str:
    if not standing.nodes:
        return "as the modes say" if standing.source is StandingSource.MODES else "nobody is known to"
    listed = [names.get(node, str(node)) for node in standing.nodes[:_LISTED_NODES]]
    return ", ".join(listed) + (f" and {len(standing.nodes) - _LISTED_NODES} more" if len(standing.nodes) > _LISTED_NODES else "")


def _scales(result: MapResult) -> list[Scale]:
    return [part.scale for part in result.components if part.scale is not None]


def _doubts(data: DataVerdict | None) -> list[str]:
    """Say why the data are not enough, and what would help."""
    if data is None or data.is_enough:
        return []
    return [
        *(f"  because {reason}" for reason in data.reasons),
        *(f"  it would help to {remedy}" for remedy in data.remedies),
    ]


def _sure(hole: Hole) -> str:
    return "" if hole.probability is None else f"{sure_text(hole.probability)}, "


def _hole(hole: Hole, xy: Sequence[list[float]]) -> JsonObject:
    return {
        "outline": [list(xy[point]) for point in hole.outline.tolist()],
        "points": hole.outline.tolist(),
        "birth": hole.birth,
        "death": hole.death,
        "component": hole.component,
        "probability": hole.probability,
        **_shape(hole),
    }


def _hole_count(count: HoleCount | None) -> JsonObject | None:
    if count is None:
        return None
    probabilities: JsonObject = {str(number): chance for number, chance in enumerate(count.probabilities) if chance >= _LEAST_TOLD}
    return {"value": count.value, "probability": count.probability, "probabilities": probabilities, "is_known": count.is_known}


def _verdict(data: DataVerdict | None) -> JsonObject | None:
    if data is None:
        return None
    return {"is_enough": data.is_enough, "reasons": list(data.reasons), "remedies": list(data.remedies)}


def _component(part: ComponentMap, index: int) -> JsonObject:
    return {
        "component": index,
        "betti_numbers": list(part.betti_numbers),
        "intervals": {str(dimension): list(_intervals(part.intervals[dimension])) for dimension in (0, 1)},
        "n_encounters": part.n_encounters,
        "n_used": part.n_used,
        "n_points": part.n_points,
        "n_landmarks": part.n_landmarks,
        "diameter": part.diameter,
        "cover_radius": part.cover_radius,
        "epsilon": part.epsilon,
        "lost_spectrum": part.lost_spectrum,
        "scale": None if part.scale is None else {"factor": part.scale.factor, "error": part.scale.error},
        "stability_band": part.stability_band,
    }


def _shape(hole: Hole) -> JsonObject:
    ring = hole.outline_xy.tolist()
    return {
        "outline_xy": [*ring, *ring[:1]],
        "centre": None if hole.centre is None else hole.centre.tolist(),
        "area": hole.area,
        "area_error": hole.area_error,
        "perimeter": hole.perimeter,
        "perimeter_error": hole.perimeter_error,
    }


def _landmark(landmark: Landmark, name: int | str) -> JsonObject:
    end_ns = landmark.t_end_ns
    return {
        "id": name,
        "x": landmark.x,
        "y": landmark.y,
        "component": landmark.component,
        "t_start": landmark.t_start_ns / _NS_PER_S,
        "t_end": None if end_ns is None else end_ns / _NS_PER_S,
    }


def _size(hole: Hole, unit: str) -> str:
    perimeter = "" if hole.perimeter is None else f", perimeter {hole.perimeter:.3g} +- {_rounded(hole.perimeter_error)} {unit}"
    area = "" if hole.area is None else f", area {hole.area:.3g} +- {_rounded(hole.area_error)} {unit}^2"
    return perimeter + area


def _rounded(error: float | None) -> str:
    """Tell an error by two digits, as ``140`` and not as ``1.4e+02``."""
    return f"{float(f'{error or 0.0:.2g}'):g}"


def _intervals(intervals: FloatArray) -> list[JsonValue]:
    return [[birth, death if isfinite(death) else None] for birth, death in intervals.tolist()]


def _parameters(recipe: Recipe, *, length_unit: str) -> JsonObject:
    rules = recipe.betti_rules or ()
    return {
        "method": str(recipe.method),
        "metric": str(recipe.metric),
        "profile_norm": str(recipe.profile_norm),
        "moving_time": recipe.moving_time,
        "bracketed": recipe.bracketed,
        "placed": recipe.placed,
        "smoothing_share": recipe.smoothing_share,
        "smoothing_passes": recipe.smoothing_passes,
        "max_candidates": recipe.max_candidates,
        "outlier_k": recipe.outlier_k,
        "outlier_q": recipe.outlier_q,
        "n_points": recipe.n_points,
        "encounters_per_point": recipe.encounters_per_point,
        "n_anchors": recipe.n_anchors,
        "epsilon_share": recipe.epsilon_share,
        "betti_rules": {str(dimension): _rule(rule) for dimension, rule in enumerate(rules)},
        "speed_mps": recipe.speed_mps,
        "replicates": recipe.replicates,
        "length_unit": length_unit,
    }


def _rule(rule: BettiRule) -> JsonObject:
    return {"rule": str(rule.kind), "q": rule.q, "delta": rule.delta, "tau": rule.tau, "power": rule.power}


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
