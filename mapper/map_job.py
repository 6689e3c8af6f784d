"""The job of the computing process: from a snapshot of the store to the documents that are served.

The pipeline is imported where it runs: the serving process needs these functions only by name.
"""

from __future__ import annotations

import pickle
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from firmware_protocol.contract.records import Cause, Mode
from mapper.record_columns import StoreSnapshot, to_unsigned

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mapper.render import ImageFormat
    from mapper.report import JsonObject, JsonValue
    from mapper.types import MapResult, ModeSpell, Recipe

_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class TooFew:
    """There are fewer encounters than a map needs."""

    n_encounters: int
    minimum: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MapDocuments:
    """A finished map: two JSON objects, and the result for pictures (as bytes: only the drawing process opens them)."""

    map_json: bytes
    diagram_json: bytes
    n_encounters: int
    drawing: bytes


def make_map(snapshot: StoreSnapshot, recipe: Recipe) -> MapDocuments | TooFew:
    """Compute the map and put it into JSON."""
    from mapper.pipeline import MIN_ENCOUNTERS, compute_map  # noqa: PLC0415  # see the module's docstring
    from mapper.report import to_json_object  # noqa: PLC0415  # same

    table, spells = snapshot.table, snapshot.spells
    if len(table) < MIN_ENCOUNTERS:
        return TooFew(n_encounters=len(table), minimum=MIN_ENCOUNTERS)
    result = compute_map(table, spells, recipe)
    document = to_json_object(result)
    for point, id1, id2 in zip(_objects(document["points"]), result.points.id1.tolist(), result.points.id2.tolist(), strict=True):
        point["id1"], point["id2"] = to_unsigned(id1), to_unsigned(id2)
    document["landmarks"] = list(_place_landmarks(result, spells))
    document["since_s"] = None if snapshot.since_ns is None else snapshot.since_ns / _NS_PER_S
    document["n_before"] = snapshot.n_before
    document["last_encounter_s"] = int(table.t_end_ns.max()) / _NS_PER_S
    return MapDocuments(
        map_json=msgspec.json.encode(document),
        diagram_json=msgspec.json.encode(_describe_diagram(result)),
        n_encounters=result.n_encounters,
        drawing=pickle.dumps(result),
    )


def draw_map(drawing: bytes, image_format: ImageFormat) -> bytes:
    """Draw a map that `make_map` made."""
    from mapper.render import render_map  # noqa: PLC0415  # see the module's docstring

    result: MapResult = pickle.loads(drawing)  # noqa: S301  # made by make_map in a process of ours
    return render_map(result, image_format=image_format)


def _objects(value: JsonValue) -> Iterable[JsonObject]:
    return (item for item in value if isinstance(item, dict)) if isinstance(value, list) else ()


def _place_landmarks(result: MapResult, spells: Sequence[ModeSpell]) -> Iterable[JsonObject]:
    """Place each landmark where it stood: at the mean of the drawn encounters it had while it stood there by command."""
    stood = [spell for spell in spells if spell.mode is Mode.S and spell.cause is Cause.COMMAND]
    points = result.points
    rows_of: defaultdict[int, list[int]] = defaultdict(list)
    for row, pair in enumerate(zip(points.id1.tolist(), points.id2.tolist(), strict=True)):
        for node in pair:
            rows_of[node].append(row)
    for spell in stood:
        rows = [
            row
            for row in rows_of[spell.node]
            if points.t_ns[row] >= spell.t_start_ns and (spell.t_end_ns is None or points.t_ns[row] <= spell.t_end_ns)
        ]
        if rows:
            yield {
                "id": to_unsigned(spell.node),
                "x": float(points.x[rows].mean()),
                "y": float(points.y[rows].mean()),
                "component": int(points.component[rows[0]]),
            }


def _describe_diagram(result: MapResult) -> JsonObject:
    """Say of every interval whether it is real: in dimension 1 those with a hole, in dimension 0 the longest of each component."""
    holes = {(hole.component, hole.birth, hole.death) for hole in result.holes}
    dimensions: dict[str, JsonValue] = {}
    for dimension in (0, 1):
        intervals: list[JsonValue] = []
        for component, part in enumerate(result.components):
            for rank, (birth, death) in enumerate(part.intervals[dimension].tolist()):
                is_real = rank < part.betti_numbers[0] if dimension == 0 else (component, birth, death) in holes
                end = None if death == float("inf") else death
                intervals.append({"birth": birth, "death": end, "component": component, "is_real": is_real})
        dimensions[str(dimension)] = intervals
    return {
        "betti_numbers": list(result.betti_numbers),
        "intervals": dimensions,
        "diameter": result.diameter,
        "length_unit": result.length_unit,
        "n_encounters": result.n_encounters,
    }
