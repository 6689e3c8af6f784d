"""Laws of the audit log's chain: what was changed is found, and nothing that a gateway does breaks it."""

import contextlib
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.commands import Stage
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.journal_file import (
    AuditEntry,
    AuditFindings,
    AuditSelection,
    JournalFile,
    JournalReader,
    Retention,
    check_journal,
    open_journal_file,
    read_audit_rows,
    verify_audit_of,
)
from gateway.journal_file.audit_chain import COLUMNS
from gateway.journal_file.audit_verify import verify_audit
from tests.gateway.audited import WALL_NS, Image, a_note, a_stage, commit, delete, insert, swap, write_audited
from tests.gateway.schema_3 import make_schema_2, make_schema_3

ROOT = Path(__file__).parents[2]
_N_ROWS = 20
_Edit = Callable[[sqlite3.Connection], object]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Image:
    path = tmp_path_factory.mktemp("audited") / "j"
    write_audited(path, _N_ROWS)
    return Image(path)


def _rows(database: sqlite3.Connection) -> list[tuple[object, ...]]:
    typed = ", ".join(f"typeof({column}), CAST({column} AS BLOB)" for column in (*COLUMNS.split(", "), "chain"))
    kept = "SELECT key, value FROM meta WHERE key IN ('audit_head', 'audit_genesis', 'audit_pruned') ORDER BY key"
    return database.execute(f"SELECT {typed} FROM audit ORDER BY id").fetchall() + database.execute(kept).fetchall()


def _verified(whole: Image, edit: _Edit) -> tuple[AuditFindings, bool]:
    """Return what is found after an edit, and whether that changed anything."""
    with whole.opened() as database:
        before = _rows(database)
        edit(database)
        has_changed = _rows(database) != before
        return verify_audit(database, tell=lambda _: None), has_changed


_numbers = st.integers(1, _N_ROWS)
_cells = st.one_of(st.none(), st.integers(-(1 << 63), (1 << 63) - 1), st.floats(), st.binary(max_size=40), st.text(max_size=9))
_texts_and_blobs = st.sampled_from(["kind", "operator", "command_id", "stage", "request", "body", "chain"])


def _set(column: str, number: int, value: object) -> _Edit:
    def edit(database: sqlite3.Connection) -> None:
        with contextlib.suppress(sqlite3.IntegrityError):  # what the table's own rules forbid changes nothing
            database.execute(f"UPDATE audit SET {column} = ? WHERE id = ?", (value, number))

    return edit


def _set_meta(key: str, value: str) -> _Edit:
    return lambda database: database.execute("UPDATE meta SET value = ? WHERE key = ?", (value, key))


def _flip(column: str, number: int, place: int, mask: int) -> _Edit:
    """Change bits of one octet of a text or a blob, which stays what it is."""

    def edit(database: sqlite3.Connection) -> None:
        query = f"SELECT typeof({column}), CAST({column} AS BLOB) FROM audit WHERE id = ?"
        kind, octets = database.execute(query, (number,)).fetchone()
        if octets:
            changed = bytearray(octets)
            changed[place % len(octets)] ^= mask
            value = "CAST(? AS TEXT)" if kind == "text" else "?"
            database.execute(f"UPDATE audit SET {column} = {value} WHERE id = ?", (bytes(changed), number))

    return edit


_edits: st.SearchStrategy[_Edit] = st.one_of(
    st.builds(_set, st.sampled_from([*COLUMNS.split(", "), "chain"]), _numbers, _cells),
    st.builds(_flip, _texts_and_blobs, _numbers, st.integers(0, 999), st.integers(1, 255)),
    st.builds(lambda a, b, c: delete(min(a, b), max(a, b), is_closed_up=c), _numbers, _numbers, st.booleans()),
    st.builds(swap, _numbers, _numbers),
    st.builds(lambda at, copied: insert(at, copy_of=copied), st.integers(1, _N_ROWS + 1), _numbers),
    st.just(lambda db: db.execute("DELETE FROM meta WHERE key = 'audit_head'")),
    st.builds(_set_meta, st.sampled_from(["audit_head", "audit_genesis"]), st.text(max_size=70)),
    _numbers.map(
        lambda n: (
            lambda db: (
                db.execute("INSERT INTO meta SELECT 'audit_pruned', id || ':' || lower(hex(chain)) FROM audit WHERE id = ?", (n,)),
                db.execute("DELETE FROM audit WHERE id <= ?", (n,)),
            )
        )
    ),
)


