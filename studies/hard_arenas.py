"""Five arenas of known difficulty in which exactness is checked: corners, an obstacle, walls thin as a hair, spikes, rooms apart."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from shapely.geometry import MultiPolygon, Polygon, box
from shapely.geometry.base import BaseGeometry

from simulator.arenas.arena import Arena, build_arena


def cut_out(shape: Polygon | MultiPolygon, *holes: Polygon) -> Polygon | MultiPolygon:
    """Take holes out of a shape that stays an area."""
    left: BaseGeometry = shape
    for hole in holes:
        left = left.difference(hole)
    assert isinstance(left, Polygon | MultiPolygon)
    return left


def square(side: float = 10.0) -> Arena:
    """Make an empty room."""
    return build_arena(box(0, 0, side, side))


def one_obstacle() -> Arena:
    """Make a room of side 10 around an obstacle of side 4."""
    return build_arena(cut_out(box(0, 0, 10, 10), box(3, 3, 7, 7)))


def thin_walls() -> Arena:
    """Make a room of side 10 cut by walls a thousandth thick, with doors at alternate ends."""
    walls = [box(0, 2.5, 8, 2.501), box(2, 5, 10, 5.001), box(0, 7.5, 8, 7.501)]
    return build_arena(cut_out(box(0, 0, 10, 10), *walls))


def star() -> Arena:
    """Make a star of seven spikes of about 12 degrees."""
    turns = [k * math.pi / 7 for k in range(14)]
    return build_arena(Polygon([(5 + r * math.cos(a), 5 + r * math.sin(a)) for k, a in enumerate(turns) if (r := 5.0 if k % 2 else 1.5)]))


def two_rooms() -> Arena:
    """Make two rooms apart by less than a detection radius, without a door."""
    return build_arena(MultiPolygon([box(0, 0, 4.9, 10), box(5.1, 0, 10, 10)]))


FIVE: Mapping[str, Callable[[], Arena]] = MappingProxyType(
    {"square": square, "one obstacle": one_obstacle, "thin walls": thin_walls, "star": star, "two rooms": two_rooms}
)
