"""Laws of motion beyond the bare correlated random walk: walls followed, stops, company, mishaps, steering, walls that move."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import MultiPolygon, box

from simulator.arenas.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.errors import ArenaError, ParameterError
from simulator.events import BackpackSilenced, Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged, SilenceReason
from simulator.legs import Legs
from simulator.motion import MotionParameters, WallLaw
from simulator.presets import PRESETS
from simulator.world import World
from tests.simulator.arenas import FIVE, arenas, cut_out, one_obstacle, square
from tests.simulator.test_walk import check_inside

RANGES = Ranges(detection=0.5, communication=2.0)
FOLLOWING = MotionParameters(
    speed=1.0, mean_leg=3.0, wall_law=WallLaw.FOLLOW, wall_speed=0.8, exit_hazard=0.2, departure_median_deg=36.6, departure_log_sd=0.76
)


def walked(motion: MotionParameters, arena: Arena, *, until_s: float, biobots: int = 20, seed: int = 1) -> tuple[World, list[Event]]:
    world = World(arena, motion=motion, ranges=RANGES, ids=range(1, biobots + 1), seed=seed)
    return world, world.advance(until_s)


def distance_to_wall(arena: Arena, legs: Legs) -> tuple[np.ndarray, np.ndarray]:
    ends = [legs.at(legs.t_start_s), legs.at(legs.t_end_s)]
    return tuple(np.asarray(shapely.distance(arena.polygon.boundary, shapely.points(x, y))) for x, y in ends)  # type: ignore[return-value]


@settings(max_examples=80)
@given(arenas(), st.integers(0, 2**64 - 1), st.sampled_from(WallLaw), st.floats(0, 0.9))
def test_no_insect_ever_leaves_a_random_polygon_whatever_it_does_at_walls(
    arena: Arena, seed: int, law: WallLaw, persistence: float
) -> None:
    motion = MotionParameters(
        speed=1.0, mean_leg=5.0, persistence=persistence, wall_law=law, exit_hazard=0.3, departure_log_sd=0.76, stop_hazard=0.1,
        wall_stop_hazard=0.1, short_rest_s=0.5, contact_radius=0.1, contact_turns=True,
    )  # fmt: skip
    world, _ = walked(motion, arena, until_s=20.0, biobots=10, seed=seed)
    check_inside(arena, world.legs())


@pytest.mark.parametrize("name", FIVE)
def test_wall_followers_keep_to_the_wall_until_they_leave_it(name: str) -> None:
    """Legs at wall speed begin and end a margin from a wall, however the walls turn."""
    arena = FIVE[name]()
    world, _ = walked(FOLLOWING, arena, until_s=300.0)
    legs = world.legs()
    check_inside(arena, legs)
    along = np.abs(np.hypot(legs.vx, legs.vy) - 0.8) < 1e-9
    start, end = distance_to_wall(arena, legs)
    assert np.count_nonzero(along) > 100
    # Round the corner of an obstacle the path swings out: at right angles by sqrt(2) margins.
    assert max(start[along].max(), end[along].max()) < 12 * arena.margin
    assert min(start[along].min(), end[along].min()) > 0.99 * arena.margin


def test_without_an_exit_a_wall_is_followed_all_the_way_round() -> None:
    """A square of side 10 has a way round of 40: at speed 1, back at the same place after 40 s."""
    motion = MotionParameters(speed=1.0, mean_leg=1e6, wall_law=WallLaw.FOLLOW)
    world, _ = walked(motion, square(), until_s=100.0)
    np.testing.assert_allclose(world.positions(at_s=50.0), world.positions(at_s=90.0), atol=1e-6)


def test_an_obstacle_is_followed_all_the_way_round_too() -> None:
    """The obstacle's sides are 4 long: 16 s round it, for those whose first wall it was."""
    motion = MotionParameters(speed=1.0, mean_leg=1e6, wall_law=WallLaw.FOLLOW)
    world, _ = walked(motion, one_obstacle(), until_s=100.0, biobots=60)
    places = world.positions(at_s=50.0)
    at_obstacle = np.all((places > 2.9) & (places < 7.1), axis=1)
    assert np.count_nonzero(at_obstacle) > 3
    np.testing.assert_allclose(places[at_obstacle], world.positions(at_s=66.0)[at_obstacle], atol=1e-6)


