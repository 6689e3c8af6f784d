"""The recording's file, its writer, and the transport that feeds it."""

import asyncio
import io
import logging
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.errors import RecordingError, TransportClosedError
from gateway.recordings.listing import list_recordings
from gateway.recordings.recorder import Recorder, record_to_directory, record_to_file
from gateway.recordings.recording_file import (
    MAX_DATA,
    Damage,
    RecordingHeader,
    encode_header,
    encode_record,
    find_last_wall_ns,
    read_header,
    read_records,
)
from gateway.recordings.replaying import open_recording
from gateway.transports.memory import connected_pair
from gateway.transports.recording import LineRecord, RecordingTransport, RecordKind

HEADER = RecordingHeader(port="tcp:a:1?dialect=native", dialect="native", software="test", wall_ns=1, monotonic_ns=2)

records = st.builds(
    LineRecord,
    kind=st.sampled_from(RecordKind),
    monotonic_ns=st.integers(0, (1 << 64) - 1),
    wall_ns=st.integers(0, (1 << 64) - 1),
    data=st.binary(max_size=80) | st.just(b"\xa7\x5e" * 20),
)


def read_all(data: bytes) -> tuple[list[LineRecord], list[Damage]]:
    found = list(read_records(io.BytesIO(data)))
    return [one for one in found if isinstance(one, LineRecord)], [one for one in found if isinstance(one, Damage)]


@given(st.lists(records, max_size=12))
def test_a_file_gives_back_its_header_and_records(written: list[LineRecord]) -> None:
    stream = io.BytesIO(encode_header(HEADER) + b"".join(map(encode_record, written)))

    assert read_header(stream, name="x") == HEADER
    assert list(read_records(stream)) == written


@given(st.lists(records, min_size=1, max_size=6), st.data())
def test_a_torn_tail_costs_the_last_record_and_is_told(written: list[LineRecord], data: st.DataObject) -> None:
    whole = b"".join(map(encode_record, written))
    last = len(encode_record(written[-1]))
    n_cut = data.draw(st.integers(1, last - 1))

    found, damages = read_all(whole[:-n_cut])

    assert found == written[:-1]
    assert damages == [Damage(offset=len(whole) - last, n_bytes=last - n_cut, is_torn=True)]


@given(st.lists(records, min_size=2, max_size=6), st.data())
def test_damage_costs_the_records_it_touches_alone_and_every_byte_is_accounted_for(written: list[LineRecord], data: st.DataObject) -> None:
    parts = list(map(encode_record, written))
    hit = data.draw(st.integers(0, len(parts) - 1))
    at = data.draw(st.integers(0, len(parts[hit]) - 1))
    flipped = data.draw(st.integers(1, 255))
    spoilt = bytearray(parts[hit])
    spoilt[at] ^= flipped

    found, damages = read_all(b"".join([*parts[:hit], bytes(spoilt), *parts[hit + 1 :]]))

    # A record holds its own checksum, so no other one is lost; one that stood inside the data of the hit one may appear.
    assert [one for one in found if one in written[:hit] + written[hit + 1 :]] == written[:hit] + written[hit + 1 :]
    assert sum(one.n_bytes for one in damages) + sum(len(encode_record(one)) for one in found) == sum(map(len, parts))


@given(st.binary(max_size=300))
def test_no_bytes_raise_and_none_are_lost_sight_of(data: bytes) -> None:
    found, damages = read_all(data)

    assert sum(len(encode_record(one)) for one in found) + sum(one.n_bytes for one in damages) == len(data)


def test_long_data_becomes_several_records_and_loses_nothing() -> None:
    data = bytes(range(256)) * 1000
    found, damages = read_all(encode_record(LineRecord(kind=RecordKind.BYTES_IN, monotonic_ns=5, wall_ns=6, data=data)))

    assert not damages
    assert b"".join(one.data for one in found) == data
    assert max(len(one.data) for one in found) <= MAX_DATA


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"", "nothing"),
        (b"PK\x03\x04 a zip file", "is no recording"),
        (encode_header(HEADER)[:-1], "checksum"),
        (encode_header(HEADER).replace(b"native", b"nativf"), "checksum"),
        (encode_header(RecordingHeader(port="p", dialect="d", software="s", wall_ns=1, monotonic_ns=1, version=9)), "version 9"),
    ],
)
def test_what_is_no_recording_is_told(data: bytes, word: str, tmp_path: Path) -> None:
    path = tmp_path / "x.biorec"
    path.write_bytes(data)

    with pytest.raises(RecordingError, match=word), open_recording(path):
        pass


def a_record(data: bytes, at: int = 0) -> LineRecord:
    return LineRecord(kind=RecordKind.BYTES_IN, monotonic_ns=at, wall_ns=at, data=data)


