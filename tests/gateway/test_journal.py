"""Laws of the journal, on real files."""

import asyncio
import contextlib
import os
import signal
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import msgspec.structs
import pytest

from firmware_protocol.contract.records import MissionPhase, MissionRecord, decode_journal_record
from firmware_protocol.units import BootId, Nanoseconds, NodeId
from gateway.errors import JournalUnfitError
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import (
    SESSIONS_PER_START,
    AuditEntry,
    Committed,
    JournalFile,
    JournalReader,
    JournalWrite,
    SegmentBuilder,
    UplinkReport,
    open_journal_file,
)
from tests.gateway.fake_radio import until
from tests.gateway.makers import an_encounter_record

_CHILD = """
import asyncio, sys
from pathlib import Path
from typing import Any
from gateway.health import Health
from gateway.journal import Journal
from tests.gateway.test_journal import a_write

async def story() -> None:
    journal = Journal.open(Path(sys.argv[1]), health=Health())
    running = asyncio.ensure_future(journal.run())
    number = 0
    while True:
        futures = [journal.append(a_write(journal, number + k)) for k in range(7)]
        number += 7
        for future in futures:
            await future
        print(number, flush=True)

asyncio.run(story())
"""


def a_write(journal: Journal, number: int) -> JournalWrite:
    record = MissionRecord(
        gateway="base1",
        journal=journal.journal_id,
        offset=1,
        boot=journal.boot,
        sequence=number,
        revision=0,
        wall_anchor_ns=Nanoseconds(0),
        phase=MissionPhase.IDLE,
        t_start_ns=Nanoseconds(number),
    )
    report = UplinkReport(
        node=NodeId(1),
        boot=BootId(1),
        number=number,
        next_number=number + 1,
        received_wall_ns=number,
        radio="r",
        address=1,
        rssi_dbm=-1,
        lqi=1,
        payload=b"x",
    )
    return JournalWrite(records=(record,), report=report)


def _with_journal(path: Path, story: Callable[[Journal], Awaitable[None]]) -> None:
    async def run() -> None:
        journal = Journal.open(path, health=Health())
        try:
            async with asyncio.TaskGroup() as tasks:
                running = tasks.create_task(journal.run())
                await story(journal)
                running.cancel()
        finally:
            journal.close()

    asyncio.run(run())


def test_offsets_have_no_gaps_over_restarts_and_boots_grow(tmp_path: Path) -> None:
    boots: list[int] = []
    names: set[str] = set()

    async def story(journal: Journal) -> None:
        boots.append(journal.boot)
        names.add(journal.journal_id)
        for number in range(300):
            done = journal.append(a_write(journal, 1000 * len(boots) + number))
        await done
        reader = journal.reader()
        records, head_offset = reader.read_records(from_offset=1, limit=10_000)
        reader.close()
        assert [record.offset for record in records] == list(range(1, 300 * len(boots) + 1))
        assert head_offset == journal.head_offset == 300 * len(boots)

    for _ in range(3):
        _with_journal(tmp_path / "j", story)
    assert boots == sorted(set(boots))
    assert len(names) == 1


def test_listeners_hear_of_records_after_the_disk_has_them_and_before_the_future_resolves(tmp_path: Path) -> None:
    async def story(journal: Journal) -> None:
        heard: list[int] = []
        reader = journal.reader()

        def listen(committed: Committed) -> None:
            page = reader.read_page(from_offset=1, limit=100)
            assert page.head_offset == committed.head_offset
            assert page.bodies[-len(committed.bodies) :] == committed.bodies
            assert [decode_journal_record(body) for body in committed.bodies] == list(committed.records)
            heard.append(len(committed.records))

        journal.listen(listen)
        for number in range(20):
            await journal.append(a_write(journal, number))
            assert sum(heard) == number + 1
        reader.close()

    _with_journal(tmp_path / "j", story)


