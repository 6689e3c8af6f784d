"""Laws of the engine: it says what a plain implementation says, bit for bit, and snapshots of it go on as if nothing had been."""

import contextlib
import io
import math
import threading
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon, box

from simulator.arenas.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.errors import ParameterError, SnapshotError
from simulator.events import BackpackSilenced, EncounterBegan, EncounterEnded, Event, ModeChanged
from simulator.motion import MotionParameters, WallLaw
from simulator.snapshot import seal, unseal
from simulator.world import World
from tests.simulator.arenas import FIVE, arenas, one_obstacle, square
from tests.simulator.plain.world import PlainWorld

RANGES = Ranges(detection=0.8, communication=3.0)
BUSY = MotionParameters(
    speed=1.0, mean_leg=2.0, persistence=0.4, wall_law=WallLaw.FOLLOW, wall_speed=0.9, exit_hazard=0.3, departure_log_sd=0.76,
    stop_hazard=0.1, wall_stop_hazard=0.2, short_rest_s=1.0, long_rest_s=8.0, long_rest_share=0.1, contact_radius=0.2, contact_turns=True,
    company_stop_gain=2.0, company_rest_gain=1.0, mishap_hazard=0.02, mishap_rest_s=4.0, rescue_probability=0.5, death_hazard=0.005,
    loss_hazard=0.01, battery_life_s=25.0, battery_spread=0.5,
)  # fmt: skip


def story(world: World | PlainWorld, *, stops: Sequence[int]) -> tuple[list[Event], list[object], list[list[float]]]:
    events = world.advance(3.0)
    for one in stops:
        world.stop(one)
    events += world.advance(7.5)
    for one in stops[::2]:
        world.start(one)
    events += world.advance(15.0)
    return events, list(world.open_encounters()), world.positions().tolist()


@settings(max_examples=60)
@given(arenas(), st.integers(0, 2**64 - 1), st.floats(0.1, 30), st.sets(st.integers(1, 12)))
def test_engine_and_plain_implementation_agree_bit_for_bit(arena: Arena, seed: int, mean_leg: float, stops: set[int]) -> None:
    motion = MotionParameters(speed=1.0, mean_leg=mean_leg)
    one = World(arena, motion=motion, ranges=RANGES, ids=range(1, 13), seed=seed)
    other = PlainWorld(arena, motion=motion, ranges=RANGES, ids=range(1, 13), seed=seed)
    assert story(one, stops=sorted(stops)) == story(other, stops=sorted(stops))


@pytest.mark.parametrize("name", FIVE)
def test_engine_and_plain_implementation_agree_in_a_crowd(name: str) -> None:
    motion = MotionParameters(speed=1.0, mean_leg=2.0)
    arena = FIVE[name]()
    worlds = [make(arena, motion=motion, ranges=RANGES, ids=range(1, 101), seed=8) for make in (World, PlainWorld)]
    mine, plain = (story(world, stops=range(1, 21)) for world in worlds)
    assert len(mine[0]) > 500
    assert mine == plain


def test_in_a_crowd_progress_is_told_before_the_first_second_is_over() -> None:
    """A leg ends 20 times a second, and each time 400 others are looked at: 3.2 million looks in the first second."""
    world = World(
        build_arena(box(0.0, 0.0, 1.0, 1.0)),
        motion=MotionParameters(speed=1.0, mean_leg=0.05),
        ranges=Ranges(detection=1.0, communication=1.0),
        ids=range(1, 401),
        seed=1,
    )
    told: list[float] = []
    world.run(1.0, progress=told.append)
    assert 0.0 < told[0] < told[-1] == 1.0


def busy(*, seed: int = 3, biobots: int = 40) -> World:
    return World(one_obstacle(), motion=BUSY, ranges=RANGES, ids=range(1, biobots + 1), seed=seed)


@settings(max_examples=25)
@given(st.lists(st.floats(0, 20), max_size=12))
def test_any_chunking_gives_the_same_run_of_busy_insects(cuts: list[float]) -> None:
    whole, cut_up = busy(), busy()
    expected = whole.advance(20.0)
    events = [event for cut in sorted(cuts) for event in cut_up.advance(cut)] + cut_up.advance(20.0)
    assert len({type(event) for event in expected}) == 4
    assert events == expected
    assert (cut_up.positions() == whole.positions()).all()


def test_columns_and_events_tell_the_same() -> None:
    told, columns = busy(), busy()
    events, run = told.advance(20.0), columns.run(20.0)
    ended = [(event.id1, event.id2, event.t_start_s, event.t_end_s) for event in events if isinstance(event, EncounterEnded)]
    table = run.ended
    assert list(zip(table.id1.tolist(), table.id2.tolist(), table.t_start_s.tolist(), table.t_end_s.tolist(), strict=True)) == ended
    assert run.changes == [event for event in events if isinstance(event, ModeChanged | BackpackSilenced)]