@given(edit=_edits)
@settings(max_examples=150)
def test_whatever_is_changed_is_found(whole: Image, edit: _Edit) -> None:
    found, has_changed = _verified(whole, edit)
    assert (found.fault is not None) == has_changed, found


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (_set("operator", 7, "someone else"), "row 7 was altered"),
        (_set("chain", 7, bytes(32)), "row 7 was altered: its hash alone"),
        (_set("id", 7, 700), "row 7 was altered: its number is 700 now|reordered: what was row 7 is row 700 now"),
        (_set("train_ms", _N_ROWS, 1), f"row {_N_ROWS}, the last one, was altered"),
        (delete(7, 9), "rows 7 to 9 are missing"),
        (delete(1, 1), "row 1 is missing"),
        (delete(7, 9, is_closed_up=True), "rows 7 to 9 are missing, and the rows behind have their numbers"),
        (delete(19, _N_ROWS), "rows 19 to 20 are missing: the end was cut off"),
        (delete(1, _N_ROWS), "rows 1 to 20 are missing: the end was cut off"),
        (swap(7, 8), "reordered: what was row 7 is row 8 now"),
        (swap(7, 12), "reordered: what was row 7 is row 12 now"),
        (swap(19, 20), "reordered: what was row 19 is row 20 now"),
        (insert(7, copy_of=3), "row 7 is inserted: what was row 7 is row 8 now"),
        (insert(_N_ROWS, copy_of=3), "row 20 is inserted: what was row 20 is row 21 now"),
        (insert(_N_ROWS + 1, copy_of=3), "row 21, the last one, was altered, replaced or inserted"),
        (_set("id", 7, -5), "row -5 was inserted: the log begins with row 1"),
    ],
)
def test_the_first_row_that_does_not_fit_is_named_and_what_was_done(whole: Image, edit: _Edit, told: str) -> None:
    found, has_changed = _verified(whole, edit)
    assert has_changed
    assert found.fault is not None
    assert any(found.fault.startswith(one) for one in told.split("|")), found.fault


def test_a_hash_that_was_noted_shows_a_log_that_was_cut_and_closed_again(whole: Image) -> None:
    """Whoever writes the file can also write what it says of its end: then only a hash that lies elsewhere tells."""

    def cut(database: sqlite3.Connection) -> None:
        database.execute("DELETE FROM audit WHERE id > 15")
        database.execute(
            "UPDATE meta SET value = (SELECT id || ':' || lower(hex(chain)) FROM audit WHERE id = 15) WHERE key = 'audit_head'"
        )

    with whole.opened() as database:
        (chain,) = database.execute("SELECT chain FROM audit WHERE id = 18").fetchone()
        noted = chain.hex()
        assert verify_audit(database, witness=noted[:12].upper(), tell=lambda _: None).witness_at == 18
        cut(database)
        found = verify_audit(database, witness=noted, tell=lambda _: None)
        assert (found.fault, found.witness_at, found.head.n_rows) == (None, None, 15)


def _verify(path: Path) -> AuditFindings:
    return verify_audit_of(path, tell=lambda _: None)


def _entries(path: Path) -> list[AuditEntry]:
    return [row for row in read_audit_rows(path, AuditSelection()) if isinstance(row, AuditEntry)]


def _open(path: Path, *, now_ns: int = 0, machine_boot: str = "m", clock: Callable[[], int] = lambda: 0) -> JournalFile:
    return open_journal_file(path, now_wall_ns=WALL_NS, now_ns=now_ns, machine_boot=machine_boot, clock=clock)


def test_what_is_written_is_read_again_with_the_start_that_wrote_it(tmp_path: Path) -> None:
    path = tmp_path / "j"
    strange = replace(a_note(1), operator="\x00\x1b[2J\u202e", kind="k\x00", node=None, mono_ns=None)
    with contextlib.closing(_open(path)) as file:
        commit(file, [a_stage(0), strange])
        boot = file.identity.boot
    (first, second) = _entries(path)
    assert replace(first, id=0, boot=0, chain=b"") == a_stage(0)
    assert replace(second, id=0, boot=0, chain=b"") == strange
    assert (first.id, second.id, first.boot) == (1, 2, boot)


