"""Arenas for the tests: five of known difficulty, from the studies, and random ones with spikes, holes and slits."""

import math

from hypothesis import assume
from hypothesis import strategies as st
from shapely.geometry import MultiPolygon, Polygon, box

from simulator.arenas.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.world import World
from studies.hard_arenas import FIVE, cut_out, one_obstacle, square, star, thin_walls, two_rooms

__all__ = ["FIVE", "arenas", "cut_out", "one_obstacle", "square", "star", "thin_walls", "two_rooms", "world_in"]


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