def test_bouts_at_walls_last_as_the_exit_hazard_says() -> None:
    """Hazard 0.2 /s: a mean bout of 5 s, within 4 standard errors of some 2,000 bouts."""
    world, _ = walked(FOLLOWING, square(), until_s=600.0, biobots=50)
    legs = world.legs()
    along = np.abs(np.hypot(legs.vx, legs.vy) - 0.8) < 1e-9
    begins = along[1:] & ~along[:-1] & (legs.biobot[1:] == legs.biobot[:-1])
    n_bouts = np.count_nonzero(begins)
    time_s = float((legs.t_end_s - legs.t_start_s)[along].sum())
    assert n_bouts > 1500
    assert time_s / n_bouts == pytest.approx(5.0, rel=4 / math.sqrt(n_bouts))


def spells(world: World, events: list[Event]) -> list[float]:
    since: dict[int, float] = {}
    rests = []
    for event in events:
        if isinstance(event, ModeChanged):
            if event.mode is Mode.S:
                since[event.id] = event.t_s
            elif event.id in since:
                rests.append(event.t_s - since.pop(event.id))
    return rests


def test_natural_stops_come_and_last_as_they_should() -> None:
    """Hazard 0.1 /s of walking; rests of mean 2 s: some 3,300 stops among 50 insects in 800 s, five sixths of the time walking."""
    motion = MotionParameters(speed=1.0, mean_leg=3.0, stop_hazard=0.1, short_rest_s=2.0)
    world, events = walked(motion, square(), until_s=800.0, biobots=50)
    rests = spells(world, events)
    legs = world.legs()
    walking_s = float((legs.t_end_s - legs.t_start_s)[(legs.vx != 0) | (legs.vy != 0)].sum())
    assert np.mean(rests) == pytest.approx(2.0, rel=0.07)
    assert len(rests) / walking_s == pytest.approx(0.1, rel=0.07)
    assert all(event.cause is Cause.NATURAL for event in events if isinstance(event, ModeChanged))


def test_rests_are_a_mixture_of_short_and_long_ones() -> None:
    motion = MotionParameters(speed=1.0, mean_leg=3.0, stop_hazard=0.2, short_rest_s=1.0, long_rest_s=100.0, long_rest_share=0.25)
    world, events = walked(motion, square(), until_s=5000.0, biobots=40)
    rests = np.array(spells(world, events))
    assert np.mean(rests > 8.0) == pytest.approx(0.25 * math.exp(-0.08) + 0.75 * math.exp(-8), abs=0.03)
    assert np.mean(rests[rests > 8.0]) == pytest.approx(108.0, rel=0.1)


def test_company_makes_insects_stop_sooner_and_rest_longer() -> None:
    """Resting insects gather others: with gains, more of them rest in touch with another."""
    alone = MotionParameters(speed=1.0, mean_leg=3.0, stop_hazard=0.02, short_rest_s=5.0, contact_radius=0.3)
    social = MotionParameters(
        speed=1.0, mean_leg=3.0, stop_hazard=0.02, short_rest_s=5.0, contact_radius=0.3, company_stop_gain=50.0, company_rest_gain=10.0
    )
    together: dict[str, int] = {}
    for name, motion in (("alone", alone), ("social", social)):
        world, _ = walked(motion, square(), until_s=300.0, biobots=60)
        places = world.positions()
        apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1)) + 10 * np.eye(60)
        resting = np.array([mode is Mode.S for mode in world.modes()])
        together[name] = int(np.count_nonzero((apart.min(axis=1) < 0.3) & resting))
    assert together["social"] > 5 * max(1, together["alone"])


def test_insects_that_touch_turn_away_from_each_other() -> None:
    """Two walking insects never come nearer than the radius at which they turn, but that a wall may push them back."""
    motion = MotionParameters(speed=1.0, mean_leg=5.0, contact_radius=0.4, contact_turns=True)
    world, _ = walked(motion, square(100.0), until_s=100.0, biobots=200)
    turned, ignored = world.legs(), walked(MotionParameters(speed=1.0, mean_leg=5.0), square(100.0), until_s=100.0, biobots=200)[0].legs()
    assert len(turned) > len(ignored) + 100
    for t_s in np.linspace(20.0, 100.0, 50):
        places = world.positions(at_s=float(t_s))
        inner = places[np.all((places > 1) & (places < 99), axis=1)]
        apart = np.hypot(*(inner[:, None] - inner).transpose(2, 0, 1)) + 10 * np.eye(len(inner))
        assert np.count_nonzero(apart < 0.39) <= 2  # three at once may be pushed into each other