def test_what_was_promised_is_there_after_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "j"
    for _ in range(3):
        with subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(path)], stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2], env={**os.environ}
        ) as child:
            assert child.stdout is not None
            promised = 0
            while promised < 150:
                promised = int(child.stdout.readline())
            child.send_signal(signal.SIGKILL)
            promised = max([promised, *(int(line) for line in child.stdout.read().splitlines()[:-1] if line)])
        with contextlib.closing(JournalReader(path)) as reader:
            records, head_offset = reader.read_records(from_offset=1, limit=1_000_000)
            reports = list(reader.read_reports())
        latest_boot = max(record.boot for record in records)
        numbers = [record.sequence for record in records if record.boot == latest_boot]
        assert set(range(promised)) <= set(numbers)
        assert [record.offset for record in records] == list(range(1, head_offset + 1))
        assert [report.number for report in reports] == [record.sequence for record in records]


def test_a_full_disk_delays_and_is_told_when_it_begins_and_ends(tmp_path: Path) -> None:
    async def story(journal: Journal) -> None:
        faults: list[str | None] = []
        journal.listen_for_fault(faults.append)
        await journal.append(a_write(journal, 0))
        connection = journal._file._connection
        (n_pages,) = connection.execute("PRAGMA page_count").fetchone()
        connection.execute(f"PRAGMA max_page_count = {n_pages}")
        futures = [journal.append(a_write(journal, 1 + number)) for number in range(2000)]
        await until(lambda: bool(faults), what="the disk is full")
        assert not futures[-1].done()
        note = journal.append(JournalWrite(audit=AuditEntry(wall_ns=1, kind="note")))
        assert journal.unwritten() == {"records": 2000, "messages": 2000, "audit_rows": 1}, "what an end now would lose"
        connection.execute("PRAGMA max_page_count = 1000000")
        await note
        assert set(journal.unwritten().values()) == {0}
        assert faults[0] is not None
        assert "full" in faults[0]
        assert faults[1:] == [None]
        assert journal.head_offset == 2001

    _with_journal(tmp_path / "j", story)


def test_a_file_that_is_no_journal_is_refused_and_left_alone(tmp_path: Path) -> None:
    text = tmp_path / "text"
    text.write_text("not a database at all, but long enough to look at" * 20)
    foreign = tmp_path / "foreign"
    with sqlite3.connect(foreign) as database:
        database.execute("CREATE TABLE t (a)")
    database.close()
    newer = tmp_path / "newer"
    _with_journal(newer, lambda journal: journal.append(a_write(journal, 0)))
    with sqlite3.connect(newer) as database:
        database.execute("PRAGMA user_version = 99")
    database.close()
    for path, word in (
        (text, "no journal"),
        (foreign, "another program"),
        (newer, "version 99"),
        (tmp_path, "directory"),
        (tmp_path / "missing" / "j", "cannot be written"),
    ):
        before = path.read_bytes() if path.is_file() else None
        with pytest.raises(JournalUnfitError, match=word) as caught:
            Journal.open(path, health=Health())
        assert str(path) in str(caught.value)
        assert before is None or path.read_bytes() == before


def test_a_journal_stays_its_gateways_and_an_earlier_one_is_that_of_its_newest_record(tmp_path: Path) -> None:
    path = tmp_path / "j"

    def open_as(gateway: str | None) -> None:
        open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="", gateway=gateway).close()

    open_as("base1")
    with pytest.raises(JournalUnfitError, match=r"of gateway 'base1', but this gateway is called 'base2'.*set name = \"base1\""):
        open_as("base2")
    open_as("base1")
    path.unlink()
    file = open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="")
    builder = SegmentBuilder(first_offset=1, windows=file.windows)
    builder.add(JournalWrite(records=(an_encounter_record(sequence=1, node_a=1, node_b=2, t_start_s=0, t_end_s=1),)))
    file.commit(builder)
    file.close()
    with pytest.raises(JournalUnfitError, match="of gateway 'base1'"):
        open_as("base2")
    open_as("base1")


