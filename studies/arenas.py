"""Random arenas of known shape, to train and to judge the count of holes on. Lengths are those of an arena of side 50."""

from enum import StrEnum

import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import Point, Polygon, box

from studies.errors import NoRoomError

_SIDE = 50.0
# Between obstacles, and between an obstacle and a wall: a few detection radii, so that biobots meet in the passage.
_PASSAGE = 3.0
_WIDE_PASSAGE = 10.0
_TRIES = 2_000
_RESTARTS = 20


class ArenaFamily(StrEnum):
    """What kind of arenas to draw."""

    SQUARES = "squares"  # 0 to 3 square obstacles of side 9-14 in a square of side 50
    SMALL_SQUARES = "small-squares"  # 4 to 6 of side 5-8
    BIG_SQUARE = "big-square"  # none, or one of side 20, at least 10 from every wall
    SHAPES = "shapes"  # other outlines (L, corridor, rooms, disc, random polygon) and other obstacles
    OBSTACLES = "obstacles"  # 0 to 4 of other shapes (L, U, triangle, disc, star) some 12 wide, turned, in a square of side 50


def draw_arena(family: ArenaFamily, *, seed: int) -> Polygon:
    """Draw an arena; its number of holes is that of the polygon's interior rings.

    The numbers of holes that a family allows come in turn with ascending seeds.

    Raises
    ------
    NoRoomError
        The obstacles do not fit, however they are placed.
    """
    rng = np.random.default_rng([list(ArenaFamily).index(family), seed])
    square = box(0.0, 0.0, _SIDE, _SIDE)
    match family:
        case ArenaFamily.SQUARES:
            return place_squares(square, rng, n_holes=seed % 4, sides=(9.0, 14.0))
        case ArenaFamily.SMALL_SQUARES:
            return place_squares(square, rng, n_holes=4 + seed % 3, sides=(5.0, 8.0))
        case ArenaFamily.BIG_SQUARE:
            return place_squares(square, rng, n_holes=seed % 2, sides=(20.0, 20.0), passage=_WIDE_PASSAGE)
        case ArenaFamily.OBSTACLES:
            return _draw_obstacles(square, rng, n_holes=seed % 5)
        case ArenaFamily.SHAPES:
            return _draw_shape(rng, kind=seed % 6)


def place_squares(
    outline: Polygon,
    rng: np.random.Generator,
    *,
    n_holes: int,
    sides: tuple[float, float],
    is_turned: bool = False,
    passage: float = _PASSAGE,
) -> Polygon:
    """Cut square obstacles out of an outline, in random places, with room to pass on every side of each.

    Parameters
    ----------
    sides
        Smallest and largest side [length].
    is_turned
        Turn each by a random angle.
    passage
        Least distance between obstacles, and between an obstacle and a wall [length].
    """
    room = outline.buffer(-passage)
    for _ in range(_RESTARTS):
        holes: list[Polygon] = []
        for _ in range(_TRIES if n_holes else 0):
            half = rng.uniform(*sides) / 2
            x_min, y_min, x_max, y_max = outline.bounds
            x, y = rng.uniform(x_min, x_max), rng.uniform(y_min, y_max)
            hole = box(x - half, y - half, x + half, y + half)
            if is_turned:
                hole = affinity.rotate(hole, float(rng.uniform(0, 90)))
            if room.contains(hole) and all(hole.distance(other) >= passage for other in holes):
                holes.append(hole)
            if len(holes) == n_holes:
                break
        if len(holes) == n_holes:
            return Polygon(outline.exterior, [hole.exterior for hole in holes])
    raise NoRoomError(n_holes=n_holes, sides=sides, area=float(outline.area))


