"""Stops of biobots' own accord: from records that come in whatever order to walking time in the map, and to no landmark."""

from contextlib import closing
from pathlib import Path

import pytest

from firmware_protocol.contract.records import Cause, JournalRecord, Mode
from mapper.encounter_graph import build_components
from mapper.replica import Replica
from mapper.store import Store
from tests.mapper.fake_gateway import S, batch, encounter, mode
from tests.mapper.graphs import all_times

TICKS_PER_S = 2 * S


def replica_of(store: Store) -> Replica:
    replica = Replica()
    assert replica.take(store.delta(after=0))
    return replica


def graph_of(records: list[JournalRecord]) -> tuple[float, list[int]]:
    """Return the walking time between the first encounter and the last [s], and which encounters are at landmarks."""
    with closing(Store(None)) as store:
        store.apply([batch(records)])
        replica = replica_of(store)
        (graph,) = build_components(replica.encounters.table(), replica.modes.spells(), moving_time=True)
        return float(all_times(graph)[0, -1]) / TICKS_PER_S, graph.landmarks.tolist()


MEETINGS: list[JournalRecord] = [encounter(1, nodes=(1, 2), t_ns=(0, 0)), encounter(2, nodes=(1, 3), t_ns=(100 * S, 100 * S))]


@pytest.mark.parametrize("is_late", [False, True])
def test_only_the_time_walked_lies_between_two_encounters(*, is_late: bool) -> None:
    begun = mode(3, node=1, t_ns=(10 * S, None), cause=Cause.NATURAL)
    ended = mode(4, node=1, t_ns=(10 * S, 90 * S), cause=Cause.NATURAL, sequence=3, revision=1)
    assert graph_of([*MEETINGS, begun]) == (10.0, [])
    revisions: list[JournalRecord] = [ended, begun] if is_late else [begun, ended]
    assert graph_of([*MEETINGS, *revisions]) == (20.0, [])


def test_a_command_on_top_of_a_natural_stop_makes_a_landmark_from_then_on() -> None:
    """It rests at 10 s and is told to stand at 50 s: the encounter before is no part of the landmark, the one after it is."""
    rests = mode(3, node=1, t_ns=(10 * S, None), cause=Cause.NATURAL)
    stands = mode(4, node=1, t_ns=(50 * S, None))
    walks, landmarks = graph_of([*MEETINGS, rests, stands])
    assert (walks, len(landmarks)) == (10.0, 1)


@pytest.mark.parametrize("begin_s", [40.0, 50.0])
def test_who_is_halted_is_no_landmark_whatever_gateway_tells_of_it_and_the_time_is_not_walked(begin_s: float) -> None:
    """The other gateway hears the same stop and knows of no stop of all; who stood before stays the landmark that it was."""
    halted = mode(3, node=1, t_ns=(40 * S, 90 * S), is_halted=True)
    other = mode(1, node=1, t_ns=(int(begin_s * S) + S, 90 * S), gateway="gateway2", journal="journal2")
    landmark = mode(4, node=3, t_ns=(20 * S, None))
    walks = mode(5, node=3, t_ns=(0, 20 * S), mode=Mode.CRW)
    walked, landmarks = graph_of([*MEETINGS, halted])
    assert (walked, landmarks) == (50.0, [])
    assert graph_of([*MEETINGS, halted, walks, landmark])[1] == [1]
    with closing(Store(None)) as store:
        store.apply([batch([halted]), batch([other], gateway="gateway2", journal="journal2")])
        spells = [(spell.mode, spell.cause) for spell in replica_of(store).modes.spells()]
    is_one_stop = begin_s == 40.0
    assert spells == [(Mode.S, Cause.NATURAL), (Mode.S, Cause.NATURAL if is_one_stop else Cause.COMMAND)]


def test_who_was_halted_is_known_after_a_restart(tmp_path: Path) -> None:
    with closing(Store(tmp_path / "store.sqlite")) as store:
        store.apply([batch([*MEETINGS, mode(3, node=1, t_ns=(40 * S, 90 * S), is_halted=True)])])
        before = replica_of(store).modes.spells()
    with closing(Store(tmp_path / "store.sqlite")) as store:
        assert replica_of(store).modes.spells() == before
    assert [spell.cause for spell in before] == [Cause.NATURAL]
