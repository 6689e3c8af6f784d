"""Laws of insects that are told to follow walls, whatever the law of all others: until a start, a stop, or the end of the hold."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.events import Mode
from simulator.legs import Legs
from simulator.motion import MotionParameters, WallLaw
from simulator.world import World
from tests.simulator.arenas import one_obstacle, square
from tests.simulator.test_motion import distance_to_wall
from tests.simulator.test_walk import check_inside

IDS = range(1, 41)
TOLD = range(1, 21)
OTHERS = (WallLaw.UNIFORM, WallLaw.COSINE, WallLaw.MIRROR)


WALKING = MotionParameters(speed=1.0, mean_leg=3.0)


def a_world(law: WallLaw, *, arena: Arena | None = None, motion: MotionParameters = WALKING) -> World:
    return World(arena or square(), motion=replace(motion, wall_law=law), ranges=Ranges(detection=0.5, communication=2.0), ids=IDS, seed=4)


def along_walls(world: World) -> tuple[Legs, np.ndarray]:
    """Return all legs, and which of them begin and end at a wall without leaving it."""
    legs = world.legs()
    assert world.arena is not None
    start, end = distance_to_wall(world.arena, legs)
    along = (start < 12 * world.arena.margin) & (end < 12 * world.arena.margin)
    middle = legs.at(0.5 * (legs.t_start_s + legs.t_end_s))
    inner = world.arena.polygon.buffer(-12 * world.arena.margin)
    return legs, along & ~shapely.contains_xy(inner, *middle)


@pytest.mark.parametrize("law", OTHERS)
def test_those_who_are_told_keep_to_walls_and_the_others_walk_as_if_nobody_had_been(law: WallLaw) -> None:
    """Hazard 0.12 /s, mean leg 3 of a side of 10: who follows is at walls about half the time, who does not hardly at all."""
    world, untold = a_world(law, arena=one_obstacle()), a_world(law, arena=one_obstacle())
    for one in TOLD:
        assert world.follow_walls(one) is False, "it walked before, and walks"
    world.advance(300.0)
    untold.advance(300.0)
    legs, along = along_walls(world)
    assert world.arena is not None
    check_inside(world.arena, legs)
    time_s = legs.t_end_s - legs.t_start_s
    shares = [float(time_s[along & mine].sum() / time_s[mine].sum()) for mine in (legs.biobot < len(TOLD), legs.biobot >= len(TOLD))]
    assert shares[0] > 0.3
    assert shares[1] < 0.02
    rows = slice(len(TOLD), None)
    np.testing.assert_array_equal(world.positions()[rows], untold.positions()[rows])


@pytest.mark.parametrize("verb", ["start", "stop"])
def test_a_start_and_a_stop_end_it(verb: str) -> None:
    world = a_world(WallLaw.UNIFORM)
    for one in IDS:
        world.follow_walls(one)
    world.advance(60.0)
    for one in IDS:
        getattr(world, verb)(one)
        if verb == "stop":
            world.start(one)
    world.advance(260.0)
    legs, along = along_walls(world)
    later = legs.t_start_s >= 60.0
    time_s = legs.t_end_s - legs.t_start_s
    assert time_s[along & ~later].sum() > 0.3 * time_s[~later].sum()
    assert time_s[along & later].sum() < 0.02 * time_s[later].sum()


def test_one_that_rests_at_a_wall_when_it_is_started_leaves_the_wall() -> None:
    """It must not take up the wall again where its rest is over: a start ends the following, whatever the insect does at that moment."""
    world = a_world(WallLaw.UNIFORM, motion=replace(WALKING, stop_hazard=0.2, short_rest_s=4.0))
    for one in IDS:
        world.follow_walls(one)
    world.advance(60.0)
    for one in IDS:
        world.stop(one)  # on top of a rest, too
        world.start(one)
    world.advance(61.0)
    assert world.modes().count(Mode.CRW) > 20
    world.advance(200.0)
    legs, along = along_walls(world)
    moving = along & (legs.t_start_s >= 60.0) & (np.hypot(legs.vx, legs.vy) > 0)
    time_s = legs.t_end_s - legs.t_start_s
    assert time_s[moving].sum() < 0.02 * time_s[legs.t_start_s >= 60.0].sum()


def test_a_turn_does_not_end_it_and_one_that_stands_is_let_go_by_it() -> None:
    world = a_world(WallLaw.UNIFORM)
    world.stop(1)
    world.advance(1.0)
    assert world.follow_walls(1) is True
    world.advance(20.0)
    assert world.mode(1) is Mode.CRW
    for at_s in range(21, 120):
        world.turn(1, 0.1)
        world.advance(float(at_s))
    legs, along = along_walls(world)
    assert (legs.t_end_s - legs.t_start_s)[along & (legs.biobot == 0)].sum() > 20.0


@pytest.mark.parametrize("law", OTHERS)
def test_a_snapshot_knows_who_follows_walls(law: WallLaw) -> None:
    world = a_world(law)
    for one in TOLD:
        world.follow_walls(one)
    world.advance(50.0)
    again = World.restore(world.snapshot())
    for one in (1, 2, 3):
        world.start(one)
        again.start(one)
    assert again.advance(150.0) == world.advance(150.0)
    np.testing.assert_array_equal(again.positions(), world.positions())


def test_where_all_follow_walls_the_command_changes_nothing() -> None:
    motion = replace(WALKING, exit_hazard=0.3, departure_log_sd=0.76)
    world, untold = a_world(WallLaw.FOLLOW, motion=motion), a_world(WallLaw.FOLLOW, motion=motion)
    for at_s in range(1, 60):
        world.advance(float(at_s))
        untold.advance(float(at_s))
        world.follow_walls(1 + at_s % 40)
        world.start(1 + (at_s + 20) % 40)
    np.testing.assert_array_equal(world.positions(), untold.positions())