def test_stuck_insects_free_themselves_or_are_freed() -> None:
    """Mishaps of 50 s on average, one in 20 s of walking; a rescuer ends many of them early."""
    stuck = MotionParameters(speed=1.0, mean_leg=3.0, mishap_hazard=0.05, mishap_rest_s=50.0)
    helped = MotionParameters(speed=1.0, mean_leg=3.0, mishap_hazard=0.05, mishap_rest_s=50.0, contact_radius=0.3, rescue_probability=1.0)
    means = [np.mean(spells(*walked(motion, square(), until_s=1000.0, biobots=40))) for motion in (stuck, helped)]
    assert means[0] == pytest.approx(50.0, rel=0.15)
    assert means[1] < 0.6 * means[0]


def test_the_dead_stay_where_they_are_and_their_backpacks_go_on() -> None:
    motion = MotionParameters(speed=1.0, mean_leg=3.0, death_hazard=0.02)
    world, events = walked(motion, square(), until_s=200.0, biobots=60)
    dead = [event.id for event in events if isinstance(event, ModeChanged)]
    assert len(dead) == len(set(dead)) == pytest.approx(60 * (1 - math.exp(-4)), abs=6)
    places = {one: world.position(one) for one in dead}
    later = world.advance(300.0)
    assert places == {one: world.position(one) for one in dead}
    assert any(isinstance(event, EncounterBegan) and (event.id1 in dead or event.id2 in dead) for event in later)
    assert not world.start(dead[0])
    assert world.mode(dead[0]) is Mode.S


def test_a_silent_backpack_has_no_encounters_any_more() -> None:
    motion = MotionParameters(speed=1.0, mean_leg=3.0, loss_hazard=0.01, battery_life_s=150.0, battery_spread=0.2)
    world, events = walked(motion, square(), until_s=200.0, biobots=60)
    silent = {event.id: event for event in events if isinstance(event, BackpackSilenced)}
    assert silent.keys() == set(world.ids)
    assert {event.reason for event in silent.values()} == set(SilenceReason)
    assert all(120 <= event.t_s <= 180 for event in silent.values() if event.reason is SilenceReason.BATTERY)
    for event in events:
        if isinstance(event, EncounterEnded):
            assert event.t_end_s <= min(silent[event.id1].t_s, silent[event.id2].t_s)
    assert world.open_encounters() == []


def test_silencing_by_hand_ends_what_is_open_now() -> None:
    world, _ = walked(MotionParameters(speed=1.0, mean_leg=3.0), square(3.0), until_s=5.0, biobots=30)
    one = world.open_encounters()[0]
    world.silence(one.id1)
    ended = [event for event in world.advance(6.0) if isinstance(event, EncounterEnded) and one.id1 in {event.id1, event.id2}]
    assert ended
    assert all(event.t_end_s == 5.0 for event in ended)


def test_a_turn_is_by_the_angle_asked_and_to_the_left() -> None:
    world, _ = walked(MotionParameters(speed=1.0, mean_leg=1e6), square(1000.0), until_s=5.0)
    before = world.legs().take(np.array([len(world.legs()) - 1]))
    assert world.turn(20, math.pi / 2)
    world.advance(6.0)
    after = world.legs().take(np.array([len(world.legs()) - 1]))
    np.testing.assert_allclose([after.vx[0], after.vy[0]], [-before.vy[0], before.vx[0]], atol=1e-12)


def test_a_run_is_straight_for_the_distance_asked() -> None:
    world, _ = walked(MotionParameters(speed=1.0, mean_leg=0.1), square(1000.0), until_s=5.0)
    start = np.array(world.position(7))
    assert world.run_straight(7, 20.0)
    world.advance(24.999)
    np.testing.assert_allclose(np.hypot(*(np.array(world.position(7)) - start)), 19.999, rtol=1e-9)
    world.advance(45.0)
    assert np.hypot(*(np.array(world.position(7)) - start)) < 39.9