@settings(max_examples=15)
@given(st.floats(0.01, 19.9))
def test_a_restored_snapshot_goes_on_as_if_nothing_had_been(at_s: float) -> None:
    whole, halves = busy(), busy()
    expected = whole.advance(20.0)
    before = halves.advance(at_s)
    restored = World.restore(halves.snapshot())
    assert before + restored.advance(20.0) == expected
    assert restored.open_encounters() == whole.open_encounters()
    for name in ("biobot", "t_start_s", "t_end_s", "x", "y", "vx", "vy"):
        assert (getattr(restored.legs(), name) == getattr(whole.legs(), name)).all()


def test_equal_worlds_have_equal_snapshots() -> None:
    snapshots = []
    for _ in range(2):
        world = busy()
        world.advance(12)  # a whole number is an instant too
        snapshots.append(world.snapshot())
    assert snapshots[0] == snapshots[1]


def forge(content: bytes, **changed: np.ndarray) -> bytes:
    """Change arrays of a snapshot and seal it anew, as somebody with bad intentions would."""
    mark = b"biobot world 1\n"
    with np.load(io.BytesIO(unseal(content, mark=mark, source="old"))) as archive:
        arrays = {**archive, **changed}
    body = io.BytesIO()
    np.savez(body, **{name: array for name, array in arrays.items() if array.size})
    return seal(body.getvalue(), mark=mark)