@given(cut=st.integers(0, 10**9))
@settings(max_examples=25)
def test_a_log_of_the_disk_that_is_cut_anywhere_leaves_a_chain_that_holds_and_goes_on(
    torn: tuple[bytes, bytes], tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    body, log = torn
    path = tmp_path_factory.mktemp("torn") / "j"
    path.write_bytes(body)
    path.with_name("j-wal").write_bytes(log[: cut % (len(log) + 1)])
    before = _verify(path)
    with contextlib.closing(_open(path)) as file:
        commit(file, [a_note(0)])
    after = _verify(path)
    assert (before.fault, after.fault, after.n_rows) == (None, None, before.n_rows + 1)


@pytest.fixture(scope="module")
def torn(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    """A journal's file and its log as a power cut leaves them after many commits."""
    path = tmp_path_factory.mktemp("torn") / "j"
    with contextlib.closing(_open(path)) as file:
        file._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        for number in range(12):
            commit(file, [a_stage(number), a_note(number)][: 1 + number % 2])
        return path.read_bytes(), path.with_name("j-wal").read_bytes()


_CHILD = """
import asyncio, resource, signal, sys
from pathlib import Path
from gateway.audit_log import AuditLog
from gateway.health import Health
from gateway.journal import Journal

async def story() -> None:
    journal = Journal.open(Path(sys.argv[1]), health=Health())
    audit = AuditLog(journal=journal, reader=journal.reader(), health=Health())
    faults = []
    journal.listen_for_fault(faults.append)
    running = asyncio.ensure_future(journal.run())
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, limit[1]))
    number = 0
    while not faults:
        audit.note("order", facts={"number": number, "filling": "x" * 2000})
        number += 1
        await asyncio.sleep(0)
    audit.note("stop", facts={"number": number})
    resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    await journal.drain()
    print(number + 1, flush=True)
    while True:
        audit.note("order", facts={"number": number})
        await journal.barrier()

asyncio.run(story())
"""


def test_a_disk_that_fills_and_a_process_that_is_killed_leave_a_chain_that_holds(tmp_path: Path) -> None:
    """RLIMIT_FSIZE is the disk's end; what is noted meanwhile is on disk once it is lifted, in its order."""
    path = tmp_path / "j"
    with subprocess.Popen([sys.executable, "-c", _CHILD, str(path)], stdout=subprocess.PIPE, text=True, cwd=ROOT) as child:
        assert child.stdout is not None
        n_rows = int(child.stdout.readline())
        child.send_signal(signal.SIGKILL)
    found = _verify(path)
    assert found.fault is None
    assert found.n_rows >= n_rows
    numbers = [msgspec.msgpack.decode(entry.body)["number"] for entry in _entries(path)[:n_rows]]
    assert numbers == list(range(n_rows))
    with contextlib.closing(_open(path)) as file:
        commit(file, [a_note(0)])
    assert _verify(path).n_rows == found.n_rows + 1


@pytest.mark.parametrize(("make", "version"), [(make_schema_2, 2), (make_schema_3, 3)])
def test_a_log_without_chain_is_brought_over_whole_and_a_row_says_so(tmp_path: Path, make: Callable[[Path], None], version: int) -> None:
    path = tmp_path / "j"
    with contextlib.closing(_open(path)) as file:
        commit(file, [replace(a_stage(number), mono_ns=None) for number in range(5)])
    make(path)  # drops the second row
    for _ in range(2):
        with contextlib.closing(_open(path)) as file:
            pass
    *old, told = _entries(path)
    kept = [replace(a_stage(number), mono_ns=None) for number in (0, 2, 3, 4)]
    assert [replace(entry, id=0, ran_ns=0, chain=b"") for entry in old] == kept
    facts = {"event": "brought over", "from_version": version, "rows_without_chain": 4}
    assert (told.kind, msgspec.msgpack.decode(told.body)) == ("journal", facts)
    assert _verify(path).fault is None
    assert check_journal(path, tell=lambda _: None).fault is None


def test_rows_go_by_age_many_at_a_time_and_the_rest_holds(tmp_path: Path) -> None:
    path, now_ns = tmp_path / "j", 0
    retention = Retention(audit_age_ns=100 * NS_PER_S)
    with contextlib.closing(_open(path, clock=lambda: now_ns)) as file, contextlib.closing(JournalReader(path)) as reader:
        for number in range(12):
            now_ns += 10 * NS_PER_S
            commit(file, [a_stage(number)])
        file.tidy(retention, {})
        assert _verify(path).n_pruned == 0, "a few that are a little over age stay: each pruning is a row"
        now_ns += 16 * NS_PER_S
        file.tidy(retention, {})
        found = _verify(path)
        assert (found.fault, found.n_pruned, found.n_rows) == (None, 3, 10)
        now_ns += 10_000 * NS_PER_S
        file.tidy(retention, {})
        found = _verify(path)
        assert (found.fault, found.n_pruned, found.n_rows) == (None, 13, 1)
        assert reader.read_last_wire_command() == 111, "the last number on the wire is known"
        now_ns += 10_000 * NS_PER_S
        file.tidy(retention, {})
        assert _verify(path).n_pruned == 13, "rows that tell of prunings alone are not pruned by themselves"
        commit(file, [a_stage(20)])
    assert [entry.kind for entry in _entries(path)] == ["pruned", "stage"]
    assert _verify(path).fault is None


def test_a_beginning_that_went_without_a_row_of_it_is_missed(tmp_path: Path) -> None:
    path = tmp_path / "j"
    write_audited(path, 9)
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("INSERT INTO meta SELECT 'audit_pruned', id || ':' || lower(hex(chain)) FROM audit WHERE id = 4")
        database.execute("DELETE FROM audit WHERE id <= 4")
    assert _verify(path).fault == "the rows up to 4 are missing: no row says that they went by age"


def test_a_journal_that_gets_another_name_says_so_and_its_chain_holds(tmp_path: Path) -> None:
    path = tmp_path / "j"
    with contextlib.closing(_open(path)) as file:
        commit(file, [a_stage(0)])
        was = file.identity.journal
        file.tidy(Retention(), {}, is_behind=True)
    with contextlib.closing(_open(path)) as file:
        commit(file, [a_stage(1)])
        name = file.identity.journal
    assert name != was
    (_, told, _) = _entries(path)
    assert msgspec.msgpack.decode(told.body) == {"event": "renamed: an older copy of itself", "was": was, "is": name}
    assert _verify(path).fault is None


def test_a_row_of_another_hand_is_found_and_does_not_stop_the_gateway(tmp_path: Path) -> None:
    path = tmp_path / "j"
    with contextlib.closing(_open(path)) as file:
        commit(file, [a_stage(0), a_stage(1)])
        with contextlib.closing(sqlite3.connect(path)) as database, database:
            insert(3, copy_of=1)(database)
        with pytest.raises(sqlite3.IntegrityError):
            commit(file, [a_stage(2)])
        commit(file, [a_stage(2)])  # as the journal tries it again
    assert [entry.command_id for entry in _entries(path)] == ["c0", "c1", "c0", "c2"]
    fault = _verify(path).fault
    assert fault is not None
    assert fault.startswith("row 3")


def test_trains_of_before_are_placed_without_a_wall_clock(tmp_path: Path) -> None:
    """By the monotonic clock where it is still the same; else as late as they can have been, time without a gateway not counted."""
    path, now_ns = tmp_path / "j", 1000 * NS_PER_S
    with contextlib.closing(_open(path, now_ns=now_ns, clock=lambda: now_ns)) as file:
        for number in (1002, 1007):
            now_ns = (number + 1) * NS_PER_S  # on disk a second later
            commit(file, [a_stage(number), a_stage(number, operator="x", node=4)])
    cases = ((1040, "m", [1002, 1007]), (5, "another", [0, 5]))  # by then gateways had run 3 s and 8 s on it
    for opened_s, machine_boot, expected in cases:
        opened_ns = opened_s * NS_PER_S
        with contextlib.closing(_open(path, now_ns=opened_ns, machine_boot=machine_boot, clock=partial(int, opened_ns))) as file:
            identity = file.identity
            with contextlib.closing(JournalReader(path)) as reader:
                trains = list(reader.read_newest_audit(limit=99))
            assert [identity.instant_of(entry) // NS_PER_S for entry in trains if entry.node == 3] == expected


def test_a_flood_of_refusals_hides_no_train_from_a_restart(tmp_path: Path) -> None:
    path, now_ns = tmp_path / "j", 0
    with contextlib.closing(_open(path, clock=lambda: now_ns)) as file, contextlib.closing(JournalReader(path)) as reader:
        commit(file, [a_stage(0)])
        now_ns = 8000 * NS_PER_S
        commit(file, [a_stage(1)])
        now_ns += 3600 * NS_PER_S
        commit(file, [a_stage(number, stage=Stage.REFUSED) for number in range(2, 50)])
        assert [entry.command_id for entry in reader.read_newest_audit(limit=3)] == ["c1", "c47", "c48", "c49"]


def test_what_a_command_needs_of_the_log_takes_no_longer_in_a_long_one(tmp_path: Path) -> None:
    """In steps of SQLite's machine, which do not depend on the computer."""
    steps = 0

    def step() -> int:
        nonlocal steps
        steps += 1
        return 0

    def count(ask: Callable[[JournalReader], object]) -> int:
        nonlocal steps
        steps = 0
        ask(reader)
        return steps

    path = tmp_path / "j"
    with contextlib.closing(_open(path)) as file, contextlib.closing(JournalReader(path)) as reader:
        reader._connection.set_progress_handler(step, 1)
        asked: list[Callable[[JournalReader], object]] = [
            lambda reader: reader.read_audit(command_id="c3"),
            lambda reader: reader.read_last_audit(kind="limits"),
            lambda reader: reader.read_last_audit(kind="announced", node=NodeId(3)),
            lambda reader: reader.read_last_wire_command(),
            lambda reader: list(reader.read_newest_audit(limit=3)),
        ]
        commit(file, (a_stage(number, stage=Stage.REFUSED) for number in range(20)))
        few = [count(ask) for ask in asked]
        commit(file, (a_stage(number, stage=Stage.REFUSED) for number in range(20, 3000)))
        many = [count(ask) for ask in asked]
    assert all(after <= before + 20 for before, after in zip(few, many, strict=True)), (few, many)
