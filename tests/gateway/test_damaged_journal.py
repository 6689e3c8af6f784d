"""Laws of a journal of which a part is damaged, that is an older copy of itself, or whose clock is set."""

import asyncio
import contextlib
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.contract.records import HistoryRequest, Mode, decode_journal_record
from firmware_protocol.units import NodeId
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import Damage, JournalFile, JournalReader, JournalWrite, Retention, check_journal, open_journal_file, walk_records
from gateway.journal_file.blobs import DamagedSegmentError, checksum
from gateway.record_batches import history_batches
from tests.gateway.audited import a_stage as a_stage_row
from tests.gateway.fake_radio import a_dongle, on_tcp, until
from tests.gateway.harness import a_config, a_request, command, listening, running
from tests.gateway.makers import a_mode_record, an_encounter_record
from tests.gateway.schema_3 import make_schema_2
from tests.gateway.test_journal_segments import _Clock, _commit, _fill, _opened, _tidy, a_report

DAY_NS = 86_400 * 10**9


def _commit_meetings(file: JournalFile, numbers: range) -> None:
    for number in numbers:
        record = an_encounter_record(sequence=number, node_a=1, node_b=2, t_start_s=10 * number, t_end_s=10 * number + 5)
        _commit(file, JournalWrite(records=(record,), report=a_report(number)), first_offset=number)


def _change_records(path: Path, segment: int, change: Callable[[bytearray], bytes], *, has_fitting_crc: bool = False) -> None:
    with contextlib.closing(sqlite3.connect(path)) as database:
        query = "SELECT pairs, records, reports FROM contents WHERE segment = ?"
        pairs, records, reports = database.execute(query, (segment,)).fetchone()
        changed = change(bytearray(records))
        database.execute("UPDATE contents SET records = ? WHERE segment = ?", (changed, segment))
        if has_fitting_crc:
            database.execute("UPDATE segments SET crc = ? WHERE segment = ?", (checksum(pairs, changed, reports), segment))
        database.commit()


def _flip(records: bytearray) -> bytes:
    """Make one number of a record another, which only the sum over all bytes tells."""
    records[records.index(b"t_start_ns") + len(b"t_start_ns") + 4] ^= 1
    return bytes(records)


def _make_unreadable(records: bytearray) -> bytes:
    records[8] = 0xC1
    return bytes(records)


def _ask(path: Path, *, from_offset: int = 1, limit: int = 1000) -> tuple[list[int], list[tuple[int, int]]]:
    """Return the offsets that the history gives, and those of which it says that they are damaged."""
    damage: list[Damage] = []
    request = HistoryRequest(from_offset=from_offset, limit=limit)
    batches = history_batches(request, open_reader=lambda: JournalReader(path), gateway="base1", journal="feed", on_damage=damage.append)
    offsets = [decode_journal_record(bytes(body)).offset for batch in batches for body in batch.records]
    return offsets, [(one.first, one.last) for one in damage]


@pytest.mark.parametrize(
    ("change", "has_fitting_crc"), [(_flip, False), (lambda records: bytes(records[:-1]), False), (_make_unreadable, True)]
)
def test_the_history_goes_on_behind_what_is_damaged(tmp_path: Path, change: Callable[[bytearray], bytes], has_fitting_crc: bool) -> None:
    path = tmp_path / "j"
    with _opened(path) as file:
        _commit_meetings(file, range(1, 41))
    _change_records(path, 20, change, has_fitting_crc=has_fitting_crc)
    assert _ask(path) == ([*range(1, 20), *range(21, 41)], [(20, 20)])
    # What a mapper asks that lacks just those: one more than the hole, by which it knows that they will not come.
    assert _ask(path, from_offset=20, limit=2) == ([21, 22], [(20, 20)])
    with contextlib.closing(JournalReader(path)) as reader:
        if not has_fitting_crc:
            with pytest.raises(DamagedSegmentError):
                reader.read_pair(node_a=NodeId(1), node_b=NodeId(2), from_wall_ns=0, to_wall_ns=10**15)


def test_a_history_of_which_all_is_damaged_ends(tmp_path: Path) -> None:
    path = tmp_path / "j"
    with _opened(path) as file:
        _commit_meetings(file, range(1, 4))
    for segment in (1, 2, 3):
        _change_records(path, segment, _flip)
    assert _ask(path) == ([], [(1, 1), (2, 2), (3, 3)])


