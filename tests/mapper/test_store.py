"""The store: applied exactly once, in any order; what is missing is known exactly; killed at any moment."""

import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
from contextlib import closing
from pathlib import Path

import msgspec.structs
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, EncounterRecord, JournalRecord, MissionPhase, Mode, encode_journal_record
from firmware_protocol.units import Nanoseconds
from mapper.errors import StoreError
from mapper.offsets import OffsetSet
from mapper.record_columns import to_signed, to_unsigned
from mapper.replica import Replica
from mapper.store import Store
from mapper.window import clip_table
from tests.mapper.fake_gateway import ANCHOR_NS, BOOT, S, batch, encounter, mission, mode

SOURCE = {"gateway": "gateway1", "journal": "journal1"}


@st.composite
def journals(draw: st.DrawFn) -> list[JournalRecord]:
    """A journal from offset 1 without gaps, in which later entries may correct earlier ones."""
    records: list[JournalRecord] = []
    newest: dict[int, int] = {}
    for offset in range(1, draw(st.integers(1, 25)) + 1):
        known = sorted(newest)
        sequence = draw(st.sampled_from([*known, len(known)]))
        newest[sequence] = newest.get(sequence, -1) + 1
        start = draw(st.integers(0, 5)) * S
        if sequence % 4 == 3:
            end = draw(st.none() | st.just(start + S))
            records.append(mode(offset, node=sequence, t_ns=(start, end), sequence=sequence, revision=newest[sequence]))
        else:
            nodes = (draw(st.integers(0, 3)), draw(st.integers(4, 2**64 - 1)))
            is_void = draw(st.booleans())
            records.append(
                encounter(offset, sequence=sequence, revision=newest[sequence], nodes=nodes, t_ns=(start, start + S), is_void=is_void)
            )
    return records


def replica_of(store: Store) -> Replica:
    replica = Replica()
    assert replica.take(store.delta(after=0))
    return replica


def content(store: Store) -> object:
    replica = replica_of(store)
    table = replica.encounters.table()
    columns = [column.tolist() for column in (table.t_start_ns, table.t_end_ns, table.id1, table.id2)]
    pages = sorted(store.encounters(after=0, limit=1000).records, key=lambda record: record.sequence)
    return columns, replica.modes.spells(), dict(store.count_by_node()), pages, store.n_encounters


@given(data=st.data(), records=journals())
def test_order_duplication_and_batching_never_change_the_content(data: st.DataObject, records: list[JournalRecord]) -> None:
    # closing: Hypothesis may give an example up in the middle of a draw.
    with closing(Store(None)) as straight, closing(Store(None)) as shuffled:
        straight.apply([batch(records)])
        order = data.draw(st.permutations(records + data.draw(st.lists(st.sampled_from(records), max_size=10))))
        while order:
            size = data.draw(st.integers(1, len(order)))
            shuffled.apply([batch(order[:size])])
            order = order[size:]
        assert content(shuffled) == content(straight)
        assert shuffled.watermark(**SOURCE) == straight.watermark(**SOURCE) == len(records)


@given(records=journals())
def test_the_highest_revision_of_each_identity_is_what_counts(records: list[JournalRecord]) -> None:
    store = Store(None)
    store.apply([batch(records)])
    newest: dict[object, JournalRecord] = {}
    for record in records:
        if record.identity not in newest or record.revision > newest[record.identity].revision:
            newest[record.identity] = record
    wanted = [record for record in newest.values() if isinstance(record, EncounterRecord)]
    assert sorted(store.encounters(after=0, limit=1000).records, key=lambda record: record.sequence) == sorted(
        wanted, key=lambda record: record.sequence
    )
    assert store.n_encounters == sum(not record.is_void for record in wanted)
    store.close()


