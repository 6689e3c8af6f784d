"""Captures for Wireshark: the file's structure, and what tshark makes of it with and without our dissector."""

import io
import shutil
import struct
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.envelope import CoordinatorHello, RadioReceived, RadioSend, encode_envelope
from firmware_protocol.framing.can import encode_message
from firmware_protocol.framing.can_frame import Direction
from firmware_protocol.framing.cobs import encode_frame
from firmware_protocol.layouts import DOWNLINK_LAYOUTS, UPLINK_LAYOUTS
from firmware_protocol.message_codec import decode_downlink, decode_uplink
from firmware_protocol.messages import MessageFault
from firmware_protocol.units import RssiDbm, ShortAddress
from gateway.__main__ import main
from gateway.commands.outcome import DONE, FAILED
from gateway.recordings.capture import Capture
from gateway.recordings.dialects import make_line_dissector
from gateway.recordings.pcapng import PcapngWriter
from gateway.recordings.recorder import record_to_file
from gateway.recordings.wireshark import make_lua_dissector
from gateway.transports.recording import LineRecord, RecordKind
from tests.gateway.wire_samples import DOWNLINK_SAMPLES, UPLINK_SAMPLES

_NS = 1_700_000_000_000_000_000
_PAN, _CHANNEL = 0xBEEF, 21

needs_tshark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed (make system-packages)")


def link_frame(envelope: bytes, sequence: int) -> bytes:
    return encode_frame(struct.pack("<BHB", 3, 0x1234, sequence % 256) + envelope)


def sample_records() -> list[LineRecord]:
    """The dongle says who it is, every message passes once, one with a wrong CRC, and a damaged frame."""
    hello = CoordinatorHello(firmware=1, eui64=0xC0, pan_id=_PAN, channel=_CHANNEL, max_radio_payload=57)
    frames = [(RecordKind.BYTES_IN, encode_envelope(hello))]
    for payload in (*UPLINK_SAMPLES, UPLINK_SAMPLES[0][:-1] + b"\x00"):
        received = RadioReceived(source=ShortAddress(0x1003), rssi_dbm=RssiDbm(-61), lqi=180, payload=payload)
        frames.append((RecordKind.BYTES_IN, encode_envelope(received)))
    frames += [
        (RecordKind.BYTES_OUT, encode_envelope(RadioSend(handle=7, destination=ShortAddress(0x1003), payload=payload)))
        for payload in DOWNLINK_SAMPLES
    ]
    records = [LineRecord(kind=RecordKind.OPENED, monotonic_ns=0, wall_ns=_NS, data=b"x")]
    records += [
        LineRecord(kind=kind, monotonic_ns=one, wall_ns=_NS + one * 1_000_000, data=link_frame(envelope, one))
        for one, (kind, envelope) in enumerate(frames)
    ]
    spoilt = bytearray(link_frame(b"\x10", 0))
    spoilt[4] ^= 1
    return [*records, LineRecord(kind=RecordKind.BYTES_IN, monotonic_ns=99, wall_ns=_NS + 10**9, data=bytes(spoilt))]


def link_bodies(payloads: list[bytes]) -> list[bytes]:
    """Link frames that carry the payloads up."""
    received = [RadioReceived(source=ShortAddress(0x1003), rssi_dbm=RssiDbm(-61), lqi=180, payload=one) for one in payloads]
    return [struct.pack("<BHB", 3, 0x1234, number) + encode_envelope(one) for number, one in enumerate(received)]


def write_capture(records: list[LineRecord], *, dialect: str = "native") -> bytes:
    stream = io.BytesIO()
    writer = PcapngWriter(stream, comment="a comment", software="test")
    capture = Capture(make_line_dissector(dialect, path="x"), writer, port="tcp:a:1", dialect=dialect)
    for record in records:
        capture.take(record)
    return stream.getvalue()


def blocks_of(data: bytes) -> list[tuple[int, bytes]]:
    """The blocks of a pcapng file; each must have its length at both ends and be a multiple of 4."""
    blocks = []
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from("<II", data, at)
        assert size % 4 == 0
        assert struct.unpack_from("<I", data, at + size - 4) == (size,)
        blocks.append((kind, data[at + 8 : at + size - 4]))
        at += size
    return blocks


def tshark(path: Path, *arguments: str) -> list[str]:
    result = subprocess.run(["tshark", "-r", str(path), *arguments], capture_output=True, text=True, check=False, timeout=60)
    assert result.returncode == 0, result.stderr
    assert "rror" not in result.stderr, result.stderr
    return result.stdout.splitlines()


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    path = tmp_path / "x.pcapng"
    path.write_bytes(write_capture(sample_records()))
    (tmp_path / "biobot.lua").write_text(make_lua_dissector())
    return path


