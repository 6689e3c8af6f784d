"""What is different between two maps of one site: holes, components, landmarks, size. From their JSON, whatever frames they are in. Pure.

The later map is laid over the earlier one by the encounters and landmarks that both show; a hole of one is the same as one of the other
where both stand at about one place then. What it tells of a map and itself is nothing, and of two maps either way round the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, pi, sqrt
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta

from mapper.certainty import chance_text, sure_text
from mapper.errors import MapDocumentError
from mapper.frames import Similarity
from mapper.map_alignment import ComponentFit, fit_components
from mapper.map_marks import read_marks
from mapper.types import FloatArray

# Two holes are taken for one where their centres are no further apart than this share of both radii together.
_SAME_PLACE: Final = 1.0
# Costs closer than this are alike: which is chosen then does not depend on rounding.
_DIGITS: Final = 9
_MIN_RADIUS_SHARE: Final = 0.02
"""Of the diameter: a hole has at least this radius here, however small it is drawn."""


class DiffHole(msgspec.Struct, frozen=True, kw_only=True):
    """A hole of one of both maps: ``hole`` is its number there, from 1.

    ``possible_in_other``: how likely there is a hole in the other map, which does not call it one; None: it shows nothing there.
    ``is_comparable``: the other map shows the surroundings, so that it says something that it has no such hole.
    """

    hole: int
    component: int
    centre: tuple[float, float]
    probability: float | None
    area: float | None
    area_error: float | None
    perimeter: float | None
    possible_in_other: float | None = None
    is_comparable: bool = True


class StayedHole(msgspec.Struct, frozen=True, kw_only=True):
    """A hole that both maps show; ``moved``: how far its centre is from where it was, after the one map is laid over the other."""

    before: DiffHole
    after: DiffHole
    moved: float


class DiffFrame(msgspec.Struct, frozen=True, kw_only=True):
    """How a component of the later map lies in one of the earlier: by so many shared marks, which fit to ``rms`` [unit of the map]."""

    before: int
    after: int
    n_shared: int
    rms: float
    turn_deg: float
    is_mirrored: bool


class DiffLandmarks(msgspec.Struct, frozen=True, kw_only=True):
    """Biobots that stand as landmarks in one of both maps only, and how many in both; ids as text."""

    came: list[str]
    went: list[str]
    n_stayed: int


class MapFacts(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of one of both maps."""

    version: int
    wall_ns: int
    betti_numbers: list[int]
    hole_count_probability: float | None
    is_enough: bool | None
    n_components: int
    n_encounters: int
    n_used: int
    diameter: float


class MapDifference(msgspec.Struct, frozen=True, kw_only=True):
    """What is different in the later map, ``after``; ``is_comparable``: both share enough for one to be laid over the other."""

    before: MapFacts
    after: MapFacts
    length_unit: str
    is_comparable: bool
    frames: list[DiffFrame]
    appeared: list[DiffHole]
    vanished: list[DiffHole]
    stayed: list[StayedHole]
    landmarks: DiffLandmarks
    summary: list[str]
    """In words, for people; the first says it all where nothing changed."""


_Place = tuple[float, float]
_Way = tuple[int, Similarity]


class _Hole(msgspec.Struct, frozen=True, kw_only=True):
    component: int
    outline: Annotated[list[_Place], Meta(min_length=1)]
    outline_xy: list[_Place]
    centre: _Place | None
    area: float | None
    area_error: float | None
    perimeter: float | None
    probability: float | None


class _Landmark(msgspec.Struct, frozen=True, kw_only=True):
    id: int
    t_end: float | None


class _Count(msgspec.Struct, frozen=True, kw_only=True):
    probability: float


class _Data(msgspec.Struct, frozen=True, kw_only=True):
    is_enough: bool


class _Parameters(msgspec.Struct, frozen=True, kw_only=True):
    length_unit: str


class _Map(msgspec.Struct, frozen=True, kw_only=True):
    version: int
    computed_wall_ns: int
    betti_numbers: list[int]
    holes: list[_Hole]
    possible_holes: list[_Hole]
    hole_count: _Count | None
    data: _Data | None
    landmarks: list[_Landmark]
    n_components: int
    n_encounters: int
    n_used: int
    diameter: float
    parameters: _Parameters


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Spot:
    """Where a hole is, shape (2,), and its radius."""

    component: int
    centre: FloatArray
    radius: float


_decoder = msgspec.json.Decoder(_Map)