def test_a_recorder_writes_all_it_took_in_order(tmp_path: Path) -> None:
    written = [a_record(bytes([one % 256]) * 30, one) for one in range(500)]
    recorder = record_to_file(tmp_path / "x.biorec", port="tcp:a:1", dialect="native")
    for one in written:
        recorder.take(one)
    recorder.close()

    with open_recording(tmp_path / "x.biorec") as recording:
        assert recording.header.port == "tcp:a:1"
        assert list(recording.records) == written
    with pytest.raises(RecordingError, match="is there already"):
        record_to_file(tmp_path / "x.biorec", port="tcp:a:1", dialect="native")


def test_the_files_of_a_radio_keep_the_newest_within_their_limit(tmp_path: Path) -> None:
    limit = 20_000
    other = tmp_path / "serial--dev-other-20260101T000000Z-0001.biorec"
    other.write_bytes(bytes(limit))
    for run in range(2):
        recorder = record_to_directory(tmp_path, radio="serial:/dev/x", port="serial:/dev/x", dialect="native", max_bytes=limit)
        for one in range(1000):
            recorder.take(a_record(bytes(30), run * 1000 + one))
        recorder.close()
        assert recorder.fault is None

    files = sorted(tmp_path.glob("serial--dev-x-*.biorec"))
    kept = []
    for file in files:
        with open_recording(file) as recording:
            kept += [one.monotonic_ns for one in recording.records]
            assert not recording.n_damages
    assert 0.5 * limit < sum(file.stat().st_size for file in files) <= limit
    assert kept == list(range(2000 - len(kept), 2000)), "what is left is the newest, without a gap"
    assert other.stat().st_size == limit, "another radio's files are not touched"


def test_a_directory_that_takes_no_more_ends_recording_with_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, logger="gateway"):
        recorder = record_to_directory(tmp_path / "d", radio="r", port="p", dialect="native", max_bytes=40_000)
        (tmp_path / "d").rename(tmp_path / "away")  # at once: the recorder's thread may be making a file in it
        for one in range(200):
            recorder.take(a_record(bytes(1000), one))
        recorder.close()

    assert recorder.fault
    assert [record.getMessage() for record in caplog.records] == ["recording.ended"]


def test_a_full_disk_ends_recording_told_once_and_never_the_line(caplog: pytest.LogCaptureFixture) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("this system has no /dev/full")
    told: list[str] = []
    with caplog.at_level(logging.WARNING, logger="gateway"):
        recorder = Recorder(open_next=lambda: full.open("wb"), port="p", dialect="native", on_fault=told.append)
        for one in range(200):
            recorder.take(a_record(bytes(1000), one))
        recorder.close()
        recorder.take(a_record(b"later"))

    assert told == [recorder.fault]
    assert caplog.records == [], "whoever asked for one file is told, not the log"


def test_a_recording_transport_tells_all_that_passes_and_how_it_ended() -> None:
    async def run() -> list[LineRecord]:
        ours, theirs = connected_pair()
        told: list[LineRecord] = []
        line = RecordingTransport(ours, take=told.append)
        await line.write(b"ask")
        await theirs.write(b"answer")
        assert await line.read() == b"answer"
        await theirs.aclose()
        with pytest.raises(TransportClosedError):
            await line.read()
        await line.aclose()
        return told

    told = asyncio.run(run())

    assert [one.kind.name for one in told] == ["OPENED", "BYTES_OUT", "BYTES_IN", "LOST"]
    assert [one.data for one in told[1:3]] == [b"ask", b"answer"]
    assert sorted(one.monotonic_ns for one in told) == [one.monotonic_ns for one in told]


@given(written=st.lists(records, max_size=6), torn=st.binary(max_size=60))
def test_the_end_of_a_recording_is_its_last_whole_record(written: list[LineRecord], torn: bytes) -> None:
    stream = io.BytesIO(encode_header(HEADER) + b"".join(map(encode_record, written)) + torn)
    found, _ = read_all(stream.getvalue()[len(encode_header(HEADER)) :])
    assert find_last_wall_ns(stream) == (found[-1].wall_ns if found else None)


def test_recordings_are_listed_the_oldest_first_and_what_is_none_is_passed_over(tmp_path: Path) -> None:
    assert list_recordings(None, gateway="base1").is_recording is False
    assert list_recordings(str(tmp_path / "missing"), gateway="base1").recordings == ()
    for name, wall_ns in (("b", 5), ("a", 9)):
        header = RecordingHeader(port="tcp:host:1", dialect="native", software="test", wall_ns=wall_ns, monotonic_ns=0)
        record = LineRecord(kind=RecordKind.BYTES_IN, monotonic_ns=1, wall_ns=wall_ns + 1, data=b"x")
        (tmp_path / f"{name}.biorec").write_bytes(encode_header(header) + encode_record(record))
    (tmp_path / "c.biorec").write_bytes(b"something else")
    (tmp_path / "d.biorec").write_bytes(b"")
    found = list_recordings(str(tmp_path), gateway="base1")
    assert [(entry.name, entry.radio, entry.begin_wall_ns, entry.end_wall_ns) for entry in found.recordings] == [
        ("b.biorec", "tcp:host:1", 5, 6),
        ("a.biorec", "tcp:host:1", 9, 10),
    ]