@settings(max_examples=60)
@given(st.data())
def test_forged_snapshots_are_refused_or_harmless(data: st.DataObject) -> None:
    world = busy(biobots=8)
    world.advance(2.0)
    content = world.snapshot()
    with np.load(io.BytesIO(unseal(content, mark=b"biobot world 1\n", source="old"))) as archive:
        engine = archive["engine"].copy()
    # Indices are 32-bit words of the engine's memory, behind its header and its parameters.
    word = data.draw(st.integers(300, engine.size // 4 - 1))
    engine[4 * word : 4 * word + 4] = np.frombuffer(np.int32(data.draw(st.integers(-(2**31), 2**31 - 1))).tobytes(), dtype=np.uint8)
    with contextlib.suppress(SnapshotError):
        World.restore(forge(content, engine=engine)).positions()


@pytest.mark.parametrize("name", ["ids", "head", "engine", "lost_first"])
def test_snapshots_without_a_part_are_refused(name: str) -> None:
    content = busy(biobots=8).snapshot()
    with pytest.raises(SnapshotError, match="wanted a whole snapshot"):
        World.restore(forge(content, **{name: np.empty(0, dtype=np.int64)}))
    with pytest.raises(SnapshotError, match="wanted a whole snapshot"):
        World.restore(forge(content, ids=np.array([1], dtype=np.int64), lost_first=np.array([False])))


def test_a_snapshot_taken_after_a_command_still_tells_of_it() -> None:
    world = busy()
    world.advance(2.0)
    world.stop(4)
    assert World.restore(world.snapshot()).advance(6.0) == world.advance(6.0)


@settings(max_examples=30)
@given(st.data())
def test_damaged_snapshots_are_refused(data: st.DataObject) -> None:
    world = busy(biobots=5)
    world.advance(1.0)
    content = bytearray(world.snapshot())
    if data.draw(st.booleans()):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] ^= data.draw(st.integers(1, 255))
    else:
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    with pytest.raises(SnapshotError, match="wanted a whole snapshot"):
        World.restore(bytes(content), source="old.snapshot")


def test_runs_in_two_threads_at_once_are_the_runs_alone() -> None:
    expected = [busy(seed=seed).advance(20.0) for seed in (1, 2)]
    found: dict[int, list[Event]] = {}

    def go(seed: int) -> None:
        found[seed] = busy(seed=seed).advance(20.0)

    threads = [threading.Thread(target=go, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [found[1], found[2]] == expected


def test_who_else_is_there_changes_no_path_where_insects_ignore_each_other() -> None:
    calm = MotionParameters(speed=1.0, mean_leg=2.0, wall_law=WallLaw.FOLLOW, exit_hazard=0.3, stop_hazard=0.1, short_rest_s=1.0)
    few = World(one_obstacle(), motion=calm, ranges=RANGES, ids=[7, 3], seed=8)
    many = World(one_obstacle(), motion=calm, ranges=RANGES, ids=range(1, 60), seed=8)
    few.advance(60.0)
    many.advance(60.0)
    assert [few.position(one) for one in (3, 7)] == [many.position(one) for one in (3, 7)]


def test_twice_the_speed_is_the_same_run_in_half_the_time() -> None:
    slow = World(one_obstacle(), motion=BUSY, ranges=RANGES, ids=range(1, 31), seed=8)
    lasting = BUSY.faster(1.0)
    assert lasting == BUSY
    fast_motion = MotionParameters(**{name: getattr(BUSY, name) for name in BUSY.__slots__} | {"battery_life_s": 12.5})
    fast = World(one_obstacle(), motion=fast_motion, ranges=RANGES, ids=range(1, 31), seed=8, speed_factor=2.0)
    slow_events, fast_events = slow.advance(20.0), fast.advance(10.0)
    assert [type(event) for event in fast_events] == [type(event) for event in slow_events]
    assert (fast.positions() == slow.positions()).all()


def test_a_torus_gives_the_rate_of_kinetic_gas() -> None:
    """Starts a second: v r_d 4 N (N - 1) / (pi A) = 1 * 4 * 999000 / (pi * 10^4) = 127.2, so 12,720 in 100 s (s.d. 0.9 %)."""
    world = World(
        square(100.0), motion=MotionParameters(speed=1.0, mean_leg=10.0), ranges=Ranges(detection=1.0, communication=1.0),
        ids=range(1, 1001), seed=5, torus=True,
    )  # fmt: skip
    began = sum(isinstance(event, EncounterBegan) and event.t_s > 0 for event in world.advance(100.0))
    assert began == pytest.approx(100 * 4 * 1000 * 999 / (np.pi * 1e4), rel=0.04)


def test_the_mouth_of_a_crack_narrower_than_two_margins_holds_nobody() -> None:
    """Followers of a wall come along a corridor of 1e-6 and up a wall to where 6e-9 are left, less than an insect's 2e-8, and turn back."""
    left = Polygon([(4.0, 2e-9), (6.0, 2e-9), (5.96, 9.0), (4.0, 9.0)])
    right = box(6.0 + 6e-9, 1e-6, 8.0, 9.0)
    arena = build_arena(Polygon(box(0, 0, 10, 10).exterior, [left.exterior, right.exterior]))
    motion = MotionParameters(speed=1.0, mean_leg=20.0, wall_law=WallLaw.FOLLOW, exit_hazard=0.1)
    world = World(arena, motion=motion, ranges=RANGES, ids=range(1, 41), seed=1)
    world.run(400.0)
    legs = world.legs()
    assert np.count_nonzero((legs.y < 1e-6) & (legs.x > 6) & (legs.x < 8)) > 100
    assert not ((legs.vx == 0) & (legs.vy == 0)).any()


@pytest.mark.parametrize("radius", [2.4, 1.2])
def test_on_a_torus_every_image_of_a_pair_is_met(radius: float) -> None:
    """Time together, summed over pairs, against positions looked up at many instants."""
    world = World(
        square(10.0), motion=MotionParameters(speed=1.0, mean_leg=8.0), ranges=Ranges(detection=radius, communication=radius),
        ids=range(1, 21), seed=2, torus=True,
    )  # fmt: skip
    table = world.run(40.0).ended
    told = float((table.t_end_s - table.t_start_s).sum()) + sum(40.0 - one.t_s for one in world.open_encounters())
    instants = np.arange(0.005, 40.0, 0.01)
    places = world.positions_at(instants)
    apart = places[:, :, None] - places[:, None]
    apart -= 10.0 * np.rint(apart / 10.0)
    together = np.count_nonzero(np.hypot(apart[..., 0], apart[..., 1]) <= radius) - 20 * instants.size
    assert told == pytest.approx(together / 2 * 0.01, rel=2e-3)


def test_a_torus_too_narrow_for_its_images_is_refused() -> None:
    with pytest.raises(ParameterError, match="at least four detection radii"):
        World(
            square(10.0), motion=MotionParameters(speed=1.0, mean_leg=8.0), ranges=Ranges(detection=3.0, communication=3.0),
            ids=range(1, 41), seed=2, torus=True,
        )  # fmt: skip


def test_neighbours_on_a_torus_are_those_of_the_nearest_image() -> None:
    world = World(
        square(50.0), motion=MotionParameters(speed=1.0, mean_leg=10.0), ranges=Ranges(detection=1.0, communication=8.0),
        ids=range(1, 151), seed=2, torus=True,
    )  # fmt: skip
    world.advance(3000.0)
    links = world.adjacency()
    assert np.mean([len(heard) for heard in links.values()]) == pytest.approx(149 * math.pi * 64 / 2500, rel=0.15)
    assert all(world.neighbours(one) == links[one] for one in world.ids)