def _draw_obstacles(outline: Polygon, rng: np.random.Generator, *, n_holes: int) -> Polygon:
    """Cut obstacles of many shapes out of an outline, with room to pass on every side of each."""
    room = outline.buffer(-_PASSAGE)
    x_min, y_min, x_max, y_max = outline.bounds
    for _ in range(_RESTARTS):
        holes: list[Polygon] = []
        for _ in range(_TRIES if n_holes else 0):
            drawn = affinity.rotate(_draw_obstacle(rng), float(rng.uniform(0, 360)))
            hole = affinity.translate(drawn, rng.uniform(x_min, x_max), rng.uniform(y_min, y_max))
            if room.contains(hole) and all(hole.distance(other) >= _PASSAGE for other in holes):
                holes.append(hole)
            if len(holes) == n_holes:
                return Polygon(outline.exterior, [hole.exterior for hole in holes])
        if n_holes == 0:
            return outline
    raise NoRoomError(n_holes=n_holes, sides=(10.0, 14.0), area=float(outline.area))


def _draw_obstacle(rng: np.random.Generator) -> Polygon:
    """Draw an L, a U, a triangle, a disc or a star about the origin, 10 to 14 wide."""
    width = float(rng.uniform(10, 14))
    third = width / 3
    match int(rng.integers(0, 5)):
        case 0:
            corners = [(0, 0), (width, 0), (width, third), (third, third), (third, width), (0, width)]
        case 1:
            corners = [(0, 0), (width, 0), (width, width), (width - 3, width), (width - 3, 3), (3, 3), (3, width), (0, width)]
        case 2:
            corners = [(0, 0), (width, 0), (float(rng.uniform(0, width)), width)]
        case 3:
            return Point(0, 0).buffer(width / 2)
        case _:
            angles = np.arange(10) * np.pi / 5
            radii = width / 2 * np.tile([1.0, 0.55], 5)
            return Polygon(np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]))
    return affinity.translate(Polygon(corners), -width / 2, -width / 2)


def _draw_shape(rng: np.random.Generator, *, kind: int) -> Polygon:
    is_turned = bool(rng.random() < 0.5)
    match kind:
        case 0:  # a square with up to five obstacles of middling size
            return place_squares(box(0, 0, _SIDE, _SIDE), rng, n_holes=int(rng.integers(0, 6)), sides=(7.0, 10.0), is_turned=is_turned)
        case 1:
            outline = Polygon([(0, 0), (60, 0), (60, 25), (25, 25), (25, 60), (0, 60)])
        case 2:  # a corridor bent twice: no obstacle fits
            return Polygon([(0, 0), (60, 0), (60, 14), (14, 14), (14, 46), (60, 46), (60, 60), (0, 60)])
        case 3:
            return _draw_rooms(rng)
        case 4:
            outline = _draw_star(rng)
        case _:
            outline = Point(0, 0).buffer(28)
    return place_squares(outline, rng, n_holes=int(rng.integers(0, 4)), sides=(8.0, 11.0), is_turned=is_turned)


def _draw_rooms(rng: np.random.Generator) -> Polygon:
    """Four rooms of side 30 about a cross of walls; with all four doors one can walk in a circle, with three one cannot."""
    half, wall = 30.0, 1.0
    cross = shapely.union(box(half - wall / 2, 0, half + wall / 2, 2 * half), box(0, half - wall / 2, 2 * half, half + wall / 2))
    for door in range(3 + int(rng.integers(0, 2))):
        width = rng.uniform(6, 12)
        begin = rng.uniform(4, half - 4 - width) + (half if door % 2 else 0.0)
        gap = box(half - wall, begin, half + wall, begin + width)
        cross = shapely.difference(cross, gap if door < 2 else affinity.rotate(gap, 90, origin=(half, half)))
    rooms = shapely.difference(box(0, 0, 2 * half, 2 * half), cross)
    if not isinstance(rooms, Polygon):
        raise NoRoomError(n_holes=1, sides=(0.0, wall), area=float(rooms.area))
    return rooms


def _draw_star(rng: np.random.Generator) -> Polygon:
    """Draw a star-shaped polygon of five to eight corners about as large as the square."""
    while True:
        corners = int(rng.integers(5, 9))
        angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
        radius = 30 * rng.uniform(0.8, 1.2, corners)
        outline = Polygon(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))
        if outline.is_valid and outline.area > 0.7 * _SIDE**2:
            return outline
