"""Encounters kept in order piece by piece are the table that is made of all at once, whatever came in whatever order."""

from collections.abc import Mapping
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import JournalRecord, MissionPhase
from mapper.encounter_set import EncounterSet
from mapper.record_columns import EncounterColumns, EncounterRows
from mapper.replica import Replica
from mapper.store import Store
from mapper.types import EncounterTable
from mapper.window import clip_table, make_encounter_table, window_begin
from tests.mapper.fake_gateway import ANCHOR_NS, batch, encounter, mission, mode

Row = tuple[int, int, int, int, bool]
"""Start, duration, the two ids, and whether it counts."""

# Few values each, so that encounters tie in some of their fields and in all.
rows_of = st.tuples(st.integers(0, 6), st.integers(0, 4), st.integers(-2, 0), st.integers(1, 3), st.booleans())
pieces = st.lists(st.dictionaries(st.integers(1, 40), rows_of, max_size=8), max_size=12)


def encounter_rows(piece: Mapping[int, Row]) -> EncounterRows:
    start, duration, id1, id2 = (np.array([row[k] for row in piece.values()], dtype=np.int64) for k in range(4))
    return EncounterRows(
        row=np.array(list(piece), dtype=np.int64),
        t_start_ns=start,
        t_end_ns=start + duration,
        id1=id1,
        id2=id2,
        counts=np.array([row[4] for row in piece.values()], dtype=np.bool_),
    )


def whole_table(known: Mapping[int, Row], *, since: int | None = None, until: int | None = None) -> list[tuple[int, ...]]:
    """Make the table of all rows at once, those that count and lie in between; the last column is the row."""
    low, high = -1 if since is None else since, 10**6 if until is None else until
    is_in = {n: (max(t, low), min(t + d, high), a, b) for n, (t, d, a, b, c) in sorted(known.items()) if c and t + d > low and t < high}
    columns = np.array(list(is_in.values()), dtype=np.int64).reshape(-1, 4).T
    table = make_encounter_table(t_start_ns=columns[0], t_end_ns=columns[1], id1=columns[2], id2=columns[3])
    numbers = list(is_in)
    return [(*row[:4], numbers[row[4]]) for row in rows(table)]


def rows(table: EncounterTable) -> list[tuple[int, ...]]:
    columns = (table.t_start_ns, table.t_end_ns, table.id1, table.id2, table.source_row)
    return list(zip(*(column.tolist() for column in columns), strict=True))


@given(pieces)
def test_taken_piece_by_piece_the_table_is_the_one_made_of_all_rows(pieces: list[dict[int, Row]]) -> None:
    kept, known = EncounterSet(), dict[int, Row]()
    for piece in pieces:
        kept.take(encounter_rows(piece))
        known |= piece
        assert rows(kept.table()) == whole_table(known)
        assert len(kept) == sum(row[4] for row in known.values())


@given(st.integers(0, 10**6), st.integers(1, 4))
def test_many_rows_outgrow_the_first_memory_and_keep_their_order(seed: int, n_pieces: int) -> None:
    rng = np.random.default_rng(seed)
    kept, known = EncounterSet(), dict[int, Row]()
    for _ in range(n_pieces):
        numbers = rng.permutation(4000)[: rng.integers(1, 3000)].tolist()
        starts = rng.integers(0, 500, len(numbers)).tolist()
        piece = {number: (start, number % 3, number % 5, 7, number % 4 > 0) for number, start in zip(numbers, starts, strict=True)}
        kept.take(encounter_rows(piece))
        known |= piece
    assert rows(kept.table()) == whole_table(known)


@given(
    known=st.dictionaries(st.integers(1, 40), rows_of, max_size=20),
    since=st.none() | st.integers(-1, 12),
    until=st.none() | st.integers(0, 12),
)
def test_a_clipped_table_is_the_one_made_of_clipped_encounters(known: dict[int, Row], since: int | None, until: int | None) -> None:
    kept = EncounterSet()
    kept.take(encounter_rows(known))
    if since is None or until is None or since < until:
        assert rows(clip_table(kept.table(), since_ns=since, until_ns=until)) == whole_table(known, since=since, until=until)


