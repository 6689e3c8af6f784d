"""Laws of the world: same seed, same run, however it is cut up; commands; neighbours."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.config import MotionParameters, Ranges
from simulator.errors import ParameterError, TimeError, UnknownBiobotError
from simulator.events import BackpackSilenced, Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.world import World
from tests.simulator.arenas import FIVE, one_obstacle, square, world_in

MOTION = MotionParameters(speed=1.0, mean_leg=2.0)
RANGES = Ranges(detection=0.5, communication=2.0)


def event_key(event: Event) -> tuple[float, int, int, int]:
    match event:
        case ModeChanged():
            return event.t_s, 0, 0, 0  # changes of one instant keep the order of the commands
        case EncounterEnded():
            return event.t_end_s, 1, event.id1, event.id2
        case EncounterBegan():
            return event.t_s, 2, event.id1, event.id2
        case BackpackSilenced():
            return event.t_s, 3, event.id, 0


COMMANDS = [(2.5, "stop", 4), (2.5, "stop", 9), (3.0, "stop", 4), (7.25, "start", 4), (7.25, "stop", 2), (7.25, "start", 2)]


def run_with_commands(world: World, *, cuts: list[float], until_s: float) -> list[Event]:
    events: list[Event] = []
    for at_s, verb, biobot in [*COMMANDS, (until_s, "", 0)]:
        for cut in sorted(cut for cut in cuts if world.now_s <= cut < at_s):
            events += world.advance(cut)
        events += world.advance(at_s)
        if verb:
            getattr(world, verb)(biobot)
    return events


@settings(max_examples=40)
@given(st.lists(st.floats(0, 12), max_size=30), st.sampled_from(sorted(FIVE)))
def test_any_chunking_gives_the_same_events_bit_for_bit(cuts: list[float], name: str) -> None:
    whole, cut_up = world_in(FIVE[name]()), world_in(FIVE[name]())
    expected = run_with_commands(whole, cuts=[], until_s=12.0)
    assert run_with_commands(cut_up, cuts=cuts, until_s=12.0) == expected
    assert cut_up.open_encounters() == whole.open_encounters()
    assert (cut_up.positions() == whole.positions()).all()


def test_cutting_at_the_very_instants_of_events_changes_nothing() -> None:
    expected = run_with_commands(world_in(one_obstacle()), cuts=[], until_s=12.0)
    cuts = [event_key(event)[0] for event in expected]
    assert run_with_commands(world_in(one_obstacle()), cuts=cuts, until_s=12.0) == expected


def test_cutting_at_the_very_turns_of_the_walks_changes_nothing() -> None:
    whole = world_in(one_obstacle())
    expected = whole.advance(12.0)
    log = whole._log
    turns = log.t_end_s(np.arange(len(log)))
    cut_up = world_in(one_obstacle())
    events = [event for cut in sorted(turns[turns < 12.0]) for event in cut_up.advance(cut)] + cut_up.advance(12.0)
    assert events == expected


def test_events_come_in_order_and_pair_up() -> None:
    world = world_in(square(), biobots=40)
    events = run_with_commands(world, cuts=[1.0, 5.0], until_s=20.0)
    assert [event_key(event) for event in events] == sorted(event_key(event) for event in events)
    began = {(event.t_s, event.id1, event.id2) for event in events if isinstance(event, EncounterBegan)}
    ended = {(event.t_start_s, event.id1, event.id2) for event in events if isinstance(event, EncounterEnded)}
    still = {(event.t_s, event.id1, event.id2) for event in world.open_encounters()}
    assert began == ended | still
    assert not ended & still
    assert all(first < second for _, first, second in began)
    assert all(event.t_start_s < event.t_end_s for event in events if isinstance(event, EncounterEnded))


def test_same_seed_same_run_and_another_seed_another() -> None:
    runs = [world_in(square(), seed=seed).advance(5.0) for seed in (5, 5, 6)]
    assert runs[0] == runs[1] != runs[2]


def test_an_insect_walks_the_same_whoever_else_is_there() -> None:
    few = World(one_obstacle(), motion=MOTION, ranges=RANGES, ids=[7, 3], seed=8)
    many = World(one_obstacle(), motion=MOTION, ranges=RANGES, ids=range(1, 60), seed=8)
    few.advance(30.0)
    many.advance(30.0)
    for one in (3, 7):
        assert few.position(one) == many.position(one)


def test_speed_changes_when_but_not_where() -> None:
    """At twice the speed everything happens in half the time: a power of two keeps every bit."""
    slow = World(one_obstacle(), motion=MOTION, ranges=RANGES, ids=range(1, 31), seed=8)
    fast = World(one_obstacle(), motion=MOTION, ranges=RANGES, ids=range(1, 31), seed=8, speed_factor=2.0)
    slow_keys = [event_key(event) for event in slow.advance(16.0)]
    fast_keys = [event_key(event) for event in fast.advance(8.0)]
    assert (fast.positions() == slow.positions()).all()
    assert [key[1:] for key in fast_keys] == [key[1:] for key in slow_keys]
    np.testing.assert_allclose([key[0] for key in fast_keys], [key[0] / 2 for key in slow_keys], atol=1e-12)


def test_a_stopped_biobot_stands_until_it_is_started() -> None:
    world = world_in(square())
    world.advance(3.0)
    assert world.stop(5)
    place = world.position(5)
    assert world.mode(5) is Mode.S
    world.advance(50.0)
    assert world.position(5) == place
    assert world.start(5)
    world.advance(51.0)
    assert world.mode(5) is Mode.CRW
    assert math.dist(world.position(5), place) > 0.01
    assert world.position(5, at_s=20.0) == place


def test_commands_are_idempotent_and_told_by_the_next_advance() -> None:
    world = world_in(square(), biobots=3)
    assert not world.start(1)
    assert world.stop(1)
    assert not world.stop(1)
    world.advance(0.0)
    changes = [event for event in world.advance(1.0) if isinstance(event, ModeChanged)]
    assert changes == [ModeChanged(t_s=0.0, id=1, mode=Mode.S, cause=Cause.COMMAND)]
    assert world.start(1, cause=Cause.NATURAL)
    assert not world.start(1)
    changes = [event for event in world.advance(2.0) if isinstance(event, ModeChanged)]
    assert changes == [ModeChanged(t_s=1.0, id=1, mode=Mode.CRW, cause=Cause.NATURAL)]


def test_a_command_takes_over_a_natural_stop_but_not_the_other_way_round() -> None:
    world = world_in(square(), biobots=3)
    assert world.stop(1, cause=Cause.NATURAL)
    assert world.stop(1, cause=Cause.COMMAND)
    assert not world.stop(1, cause=Cause.NATURAL)
    causes = [event.cause for event in world.advance(1.0) if isinstance(event, ModeChanged)]
    assert causes == [Cause.NATURAL, Cause.COMMAND]


def test_an_encounter_outlives_the_stop_of_either() -> None:
    """Stopping in the middle of an encounter neither ends nor restarts it."""
    world = world_in(square(), biobots=40, detection=1.0)
    world.advance(5.0)
    before = world.open_encounters()
    assert before
    for event in before:
        world.stop(event.id1)
        world.stop(event.id2)
    world.advance(500.0)
    assert set(before) <= set(world.open_encounters())


def test_places_of_the_past_are_remembered() -> None:
    world = world_in(one_obstacle())
    seen = {}
    for t_s in (0.0, 0.7, 1.9, 2.5, 8.0):
        world.advance(t_s)
        seen[t_s] = world.positions()
    world.stop(1)
    world.advance(10.0)
    for t_s, places in seen.items():
        np.testing.assert_allclose(world.positions(at_s=t_s), places, atol=1e-12)


def test_neighbours_are_those_within_the_communication_radius() -> None:
    world = world_in(square(), biobots=50)
    world.advance(3.0)
    places = dict(zip(world.ids, world.positions().tolist(), strict=True))
    adjacency = world.adjacency()
    for one, place in places.items():
        near = {other for other in places if other != one and math.dist(place, places[other]) <= 2.0}
        assert world.neighbours(one) == near == adjacency[one]


def test_walls_do_not_hinder_radio() -> None:
    world = world_in(FIVE["two rooms"](), biobots=50)
    left = {one for one in world.ids if world.position(one)[0] < 5}
    assert any(world.neighbours(one) - left for one in left)


def test_time_does_not_run_backwards() -> None:
    world = world_in(square())
    world.advance(2.0)
    for wrong in (1.0, math.nan, math.inf):
        with pytest.raises(TimeError, match=r"not before the present, 2\.0 s"):
            world.advance(wrong)
    for wrong in (-1.0, 2.1, math.nan):
        with pytest.raises(TimeError, match="from 0 to the present"):
            world.positions(at_s=wrong)


def test_strangers_are_refused() -> None:
    world = world_in(square(), biobots=3)
    for ask in (world.stop, world.start, world.mode, world.position, world.neighbours):
        with pytest.raises(UnknownBiobotError, match="no biobot has id 4; this world holds 3, with ids between 1 and 3"):
            ask(4)


@pytest.mark.parametrize("ids", [[], [1, 1], [0], [2**63]])
def test_ids_are_positive_and_different(ids: list[int]) -> None:
    with pytest.raises(ParameterError, match="at least one id, all different"):
        World(square(), motion=MOTION, ranges=RANGES, ids=ids, seed=1)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_parameters_are_positive_and_finite(value: float) -> None:
    with pytest.raises(ParameterError, match=r"speed is .*; wanted a positive finite number"):
        MotionParameters(speed=value, mean_leg=1.0)
    with pytest.raises(ParameterError, match="detection is"):
        Ranges(detection=value, communication=1.0)
    with pytest.raises(ParameterError, match="speed_factor is"):
        World(square(), motion=MOTION, ranges=RANGES, ids=[1], seed=1, speed_factor=value)


def test_radio_reaches_at_least_as_far_as_detection() -> None:
    with pytest.raises(ParameterError, match=r"at least the detection radius, 2\.0"):
        Ranges(detection=2.0, communication=1.0)