def test_the_samples_hold_every_message_of_the_wire_format() -> None:
    ups, downs = [decode_uplink(one) for one in UPLINK_SAMPLES], [decode_downlink(one) for one in DOWNLINK_SAMPLES]

    assert {type(one[1]).__name__ for one in ups if not isinstance(one, MessageFault)} == {one.name for one in UPLINK_LAYOUTS}
    assert {type(one[1]).__name__ for one in downs if not isinstance(one, MessageFault)} == {one.name for one in DOWNLINK_LAYOUTS}


def test_a_capture_is_sound_pcapng_with_each_frame_as_it_stood_on_the_line() -> None:
    records = sample_records()
    blocks = blocks_of(write_capture(records))
    packets = [(struct.unpack_from("<IIII", body), body) for kind, body in blocks if kind == 6]
    on_line = [body[20 : 20 + head[3]] for head, body in packets if head[0] == 1]

    assert [kind for kind, _ in blocks[:3]] == [0x0A0D0D0A, 1, 1]
    assert [struct.unpack_from("<H", body)[0] for kind, body in blocks if kind == 1] == [283, 147]
    assert b"".join(on_line) == b"".join(one.data for one in records if one.kind in {RecordKind.BYTES_IN, RecordKind.BYTES_OUT})
    assert len(packets) == len(on_line) + len(UPLINK_SAMPLES) + 1 + len(DOWNLINK_SAMPLES)


@needs_tshark
def test_wireshark_opens_it_without_complaint_and_shows_signal_and_network(capture: Path) -> None:
    rows = tshark(
        capture,
        *("-Y", "wpan", "-T", "fields", "-e", "wpan-tap.rss", "-e", "wpan-tap.lqi", "-e", "wpan-tap.ch_num", "-e", "wpan.src16"),
        *("-e", "wpan.dst16", "-e", "wpan.dst_pan"),
    )
    up, down = rows[0].split("\t"), rows[-1].split("\t")

    # RSSI [dBm], LQI, channel, source, destination, PAN; of what goes down there is no RSSI and no LQI.
    assert [float(up[0]), int(up[1], 0), int(up[2], 0), *(int(one, 0) for one in up[3:])] == [-61.0, 180, _CHANNEL, 0x1003, 0, _PAN]
    assert down[:2] == ["", ""]
    assert [int(one, 0) for one in down[3:]] == [0, 0x1003, _PAN]
    assert tshark(capture, "-Y", "_ws.malformed") == []
    assert tshark(capture, "-Y", 'frame.comment contains "fault: frame.bad_crc"', "-T", "fields", "-e", "frame.number")
    assert len(tshark(capture, "-Y", 'frame.comment contains "message.bad_crc" and wpan')) == 1


@needs_tshark
def test_the_dissector_shows_every_message_by_name_with_its_fields(capture: Path) -> None:
    lua = ("-X", f"lua_script:{capture.with_name('biobot.lua')}")
    seen = Counter(tshark(capture, *lua, "-Y", "biobot.type", "-T", "fields", "-e", "biobot.type"))
    names = tshark(capture, *lua, "-Y", "wpan and biobot.type", "-T", "fields", "-e", "_ws.col.Info")

    # Once in the radio frame and once in the frame on the line.
    assert seen == {str(one.kind): 2 for one in (*UPLINK_LAYOUTS, *DOWNLINK_LAYOUTS)}
    assert sorted({name.split(" ")[0] for name in names}) == sorted(one.name for one in (*UPLINK_LAYOUTS, *DOWNLINK_LAYOUTS))
    assert len(tshark(capture, *lua, "-Y", "_ws.malformed")) == 1, "the payload with a wrong CRC, on the line"
    (row,) = tshark(
        capture,
        *lua,
        *("-Y", "wpan and biobot.type == 2", "-T", "fields", "-e", "biobot.node", "-e", "biobot.encounterbatch.peer"),
        *("-e", "biobot.encounter_duration_ms", "-e", "biobot.encounterbatch.rssi_dbm"),
    )
    assert row.split("\t") == ["3", "4,5", "70000,900", "-60,-61"]


