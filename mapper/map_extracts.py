"""Parts of a map's JSON by themselves: its Betti numbers and how sure they are, its holes one by one, and who was at a place."""

from math import hypot

import msgspec

from firmware_protocol.first_use import prepare
from mapper.errors import PlaceError
from mapper.places import BiobotPlace, MapPlace, PointPlace
from mapper.request_errors import HoleNotFoundError


class _Document(msgspec.Struct, frozen=True, kw_only=True):
    """What is taken from the JSON of a map; all else is skipped, and what is nested stays text."""

    version: int
    computed_wall_ns: int
    betti_numbers: tuple[int, int]
    n_components: int
    n_encounters: int
    hole_count: msgspec.Raw
    data: msgspec.Raw
    holes: list[msgspec.Raw]
    possible_holes: list[msgspec.Raw]
    parameters: "_Parameters"
    frame: msgspec.Raw


class _Parameters(msgspec.Struct, frozen=True, kw_only=True):
    length_unit: str


class _Frame(msgspec.Struct, frozen=True, kw_only=True):
    holes: "list[_FramedHole]"


class _FramedHole(msgspec.Struct, frozen=True, kw_only=True):
    """A hole in the operator's frame."""

    number: int
    outline_xy: list[tuple[float, float]]
    centre: tuple[float, float] | None
    area: float | None
    area_error: float | None
    perimeter: float | None
    perimeter_error: float | None


class _Sure(msgspec.Struct, frozen=True, kw_only=True):
    birth: float
    death: float
    component: int
    probability: float | None


class _Point(msgspec.Struct, frozen=True, kw_only=True):
    x: float
    y: float
    t: float
    id1: int | str
    component: int


class _Points(msgspec.Struct, frozen=True, kw_only=True):
    points: list[_Point]


prepare(_Sure, _Points, _Frame)


_decoder = msgspec.json.Decoder(_Document)


def extract_betti(map_json: bytes) -> bytes:
    """Return the Betti numbers of a map, and how sure they are, as JSON."""
    document = _decoder.decode(map_json)
    possible = [msgspec.json.decode(one, type=_Sure) for one in document.possible_holes]
    b0, b1 = document.betti_numbers
    return msgspec.json.encode(
        {
            **_circumstances(document),
            "b0": b0,
            "b1": b1,
            "n_components": document.n_components,
            "hole_count": document.hole_count,
            "possible_holes": possible,
            "data": document.data,
        }
    )


def extract_holes(map_json: bytes) -> bytes:
    """Return the holes of a map, and loops that may be some, as JSON."""
    document = _decoder.decode(map_json)
    holes = [_describe(document, number) for number in range(1, len(document.holes) + 1)]
    return msgspec.json.encode({**_circumstances(document), "holes": holes, "possible_holes": document.possible_holes})


def extract_hole(map_json: bytes, number: int) -> bytes:
    """Return one hole of a map as JSON.

    Raises
    ------
    HoleNotFoundError
        It has none of this number; they are counted from 1.
    """
    document = _decoder.decode(map_json)
    if not 1 <= number <= len(document.holes):
        raise HoleNotFoundError(number=number, n_holes=len(document.holes))
    return msgspec.json.encode({**_circumstances(document), **_describe(document, number)})


def settle_place(map_json: bytes, place: PointPlace | MapPlace) -> BiobotPlace:
    """Say of a place that only this map knows which biobot was there, or at the nearest point, and when: later maps know that too.

    Raises
    ------
    PlaceError
        The map has no such point or component.
    """
    points = msgspec.json.decode(map_json, type=_Points).points
    if isinstance(place, PointPlace):
        if place.index >= len(points):
            raise PlaceError(place=str(place), problem=f"is beyond the {len(points)} points of the map", next_step="give an index from 0")
        nearest = points[place.index]
    else:
        own = [point for point in points if point.component == place.component]
        if not own:
            raise PlaceError(place=str(place), problem="is in no component of the map", next_step="they are counted from 0")
        nearest = min(own, key=lambda point: hypot(point.x - place.x, point.y - place.y))
    return BiobotPlace(node=str(nearest.id1), t_s=nearest.t)


def _circumstances(document: _Document) -> dict[str, object]:
    return {
        "version": document.version,
        "computed_wall_ns": document.computed_wall_ns,
        "n_encounters": document.n_encounters,
        "length_unit": document.parameters.length_unit,
    }


def _describe(document: _Document, number: int) -> dict[str, object]:
    hole = msgspec.json.decode(document.holes[number - 1], type=dict[str, msgspec.Raw])
    frame = msgspec.json.decode(document.frame, type=_Frame | None)
    framed = [] if frame is None else [one for one in frame.holes if one.number == number]
    return {"number": number, **hole, "in_frame": framed[0] if framed else None}