def compare_maps(before: bytes, after: bytes) -> MapDifference:
    """Say what is different between two maps, each as ``/api/v1/map`` gives it.

    Raises
    ------
    MapDocumentError
        One of them is no map.
    """
    maps = _read(before, "the earlier map"), _read(after, "the later map")
    fits = fit_components(read_marks(after, source="the later map"), read_marks(before, source="the earlier map"))
    unit = maps[1].parameters.length_unit
    if maps[0].parameters.length_unit != unit:
        fits = ()  # lengths in seconds and in metres: nothing of one fits the other
    ways: tuple[dict[int, _Way], dict[int, _Way]] = ({}, {})
    for fit in fits:
        ways[0].setdefault(fit.other, (fit.component, fit.motion.inverse()))
        ways[1].setdefault(fit.component, (fit.other, fit.motion))
    spots = tuple([_spot(hole, one.diameter) for hole in one.holes] for one in maps)
    pairs = _match(spots[0], spots[1], fits)
    matched = {mine for mine, _, _ in pairs}, {other for _, other, _ in pairs}
    vanished, appeared = (
        [
            _describe(hole, number, spot, way=ways[side].get(spot.component), other=maps[1 - side])
            for number, (hole, spot) in enumerate(zip(maps[side].holes, spots[side], strict=True))
            if number not in matched[side]
        ]
        for side in (0, 1)
    )
    stayed = [
        StayedHole(
            before=_view(maps[0].holes[mine], mine, spots[0][mine]),
            after=_view(maps[1].holes[other], other, spots[1][other]),
            moved=distance,
        )
        for mine, other, distance in pairs
    ]
    landmarks = _compare_landmarks(maps)
    found = MapDifference(
        before=_facts(maps[0]),
        after=_facts(maps[1]),
        length_unit=unit,
        is_comparable=bool(fits),
        frames=[_frame(fit) for fit in fits],
        appeared=appeared,
        vanished=vanished,
        stayed=stayed,
        landmarks=landmarks,
        summary=[],
    )
    return msgspec.structs.replace(found, summary=summarize_difference(found))


def summarize_difference(found: MapDifference) -> list[str]:
    """Say in words what is different, the most important first."""
    unit = found.length_unit
    lines = []
    if not found.is_comparable:
        lines.append(
            "the two maps share too few encounters and landmarks to be laid over each other: which holes are the same is not known"
        )
    lines += [f"hole {hole.hole} is new{_sure(hole)}{_size(hole, unit)}{_before(hole, 'before')}" for hole in found.appeared]
    lines += [
        f"hole {hole.hole} of the earlier map is gone{_sure(hole)}{_size(hole, unit)}{_before(hole, 'now')}" for hole in found.vanished
    ]
    for one in found.stayed:
        grown = "" if one.before.area is None or one.after.area is None else f", area {one.before.area:.3g} -> {one.after.area:.3g} {unit}²"
        sure = (
            ""
            if one.before.probability is None or one.after.probability is None
            else f", {chance_text(one.before.probability)} -> {sure_text(one.after.probability)}"
        )
        if round(one.moved, _DIGITS) or one.before.area != one.after.area or one.before.probability != one.after.probability:
            lines.append(f"hole {one.after.hole} is still there{grown}{sure}")
    if found.before.betti_numbers[0] != found.after.betti_numbers[0]:
        lines.append(f"components {found.before.betti_numbers[0]} -> {found.after.betti_numbers[0]}")
    if found.landmarks.came:
        lines.append(f"new landmarks: {', '.join(found.landmarks.came)}")
    if found.landmarks.went:
        lines.append(f"no longer landmarks: {', '.join(found.landmarks.went)}")
    if found.before.n_encounters != found.after.n_encounters:
        lines.append(f"encounters {found.before.n_encounters} -> {found.after.n_encounters}")
    return lines or ["nothing changed"]


def _read(document: bytes, source: str) -> _Map:
    try:
        return _decoder.decode(document)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MapDocumentError(source=source, problem=str(error)) from error


def _facts(map_: _Map) -> MapFacts:
    return MapFacts(
        version=map_.version,
        wall_ns=map_.computed_wall_ns,
        betti_numbers=map_.betti_numbers,
        hole_count_probability=None if map_.hole_count is None else map_.hole_count.probability,
        is_enough=None if map_.data is None else map_.data.is_enough,
        n_components=map_.n_components,
        n_encounters=map_.n_encounters,
        n_used=map_.n_used,
        diameter=map_.diameter,
    )


