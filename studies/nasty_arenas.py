"""Arenas that are hard to stay inside of: walls thin as a hair, corners sharp as needles, holes that touch, rubble of many corners."""

import math
from enum import StrEnum

import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import MultiPolygon, Polygon, box
from shapely.geometry.base import BaseGeometry

from simulator.arenas.arena import Arena, build_arena
from simulator.errors import ArenaError
from studies.errors import NoArenaError

_SIDE = 10.0
_TRIES = 100


class Nastiness(StrEnum):
    """What is nasty about an arena."""

    THIN_WALLS = "thin walls"  # walls of 1e-6 of the extent, some with free ends, some across a corner
    SHARP_CORNERS = "sharp corners"  # spikes of the outline and of holes, down to a thousandth of a radian
    TOUCHING_HOLES = "touching holes"  # holes that touch a wall or each other in exactly one point
    NARROW_GAPS = "narrow gaps"  # holes 1e-10 to 1e-2 of the extent apart from each other and from walls
    RUBBLE = "rubble"  # hundreds of overlapping fragments: thousands of corners, some a rounding error apart
    ROOMS_APART = "rooms apart"  # parts without a way between them, a hair apart


def draw_nasty_arena(nastiness: Nastiness, rng: np.random.Generator) -> Arena:
    """Draw an arena of extent 10, or now and then the same far smaller, or far away from the origin.

    Raises
    ------
    NoArenaError
        Nothing valid came out of many tries.
    """
    for _ in range(_TRIES):
        shape = _DRAW[nastiness](rng)
        placing = rng.random()
        if placing < 0.1:
            shape = affinity.scale(shape, 1e-4, 1e-4, origin=(0, 0))
        elif placing < 0.2:
            shape = affinity.translate(shape, 1e5 * rng.uniform(-1, 1), 1e5 * rng.uniform(-1, 1))
        elif placing < 0.5:
            shape = affinity.rotate(shape, float(rng.uniform(0, 360)))
        if isinstance(shape, Polygon | MultiPolygon) and shape.is_valid and shape.area > 0.0:
            try:
                return build_arena(shape, source=nastiness)
            except ArenaError:
                continue
    raise NoArenaError(kind=nastiness, tries=_TRIES)


def _thin_walls(rng: np.random.Generator) -> BaseGeometry:
    shape: BaseGeometry = box(0, 0, _SIDE, _SIDE)
    for _ in range(int(rng.integers(1, 9))):
        length, thickness = rng.uniform(0.5, 9.0), _SIDE * 10 ** rng.uniform(-6, -4)
        wall = box(0, 0, length, thickness)
        wall = affinity.rotate(wall, float(rng.choice([0.0, 90.0, rng.uniform(0, 180)])), origin=(0, 0))
        shape = shape.difference(affinity.translate(wall, rng.uniform(-1, 9), rng.uniform(-1, 9)))
    return shape


def _sharp_corners(rng: np.random.Generator) -> BaseGeometry:
    """A star whose spikes are from a thousandth of a radian to blunt, with needles as holes."""
    n = int(rng.integers(2, 9))
    points: list[tuple[float, float]] = []
    for k in range(n):
        middle, half = 2 * math.pi * k / n, 0.5 * 10 ** rng.uniform(-3, -0.3)
        # A spike of opening angle 2 half at its tip, rising from a base circle of radius 1.
        width = half * 4.0
        points += [(math.cos(middle - width), math.sin(middle - width)), (5 * math.cos(middle), 5 * math.sin(middle))]
        points += [(math.cos(middle + width), math.sin(middle + width))]
    shape: BaseGeometry = Polygon(points).buffer(0)
    if n < 3 or rng.random() < 0.3:
        shape = Polygon([(0, 0), (_SIDE, 0), (_SIDE, _SIDE * 10 ** rng.uniform(-3, 0))])
    for _ in range(int(rng.integers(0, 3))):
        needle = Polygon([(0, 0), (rng.uniform(0.2, 2), 0), (0, 10 ** rng.uniform(-3, 0))])
        needle = affinity.rotate(needle, float(rng.uniform(0, 360)), origin=(0, 0))
        shape = shape.difference(affinity.translate(needle, rng.uniform(-1, 1), rng.uniform(-1, 1)))
    return _largest(shape)


