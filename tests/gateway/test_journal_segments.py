"""Laws of the journal's segments: what is packed comes back, pairs are found, neighbours merge, old ones go."""

import contextlib
import random
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import EncounterRecord, Mode, decode_journal_record
from firmware_protocol.units import BootId, NodeId
from gateway.journal_file import (
    AuditEntry,
    JournalFile,
    JournalReader,
    JournalWrite,
    Retention,
    SegmentBuilder,
    UplinkReport,
    open_journal_file,
)
from gateway.journal_file.blobs import (
    DamagedSegmentError,
    compress,
    decompress,
    join_records,
    pack_records,
    pack_report,
    unpack_records,
    unpack_reports,
)
from gateway.journal_file.segments import Windows
from gateway.sequences import SequenceWindow
from tests.gateway.makers import a_mode_record, an_encounter_record

NS_PER_S = 1_000_000_000


def a_report(number: int, *, node: int = 1, next_number: int | None = None, wall_ns: int = 0, payload: bytes = b"x") -> UplinkReport:
    return UplinkReport(
        node=NodeId(node),
        boot=BootId(1),
        number=number,
        next_number=number + 1 if next_number is None else next_number,
        received_wall_ns=wall_ns,
        radio="serial:/dev/ttyACM0",
        address=node,
        rssi_dbm=-60,
        lqi=200,
        payload=payload,
    )