def test_those_who_stand_by_command_only_turn_on_the_spot_and_resters_get_up() -> None:
    motion = MotionParameters(speed=1.0, mean_leg=3.0, stop_hazard=10.0, short_rest_s=1e6)
    world, _ = walked(motion, square(), until_s=20.0)
    world.stop(3)
    place = world.position(3)
    assert not world.turn(3, 1.0)
    assert world.turn(4, 1.0)
    assert world.mode(4) is Mode.CRW
    events = world.advance(20.5)
    assert ModeChanged(t_s=20.0, id=4, mode=Mode.CRW, cause=Cause.COMMAND) in events
    assert world.position(3) == place


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
def test_runs_have_a_length(wrong: float) -> None:
    world, _ = walked(MotionParameters(speed=1.0, mean_leg=3.0), square(), until_s=1.0)
    with pytest.raises(ParameterError, match="distance is"):
        world.run_straight(1, wrong)
    if not math.isfinite(wrong):
        with pytest.raises(ParameterError, match="angle_rad is"):
            world.turn(1, wrong)


ROOMS = cut_out(box(0, 0, 10, 10), box(4.5, 0, 5.5, 3), box(4.5, 7, 5.5, 10))
CLOSED = MultiPolygon([box(0, 0, 4.5, 10), box(5.5, 0, 10, 10)])


@pytest.mark.parametrize("law", WallLaw)
def test_nobody_passes_a_door_that_is_closed(law: WallLaw) -> None:
    motion = MotionParameters(speed=1.0, mean_leg=4.0, wall_law=law, exit_hazard=0.3, stop_hazard=0.05, short_rest_s=2.0)
    world = World(build_arena(ROOMS), motion=motion, ranges=RANGES, ids=range(1, 61), seed=3)
    world.advance(50.0)
    between = [one for one in world.ids if 4.5 < world.position(one)[0] < 5.5]
    world.replace_arena(build_arena(CLOSED))
    side = {one: world.position(one)[0] > 5 for one in world.ids}
    assert between
    assert all(not 4.5 < world.position(one)[0] < 5.5 for one in world.ids)
    events = world.advance(150.0)
    assert {one: world.position(one)[0] > 5 for one in world.ids} == side
    legs = world.legs()
    check_inside(build_arena(CLOSED), legs.take(np.flatnonzero(legs.t_start_s >= 50.0)))
    apart = [event for event in events if isinstance(event, EncounterBegan) and side[event.id1] != side[event.id2]]
    assert not [event for event in apart if event.t_s > 50.0]
    assert not [one for one in world.open_encounters() if side[one.id1] != side[one.id2]]


def test_those_who_are_pushed_apart_meet_no_longer() -> None:
    """An obstacle rises in the middle of a crowd: everybody is pushed to its rim, some far from those they were with."""
    motion = MotionParameters(speed=1.0, mean_leg=4.0, contact_radius=0.5, company_stop_gain=1.0)
    ranges = Ranges(detection=2.0, communication=2.0)
    world = World(square(50.0), motion=motion, ranges=ranges, ids=range(1, 121), seed=3)
    world.advance(10.0)
    world.replace_arena(build_arena(cut_out(box(0, 0, 50, 50), box(5, 5, 45, 45))))
    world.advance(10.0 + 1e-9)
    for one in world.open_encounters():
        assert math.dist(world.position(one.id1), world.position(one.id2)) <= 2.0 + 1e-6
    assert (world.positions() == world.positions_at([world.now_s])[0]).all()


def test_walls_stay_within_the_bounds_of_the_first_arena() -> None:
    world, _ = walked(MotionParameters(speed=1.0, mean_leg=3.0), square(10.0), until_s=1.0)
    with pytest.raises(ArenaError, match="reach beyond"):
        world.replace_arena(square(11.0))


def test_a_door_that_opens_lets_insects_through() -> None:
    world = World(build_arena(CLOSED), motion=MotionParameters(speed=1.0, mean_leg=4.0), ranges=RANGES, ids=range(1, 61), seed=3)
    world.advance(50.0)
    side = {one: world.position(one)[0] > 5 for one in world.ids}
    world.replace_arena(build_arena(ROOMS))
    world.advance(300.0)
    assert sum(side[one] != (world.position(one)[0] > 5) for one in world.ids) > 10