@needs_tshark
@pytest.mark.parametrize("is_fd", [False, True])
def test_a_can_line_is_captured_frame_by_frame_and_what_the_frames_carry_besides(is_fd: bool, tmp_path: Path) -> None:
    lines = [encode_message(body, unit=3, direction=Direction.FROM_COORDINATOR, is_fd=is_fd) for body in link_bodies(UPLINK_SAMPLES)]
    records = [LineRecord(kind=RecordKind.BYTES_IN, monotonic_ns=0, wall_ns=_NS + one, data=line) for one, line in enumerate(lines)]
    path = tmp_path / "can.pcapng"
    path.write_bytes(write_capture(records, dialect="can:3"))
    n_frames = sum(map(len, lines)) // (72 if is_fd else 16)

    assert len(tshark(path, "-Y", "canfd" if is_fd else "can")) == n_frames
    assert len(tshark(path, "-Y", "wpan")) == len(UPLINK_SAMPLES)
    assert {int(one, 0) >> 21 & 31 for one in tshark(path, "-Y", "not wpan", "-T", "fields", "-e", "can.id")} == {3}
    assert tshark(path, "-Y", 'frame.comment contains "fault"') == []


@needs_tshark
def test_the_command_writes_what_wireshark_opens(tmp_path: Path) -> None:
    from gateway.__main__ import main  # noqa: PLC0415  # the command as a user calls it

    recorder = record_to_file(tmp_path / "x.biorec", port="tcp:a:1", dialect="native")
    for record in sample_records():
        recorder.take(record)
    recorder.close()
    out, lua = tmp_path / "x.pcapng", tmp_path / "biobot.lua"

    assert main(["pcap", str(tmp_path / "x.biorec"), str(out), "--dissector", str(lua)]) == DONE
    assert lua.read_text() == make_lua_dissector()
    assert len(tshark(out)) == len([kind for kind, _ in blocks_of(out.read_bytes()) if kind == 6])
    assert main(["pcap", str(out)]) == 2


def test_the_dissector_has_every_field_of_every_layout() -> None:
    lua = make_lua_dissector()
    for layout in (*UPLINK_LAYOUTS, *DOWNLINK_LAYOUTS):
        line = next(one for one in lua.splitlines() if one.startswith(f"  [{layout.kind}] = "))
        for one in (*layout.fields, *layout.entry):
            assert f'name = "{one.name}", code = "{one.code}"' in line


def test_a_host_and_the_dissector_know_the_same_handles() -> None:
    """What our own host writes is read from beside the line as what it was told to send."""
    host = NativeHost()
    host.open(session=1, now_ns=0)
    host.feed(encode_frame(struct.pack("<BHB", 2, 1, 0)), now_ns=0)
    host.take_frames()
    host.send(destination=ShortAddress(0x1003), payload=DOWNLINK_SAMPLES[0], now_ns=0)
    dissector = make_line_dissector("native", path="x")
    found = [one for frame in host.take_frames() for one in dissector.feed(frame, is_outgoing=True)]

    assert [one.payload.data for one in found if one.payload is not None] == [DOWNLINK_SAMPLES[0]]


def a_recording(path: Path) -> Path:
    recorder = record_to_file(path, port="tcp:a:1", dialect="native")
    for record in sample_records():
        recorder.take(record)
    recorder.close()
    return path


def test_a_capture_is_never_written_over_a_file_that_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, other = a_recording(tmp_path / "one.biorec"), a_recording(tmp_path / "other.biorec")
    earlier = tmp_path / "earlier.pcapng"
    earlier.write_bytes(b"somebody's")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    for source, out in ((one, one), (one, other), (one, earlier), (tmp_path / "missing", earlier), (earlier, tmp_path / "new")):
        assert main(["pcap", str(source), str(out)]) == FAILED
    assert main(["pcap", "--port", "tcp:127.0.0.1:1", str(earlier)]) == FAILED
    assert main(["pcap", "--dissector", str(one)]) == FAILED

    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert capsys.readouterr().err.count("is there already; name another file") == 5


def test_a_capture_that_could_not_begin_leaves_no_file_in_the_way_of_the_next_try(tmp_path: Path) -> None:
    out = tmp_path / "x.pcapng"

    assert main(["pcap", "--port", "tcp:127.0.0.1:1", str(out)]) == FAILED
    assert not out.exists()
    assert main(["pcap", str(a_recording(tmp_path / "x.biorec")), str(out)]) == DONE
    assert out.read_bytes()[:4] == b"\x0a\x0d\x0d\x0a"


def test_a_dissector_may_be_written_over_an_earlier_one(tmp_path: Path) -> None:
    path = tmp_path / "biobot.lua"

    assert [main(["pcap", "--dissector", str(path)]) for _ in range(2)] == [DONE, DONE]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_disk_ends_a_capture_with_a_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pcap", str(a_recording(tmp_path / "x.biorec")), "/dev/full"]) == FAILED
    assert "capture /dev/full: is cut short: No space left on device; make room" in capsys.readouterr().err