@given(offsets=st.lists(st.tuples(st.integers(1, 40), st.integers(0, 5))))
def test_the_watermark_is_the_highest_offset_up_to_which_nothing_is_missing(offsets: list[tuple[int, int]]) -> None:
    held, plain = OffsetSet(), set[int]()
    for first, more in offsets:
        held.add(first, first + more)
        plain |= set(range(first, first + more + 1))
    watermark = next(n for n in range(60) if n + 1 not in plain)
    assert held.watermark == watermark
    assert {n for n in range(1, 60) if n in held} == plain
    assert {n for first, last in held.spans for n in range(first, last + 1)} == {n for n in plain if n > watermark}
    assert held.last == max(plain, default=0)
    missing = [n for n in range(1, 51) if n not in plain]
    hole = held.first_hole(up_to=50)
    assert (hole is None) == (not missing)
    if hole is not None:
        assert hole[0] == missing[0]
        assert set(range(hole[0], hole[1] + 1)) <= set(missing)
        assert hole[1] + 1 in plain or hole[1] == 50
    again = OffsetSet(watermark=held.watermark, spans=held.spans)
    assert (again.watermark, again.spans) == (held.watermark, held.spans)


def test_a_reopened_store_has_the_same_content_and_the_same_gaps(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    first = Store(path)
    first.apply([batch([encounter(1), encounter(2, is_void=True), mode(3, node=7, t_ns=(0, None)), encounter(6, nodes=(2, 2**64 - 1))])])
    before, page = content(first), first.encounters(after=0, limit=1)
    first.close()
    second = Store(path)
    assert content(second) == before
    assert second.watermark(**SOURCE) == 3
    assert second.first_hole(**SOURCE, head_offset=9) == (4, 5)
    assert second.encounters(after=page.cursor, limit=10).records == tuple(second.encounters(after=0, limit=10).records[1:])
    assert second.apply([batch([encounter(1)])]).n_repeated == 1
    assert second.apply([batch([encounter(4)])]).n_new == 1
    second.close()


def test_what_was_applied_before_a_kill_is_there_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    program = """
        import sys
        from pathlib import Path
        from mapper.store import Store
        from tests.mapper.fake_gateway import batch, encounter
        store = Store(Path(sys.argv[1]))
        offset = 1
        while True:
            store.apply([batch([encounter(n) for n in range(offset, offset + 7)])])
            offset += 7
            print(offset - 1, flush=True)
    """
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(program), str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    told = 0
    for line in child.stdout:
        told = int(line)
        if told >= 700:
            break
    os.kill(child.pid, signal.SIGKILL)
    rest = child.stdout.read().split()
    child.wait()
    child.stdout.close()
    told = max([told, *(int(number) for number in rest)])
    store = Store(path)
    assert store.watermark(**SOURCE) >= told
    assert store.n_encounters == store.watermark(**SOURCE)
    assert store.count_by_node() == {1: store.n_encounters, 2: store.n_encounters}
    store.close()


def test_pages_reach_every_encounter_once_and_corrections_come_again_later() -> None:
    store = Store(None)
    store.apply([batch([encounter(n) for n in range(1, 26)])])
    seen, cursor, has_more = [], 0, True
    while has_more:
        page = store.encounters(after=cursor, limit=10)
        seen += [record.sequence for record in page.records]
        cursor, has_more = page.cursor, page.has_more
    assert seen == list(range(1, 26))
    store.apply([batch([encounter(26, sequence=3, revision=1), encounter(27, sequence=4, revision=0)])])
    page = store.encounters(after=cursor, limit=10)
    assert [(record.sequence, record.revision) for record in page.records] == [(3, 1)]
    assert store.encounters(after=page.cursor, limit=10).cursor == page.cursor
    store.close()


def test_unfit_records_are_left_out_but_leave_no_gap() -> None:
    store = Store(None)
    records: list[JournalRecord] = [
        encounter(1, nodes=(5, 5)),
        encounter(2, t_ns=(S, 0)),
        encounter(3, t_ns=(0, 2**63)),
        encounter(4, t_ns=(-ANCHOR_NS - 1, 0)),
        mode(5, node=1, t_ns=(S, 0)),
        encounter(6, sequence=2**63),
        encounter(7),
    ]
    applied = store.apply([batch(records), batch([encounter(8, gateway="other")])])
    assert (applied.n_unfit, applied.n_new) == (7, 1)
    assert store.watermark(**SOURCE) == 7
    store.close()


# What MessagePack can carry; most of it lies around the borders of signed numbers.
_numbers = st.integers(-(2**63), 2**64 - 1) | st.sampled_from([-(2**63), -1, 0, 2**62, 2**63 - 1, 2**63, 2**64 - 1])


@given(
    kind=st.sampled_from(["encounter", "mode", "mission"]),
    anchor=_numbers,
    begin=_numbers,
    length=st.integers(0, 2**62),
    as_sum=st.booleans(),
)
@example(kind="encounter", anchor=-(2**63) + ANCHOR_NS, begin=ANCHOR_NS + 5, length=4, as_sum=True)
def test_whatever_is_taken_in_is_there_after_a_restart(
    tmp_path_factory: pytest.TempPathFactory, kind: str, anchor: int, begin: int, length: int, as_sum: bool
) -> None:
    start = begin % 2**62 - anchor if as_sum else begin  # on the wall clock, or as it comes
    instants = start, start + length
    assume(all(-(2**63) <= instant < 2**64 for instant in instants))
    records: dict[str, JournalRecord] = {
        "encounter": encounter(1, t_ns=instants),
        "mode": mode(1, node=3, t_ns=instants),
        "mission": mission(1, phase=MissionPhase.EXPLORATION, t_ns=start),
    }
    path = tmp_path_factory.mktemp("store") / "store.db"
    with closing(Store(path)) as store:
        store.apply([batch([msgspec.structs.replace(records[kind], wall_anchor_ns=anchor), encounter(2)])])
        before, phases = content(store), store.missions()
        assert store.watermark(**SOURCE) == 2
    with closing(Store(path)) as store:
        assert (content(store), store.missions()) == (before, phases)


def test_a_store_opens_with_rows_that_an_earlier_version_should_have_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "store.db"
    with closing(Store(path)) as store:
        store.apply([batch([encounter(n) for n in range(1, 5)])])
    odd = msgspec.structs.replace(
        encounter(2), wall_anchor_ns=Nanoseconds(-(2**63) + ANCHOR_NS), t_start_ns=Nanoseconds(2**63), t_end_ns=Nanoseconds(2**63 + 9)
    )
    never = msgspec.structs.replace(encounter(3), t_end_ns=Nanoseconds(2**64 - 1))
    with closing(sqlite3.connect(path)) as database, database:
        for record in (odd, never):
            database.execute("UPDATE record SET body = ? WHERE sequence = ?", (encode_journal_record(record), record.sequence))
    with closing(Store(path)) as store:
        table = replica_of(store).encounters.table()
        assert (table.t_end_ns - ANCHOR_NS).tolist() == [9, S, S]
        assert (store.n_encounters, store.progress.change) == (3, 4)
        # Its correction is taken in as that of any other.
        store.apply([batch([encounter(5, sequence=3, revision=1)])])
        assert store.n_encounters == 4
    (told,) = [record for record in caplog.records if record.getMessage() == "store.rows_left_out"]
    assert vars(told)["fields"]["encounters"] == 1


def test_a_record_of_another_kind_under_a_known_identity_changes_nothing() -> None:
    store = Store(None)
    store.apply([batch([encounter(1, sequence=1)])])
    before = content(store)
    assert store.apply([batch([mode(2, node=3, t_ns=(0, None), sequence=1, revision=5)])]).n_repeated == 1
    assert content(store) == before
    store.close()


def test_a_spell_ends_at_the_latest_where_the_next_begins() -> None:
    store = Store(None)
    records: list[JournalRecord] = [
        mode(1, node=3, t_ns=(0, None)),
        mode(2, node=3, t_ns=(5 * S, None), mode=Mode.CRW),
        mode(3, node=2**64 - 2, t_ns=(S, 2 * S)),
    ]
    store.apply([batch(records)])
    spells = replica_of(store).modes.spells()
    assert [(spell.node, spell.t_start_ns - ANCHOR_NS, spell.t_end_ns and spell.t_end_ns - ANCHOR_NS) for spell in spells] == [
        (-2, S, 2 * S),
        (3, 0, 5 * S),
        (3, 5 * S, None),
    ]
    assert {(record.node, record.mode) for record in store.latest_modes()} == {(3, Mode.CRW), (2**64 - 2, Mode.S)}
    assert spells[0].cause is Cause.COMMAND
    store.close()


@given(st.integers(0, 2**64 - 1))
def test_unsigned_ids_survive_signed_columns(node: int) -> None:
    assert to_unsigned(to_signed(node)) == node
    assert -(2**63) <= to_signed(node) < 2**63


def test_once_a_mission_has_set_landmarks_only_what_came_after_counts() -> None:
    store = Store(None)
    store.apply([batch([encounter(1, t_ns=(0, 2 * S)), encounter(2, t_ns=(S, 9 * S)), encounter(3, t_ns=(6 * S, 7 * S))])])
    assert (len(replica_of(store).encounters), replica_of(store).since_ns) == (3, None)
    phases = [(4, MissionPhase.DISPERSION, 0), (5, MissionPhase.EXPLORATION, 2 * S), (6, MissionPhase.DONE, 20 * S)]
    store.apply([batch([mission(offset, phase=phase, t_ns=at) for offset, phase, at in phases])])
    replica = replica_of(store)
    table = clip_table(replica.encounters.table(), since_ns=replica.since_ns)
    assert (table.t_start_ns - ANCHOR_NS).tolist() == [2 * S, 6 * S]
    assert (replica.since_ns, store.count_by_node()) == (ANCHOR_NS + 2 * S, {1: 3, 2: 3})
    assert store.n_encounters == 3
    assert [record.phase for record in store.missions()] == [phase for _, phase, _ in phases]
    store.close()


def test_gateways_and_their_journals_are_told_apart() -> None:
    store = Store(None)
    store.apply([batch([encounter(1)]), batch([encounter(1, nodes=(1, 3), gateway="gateway2")], gateway="gateway2")])
    store.apply([batch([encounter(1, sequence=2, journal="journal2")], journal="journal2")])
    assert store.n_encounters == 3
    assert store.watermark(gateway="gateway1", journal="journal2") == 1
    assert store.watermark(gateway="gateway3", journal="journal1") == 0
    store.apply([batch([encounter(2, sequence=1, journal="journal2")], journal="journal2")])
    assert store.n_encounters == 4, "a start of another journal may have the same number"
    assert store.encounters(after=0, limit=10).records[0].identity == ("gateway1", "journal1", BOOT, 1)
    store.close()


def test_offsets_given_up_count_as_arrived(tmp_path: Path) -> None:
    store = Store(tmp_path / "store.db")
    store.apply([batch([encounter(4)])])
    store.give_up(**SOURCE, first=1, last=3)
    store.close()
    store = Store(tmp_path / "store.db")
    assert store.watermark(**SOURCE) == 4
    store.close()


def test_a_second_mapper_is_refused_the_file(tmp_path: Path) -> None:
    store = Store(tmp_path / "store.db")
    with pytest.raises(StoreError, match="in use by another mapper"):
        Store(tmp_path / "store.db")
    store.close()


def test_files_that_are_no_store_are_refused_and_not_changed(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("not a database, but long enough to look at " * 10)
    foreign = tmp_path / "foreign.db"
    with sqlite3.connect(foreign) as database:
        database.execute("CREATE TABLE bookmarks (url TEXT)")
    database.close()
    newer = tmp_path / "newer.db"
    Store(newer).close()
    with sqlite3.connect(newer) as database:
        database.execute("PRAGMA user_version = 99")
    database.close()
    before = {path: path.read_bytes() for path in (text, foreign, newer)}
    for path, reason in [
        (text, "not a store of records"),
        (foreign, "of another program"),
        (newer, "schema version 99"),
        (tmp_path, "is a directory"),
        (tmp_path / "nowhere" / "store.db", "there is no directory"),
    ]:
        with pytest.raises(StoreError, match=reason):
            Store(path)
    assert {path: path.read_bytes() for path in before} == before


def test_a_damaged_store_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    store = Store(path)
    store.apply([batch([encounter(n) for n in range(1, 500)])])
    store.close()
    with sqlite3.connect(path) as database:
        database.execute("UPDATE record SET body = x'c1' WHERE id = 7")
    database.close()
    with pytest.raises(StoreError, match="is damaged"):
        Store(path)
