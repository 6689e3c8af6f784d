"""The intervals of a finished map: which count, how likely each is, which hole it is, and what separates it from the others."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isfinite

from mapper.betti import find_threshold
from mapper.confidence import LEAST_CLAIMED
from mapper.report import JsonObject, JsonValue
from mapper.types import Hole, MapResult

_WHOLE = 1.0 - 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """One interval of a map.

    ``death`` is inf where it never comes. ``is_real``: it counts in the Betti number; in dimension 0 the longest of each component do.
    ``probability``: that it goes around an obstacle, None where nobody knows, or where it is too small to tell of. ``hole`` and
    ``possible_hole``: its number in those lists of the map, from 1.
    """

    dimension: int
    component: int
    birth: float
    death: float
    is_real: bool
    probability: float | None = None
    hole: int | None = None
    possible_hole: int | None = None

    @property
    def length(self) -> float:
        """How long it lasts."""
        return self.death - self.birth


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """What separates the intervals of a component and dimension that count from the others.

    The rule asks for more than ``length``, and for death over birth above ``ratio``; None: it asks nothing of that, or (``is_open`` False)
    lets no finite interval count. Where ``probability`` is given the rule only takes part: as many of the likeliest count as there are
    holes, none of less than it. Those longer than ``sure_length`` are there in 95 of 100 maps: twice the stability band.
    """

    dimension: int
    component: int
    is_open: bool
    length: float | None
    ratio: float | None
    probability: float | None
    sure_length: float | None


def list_bars(result: MapResult, dimension: int) -> list[Bar]:
    """List the intervals of a dimension by component, the longest first in each."""
    numbers = _number(result.holes)
    possible = _number(result.possible_holes)
    bars = []
    for component, part in enumerate(result.components):
        for rank, (birth, death) in enumerate(part.intervals[dimension].tolist()):
            key = (component, birth, death)
            hole = numbers.get(key) if dimension == 1 else None
            other = possible.get(key) if dimension == 1 else None
            told = result.holes[hole - 1] if hole is not None else None if other is None else result.possible_holes[other - 1]
            bars.append(
                Bar(
                    dimension=dimension,
                    component=component,
                    birth=birth,
                    death=death,
                    is_real=rank < part.betti_numbers[0] if dimension == 0 else hole is not None,
                    probability=None if told is None else told.probability,
                    hole=hole,
                    possible_hole=other,
                )
            )
    return bars


def list_lines(result: MapResult) -> list[Line]:
    """List what separates intervals that count from the others, by component and dimension; none where the rule is not told."""
    lines = []
    for component, part in enumerate(result.components):
        reach = part.diameter if part.reach is None else part.reach
        # Of several views, each sees a part of the encounters, and how many is not kept.
        is_one_view = reach >= _WHOLE * part.diameter
        for dimension, rule in enumerate(result.recipe.betti_rules or ()):
            threshold = find_threshold(part.intervals[dimension], rule, diameter=reach, n_encounters=part.n_used)
            length = threshold.length_share * (reach or 1.0)
            is_told = is_one_view or rule.power == 0.0
            is_judged = dimension == 1 and result.hole_count is not None
            lines.append(
                Line(
                    dimension=dimension,
                    component=component,
                    is_open=length < inf,
                    length=length if is_told and 0.0 <= length < inf else None,
                    ratio=threshold.ratio if threshold.ratio > 0.0 else None,
                    probability=LEAST_CLAIMED if is_judged else None,
                    sure_length=2.0 * part.stability_band if is_judged and part.stability_band is not None else None,
                )
            )
    return lines


def describe_diagram(result: MapResult) -> JsonObject:
    """Describe the persistence diagram: of every interval whether it is real, and what separates those from the others."""
    dimensions: JsonObject = {str(dimension): [_describe(bar) for bar in list_bars(result, dimension)] for dimension in (0, 1)}
    return {"intervals": dimensions, **_circumstances(result)}


def describe_barcode(result: MapResult) -> JsonObject:
    """Describe the same as a barcode: the intervals of each dimension over all components, those that count first, then the longest."""
    bars: JsonObject = {str(dimension): [_describe(bar) for bar in sort_bars(list_bars(result, dimension))] for dimension in (0, 1)}
    return {"bars": bars, **_circumstances(result)}


def sort_bars(bars: list[Bar]) -> list[Bar]:
    """Put bars that count first, and the longest of each kind before the others."""
    return sorted(bars, key=lambda bar: (not bar.is_real, -bar.length, bar.component, bar.birth))


def _circumstances(result: MapResult) -> JsonObject:
    return {
        "thresholds": list(_describe_lines(result)),
        "betti_numbers": list(result.betti_numbers),
        "diameter": result.diameter,
        "length_unit": result.length_unit,
        "n_encounters": result.n_encounters,
    }


def _describe_lines(result: MapResult) -> Iterator[JsonValue]:
    for line in list_lines(result):
        yield {
            "dimension": line.dimension,
            "component": line.component,
            "decided_by": "rule" if line.probability is None else "probability",
            "counts_any": line.is_open,
            "least_length": line.length,
            "least_ratio": line.ratio,
            "least_probability": line.probability,
            "sure_length": line.sure_length,
        }


def _describe(bar: Bar) -> JsonValue:
    return {
        "birth": bar.birth,
        "death": bar.death if isfinite(bar.death) else None,
        "component": bar.component,
        "is_real": bar.is_real,
        "probability": bar.probability,
        "hole": bar.hole,
        "possible_hole": bar.possible_hole,
    }


def _number(holes: tuple[Hole, ...]) -> dict[tuple[int, float, float], int]:
    return {(hole.component, hole.birth, hole.death): number for number, hole in enumerate(holes, start=1)}