def _touching_holes(rng: np.random.Generator) -> BaseGeometry:
    """Triangles with a corner on a wall of the square, and rings of triangles that meet in points. Coordinates are exact."""
    holes = []
    x = 1.0
    while x < 9.0:  # their tips at the bottom wall
        width, height = 0.25 * rng.integers(1, 4), 0.5 * rng.integers(1, 6)
        holes.append(Polygon([(x, 0.0), (x + width, height), (x - width, height)]))
        x += 2.0
    y = 4.0
    holes += [  # a row of diamonds, tip to tip
        Polygon([(2.0 + 1.5 * k, y), (2.75 + 1.5 * k, y - 0.5), (3.5 + 1.5 * k, y), (2.75 + 1.5 * k, y + 0.5)])
        for k in range(int(rng.integers(1, 5)))
    ]
    if rng.random() < 0.5:  # one that hangs from the top, and a square that stands on its corner
        holes.append(Polygon([(5.0, _SIDE), (4.5, 8.0), (5.5, 8.0)]))
        holes.append(Polygon([(0.0, 7.0), (1.0, 6.0), (2.0, 7.0), (1.0, 8.0)]))
    return Polygon(box(0, 0, _SIDE, _SIDE).exterior, [hole.exterior for hole in holes])


def _narrow_gaps(rng: np.random.Generator) -> BaseGeometry:
    shape: BaseGeometry = box(0, 0, _SIDE, _SIDE)
    x = float(_SIDE * 10 ** rng.uniform(-10, -2))
    while x < 9.0:
        width = rng.uniform(0.3, 3.0)
        low, high = _SIDE * 10 ** rng.uniform(-10, -2), _SIDE * (1 - 10 ** rng.uniform(-10, -0.3))
        slant = float(rng.choice([0.0, rng.uniform(-0.2, 0.2)]))
        shape = shape.difference(Polygon([(x, low), (x + width, low), (x + width + slant, high), (x + slant, high)]))
        x += width + _SIDE * 10 ** rng.uniform(-10, -1)
    return shape


def _rubble(rng: np.random.Generator) -> BaseGeometry:
    fragments = []
    for _ in range(int(rng.integers(20, 300))):
        corners = int(rng.integers(3, 12))
        angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
        size = 10 ** rng.uniform(-2, 0)
        x, y = rng.uniform(0, _SIDE, 2)
        ring = np.column_stack([x + size * np.cos(angle), y + size * rng.uniform(0.05, 1.0) * np.sin(angle)])
        fragments.append(Polygon(ring).buffer(0))
    return _largest(box(0, 0, _SIDE, _SIDE).difference(shapely.union_all(fragments)))


def _rooms_apart(rng: np.random.Generator) -> BaseGeometry:
    apart = _SIDE * 10 ** rng.uniform(-6, -2)
    middle = rng.uniform(3, 7)
    right = Polygon([(middle + apart, 0), (_SIDE, 0), (_SIDE, _SIDE), (middle + apart, _SIDE)])
    left = Polygon([(0, 0), (middle, 0), (middle, _SIDE), (rng.uniform(0, middle), rng.uniform(1, _SIDE))])
    return MultiPolygon([left, right])


def _largest(shape: BaseGeometry) -> BaseGeometry:
    return max(shape.geoms, key=lambda part: part.area) if isinstance(shape, MultiPolygon) else shape


_DRAW = {
    Nastiness.THIN_WALLS: _thin_walls,
    Nastiness.SHARP_CORNERS: _sharp_corners,
    Nastiness.TOUCHING_HOLES: _touching_holes,
    Nastiness.NARROW_GAPS: _narrow_gaps,
    Nastiness.RUBBLE: _rubble,
    Nastiness.ROOMS_APART: _rooms_apart,
}