def test_what_is_damaged_is_never_merged_and_keeps_nothing_else_from_it(tmp_path: Path) -> None:
    path = tmp_path / "j"
    with _opened(path) as file:
        _commit_meetings(file, range(1, 201))
        _change_records(path, 100, _flip)
        told: list[Damage] = []
        while (done := file.tidy(Retention(), {})).has_more:
            told += done.damage
        assert [(one.first, one.last) for one in told] == [(100, 100)]
        assert not done.refused
    with contextlib.closing(sqlite3.connect(path)) as database:
        firsts = [first for (first,) in database.execute("SELECT first_offset FROM segments ORDER BY first_offset")]
    assert 100 in firsts
    assert len(firsts) < 80, "those around it are merged"
    fault = check_journal(path, tell=lambda _: None).fault
    assert fault is not None
    assert "offsets 100 to 100" in fault
    assert _ask(path) == ([*range(1, 100), *range(101, 201)], [(100, 100)])


def test_a_wall_clock_that_is_set_makes_nothing_old(tmp_path: Path) -> None:
    """Forward by mistake, or from 1970 when the time is known at last: what a mapper lacks is kept, and so is all else."""
    clock = _Clock()
    with _opened(tmp_path / "j", clock) as file, contextlib.closing(JournalReader(tmp_path / "j")) as reader:
        head = _fill(file, clock, n_segments=10, step_s=100) - 1
        retention = Retention(
            max_age_ns=7 * DAY_NS, keep_ns=600 * 10**9, mapper_age_ns=30 * DAY_NS, node_age_ns=90 * DAY_NS, audit_age_ns=365 * DAY_NS
        )
        file.tidy(retention, {"slow": 500})
        for offset_ns in (10**18 + 400 * DAY_NS, 0, 10**18):
            clock.wall_offset_ns = offset_ns
            assert _tidy(file, retention) == (0, 0)
            head = _fill(file, clock, n_segments=1, step_s=1, first_offset=head + 1) - 1
        assert file.oldest_offset() == 1
        assert file.watermarks() == {"slow": 500}
        assert reader.read_windows()
        clock.now_ns += 8 * DAY_NS
        assert _tidy(file, retention) == (500, 0), "time that passes makes old"


def test_a_commit_while_the_clock_was_ahead_does_not_stop_retention(tmp_path: Path) -> None:
    clock = _Clock()
    with _opened(tmp_path / "j", clock) as file:
        clock.wall_offset_ns += 365 * DAY_NS
        offset = _fill(file, clock, n_segments=1, step_s=100)
        clock.wall_offset_ns -= 365 * DAY_NS
        offset = _fill(file, clock, n_segments=70, step_s=100, first_offset=offset, n_octets=10)
        while file.tidy(Retention(), {}).has_more:
            pass  # the one from the future is merged with others
        _fill(file, clock, n_segments=20, step_s=100, first_offset=offset)
        clock.now_ns += 8 * DAY_NS
        assert _tidy(file, Retention(max_age_ns=7 * DAY_NS)) == (9000, 0)
        assert file.oldest_offset() == 9001


def test_how_long_gateways_ran_is_known_over_a_restart_and_by_files_of_version_2(tmp_path: Path) -> None:
    path, clock = tmp_path / "j", _Clock()
    with _opened(path, clock) as file:
        _fill(file, clock, n_segments=10, step_s=100)
    make_schema_2(path)
    for _ in range(3):
        clock.now_ns = 0  # the machine was started anew
        with _opened(path, clock) as file:
            assert _tidy(file, Retention(max_age_ns=2500 * 10**9)) == (0, 0)
            _fill(file, clock, n_segments=10, step_s=100, first_offset=file.identity.head_offset + 1)
    with _opened(path, clock) as file:
        assert _tidy(file, Retention(max_age_ns=2500 * 10**9))[0] == 1400, "those of version 2 began to age when they were opened"
    assert check_journal(path, tell=lambda _: None).fault is None


