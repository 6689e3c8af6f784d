"""Laws of a journal whose disk is cut off, filled, or from before."""

import asyncio
import contextlib
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.records import JournalRecord, Mode
from firmware_protocol.units import BootId, NodeId
from gateway.errors import JournalUnfitError
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import JournalReader, JournalWrite, SegmentBuilder, check_journal, open_journal_file
from tests.gateway.fake_radio import until
from tests.gateway.makers import a_mode_record, an_encounter_record
from tests.gateway.schema_1 import write_schema_1
from tests.gateway.test_journal_segments import a_report

ROOT = Path(__file__).parents[2]


def test_a_journal_of_version_1_keeps_its_history_and_all_that_a_restart_needs(tmp_path: Path) -> None:
    path = tmp_path / "j"
    modes = [a_mode_record(sequence=100 + number, node=number, mode=Mode.S) for number in range(3)]
    meetings = [an_encounter_record(sequence=number, node_a=1, node_b=2, t_start_s=number, t_end_s=number + 1) for number in range(5000)]
    said: list[JournalRecord] = [*modes, *meetings]
    records: list[JournalRecord] = [msgspec.structs.replace(record, offset=offset) for offset, record in enumerate(said, start=1)]
    # 0 to 4 are done; 5 is missing, 6 and 8 came.
    reports = [a_report(number, next_number=min(5, number + 1), wall_ns=number) for number in (0, 1, 2, 3, 4, 6, 8)]
    write_schema_1(path, records=records, reports=reports)
    file = open_journal_file(path, now_wall_ns=10**18, now_ns=3, machine_boot="m")
    with contextlib.closing(JournalReader(path)) as reader:
        assert reader.read_records(from_offset=1, limit=9000) == (records, 5003)
        assert [report.number for report in reader.read_reports()] == [0, 1, 2, 3, 4, 6, 8]
        assert reader.read_windows() == [(1, 1, 5, [6, 8])]
        assert reader.read_recent_modes(limit=9) == records[:3]
        assert reader.read_nodes() == [b"\x00\xff"]
        assert reader.read_last_wire_command() == 77
        assert [(entry.command_id, entry.body) for entry in reader.read_newest_audit(limit=99)] == [("c", b"\x01")]
        found = reader.read_pair(node_a=NodeId(1), node_b=NodeId(2), from_wall_ns=10 * 10**9, to_wall_ns=11 * 10**9)
        assert [record.sequence for record in found] == [9, 10, 11]
    assert (file.identity.journal, file.identity.head_offset, file.identity.earlier_anchors) == ("5f0c9a31", 5003, (7,))
    assert file.identity.boot > 41
    assert file.identity.first_session == 320
    file.close()
    assert check_journal(path, tell=lambda _: None).fault is None
    assert sorted(one.name for one in tmp_path.iterdir() if one.suffix == ".new") == []


def test_a_journal_of_version_1_that_somebody_reads_is_left_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "j"
    write_schema_1(path, records=[a_mode_record(sequence=1, node=1, mode=Mode.S)], reports=[])
    with contextlib.closing(sqlite3.connect(path)) as other:
        other.execute("BEGIN")
        other.execute("SELECT * FROM entries").fetchall()
        with pytest.raises(JournalUnfitError, match="locked"):
            open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="")
        assert other.execute("SELECT count(*) FROM entries").fetchone() == (1,)
    open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="").close()


_N_COMMITS = 25


@pytest.fixture(scope="module")
def cut_off(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes, list[int]]:
    """A journal's file and its log as a power cut leaves them, and the length of the log after each commit."""
    path = tmp_path_factory.mktemp("cut") / "j"
    file = open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="")
    file._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    wal, offset, lengths = path.with_name("j-wal"), 1, []
    for number in range(_N_COMMITS):
        builder = SegmentBuilder(first_offset=offset, windows=file.windows)
        records = tuple(an_encounter_record(sequence=number, node_a=1, node_b=2, t_start_s=1, t_end_s=2) for _ in range(1 + number % 4))
        builder.add(JournalWrite(records=records, report=a_report(number)))
        file.commit(builder)
        offset = builder.next_offset
        lengths.append(wal.stat().st_size)
    found = path.read_bytes(), wal.read_bytes(), lengths
    file.close()
    return found