class _Clock:
    """A monotonic clock that is set by hand [ns], and a wall clock that may be set beside it."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.wall_offset_ns = 10**18

    def __call__(self) -> int:
        return self.now_ns

    def wall(self) -> int:
        return self.now_ns + self.wall_offset_ns


@contextlib.contextmanager
def _opened(path: Path, clock: _Clock | None = None) -> Iterator[JournalFile]:
    clock = clock or _Clock()
    file = open_journal_file(path, now_wall_ns=clock.wall(), now_ns=clock(), machine_boot="", wall_clock=clock.wall, clock=clock)
    try:
        yield file
    finally:
        file.close()


def _commit(file: JournalFile, *writes: JournalWrite, first_offset: int) -> int:
    """Commit writes as one segment; return the next offset."""
    builder = SegmentBuilder(first_offset=first_offset, windows=file.windows)
    for write in writes:
        builder.add(write)
    file.commit(builder)
    return builder.next_offset


@given(bodies=st.lists(st.binary(max_size=80), max_size=40))
def test_records_come_back_as_they_were_packed(bodies: list[bytes]) -> None:
    stored, is_compressed = compress(pack_records(bodies))
    assert unpack_records(decompress(stored, is_compressed=is_compressed)) == bodies


@given(st.lists(st.lists(st.binary(max_size=20), min_size=1, max_size=5), min_size=1, max_size=5))
def test_joined_segments_are_one_segment_of_all_their_records(parts: list[list[bytes]]) -> None:
    assert join_records([pack_records(bodies) for bodies in parts]) == pack_records([body for bodies in parts for body in bodies])


@given(bodies=st.lists(st.binary(max_size=20), min_size=1, max_size=9), cut=st.integers(0, 60), flip=st.integers(0, 35))
def test_damaged_records_are_told_and_never_read_past_their_end(bodies: list[bytes], cut: int, flip: int) -> None:
    packed = bytearray(pack_records(bodies))
    packed[flip % len(packed)] ^= 0x55
    for damaged in (bytes(packed), pack_records(bodies)[:cut]):
        try:
            found = unpack_records(damaged)
        except DamagedSegmentError:
            continue
        assert sum(map(len, found)) == len(damaged) - 4 - 4 * len(found)


@given(numbers=st.lists(st.integers(0, 1 << 40), max_size=8), payload=st.binary(max_size=100))
def test_reports_come_back_as_they_were_packed(numbers: list[int], payload: bytes) -> None:
    reports = [a_report(number, payload=payload) for number in numbers]
    assert list(unpack_reports(b"".join(map(pack_report, reports)))) == reports


@given(numbers=st.lists(st.integers(0, 60), min_size=1, max_size=60))
def test_the_disk_knows_a_window_as_the_window_itself(numbers: list[int]) -> None:
    window, windows = SequenceWindow(), Windows()
    for number in numbers:
        if not window.has(number):
            window.add(number)
            at, above, _ = windows.note(a_report(number, next_number=window.next))
    assert at == window.next
    assert {at + bit for bit in range(above.bit_length()) if above >> bit & 1} == window._above


def test_merging_changes_nothing_that_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "j"
    with _opened(path) as file, contextlib.closing(JournalReader(path)) as reader:

        def all_there_is() -> object:
            pair = reader.read_pair(node_a=NodeId(3), node_b=NodeId(4), from_wall_ns=100 * NS_PER_S, to_wall_ns=900 * NS_PER_S)
            everything = list(reader.read_encounters(from_wall_ns=0, to_wall_ns=1 << 62))
            return (
                reader.read_page(from_offset=1, limit=5000),
                reader.read_page(from_offset=777, limit=9),
                pair,
                everything,
                list(reader.read_reports()),
                reader.read_windows(),
                reader.read_recent_modes(limit=7),
            )

        offset = 1
        for number in range(400):
            node = number % 7
            record = an_encounter_record(sequence=number, node_a=node, node_b=node + 1, t_start_s=number, t_end_s=number + 1)
            mode = a_mode_record(sequence=5000 + number, node=node, mode=Mode.S)
            records = (record, mode) if number % 100 == 0 else (record,)
            report = None if number % 3 == 0 else a_report(number)
            offset = _commit(file, JournalWrite(records=records, report=report), first_offset=offset)
        before = all_there_is()
        n_steps = 0
        while file.tidy(Retention(), {}).has_more:
            n_steps += 1
        assert all_there_is() == before
        connection = sqlite3.connect(path)
        (n_segments,) = connection.execute("SELECT count(*) FROM segments").fetchone()
        connection.close()
        assert n_steps > 0
        assert n_segments < 10
        assert reader.read_page(from_offset=1, limit=1).head_offset == offset - 1
    with _opened(path) as file:
        assert file.identity.head_offset == offset - 1, "merged ones keep their place"
        assert _commit(file, JournalWrite(records=(a_mode_record(sequence=1, node=1, mode=Mode.S),)), first_offset=offset) == offset + 1


def _fill(file: JournalFile, clock: _Clock, *, n_segments: int, step_s: int, first_offset: int = 1, n_octets: int = 4000) -> int:
    rng = random.Random(1)
    for number in range(n_segments):
        clock.now_ns += step_s * NS_PER_S
        records = tuple(an_encounter_record(sequence=number * 100 + k, node_a=1, node_b=2, t_start_s=1, t_end_s=2) for k in range(100))
        report = a_report(number, payload=rng.randbytes(n_octets))
        first_offset = _commit(file, JournalWrite(records=records, report=report), first_offset=first_offset)
    return first_offset


def _tidy(file: JournalFile, retention: Retention) -> tuple[int, int]:
    dropped = undelivered = 0
    while True:
        done = file.tidy(retention, {})
        dropped, undelivered = dropped + done.n_dropped, undelivered + done.n_undelivered
        if not done.has_more:
            return dropped, undelivered


def test_what_is_over_age_goes_oldest_first_and_the_rest_stays_whole(tmp_path: Path) -> None:
    clock = _Clock()
    with _opened(tmp_path / "j", clock) as file, contextlib.closing(JournalReader(tmp_path / "j")) as reader:
        head = _fill(file, clock, n_segments=50, step_s=100) - 1
        dropped, undelivered = _tidy(file, Retention(max_age_ns=1_950 * NS_PER_S))
        page = reader.read_page(from_offset=1, limit=10_000)
        assert (dropped, undelivered) == (3000, 0)
        assert page.first_offset == page.oldest_offset == file.oldest_offset() == 3001
        assert [decode_journal_record(body).offset for body in page.bodies] == list(range(3001, head + 1))
        _tidy(file, Retention(max_age_ns=1))
        assert file.oldest_offset() == 4901, "the newest segment says how far the journal has come"


def test_what_a_mapper_lacks_outlives_its_age_and_goes_by_size_alone_and_is_told(tmp_path: Path) -> None:
    clock = _Clock()
    with _opened(tmp_path / "j", clock) as file:
        _fill(file, clock, n_segments=50, step_s=100)
        file.tidy(Retention(), {"slow": 1250, "quick": 4000})
        old = Retention(max_age_ns=NS_PER_S, mapper_age_ns=10**6 * NS_PER_S)
        assert _tidy(file, old) == (1200, 0)
        assert file.oldest_offset() == 1201
        small = Retention(max_size=100_000, mapper_age_ns=10**6 * NS_PER_S)
        dropped, undelivered = _tidy(file, small)
        assert dropped > 0
        assert undelivered == dropped - 50, "fifty of the first segment had arrived"
        clock.now_ns += 2 * 10**6 * NS_PER_S
        assert _tidy(file, old)[1] == 0, "a mapper that is not heard of any more is not waited for"
        assert file.oldest_offset() == 4901


def test_what_is_young_stays_whatever_it_takes(tmp_path: Path) -> None:
    clock = _Clock()
    with _opened(tmp_path / "j", clock) as file:
        _fill(file, clock, n_segments=20, step_s=1)
        done = file.tidy(Retention(max_size=1000, max_age_ns=1, keep_ns=3600 * NS_PER_S), {})
        assert (done.n_dropped, done.is_oversized) == (0, True)


def test_the_file_is_bounded_and_gives_its_pages_back(tmp_path: Path) -> None:
    path, clock = tmp_path / "j", _Clock()
    with _opened(path, clock) as file:
        offset, sizes = 1, []
        for n_segments in (20, 20, 20, 120):
            offset = _fill(file, clock, n_segments=n_segments, step_s=1, first_offset=offset, n_octets=60_000)
            before = path.stat().st_size
            _tidy(file, Retention(max_size=1_000_000))
            file._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            sizes.append(path.stat().st_size)
        assert sizes[2] <= 1.1 * sizes[1], "new segments take the place of old ones"
        assert before > 6_000_000
        assert sizes[3] < 1_000_000 + 1.1 * 1024 * 4096, "but for what is spared for new ones"


def test_modes_of_segments_that_are_gone_go_but_for_those_that_a_restart_reads(tmp_path: Path) -> None:
    clock, offset, per_segment = _Clock(), 1, 2500
    with _opened(tmp_path / "j", clock) as file, contextlib.closing(JournalReader(tmp_path / "j")) as reader:
        for number in range(6):
            clock.now_ns += NS_PER_S
            modes = tuple(a_mode_record(sequence=per_segment * number + k, node=k, mode=Mode.S) for k in range(per_segment))
            offset = _commit(file, JournalWrite(records=modes), first_offset=offset)
        _tidy(file, Retention(max_age_ns=1))
        assert file.oldest_offset() == 5 * per_segment + 1
        assert [mode.offset for mode in reader.read_recent_modes(limit=1 << 20)] == list(range(offset - 10_000, offset))


def test_audits_and_silent_biobots_have_ages_of_their_own(tmp_path: Path) -> None:
    clock, offset = _Clock(), 1
    with _opened(tmp_path / "j", clock) as file, contextlib.closing(JournalReader(tmp_path / "j")) as reader:
        for number in range(4):
            clock.now_ns += 100 * NS_PER_S
            entry = AuditEntry(
                wall_ns=clock.now_ns,
                command_id=f"c{number}",
                wire_command=number if number < 2 else None,
                stage="accepted",
                node=NodeId(number),
                train_ms=500,
                request=b"",
                body=b"",
            )
            write = JournalWrite(report=a_report(0, node=number, wall_ns=clock.now_ns), node=(NodeId(number), bytes([number])), audit=entry)
            offset = _commit(file, write, first_offset=offset)
        file.tidy(Retention(audit_age_ns=50 * NS_PER_S, node_age_ns=150 * NS_PER_S), {})
        assert [entry.command_id for entry in reader.read_newest_audit(limit=99)] == ["c3"]
        assert reader.read_last_wire_command() == 1, "the last number on the wire stays"
        assert reader.read_nodes() == [b"\x02", b"\x03"]
        assert [node for node, _, _, _ in reader.read_windows()] == [2, 3]
        assert len(list(reader.read_reports())) == 4


def test_a_pair_is_found_among_others_whatever_their_numbers(tmp_path: Path) -> None:
    """Numbers beyond 16 bits, and octets that look like a pair where none begins."""
    path = tmp_path / "j"
    nodes = [0, 1, 256, 257, 65_535, 65_536, 65_537, (1 << 64) - 1]
    pairs = [(a, b) for a in nodes for b in nodes if a < b]
    with _opened(path) as file:
        offset = 1
        for _ in range(2):
            records = [
                an_encounter_record(sequence=number, node_a=a, node_b=b, t_start_s=1, t_end_s=2) for number, (a, b) in enumerate(pairs)
            ]
            offset = _commit(file, JournalWrite(records=tuple(records)), first_offset=offset)
    with contextlib.closing(JournalReader(path)) as reader:
        for number, (a, b) in enumerate(pairs):
            found = reader.read_pair(node_a=NodeId(a), node_b=NodeId(b), from_wall_ns=0, to_wall_ns=3 * NS_PER_S)
            assert [record.sequence for record in found] == [number, number]
        assert reader.read_pair(node_a=NodeId(2), node_b=NodeId(3), from_wall_ns=0, to_wall_ns=3 * NS_PER_S) == []


def test_encounters_of_a_time_are_those_that_overlap_it(tmp_path: Path) -> None:
    path = tmp_path / "j"
    with _opened(path) as file, contextlib.closing(JournalReader(path)) as reader:
        offset = 1
        for number in range(40):
            record = an_encounter_record(sequence=number, node_a=1, node_b=2 + number % 2, t_start_s=10 * number, t_end_s=10 * number + 5)
            offset = _commit(file, JournalWrite(records=(record,)), first_offset=offset)
        span = {"from_wall_ns": 15 * NS_PER_S, "to_wall_ns": 40 * NS_PER_S}
        found = list(reader.read_encounters(**span))
        assert [record.sequence for record in found] == [1, 2, 3, 4]
        assert all(isinstance(record, EncounterRecord) for record in found)
        assert [one.sequence for one in reader.read_pair(node_a=NodeId(1), node_b=NodeId(3), **span)] == [1, 3]