def test_a_journal_that_is_an_older_copy_of_itself_says_so_and_gets_a_new_name(tmp_path: Path) -> None:
    path, names, alarms = tmp_path / "j", [], []

    async def start(watermark: int | None) -> None:
        journal = Journal.open(path, health=Health())
        journal.listen_for_alarm(lambda kind, _: alarms.append(kind))
        names.append(journal.journal_id)
        try:
            async with asyncio.TaskGroup() as tasks:
                running = tasks.create_task(journal.run())
                for number in range(3):
                    mode = a_mode_record(sequence=number, node=1, mode=Mode.S)
                    await journal.append(JournalWrite(records=(mode,)))
                if watermark is not None:
                    for _ in range(2):
                        journal.note_watermark("mapper1", watermark)
                    await until(lambda: not journal._new_watermarks and not journal._is_behind_untold, what="it is written down")
                    await asyncio.get_running_loop().run_in_executor(journal._executor, lambda: None)
                running.cancel()
        finally:
            journal.close()

    asyncio.run(start(3))
    assert alarms == []
    asyncio.run(start(9))
    assert alarms == ["journal.behind"]
    asyncio.run(start(None))
    assert names[0] == names[1] != names[2]
    with contextlib.closing(JournalReader(path)) as reader:
        page = reader.read_page(from_offset=1, limit=100)
        assert (page.first_offset, page.oldest_offset, page.head_offset) == (7, 7, 9), "what was of the other name is not of this one"
        assert [record.offset for record in reader.read_recent_modes(limit=100)] == [7, 8, 9]
    assert sum(map(len, walk_records(path, until=9))) == 9, "an export has all"
    with contextlib.closing(open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="")) as file:
        assert (file.identity.journal, file.watermarks()) == (names[2], {})


class _HasNoRoom(sqlite3.Connection):
    """A disk that takes nothing that makes the file larger."""

    def execute(self, sql: str, *values: object) -> sqlite3.Cursor:
        if sql.startswith("INSERT"):
            raise sqlite3.OperationalError("database or disk is full")
        return super().execute(sql, *values)  # type: ignore[arg-type]  # the stub has a positional only


def test_a_full_disk_takes_no_watermark_but_what_is_old_goes_all_the_same(tmp_path: Path) -> None:
    path, clock = tmp_path / "j", _Clock()
    with _opened(path, clock) as made:
        _fill(made, clock, n_segments=80, step_s=100, n_octets=4000)
        connection = sqlite3.connect(path, factory=_HasNoRoom, isolation_level=None)
        with contextlib.closing(connection):
            full = JournalFile(connection=connection, lock=made._lock, identity=made.identity, clock=clock)
            done = full.tidy(Retention(max_size=100_000), {"mapper1": 5})
            assert done.n_dropped > 0
            assert done.oldest_offset == 1 + done.n_dropped
            assert done.refused.keys() >= {"progress"}


def _damage_first_audit_rows(path: Path) -> None:
    """Overwrite the leaf of the audit table that has its first rows (https://www.sqlite.org/fileformat2.html, 1.6)."""
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (size,) = database.execute("PRAGMA page_size").fetchone()
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'audit'").fetchone()
    with path.open("r+b") as file:
        file.seek((root - 1) * size)
        page = file.read(size)
        while page[0] == 5:  # an interior page: its first cell begins with the number of the page to the left
            leaf = int.from_bytes(page[(cell := int.from_bytes(page[12:14])) : cell + 4])
            file.seek((leaf - 1) * size)
            page = file.read(size)
        file.seek((leaf - 1) * size)
        file.write(bytes(size))


def test_a_gateway_whose_audit_log_is_damaged_starts_and_stops_whom_it_is_told_to(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(7)
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}")
            async with running(config) as service:
                for number in range(400):
                    service._journal.append(JournalWrite(audit=a_stage_row(number)))
                await service._journal.drain()
            _damage_first_audit_rows(Path(config.journal))
            with pytest.raises(sqlite3.DatabaseError):
                list(JournalReader(Path(config.journal)).read_newest_audit(limit=30_000))
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    dongle.backpacks[NodeId(7)].say_hello()
                    dongle.backpacks[NodeId(7)].say_status(since_ms=1)
                    await until(lambda: {status.node for status in peer.node_statuses} == {7}, what="the biobot is known")
                    stages = await command(peer, a_request(7, StimulationAction.STOP))
                    assert stages[-1].stage is Stage.BIOBOT_CONFIRMED

    asyncio.run(story())