def test_a_table_is_no_copy_and_cannot_be_written_to() -> None:
    kept = EncounterSet()
    kept.take(encounter_rows({1: (5, 1, 1, 2, True), 2: (7, 1, 1, 2, True)}))
    table = kept.table()
    assert np.shares_memory(table.t_start_ns, kept.table().t_start_ns)
    assert np.shares_memory(clip_table(table, since_ns=6).t_start_ns, table.t_start_ns)
    with pytest.raises(ValueError, match="read-only"):
        table.t_start_ns[0] = 0


def test_a_window_begins_before_the_newest_end_and_not_before_time_zero() -> None:
    kept = EncounterSet()
    assert window_begin(kept.table(), window_ns=5, since_ns=None) is None
    kept.take(encounter_rows({1: (0, 20, 1, 2, True), 2: (7, 1, 1, 2, True)}))
    table = kept.table()
    assert window_begin(table, window_ns=None, since_ns=None) is None
    assert window_begin(table, window_ns=None, since_ns=3) == 3
    assert window_begin(table, window_ns=5, since_ns=None) == 15
    assert window_begin(table, window_ns=5, since_ns=3) == 15
    assert window_begin(table, window_ns=50, since_ns=3) == 3


@given(pieces)
def test_counts_of_each_biobot_follow_every_change(pieces: list[dict[int, Row]]) -> None:
    columns, known = EncounterColumns(), dict[int, Row]()
    for change, piece in enumerate(pieces, start=1):
        columns.put(encounter_rows(piece), changes=np.full(len(piece), change))
        known |= piece
    counting = [row for row in known.values() if row[4]]
    ids = [node % 2**64 for row in counting for node in row[2:4]]
    assert columns.count_by_node() == {node: ids.count(node) for node in set(ids)}
    assert columns.n_counting == len(counting)


@st.composite
def arrivals(draw: st.DrawFn) -> list[list[JournalRecord]]:
    """Batches of new records and corrections, of all kinds, in any order."""
    batches: list[list[JournalRecord]] = []
    offset = 0
    for _ in range(draw(st.integers(1, 6))):
        records: list[JournalRecord] = []
        for _ in range(draw(st.integers(0, 6))):
            offset += 1
            sequence, revision, start = draw(st.integers(1, 12)), draw(st.integers(0, 3)), draw(st.integers(0, 5))
            if sequence <= 2:
                records.append(mode(offset, node=sequence, t_ns=(start, None), sequence=sequence, revision=revision))
            elif sequence == 3:
                records.append(mission(100 + offset, phase=MissionPhase.EXPLORATION, t_ns=start))
            else:
                times = (start, start + draw(st.integers(0, 3)))
                nodes, is_void = (draw(st.integers(1, 2)), draw(st.integers(3, 2**64 - 1))), draw(st.booleans())
                records.append(encounter(offset, sequence=sequence, revision=revision, nodes=nodes, t_ns=times, is_void=is_void))
        batches.append(records)
    return batches


@given(batches=arrivals(), takes=st.lists(st.booleans(), min_size=6, max_size=6))
def test_a_replica_sent_only_what_has_changed_is_as_one_sent_everything(batches: list[list[JournalRecord]], takes: list[bool]) -> None:
    with closing(Store(None)) as store:
        followed = Replica()
        for records, is_taken in zip(batches, takes, strict=False):
            store.apply([batch(records)])
            if is_taken:
                delta = store.delta(after=followed.change)
                assert followed.take(delta)
        assert followed.take(store.delta(after=followed.change))
        fresh = Replica()
        assert fresh.take(store.delta(after=0))
        assert rows(followed.encounters.table()) == rows(fresh.encounters.table())
        assert followed.modes.spells() == fresh.modes.spells()
        assert (followed.change, followed.since_ns) == (fresh.change, fresh.since_ns)


def test_a_delta_is_what_is_new_and_fits_only_where_it_belongs() -> None:
    with closing(Store(None)) as store:
        store.apply([batch([encounter(n, t_ns=(n, n + 1)) for n in range(1, 11)])])
        first = store.delta(after=0)
        store.apply([batch([encounter(11, sequence=3, revision=1, t_ns=(0, 1)), encounter(12, t_ns=(4, 5))])])
        second = store.delta(after=first.change)
        assert (len(first.encounters), len(second.encounters)) == (10, 2)
        late = Replica()
        assert not late.take(second)
        assert len(late.encounters) == 0
        assert late.take(first)
        assert late.take(second)
        assert not late.take(second)
        assert (late.encounters.table().t_start_ns - ANCHOR_NS).tolist() == [0, 1, 2, 4, 4, 5, 6, 7, 8, 9, 10]
