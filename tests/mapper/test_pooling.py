"""Recordings put together: what two tell counts once, in whatever order they come."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.pooling import Recording, count_shared_landmarks, pool_recordings, shift_recording
from mapper.types import EncounterTable, ModeSpell
from mapper.window import clip_table
from tests.mapper.worlds import NS, Row, mode_spells, table_of


@st.composite
def meetings(draw: st.DrawFn, *, first_start: int = 0) -> list[Row]:
    """Encounters as they are: those of one pair come one after the other, now and then without a gap."""
    rows = []
    for pair in draw(st.lists(st.sampled_from([(1, 2), (1, 3), (2, 3), (3, 4)]), min_size=1, max_size=3, unique=True)):
        at = first_start + draw(st.integers(0, 5))
        for _ in range(draw(st.integers(1, 4))):
            end = at + draw(st.integers(1, 4))
            rows.append((at, end, *pair))
            at = end + draw(st.integers(0, 3))
    return rows


def _told(table: EncounterTable) -> list[Row]:
    return list(zip(table.t_start_ns.tolist(), table.t_end_ns.tolist(), table.id1.tolist(), table.id2.tolist(), strict=True))


def _recording(rows: list[Row], spells: list[ModeSpell] | None = None, *, name: str = "a") -> Recording:
    return Recording(name=name, table=table_of(rows), spells=tuple(spells or ()))


def _stand(node: int, begin: int, end: int | None) -> ModeSpell:
    return ModeSpell(node=NodeId(node), t_start_ns=begin, t_end_ns=end, mode=Mode.S, cause=Cause.COMMAND)


@given(meetings())
def test_a_recording_pooled_with_itself_is_itself(rows: list[Row]) -> None:
    one = _recording(rows)
    for pool in (pool_recordings([one]), pool_recordings([one, replace(one, name="again")])):
        assert _told(pool.table) == _told(one.table)
    assert pool.n_repeated == len(rows)


@settings(max_examples=30)
@given(meetings(), meetings(), meetings(), mode_spells, st.permutations([0, 1, 2]))
def test_the_order_of_recordings_does_not_matter(
    first: list[Row], second: list[Row], third: list[Row], spells: list[ModeSpell], order: list[int]
) -> None:
    given_ = [_recording(first, spells, name="a"), _recording(second, name="b"), _recording(third, spells[:1], name="c")]
    one, other = pool_recordings(given_), pool_recordings([given_[index] for index in order])
    assert _told(one.table) == _told(other.table)
    assert (one.spells, one.n_repeated, one.warnings) == (other.spells, other.n_repeated, other.warnings)
    assert count_shared_landmarks(given_) == count_shared_landmarks([given_[index] for index in order])


@given(meetings(), st.integers(1, 12), st.integers(0, 6))
def test_windows_cut_out_of_a_recording_are_the_recording_again(rows: list[Row], begin: int, overlap: int) -> None:
    """Where the windows overlap encounters are told twice; where they only meet, one that was going on was cut in two."""
    whole = table_of(rows)
    windows = [clip_table(whole, until_ns=begin + overlap), clip_table(whole, since_ns=begin)]
    if min(map(len, windows)) == 0:
        return
    pool = pool_recordings([Recording(name=str(k), table=table, spells=()) for k, table in enumerate(windows)])
    cut_where_another_began = any(
        start < begin == end and (begin, one, two) in {(r[0], r[2], r[3]) for r in rows} for start, end, one, two in rows
    )
    if overlap or not cut_where_another_began:
        assert _told(pool.table) == _told(whole)


def test_encounters_that_one_recording_keeps_apart_stay_apart() -> None:
    """A wall came between the two at 5; both recordings know."""
    rows = [(0, 5, 1, 2), (5, 9, 1, 2)]
    assert _told(pool_recordings([_recording(rows), _recording(rows, name="b")]).table) == rows


def test_two_recordings_of_one_encounter_from_different_begins_make_one() -> None:
    pool = pool_recordings([_recording([(0, 5, 1, 2)]), _recording([(3, 9, 1, 2)], name="b"), _recording([(8, 11, 1, 2)], name="c")])
    assert _told(pool.table) == [(0, 11, 1, 2)]
    assert pool.n_repeated == 2


def test_a_stand_that_lasts_ends_with_its_recording() -> None:
    """Who stood at the end of the first window may have been withdrawn before the second."""
    first = _recording([(0, 5, 1, 2), (8, 10, 1, 3)], [_stand(1, 0, None)])
    second = _recording([(20, 25, 1, 2)], name="b")
    assert pool_recordings([first, second]).spells == (_stand(1, 0, 10),)
    assert pool_recordings([first, replace(second, spells=(_stand(1, 9, None),))]).spells == (_stand(1, 0, None),)
    assert count_shared_landmarks([first, second]) == 0
    assert count_shared_landmarks([first, replace(second, spells=(_stand(1, 10, 30),))]) == 1


def test_common_time_and_biobots_without_a_common_encounter_are_told_of() -> None:
    one, other = _recording([(0, 10 * NS, 1, 2)]), _recording([(4 * NS, 12 * NS, 2, 3)], name="b")
    assert "1 biobots and 6 s" in pool_recordings([one, other]).warnings[0]
    assert pool_recordings([one, replace(other, table=table_of([(4 * NS, 12 * NS, 5, 6)]))]).warnings == ()


@settings(max_examples=30)
@given(meetings(), mode_spells, st.integers(-(10**6), 10**6))
def test_shifts_there_and_back_change_nothing(rows: list[Row], spells: list[ModeSpell], shift_ns: int) -> None:
    one = _recording(rows, spells)
    back = shift_recording(shift_recording(one, shift_ns=shift_ns), shift_ns=-shift_ns)
    assert (_told(back.table), back.spells) == (_told(one.table), one.spells)
    assert np.array_equal(shift_recording(one, shift_ns=shift_ns).table.t_start_ns, one.table.t_start_ns + shift_ns)