class _LosesAnAnswer(sqlite3.Connection):
    """A disk whose first commit gets through, but says that it did not."""

    has_lied = False

    def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
        cursor = super().execute(sql, *values)
        if sql.startswith("INSERT INTO commits") and not self.has_lied:
            self.has_lied = True
            raise sqlite3.OperationalError("disk I/O error")
        return cursor


def _an_audit(node: int) -> AuditEntry:
    return AuditEntry(wall_ns=1, command_id="c", wire_command=None, stage="refused", node=NodeId(node), train_ms=0, request=b"", body=b"")


def test_a_commit_that_got_through_and_said_it_did_not_is_not_repeated(tmp_path: Path) -> None:
    path = tmp_path / "j"
    made = open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="")
    with contextlib.closing(sqlite3.connect(path, factory=_LosesAnAnswer, check_same_thread=False, isolation_level=None)) as connection:
        journal = Journal(path=path, file=JournalFile(connection=connection, lock=made._lock, identity=made.identity), health=Health())

        async def story() -> None:
            async with asyncio.TaskGroup() as tasks:
                running = tasks.create_task(journal.run())
                first = a_write(journal, 0)
                await journal.append(JournalWrite(records=first.records, report=first.report, audit=_an_audit(1)))
                await journal.append(a_write(journal, 1))
                running.cancel()

        asyncio.run(story())
        reader = journal.reader()
        assert [record.offset for record in reader.read_records(from_offset=1, limit=9)[0]] == [1, 2]
        assert len(list(reader.read_reports())) == 2
        assert len(list(reader.read_newest_audit(limit=99))) == 1
        reader.close()
        journal.close()
    made.close()


def test_a_write_that_can_never_be_stored_costs_itself_alone_and_leaves_no_gap(tmp_path: Path) -> None:
    async def story(journal: Journal) -> None:
        good = a_write(journal, 0)
        bad = a_write(journal, 1)
        assert bad.report is not None
        futures = [journal.append(good)]
        futures.append(journal.append(JournalWrite(records=bad.records, report=msgspec.structs.replace(bad.report, address=1 << 63))))
        futures.append(journal.append(a_write(journal, 2)))
        done, _ = await asyncio.wait(futures)
        assert [type(future.exception()) for future in futures] == [type(None), struct.error, type(None)]
        assert len(done) == 3
        await journal.drain()
        assert journal.head_offset == 2
        reader = journal.reader()
        assert [record.sequence for record in reader.read_records(from_offset=1, limit=9)[0]] == [0, 2]
        reader.close()

    _with_journal(tmp_path / "j", story)


def test_an_audited_node_of_any_size_is_stored(tmp_path: Path) -> None:
    _with_journal(tmp_path / "j", lambda journal: journal.append(JournalWrite(audit=_an_audit((1 << 64) - 1))))


def test_starts_have_session_numbers_of_their_own(tmp_path: Path) -> None:
    numbers: list[int] = []
    for _ in range(20):
        file = open_journal_file(tmp_path / "j", now_wall_ns=10**18, now_ns=0, machine_boot="")
        numbers += [(file.identity.first_session + at) % (1 << 16) for at in range(SESSIONS_PER_START)]
        file.close()
    assert len(set(numbers)) == len(numbers)


def test_a_start_knows_the_anchors_of_those_before_it_since_the_machine_booted(tmp_path: Path) -> None:
    known = []
    for machine_boot, now_wall_ns in (("a", 1000), ("a", 5000), ("a", 900), ("b", 700), ("", 600), ("", 500)):
        file = open_journal_file(tmp_path / "j", now_wall_ns=now_wall_ns, now_ns=100, machine_boot=machine_boot)
        known.append(file.identity.earlier_anchors)
        file.close()
    assert known == [(), (900,), (900, 4900), (), (), ()]
