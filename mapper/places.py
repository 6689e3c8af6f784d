"""Places that people name: where a landmark stood, where a biobot was at a time, a point of the map, or map coordinates.

In text: ``landmark:7``, ``landmark:7@12.5`` (the place where it stood at 12.5 s), ``biobot:3@61.5``, ``biobot:3`` (at its newest
encounter on the map), ``point:17``, ``xy:1.5,-2`` and ``xy:1.5,-2,1`` (in component 1). Ids are as the log has them, numbers or names.
Times are those of the map: of the file, or seconds since 1970 of a live map.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import isfinite

import numpy as np

from mapper.errors import PlaceError
from mapper.map_sketch import MapSketch
from mapper.types import EncounterTable, FloatArray, IntArray

_NS_PER_S = 1e9
_FORMS = "landmark:ID, landmark:ID@T, biobot:ID, biobot:ID@T, point:INDEX, xy:X,Y or xy:X,Y,COMPONENT, with T in seconds of the map's clock"
_SHOWN = 60
_MOST_COVER_RADII = 5
"""So far from all points of a map coordinates still lie on it; in an obstacle one is as far from them as its half width."""
_MOST_EXTENT = 0.25
"""The same as a share of the extent of a component: where every encounter is a point there is nothing to cover."""
_MOST_GAP = 0.25
"""So long from all encounters of a biobot it is not known where it is, as a share of the time that the map is of."""
_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?"
_TEXT = re.compile(
    rf"landmark:(?P<landmark>.{{1,200}}?)(?:@(?P<stood>{_NUMBER}))?|biobot:(?P<biobot>.{{1,200}}?)(?:@(?P<t>{_NUMBER}))?|"
    rf"point:(?P<point>[0-9]{{1,9}})|xy:(?P<x>{_NUMBER}),(?P<y>{_NUMBER})(?:,(?P<component>[0-9]{{1,9}}))?",
    re.ASCII,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LandmarkPlace:
    """Where a landmark stood; at ``t_s``, where it stood in several places."""

    node: str
    t_s: float | None = None

    def __str__(self) -> str:
        return f"landmark:{self.node}" + ("" if self.t_s is None else f"@{self.t_s:.15g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class BiobotPlace:
    """Where a biobot was at a time; None: at its newest encounter."""

    node: str
    t_s: float | None = None

    def __str__(self) -> str:
        return f"biobot:{self.node}" + ("" if self.t_s is None else f"@{self.t_s:.15g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class PointPlace:
    """A point of the map, counted from 0."""

    index: int

    def __str__(self) -> str:
        return f"point:{self.index}"


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPlace:
    """Map coordinates [unit of the map]."""

    x: float
    y: float
    component: int = 0

    def __str__(self) -> str:
        return f"xy:{self.x:.15g},{self.y:.15g},{self.component}"


NamedPlace = LandmarkPlace | BiobotPlace | PointPlace | MapPlace


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundPlace:
    """A place on a map.

    ``xy``, shape (2,) [unit of the map]; ``point`` is its index where it is a point of the map; ``gap_s`` is how far the encounters that
    tell it are from the time asked for [s], the nearer of the two where it is between two: a biobot may have walked so long elsewhere.
    """

    name: str
    xy: FloatArray
    component: int
    point: int | None
    gap_s: float


def parse_place(text: str) -> NamedPlace:
    """Read a place from text.

    Raises
    ------
    PlaceError
        It has none of the forms.
    """
    found = _TEXT.fullmatch(text.strip())
    if found is None:
        raise PlaceError(place=text[:_SHOWN], problem="is no place", next_step=f"give one of {_FORMS}")
    part = found.groupdict()
    numbers = {name: float(part[name]) for name in ("stood", "t", "x", "y") if part[name] is not None}
    if not all(map(isfinite, numbers.values())):
        raise PlaceError(place=text[:_SHOWN], problem="has a number that is not finite", next_step=f"give one of {_FORMS}")
    if part["landmark"] is not None:
        return LandmarkPlace(node=part["landmark"], t_s=numbers.get("stood"))
    if part["biobot"] is not None:
        return BiobotPlace(node=part["biobot"], t_s=numbers.get("t"))
    if part["point"] is not None:
        return PointPlace(index=int(part["point"]))
    return MapPlace(x=numbers["x"], y=numbers["y"], component=int(part["component"] or 0))


def find_place(place: NamedPlace, sketch: MapSketch) -> FoundPlace:
    """Find a place on a map.

    Raises
    ------
    PlaceError
        The map does not show it.

    Notes
    -----
    A biobot is taken to have walked straight and evenly between the encounters before and after the time. Before the first and after the
    last of them it is where that was.
    """
    match place:
        case LandmarkPlace():
            return _find_landmark(place, sketch)
        case BiobotPlace():
            return _find_biobot(place, sketch)
        case PointPlace(index=index):
            if index >= len(sketch.xy):
                raise _unknown(place, f"is beyond the {len(sketch.xy)} points of the map", "give an index from 0")
            return FoundPlace(name=str(place), xy=sketch.xy[index], component=int(sketch.component[index]), point=index, gap_s=0.0)
        case MapPlace(component=component):
            if component >= len(sketch.cover_radii):
                raise _unknown(place, f"is in none of the {len(sketch.cover_radii)} components mapped", "they are counted from 0")
            return _find_coordinates(place, sketch)


def _find_coordinates(place: MapPlace, sketch: MapSketch) -> FoundPlace:
    xy = np.array([place.x, place.y])
    own = np.flatnonzero(sketch.component == place.component)
    off = np.hypot(*(sketch.xy[own] - xy).T)
    extent = float(np.hypot(*np.ptp(sketch.xy[own], axis=0))) if len(own) else 0.0
    most = max(_MOST_COVER_RADII * sketch.cover_radii[place.component], _MOST_EXTENT * extent)
    if len(own) and off.min() > most:
        nearest = int(own[off.argmin()])
        x, y = sketch.xy[nearest].tolist()
        raise _unknown(
            place,
            f"is {off.min():.3g} from the nearest point of the map, at most {most:.3g} (cover radii, or a quarter of its extent) may be",
            f"the nearest is point:{nearest} at xy:{x:.4g},{y:.4g}",
        )
    return FoundPlace(name=str(place), xy=xy, component=place.component, point=None, gap_s=0.0)


def rows_to_place(places: Iterable[NamedPlace], table: EncounterTable, *, number_of: Callable[[str], int | None]) -> IntArray:
    """Return the encounters that tell where biobots were: for each of the places that name one, the last before and the first after it.

    Parameters
    ----------
    number_of
        Returns the number that stands for an id in the table; None: it is not there.
    """
    rows: set[int] = set()
    centres = table.t_start_ns + (table.t_end_ns - table.t_start_ns) // 2
    for place in places:
        if isinstance(place, BiobotPlace):
            number = number_of(place.node)
            own = np.flatnonzero((table.id1 == number) | (table.id2 == number)) if number is not None else np.empty(0, dtype=np.int64)
            own = own[np.argsort(centres[own], kind="stable")]
            after = len(own) if place.t_s is None else int(np.searchsorted(centres[own], place.t_s * _NS_PER_S))
            rows |= set(own[max(0, after - 1) : after + 1].tolist())
    return np.array(sorted(rows), dtype=np.int64)


def _find_landmark(place: LandmarkPlace, sketch: MapSketch) -> FoundPlace:
    stands = [stand for stand in sketch.landmarks if _is_same(stand.node, place.node)]
    if not stands:
        known = ", ".join(sorted({stand.node for stand in sketch.landmarks}, key=lambda node: (len(node), node))[:20]) or "none"
        raise _unknown(place, "is no landmark of the map", f"the map has {known}; a landmark stands by command and has met somebody")
    at = [stand for stand in stands if place.t_s is None or _stood(stand.t_start_s, stand.t_end_s, place.t_s)]
    if not at:
        spells = "; ".join(f"{stand.t_start_s:.6g} s to {_end(stand.t_end_s)}" for stand in stands[:5])
        raise _unknown(place, "did not stand then", f"it stood from {spells}")
    if len({(stand.x, stand.y, stand.component) for stand in at}) > 1:
        spells = "; ".join(f"{stand.t_start_s:.6g} s to {_end(stand.t_end_s)}" for stand in at[:5])
        raise _unknown(place, f"stood at {len(at)} places", f"say when, as {place}@T: {spells}")
    return FoundPlace(name=str(place), xy=np.array([at[0].x, at[0].y]), component=at[0].component, point=None, gap_s=0.0)


def _find_biobot(place: BiobotPlace, sketch: MapSketch) -> FoundPlace:
    met = zip(sketch.met_id1, sketch.met_id2, strict=True)
    own = np.flatnonzero([_is_same(one, place.node) or _is_same(other, place.node) for one, other in met])
    if not len(own):
        raise _unknown(place, "is in no encounter that has a place on the map", "name one that is, or a landmark")
    own = own[np.argsort(sketch.met_t_s[own], kind="stable")]
    times = sketch.met_t_s[own]
    t_s = float(times[-1]) if place.t_s is None else place.t_s
    after = int(np.searchsorted(times, t_s))
    before, after = max(0, after - 1), min(after, len(own) - 1)
    one, other = int(own[before]), int(own[after])
    gaps = abs(t_s - float(times[before])), abs(float(times[after]) - t_s)
    most_s = _MOST_GAP * float(np.ptp(sketch.met_t_s))
    if min(gaps) > most_s:
        nearest_s = float(times[before] if gaps[0] <= gaps[1] else times[after])
        raise _unknown(
            place,
            f"is {min(gaps):.3g} s from its nearest encounter on the map, at most {most_s:.3g} s, a quarter of its time, tell a place",
            f"the nearest is at {nearest_s:.6g} s",
        )
    if before == after or sketch.met_component[one] != sketch.met_component[other] or sum(gaps) == 0:
        nearest = one if gaps[0] <= gaps[1] else other
        xy = sketch.met_xy[nearest]
    else:
        nearest = one
        xy = sketch.met_xy[one] + gaps[0] / sum(gaps) * (sketch.met_xy[other] - sketch.met_xy[one])
    return FoundPlace(name=str(place), xy=xy, component=int(sketch.met_component[nearest]), point=None, gap_s=min(gaps))


def _is_same(name: str, asked: str) -> bool:
    """Say whether an id is the one asked for: the same text, or the same number."""
    return name == asked or (name.isdecimal() and asked.isascii() and asked.isdecimal() and name == asked.lstrip("0"))


def _stood(t_start_s: float, t_end_s: float | None, t_s: float) -> bool:
    return t_start_s <= t_s and (t_end_s is None or t_s <= t_end_s)


def _end(t_end_s: float | None) -> str:
    return "the end" if t_end_s is None else f"{t_end_s:.6g} s"


def _unknown(place: NamedPlace, problem: str, next_step: str) -> PlaceError:
    return PlaceError(place=str(place), problem=problem, next_step=next_step)
