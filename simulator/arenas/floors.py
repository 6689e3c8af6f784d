"""Floors of the named arenas, drawn by hand in a square of side 50."""

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon, box

from simulator import draws

Box = tuple[float, float, float, float]
Place = tuple[float, float]

_SIDE = 50.0
_MIDDLE = (25.0, 25.0)
_DISC_SIDES = 96


def square(*obstacles: Box) -> Polygon:
    """Draw the square with box-shaped obstacles: lowest x and y, highest x and y of each."""
    return Polygon(box(0.0, 0.0, _SIDE, _SIDE).exterior, [box(*obstacle).exterior for obstacle in obstacles])


def three_obstacles() -> Polygon:
    """Draw one obstacle each with three, many and four corners."""
    triangle = [(8.0, 8.0), (22.0, 8.0), (15.0, 21.0)]
    return _without(triangle, _regular(48, centre=(36.0, 15.0), radius=7.0), [(19.0, 28.0), (33.0, 28.0), (33.0, 42.0), (19.0, 42.0)])


def four_obstacles() -> Polygon:
    """Draw four obstacles none of which is convex."""
    ell = [(6.0, 6.0), (20.0, 6.0), (20.0, 10.0), (10.0, 10.0), (10.0, 20.0), (6.0, 20.0)]
    u = [(30.0, 6.0), (44.0, 6.0), (44.0, 20.0), (40.0, 20.0), (40.0, 10.0), (34.0, 10.0), (34.0, 20.0), (30.0, 20.0)]
    tee = [(6.0, 44.0), (6.0, 40.0), (11.0, 40.0), (11.0, 30.0), (15.0, 30.0), (15.0, 40.0), (20.0, 40.0), (20.0, 44.0)]
    return _without(ell, u, tee, _plus(centre=(37.0, 37.0), reach=7.0, half_width=2.0))


def five_obstacles() -> Polygon:
    """Draw five squares of side 8."""
    corners = [(7.0, 7.0), (35.0, 7.0), (21.0, 21.0), (7.0, 35.0), (35.0, 35.0)]
    return square(*((x, y, x + 8.0, y + 8.0) for x, y in corners))


def six_pillars() -> Polygon:
    """Draw two rows of three pillars."""
    return _without(*(_regular(8, centre=(x, y), radius=4.0) for y in (15.0, 35.0) for x in (10.0, 25.0, 40.0)))


def disc() -> Polygon:
    """Draw a regular polygon of 96 corners, all on the circle of diameter 50."""
    return Polygon(_regular(_DISC_SIDES, centre=_MIDDLE, radius=25.0))


def corridor() -> Polygon:
    """Draw a corridor 8 wide."""
    return box(0.0, 0.0, _SIDE, 8.0)


def l_room() -> Polygon:
    """Draw two wings 20 wide."""
    return Polygon([(0.0, 0.0), (50.0, 0.0), (50.0, 20.0), (20.0, 20.0), (20.0, 50.0), (0.0, 50.0)])


def u_corridor() -> Polygon:
    """Draw a corridor 12 wide on three sides of the square."""
    return Polygon([(0.0, 0.0), (50.0, 0.0), (50.0, 50.0), (38.0, 50.0), (38.0, 12.0), (12.0, 12.0), (12.0, 50.0), (0.0, 50.0)])


def t_junction() -> Polygon:
    """Draw corridors 16 wide."""
    return Polygon([(0.0, 34.0), (17.0, 34.0), (17.0, 0.0), (33.0, 0.0), (33.0, 34.0), (50.0, 34.0), (50.0, 50.0), (0.0, 50.0)])


def cross() -> Polygon:
    """Draw corridors 14 wide."""
    return Polygon(_plus(centre=_MIDDLE, reach=25.0, half_width=7.0))


def ring_corridor() -> Polygon:
    """Draw a corridor 8 wide round a disc."""
    return Polygon(_regular(_DISC_SIDES, centre=_MIDDLE, radius=25.0), [_regular(_DISC_SIDES, centre=_MIDDLE, radius=17.0)])


