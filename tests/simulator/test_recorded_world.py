"""Laws of a recorded world: it tells what was recorded, when it was, in any chunking, and nothing changes it."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.errors import ParameterError, TimeError, UnknownBiobotError
from simulator.events import Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.recorded_world import RecordedWorld
from simulator.recording import RecordedEncounter, RecordedPlaces, RecordedSpell, Recording
from tests.simulator.arenas import square


@st.composite
def encounters(draw: st.DrawFn) -> tuple[RecordedEncounter, ...]:
    """Draw encounters of three biobots; those of one pair do not overlap, but may touch and may have no length."""
    listed = []
    for id1, id2 in ((1, 2), (1, 5), (2, 5)):
        at = 10
        for gap, length in draw(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=6)):
            start = at + gap + (1 if gap == 0 and length == 0 else 0)
            listed.append(RecordedEncounter(t_start_s=start / 4, t_end_s=(start + length) / 4, id1=id1, id2=id2))
            at = start + length
    return tuple(sorted(listed, key=lambda one: (one.t_start_s, one.t_end_s, one.id1, one.id2)))


def a_recording(
    met: tuple[RecordedEncounter, ...], *, spells: tuple[RecordedSpell, ...] = (), places: RecordedPlaces | None = None, zero_s: float = 2.5
) -> Recording:
    end_s = max([zero_s, *(one.t_end_s for one in met), *(one.t_end_s for one in spells)])
    return Recording(
        source=Path("recording.csv"), encounters=met, spells=spells, ids=(1, 2, 5), zero_s=zero_s, end_s=end_s,
        ranges=Ranges(detection=1.0, communication=4.0), places=places,
    )  # fmt: skip


def ended(events: list[Event]) -> list[tuple[float, float, int, int]]:
    return [(one.t_start_s, one.t_end_s, one.id1, one.id2) for one in events if isinstance(one, EncounterEnded)]


@given(encounters(), st.sampled_from([0.5, 1.0, 8.0]), st.lists(st.floats(0, 60), max_size=8))
def test_every_recorded_encounter_begins_and_ends_once_at_its_compressed_time_however_time_is_cut(
    met: tuple[RecordedEncounter, ...], speed: float, cuts: list[float]
) -> None:
    world, whole = (RecordedWorld(a_recording(met), compression=speed) for _ in range(2))
    events: list[Event] = []
    for until_s in [*sorted(cut for cut in cuts if cut < world.end_s), world.end_s]:
        before_s = world.now_s
        told = world.advance(until_s)
        assert all(before_s <= (one.t_end_s if isinstance(one, EncounterEnded) else one.t_s) < until_s for one in told)
        events += told
    assert events == whole.advance(whole.end_s)
    assert sorted(ended(events)) == sorted(((a.t_start_s - 2.5) / speed, (a.t_end_s - 2.5) / speed, a.id1, a.id2) for a in met)
    assert world.open_encounters() == []
    running: set[tuple[int, int]] = set()
    for one in events:
        if isinstance(one, EncounterBegan):
            assert (one.id1, one.id2) not in running
            running.add((one.id1, one.id2))
        elif isinstance(one, EncounterEnded):
            running.remove((one.id1, one.id2))


MET = (RecordedEncounter(t_start_s=3.0, t_end_s=5.0, id1=2, id2=5),)
SPELLS = (
    RecordedSpell(t_start_s=2.5, t_end_s=4.0, id=1, mode=Mode.CRW, cause=Cause.NATURAL),
    RecordedSpell(t_start_s=2.5, t_end_s=9.0, id=5, mode=Mode.S, cause=Cause.COMMAND),
    RecordedSpell(t_start_s=4.0, t_end_s=9.0, id=1, mode=Mode.S, cause=Cause.NATURAL),
)


def test_modes_change_as_recorded_and_a_start_in_another_mode_than_walking_is_a_change() -> None:
    world = RecordedWorld(a_recording(MET, spells=SPELLS))
    changes = [one for one in world.advance(world.end_s) if isinstance(one, ModeChanged)]
    assert changes == [
        ModeChanged(t_s=0.0, id=5, mode=Mode.S, cause=Cause.COMMAND),
        ModeChanged(t_s=1.5, id=1, mode=Mode.S, cause=Cause.NATURAL),
    ]
    assert [world.mode(one) for one in (1, 2, 5)] == [Mode.S, Mode.CRW, Mode.S]


def test_no_command_changes_the_past() -> None:
    world, untouched = RecordedWorld(a_recording(MET, spells=SPELLS)), RecordedWorld(a_recording(MET, spells=SPELLS))
    events = world.advance(1.0)
    assert world.stop(1) is False
    assert world.start(5) is False
    world.turn(2, 1.0)
    world.run_straight(2, 1.0)
    events += world.advance(world.end_s)
    assert events == untouched.advance(untouched.end_s)


def test_renumbered_biobots_keep_their_order_and_their_recorded_ids_are_known() -> None:
    world = RecordedWorld(a_recording(MET), renumber=True)
    assert world.ids == (1, 2, 3)
    assert world.recorded_ids == {1: 1, 2: 2, 3: 5}
    assert ended(world.advance(world.end_s)) == [(0.5, 2.5, 2, 3)]


@pytest.fixture
def arena() -> Arena:
    return square(10.0)


def test_between_recorded_places_biobots_go_straight_and_beyond_them_they_stand(arena: Arena) -> None:
    position = np.array([[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]], [[4.0, 0.0], [1.0, 1.0], [2.0, 6.0]]])
    places = RecordedPlaces(arena=arena, t_s=np.array([2.5, 6.5]), ids=(1, 2, 5), position=position)
    world = RecordedWorld(a_recording(MET, places=places), compression=2.0)
    assert world.arena is arena
    asked = world.positions_of([1, 1, 5, 1], [0.0, 0.5, 1.0, 9.0])
    assert asked.tolist() == [[0.0, 0.0], [1.0, 0.0], [2.0, 4.0], [4.0, 0.0]]
    world.advance(1.0)
    assert world.positions().tolist() == [[2.0, 0.0], [1.0, 1.0], [2.0, 4.0]]


def test_where_no_places_were_recorded_there_are_none() -> None:
    world = RecordedWorld(a_recording(MET))
    assert world.arena is None
    assert np.isnan(world.positions()).all()


def test_gaps_that_a_gateways_clocks_cannot_tell_are_counted() -> None:
    met = tuple(RecordedEncounter(t_start_s=at, t_end_s=at + 1.0, id1=1, id2=2) for at in (3.0, 4.5, 5.5, 60.0))
    assert RecordedWorld(a_recording(met)).count_short_gaps(0.1) == 1
    assert RecordedWorld(a_recording(met), compression=10.0).count_short_gaps(0.1) == 2


def test_what_a_world_refuses_a_recorded_one_refuses_too() -> None:
    world = RecordedWorld(a_recording(MET))
    world.advance(1.0)
    with pytest.raises(TimeError):
        world.advance(0.5)
    with pytest.raises(UnknownBiobotError):
        world.mode(3)
    with pytest.raises(ParameterError):
        RecordedWorld(a_recording(MET), compression=float("nan"))