def _spot(hole: _Hole, diameter: float) -> _Spot:
    corners = np.array(hole.outline_xy or hole.outline, dtype=np.float64).reshape(-1, 2)
    centre = corners.mean(axis=0) if hole.centre is None else np.array(hole.centre)
    drawn = float(np.sqrt(np.mean(np.sum((corners - centre) ** 2, axis=1))))
    radius = drawn if hole.area is None else sqrt(max(hole.area, 0.0) / pi)
    return _Spot(component=hole.component, centre=centre, radius=max(radius, _MIN_RADIUS_SHARE * diameter))


def _match(earlier: Sequence[_Spot], later: Sequence[_Spot], fits: Sequence[ComponentFit]) -> list[tuple[int, int, float]]:
    """Pair the holes of both maps, the nearest first: numbers in both, and how far apart; by the number in the later map.

    Ties go to the lower sum of numbers, which is the same pair either way round.
    """
    motions = {(fit.other, fit.component): fit.motion for fit in fits}
    costs: list[tuple[float, int, int, int, float]] = []
    for mine, one in enumerate(earlier):
        for other, two in enumerate(later):
            motion = motions.get((one.component, two.component))
            if motion is None:
                continue
            distance = float(hypot(*(motion(two.centre[None, :])[0] - one.centre)))
            cost = round(distance / (one.radius + two.radius), _DIGITS)
            if cost <= _SAME_PLACE:
                costs.append((cost, mine + other, mine, other, distance))
    found: list[tuple[int, int, float]] = []
    taken: tuple[set[int], set[int]] = (set(), set())
    for _, _, mine, other, distance in sorted(costs):
        if mine not in taken[0] and other not in taken[1]:
            taken[0].add(mine)
            taken[1].add(other)
            found.append((mine, other, distance))
    return sorted(found, key=lambda pair: pair[1])


def _describe(hole: _Hole, number: int, spot: _Spot, *, way: _Way | None, other: _Map) -> DiffHole:
    """Describe a hole that the other map does not have; ``way``: the other's component where it would be, and the motion to there."""
    if way is None:
        return msgspec.structs.replace(_view(hole, number, spot), is_comparable=False)
    component, motion = way
    centre = motion(spot.centre[None, :])[0]
    near = [
        maybe.probability or 0.0
        for maybe in other.possible_holes
        if maybe.component == component and _is_there(_spot(maybe, other.diameter), centre, radius=spot.radius)
    ]
    return msgspec.structs.replace(_view(hole, number, spot), possible_in_other=max(near, default=None))


def _is_there(spot: _Spot, centre: FloatArray, *, radius: float) -> bool:
    return round(float(hypot(*(spot.centre - centre))) / (spot.radius + radius), _DIGITS) <= _SAME_PLACE


def _view(hole: _Hole, number: int, spot: _Spot) -> DiffHole:
    x, y = spot.centre.tolist()
    return DiffHole(
        hole=number + 1,
        component=hole.component,
        centre=(x, y),
        probability=hole.probability,
        area=hole.area,
        area_error=hole.area_error,
        perimeter=hole.perimeter,
    )


def _frame(fit: ComponentFit) -> DiffFrame:
    return DiffFrame(
        before=fit.other,
        after=fit.component,
        n_shared=fit.n_shared,
        rms=fit.rms,
        turn_deg=float(np.degrees(fit.motion.turn_rad)),
        is_mirrored=fit.motion.is_mirrored,
    )


def _compare_landmarks(maps: tuple[_Map, _Map]) -> DiffLandmarks:
    before, after = ({one.id for one in map_.landmarks if one.t_end is None} for map_ in maps)
    return DiffLandmarks(
        came=[str(node) for node in sorted(after - before)],
        went=[str(node) for node in sorted(before - after)],
        n_stayed=len(before & after),
    )


def _sure(hole: DiffHole) -> str:
    return "" if hole.probability is None else f", {sure_text(hole.probability)}"


def _size(hole: DiffHole, unit: str) -> str:
    return "" if hole.area is None else f", area {hole.area:.3g} +- {hole.area_error or 0.0:.2g} {unit}²"


def _before(hole: DiffHole, when: str) -> str:
    if not hole.is_comparable:
        return " (the other map does not show its surroundings)"
    if hole.possible_in_other is None:
        return ""
    return (
        f" ({when} it is only possible, {chance_text(hole.possible_in_other)})"
        if when == "now"
        else f" (before it was only possible, {chance_text(hole.possible_in_other)})"
    )