def star() -> Polygon:
    """Draw seven spikes of length 25 that leave a heptagon of radius 7 in the middle."""
    # Half the angle of a tip is atan(7 sin(pi/7) / (25 - 7 cos(pi/7))), 9.2 degrees.
    x, y = draws.circle(np.arange(14) / 14 + 0.25)
    radius = np.where(np.arange(14) % 2 == 0, 25.0, 7.0)
    return Polygon(np.column_stack([25.0 + radius * x, 25.0 + radius * y]))


def thin_walls() -> Polygon:
    """Draw four walls across the square that leave gaps of 8 at alternate ends."""
    walls = [
        box(0.0, y, 42.0, y + 0.05) if number % 2 == 0 else box(8.0, y, 50.0, y + 0.05) for number, y in enumerate((10.0, 20.0, 30.0, 40.0))
    ]
    return _only_polygon(shapely.difference(box(0.0, 0.0, _SIDE, _SIDE), shapely.union_all(walls)))


def office() -> Polygon:
    """Draw a corridor 8 wide, three rooms on each side behind walls 1 thick, with doors 4 wide.

    Two rooms that are joined by a door, and each to the corridor, make a way round; the desks make another.
    """
    rooms = [box(x, y, x + 16.0, y + 20.0) for y in (0.0, 30.0) for x in (0.0, 17.0, 34.0)]
    to_corridor = [box(x + 6.0, y, x + 10.0, y + 1.0) for y in (20.0, 29.0) for x in (0.0, 17.0, 34.0)]
    between = [box(16.0, 40.0, 17.0, 44.0), box(33.0, 6.0, 34.0, 10.0)]
    floor = shapely.union_all([box(0.0, 21.0, 50.0, 29.0), *rooms, *to_corridor, *between])
    return _only_polygon(shapely.difference(floor, box(39.0, 37.0, 45.0, 43.0)))


def two_islands() -> MultiPolygon:
    """Draw two rooms 22 wide, 6 apart."""
    obstacle = box(35.0, 20.0, 43.0, 30.0)
    return MultiPolygon([box(0.0, 0.0, 22.0, 50.0), Polygon(box(28.0, 0.0, 50.0, 50.0).exterior, [obstacle.exterior])])


def two_rooms(*, is_open: bool) -> Polygon | MultiPolygon:
    """Draw two rooms behind a wall 1 thick, with a doorway 10 wide that a slab 0.2 thick can close."""
    wall = [box(24.5, 0.0, 25.5, 20.0), box(24.5, 30.0, 25.5, 50.0)]
    obstacles = [box(8.0, 20.0, 17.0, 30.0), box(33.0, 20.0, 42.0, 30.0)]
    slab = [] if is_open else [box(24.9, 20.0, 25.1, 30.0)]
    rooms = shapely.difference(box(0.0, 0.0, _SIDE, _SIDE), shapely.union_all(wall + obstacles + slab))
    assert isinstance(rooms, Polygon | MultiPolygon)
    return rooms


def _without(*obstacles: list[Place]) -> Polygon:
    return Polygon(box(0.0, 0.0, _SIDE, _SIDE).exterior, obstacles)


def _regular(n_corners: int, *, centre: Place, radius: float) -> list[Place]:
    # Not of the C library, whose cosine differs in the last bit from one machine to the next.
    x, y = draws.circle((np.arange(n_corners) + 0.5) / n_corners)
    return list(zip((centre[0] + radius * x).tolist(), (centre[1] + radius * y).tolist(), strict=True))


def _plus(*, centre: Place, reach: float, half_width: float) -> list[Place]:
    x, y = centre
    quarter = [(reach, -half_width), (reach, half_width), (half_width, half_width)]
    corners = []
    for _ in range(4):
        corners += [(x + across, y + up) for across, up in quarter]
        quarter = [(-up, across) for across, up in quarter]
    return corners


def _only_polygon(shape: object) -> Polygon:
    assert isinstance(shape, Polygon)
    return shape
