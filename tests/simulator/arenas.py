"""Arenas for the tests: five of known difficulty, and random ones with spikes, holes and slits."""

import math

from hypothesis import assume
from hypothesis import strategies as st
from shapely.geometry import MultiPolygon, Polygon, box
from shapely.geometry.base import BaseGeometry

from simulator.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.world import World


def cut_out(shape: Polygon | MultiPolygon, *holes: Polygon) -> Polygon | MultiPolygon:
    """Take holes out of a shape that stays an area."""
    left: BaseGeometry = shape
    for hole in holes:
        left = left.difference(hole)
    assert isinstance(left, Polygon | MultiPolygon)
    return left


def square(side: float = 10.0) -> Arena:
    return build_arena(box(0, 0, side, side))


def one_obstacle() -> Arena:
    return build_arena(cut_out(box(0, 0, 10, 10), box(3, 3, 7, 7)))


def thin_walls() -> Arena:
    """A room of side 10 cut by walls a thousandth thick, with doors at alternate ends."""
    walls = [box(0, 2.5, 8, 2.501), box(2, 5, 10, 5.001), box(0, 7.5, 8, 7.501)]
    return build_arena(cut_out(box(0, 0, 10, 10), *walls))


def star() -> Arena:
    """Seven spikes of about 12 degrees."""
    turns = [k * math.pi / 7 for k in range(14)]
    return build_arena(Polygon([(5 + r * math.cos(a), 5 + r * math.sin(a)) for k, a in enumerate(turns) if (r := 5.0 if k % 2 else 1.5)]))


def two_rooms() -> Arena:
    """Two rooms apart by less than a detection radius, without a door."""
    return build_arena(MultiPolygon([box(0, 0, 4.9, 10), box(5.1, 0, 10, 10)]))


FIVE = {"square": square, "one obstacle": one_obstacle, "thin walls": thin_walls, "star": star, "two rooms": two_rooms}


@st.composite
def arenas(draw: st.DrawFn) -> Arena:
    """Draw a star-shaped outline with spikes as sharp as they come, a triangular hole, and now and then a wall thin as a hair."""
    count = draw(st.integers(3, 12))
    radii = draw(st.lists(st.floats(0.02, 1.0), min_size=count, max_size=count))
    jitter = draw(st.lists(st.floats(0.0, 0.9), min_size=count, max_size=count))
    angles = [2 * math.pi * (k + j) / count for k, j in enumerate(jitter)]
    outline = Polygon([(10 * r * math.cos(a), 10 * r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]).buffer(0)
    holes = []
    if draw(st.booleans()):
        x, y, size = draw(st.floats(-3, 3)), draw(st.floats(-3, 3)), draw(st.floats(0.01, 3))
        holes.append(Polygon([(x, y), (x + size, y + 0.1 * size), (x + 0.3 * size, y + size)]))
    if draw(st.booleans()):
        y, thickness = draw(st.floats(-3, 3)), draw(st.floats(1e-6, 1e-3))
        holes.append(box(-4, y, 4, y + thickness))
    assume(isinstance(outline, Polygon | MultiPolygon))
    shape = cut_out(outline, *holes)
    assume(shape.is_valid and shape.area > 0.5)
    return build_arena(shape)


def world_in(arena: Arena, *, biobots: int = 30, seed: int = 1, speed: float = 1.0, mean_leg: float = 2.0, detection: float = 0.5) -> World:
    return World(
        arena,
        motion=MotionParameters(speed=speed, mean_leg=mean_leg),
        ranges=Ranges(detection=detection, communication=4 * detection),
        ids=range(1, biobots + 1),
        seed=seed,
    )