@settings(max_examples=40)
@given(st.floats(1.05, 6.0), st.floats(0.1, 5.0), st.floats(4.0, 1000.0))
def test_legs_of_a_power_law_have_the_mean_asked_for(exponent: float, mean_leg: float, ratio: float) -> None:
    motion = MotionParameters(speed=1.0, mean_leg=mean_leg, levy_exponent=exponent, longest_leg=ratio * mean_leg)
    shortest, longest = motion.shortest_leg, motion.cut_off
    lengths = np.geomspace(shortest, longest, 20_001)
    density = lengths**-exponent
    mean = np.trapezoid(density * lengths, lengths) / np.trapezoid(density, lengths)
    assert mean == pytest.approx(mean_leg, rel=1e-4)


def test_walked_power_law_legs_follow_it() -> None:
    """P(L > l) for mu = 2.2 between the cut-offs, at quartiles of some 20,000 legs in the open."""
    motion = MotionParameters(speed=1.0, mean_leg=1.0, levy_exponent=2.2, longest_leg=50.0)
    world, _ = walked(motion, square(1e5), until_s=400.0, biobots=60)
    legs = world.legs()
    lengths = (legs.t_end_s - legs.t_start_s)[legs.t_end_s < 340.0]
    low, high = motion.shortest_leg, 50.0
    for quantile in (0.25, 0.5, 0.75, 0.95):
        expected = low * (1 - quantile * (1 - (high / low) ** -1.2)) ** (-1 / 1.2)
        assert np.quantile(lengths, quantile) == pytest.approx(expected, rel=0.03)


def test_turns_have_the_persistence_asked_for() -> None:
    motion = MotionParameters(speed=1.0, mean_leg=1.0, persistence=0.6)
    world, _ = walked(motion, square(1e5), until_s=400.0, biobots=40)
    legs = world.legs()
    same = legs.biobot[1:] == legs.biobot[:-1]
    cosines = (legs.vx[1:] * legs.vx[:-1] + legs.vy[1:] * legs.vy[:-1])[same]
    sines = (legs.vx[:-1] * legs.vy[1:] - legs.vy[:-1] * legs.vx[1:])[same]
    assert cosines.mean() == pytest.approx(0.6, abs=0.02)
    assert sines.mean() == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"persistence": 1.0}, "persistence is 1.0"),
        ({"levy_exponent": 1.0}, "levy_exponent is 1.0"),
        ({"levy_exponent": 2.0, "longest_leg": 1.0}, "longest_leg is 1.0; wanted at least two mean legs"),
        ({"stop_hazard": 0.1}, "short_rest_s is 0.0"),
        ({"mishap_hazard": 0.1}, "mishap_rest_s is 0.0"),
        ({"contact_turns": True}, "contact_radius is 0.0"),
        ({"exit_hazard": -0.1}, "exit_hazard is -0.1"),
        ({"wall_speed": 1e5}, "wall_speed is 100000.0; wanted 0.01 to 100, a hundredth to a hundred times the speed"),
        ({"departure_median_deg": 200.0}, "departure_median_deg is 200.0"),
        ({"battery_life_s": math.nan}, "battery_life_s is nan"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(changed: dict[str, float], problem: str) -> None:
    with pytest.raises(ParameterError, match=problem):
        MotionParameters(speed=1.0, mean_leg=1.0, **changed)  # type: ignore[arg-type]  # names and values from the table above


def test_a_world_whose_walls_have_become_fewer_can_be_put_on_disk() -> None:
    """Wall followers remember walls by number; those numbers mean nothing between other walls."""
    world = World(build_arena(cut_out(box(0, 0, 10, 10), box(3, 3, 7, 7))), motion=FOLLOWING, ranges=RANGES, ids=range(1, 31), seed=3)
    world.advance(20.0)
    world.replace_arena(square(10.0))
    world.advance(20.5)
    assert World.restore(world.snapshot()).advance(30.0) == world.advance(30.0)


def test_what_is_set_without_effect_is_named() -> None:
    idle = MotionParameters(speed=1.0, mean_leg=1.0, wall_speed=2.0, longest_leg=5.0, long_rest_s=3.0, rescue_probability=0.5).idle()
    assert idle == ("wall_speed", "longest_leg", "long_rest_s", "rescue_probability")
    assert not any(preset.motion.idle() for preset in PRESETS.values())