@given(cut=st.integers(0, 10**9), garbage=st.binary(max_size=5000), is_overwritten=st.booleans())
@settings(max_examples=40)
def test_a_log_cut_anywhere_yields_the_commits_before_the_cut(
    cut_off: tuple[bytes, bytes, list[int]], tmp_path_factory: pytest.TempPathFactory, cut: int, garbage: bytes, is_overwritten: bool
) -> None:
    body, log, lengths = cut_off
    cut %= len(log) + 1
    path = tmp_path_factory.mktemp("torn") / "j"
    path.write_bytes(body)
    path.with_name("j-wal").write_bytes(log[:cut] + garbage + (log[cut + len(garbage) :] if is_overwritten else b""))
    n_whole = sum(length <= cut for length in lengths)
    file = open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="")
    with contextlib.closing(JournalReader(path)) as reader:
        records, head_offset = reader.read_records(from_offset=1, limit=1000)
        windows = reader.read_windows()
    n_found = len({record.sequence for record in records})
    is_same_again = is_overwritten and log[cut : cut + len(garbage)] == garbage[: len(log) - cut]
    assert n_found == (_N_COMMITS if is_same_again else n_whole)
    assert [record.offset for record in records] == list(range(1, head_offset + 1))
    assert windows == ([(1, 1, n_found, [])] if n_found else []), "what is on disk of a commit is all of it"
    builder = SegmentBuilder(first_offset=head_offset + 1, windows=file.windows)
    builder.add(JournalWrite(records=(a_mode_record(sequence=999, node=1, mode=Mode.S),)))
    file.commit(builder)
    file.close()
    assert check_journal(path, tell=lambda _: None).fault is None


_FILLER = """
import asyncio, resource, signal, sys
from pathlib import Path
from gateway.health import Health
from gateway.journal import Journal
from tests.gateway.test_journal import a_write

async def story() -> None:
    journal = Journal.open(Path(sys.argv[1]), health=Health())
    faults = []
    journal.listen_for_fault(faults.append)
    running = asyncio.ensure_future(journal.run())
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (250_000, limit[1]))
    futures = [journal.append(a_write(journal, number)) for number in range(8_000)]
    while not faults:
        await asyncio.sleep(0.01)
    n_done = sum(future.done() for future in futures)
    assert n_done == journal.head_offset < 8_000, (n_done, journal.head_offset)
    resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    await journal.drain()
    assert all(future.done() for future in futures)
    assert faults[1:] == [None], faults
    print(journal.head_offset)
    running.cancel()
    journal.close()

asyncio.run(story())
"""


def test_a_flood_that_meets_the_end_of_the_disk_waits_and_arrives_once(tmp_path: Path) -> None:
    """RLIMIT_FSIZE is the disk's end here: writes beyond it fail as on a full one, until the limit is lifted."""
    path = tmp_path / "j"
    child = subprocess.run([sys.executable, "-c", _FILLER, str(path)], capture_output=True, text=True, cwd=ROOT, timeout=60, check=False)
    assert child.stdout == "8000\n", child.stderr
    with contextlib.closing(JournalReader(path)) as reader:
        records, head_offset = reader.read_records(from_offset=1, limit=10_000)
        numbers = [report.number for report in reader.read_reports()]
    assert head_offset == 8_000
    assert [record.sequence for record in records] == list(range(8_000)) == numbers
    assert check_journal(path, tell=lambda _: None).fault is None


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB."""
    mount = shutil.which("mount")
    place = tmp_path / "disk"
    place.mkdir()
    command = [mount or "mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)]
    if mount is None or os.geteuid() != 0 or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("a small file system can be mounted by root alone")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_disk_that_fills_in_the_middle_of_a_flood_and_is_freed_loses_nothing(small_disk: Path) -> None:
    async def story() -> None:
        health = Health()
        journal = Journal.open(small_disk / "j", health=health)
        faults: list[str | None] = []
        journal.listen_for_fault(faults.append)
        (small_disk / "ballast").write_bytes(bytes(1_800_000))
        running = asyncio.ensure_future(journal.run())
        futures = [journal.append(a_flood_write(journal, number)) for number in range(8_000)]
        await until(lambda: bool(faults), what="the disk is full")
        assert 0 <= journal.head_offset < 8_000
        assert [future.done() for future in futures] == [True] * journal.head_offset + [False] * (8_000 - journal.head_offset)
        (small_disk / "ballast").unlink()
        await journal.drain()
        assert len(faults) == 2, "told once when it began, and once when it ended"
        assert faults[1] is None
        running.cancel()
        await asyncio.wait({running})
        journal.close()

    asyncio.run(story())
    with contextlib.closing(JournalReader(small_disk / "j")) as reader:
        records, _ = reader.read_records(from_offset=1, limit=10_000)
        assert [record.sequence for record in records] == list(range(8_000))
        assert [report.number for report in reader.read_reports()] == list(range(8_000))


def a_flood_write(journal: Journal, number: int) -> JournalWrite:
    record = an_encounter_record(sequence=number, node_a=1, node_b=2, t_start_s=number, t_end_s=number + 1)
    return JournalWrite(records=(msgspec.structs.replace(record, journal=journal.journal_id, boot=BootId(1)),), report=a_report(number))
