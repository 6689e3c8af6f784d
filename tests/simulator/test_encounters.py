"""Laws of encounters: exact, and never through a wall."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import box

from simulator.arenas.arena import Arena, build_arena
from simulator.events import EncounterBegan, EncounterEnded
from simulator.world import World
from tests.simulator.arenas import FIVE, cut_out, square, world_in
from tests.simulator.plain.encounters import ContactFinder, Contacts
from tests.simulator.plain.leg_log import Legs

# A wall from x = 4 to x = 6, a thousandth thick, in a room of side 10; both ends free.
FREE_WALL = build_arena(cut_out(box(0, 0, 10, 10), box(4, 4.9995, 6, 5.0005)))


def contacts_of(arena: Arena, *paths: tuple[float, float, float, float], radius: float = 1.0, end_s: float = 10.0) -> Contacts:
    """Let insects walk from (x, y) at velocity (vx, vy), one leg each, from 0 to ``end_s``."""
    x, y, vx, vy = np.array(paths, dtype=float).T
    legs = Legs(biobot=np.arange(len(paths)), t_start_s=np.zeros(len(paths)), t_end_s=np.full(len(paths), end_s), x=x, y=y, vx=vx, vy=vy)
    return ContactFinder(arena, detection_radius=radius, speed=1.0).find(legs, begin_s=0.0, end_s=end_s)


def intervals(contacts: Contacts) -> list[tuple[float, float]]:
    return list(zip(contacts.t_start_s.tolist(), contacts.t_end_s.tolist(), strict=True))


def test_walkers_that_cross_meet_from_one_root_to_the_other() -> None:
    """Towards each other at 1 each, aside by 0.6: within 1 while |dx| <= 0.8, that is 0.8 s around the passing."""
    assert intervals(contacts_of(square(), (1, 5, 1, 0), (9, 5.6, -1, 0))) == [pytest.approx((3.6, 4.4), rel=1e-14)]


def test_those_who_stand_together_meet_for_as_long_as_they_stand() -> None:
    assert intervals(contacts_of(square(), (5, 5, 0, 0), (5.5, 5, 0, 0))) == [(0.0, 10.0)]
    assert intervals(contacts_of(square(), (5, 5, 0, 0), (6.5, 5, 0, 0))) == []


def test_those_who_walk_side_by_side_meet_all_along() -> None:
    assert intervals(contacts_of(square(), (1, 5, 0.5, 0), (1, 5.5, 0.5, 0))) == [(0.0, 10.0)]


def test_a_wall_ends_an_encounter_at_the_instant_its_end_is_in_line() -> None:
    """Side by side at 1 apart from 2.5 to 7.5, one on each side: the wall hides them exactly from 4 to 6."""
    met = intervals(contacts_of(FREE_WALL, (2.5, 4.6, 0.5, 0), (2.5, 5.4, 0.5, 0)))
    assert met == [pytest.approx((0, 3), rel=1e-12), pytest.approx((7, 10), rel=1e-12)]


def test_a_walker_comes_into_sight_around_a_corner() -> None:
    """One rests at (4.1, 4.8) below the wall; one walks up past its end at x = 3.9 in speed 0.1 from y = 4.8.

    In line with the corner (4, 4.9995): y = 4.8 + 2 * 0.1995 = 5.199 at 3.99 s; from then on the wall is between.
    """
    met = intervals(contacts_of(FREE_WALL, (4.1, 4.8, 0, 0), (3.9, 4.8, 0, 0.1)))
    assert met == [pytest.approx((0, 3.99), rel=1e-12)]


@pytest.mark.parametrize("x", [4.0, 4.001, 5.0, 5.9])
def test_resting_insects_do_not_meet_through_a_wall(x: float) -> None:
    assert intervals(contacts_of(FREE_WALL, (x, 4.8, 0, 0), (x + 0.05, 5.2, 0, 0))) == []


def test_two_rooms_never_meet() -> None:
    world = world_in(FIVE["two rooms"](), biobots=60)
    events = world.advance(50.0)
    ended = [event for event in events if isinstance(event, EncounterEnded)]
    right = {one for one in world.ids if world.position(one)[0] > 5}
    assert len(ended) > 100
    assert not [event for event in ended if (event.id1 in right) != (event.id2 in right)]


def encounter_intervals(world: World, *, until_s: float) -> dict[tuple[int, int], list[tuple[float, float]]]:
    found: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for event in world.advance(until_s):
        if isinstance(event, EncounterEnded):
            found.setdefault((event.id1, event.id2), []).append((event.t_start_s, event.t_end_s))
    for still in world.open_encounters():
        found.setdefault((still.id1, still.id2), []).append((still.t_s, math.inf))
    return found


@pytest.mark.parametrize("name", FIVE)
def test_encounters_agree_with_stepping_by_a_millisecond(name: str) -> None:
    """Whether a pair is within reach and in sight, looked up every millisecond, is what the intervals say at that instant."""
    arena, biobots, until_s = FIVE[name](), 24, 12.0
    world = world_in(arena, biobots=biobots, seed=11, detection=0.8)
    world.stop(3)
    found = encounter_intervals(world, until_s=until_s)
    # Odd offset: no step falls on the start, where everything begins at once.
    t_s = np.arange(0.0005, until_s, 0.001)
    at = world.positions_of(np.repeat(world.ids, t_s.size).tolist(), np.tile(t_s, biobots)).reshape(biobots, t_s.size, 2)
    shapely.prepare(arena.polygon)
    n_edges = 0
    for one in range(biobots):
        for other in range(one + 1, biobots):
            near = np.hypot(*(at[one] - at[other]).T) <= 0.8
            lines = shapely.linestrings(np.stack([at[one][near], at[other][near]], axis=1))
            stepped = near.copy()
            stepped[near] = shapely.covers(arena.polygon, lines)
            exact = np.zeros(t_s.size, dtype=bool)
            for start_s, end_s in found.get((one + 1, other + 1), []):
                exact |= (t_s >= start_s) & (t_s <= end_s)
            assert (stepped == exact).all()
            n_edges += int(np.count_nonzero(stepped[1:] != stepped[:-1]))
    assert n_edges > 50


@given(
    st.lists(
        st.tuples(st.floats(45, 55), st.floats(45, 55), st.floats(-1, 1), st.floats(-1, 1)), min_size=2, max_size=6
    ),
    st.floats(0.01, 5),
)  # fmt: skip
def test_distance_at_the_ends_of_a_contact_is_the_radius(paths: list[tuple[float, float, float, float]], radius: float) -> None:
    contacts = contacts_of(square(100.0), *paths, radius=radius)
    legs = np.array(paths)
    for first, second, *ends in zip(contacts.first, contacts.second, contacts.t_start_s, contacts.t_end_s, strict=True):
        apart = legs[first] - legs[second]
        for t_s in ends:
            distance = np.hypot(*(apart[:2] + apart[2:] * t_s))
            assert distance <= radius * (1 + 1e-7)
            assert t_s in (0.0, 10.0) or distance == pytest.approx(radius, rel=1e-6)


def test_kinetic_gas_sets_the_rate() -> None:
    """Starts a second: v r_d 4 N (N - 1) / (pi A) = 1 * 0.5 * 4 * 999000 / (pi * 10^4) = 63.6, so 3,180 in 50 s (s.d. 1.8 %).

    The walls cut off about 4 r_d / (pi L) = 0.6 % of the discs.
    """
    world = world_in(square(100.0), biobots=1000, seed=2, mean_leg=20.0, detection=0.5)
    events = world.advance(50.0)
    began = [event for event in events if isinstance(event, EncounterBegan) and event.t_s > 0]
    assert len(began) == pytest.approx(50 * 0.5 * 4 * 1000 * 999 / (math.pi * 1e4), rel=0.06)
