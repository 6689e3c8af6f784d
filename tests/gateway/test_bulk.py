"""Bulk decoding: the compiled way and the plain one give the same columns of any stream, in any chunks."""

import shutil
from ctypes import CDLL
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

import hatch_build
from firmware_protocol.envelope import RadioConfirm, RadioReceived, encode_envelope
from firmware_protocol.framing.cobs import encode_frame
from firmware_protocol.message_codec import encode_uplink
from firmware_protocol.messages import EncounterBatch, EncounterBatchWithPaths, EncounterEntry, TimeSyncReply, UplinkHeader
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm, ShortAddress
from gateway.bulk.columns import NO_PATH, NO_SOURCE, OF_ENTRIES, OF_FRAMES, OTHER, UPLINK, Columns
from gateway.bulk.compiled import CompiledDecoder, LibraryMissing, load_library
from gateway.bulk.plain import PlainDecoder
from tests.strategies import uplink_headers, uplinks

ROOT = Path(__file__).parents[2]
HEADER = UplinkHeader(node=NodeId(7), boot=BootId(2), sequence=9, sent_ms=Milliseconds(5000))
ENTRY = EncounterEntry(
    peer=NodeId(8), start_ms=Milliseconds(100), duration_ms=Milliseconds(70_000), rssi_dbm=RssiDbm(-60), is_ongoing=False
)


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> CDLL:
    """Compile afresh, so that the test is of these sources; CC may bring sanitizers."""
    compiler = hatch_build.find_compiler()
    if compiler is None:
        pytest.skip("no C compiler here: install gcc")
    root = tmp_path_factory.mktemp("tree")
    for folder in ("firmware_protocol/c", "gateway/bulk"):
        shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("*.so"))
    hatch_build.compile_library(root, hatch_build.BULK, compiler=compiler)
    return load_library(root / hatch_build.BULK)


def carried(payload: bytes, *, sequence: int = 0) -> bytes:
    """Return a payload as a native dongle hands it up, framed."""
    received = RadioReceived(source=ShortAddress(0x1234), rssi_dbm=RssiDbm(-70), lqi=90, payload=payload)
    return encode_frame(bytes([3, 1, 0, sequence % 256]) + encode_envelope(received))


def merged(parts: list[Columns]) -> dict[str, list[int]]:
    """Join the columns of chunks."""
    joined: dict[str, list[int]] = {name: [] for name in (*OF_FRAMES, *OF_ENTRIES)}
    for part in parts:
        n_before = len(joined["peer"])
        for name, values in joined.items():
            values.extend(value + n_before if name == "entries_end" else value for value in getattr(part, name))
    return joined


streams = st.lists(
    st.builds(lambda header, message: encode_frame(encode_uplink(header, message)), uplink_headers, uplinks)
    | st.builds(lambda header, message: carried(encode_uplink(header, message)), uplink_headers, uplinks)
    | st.binary(min_size=1, max_size=60).map(encode_frame)
    | st.binary(max_size=60).map(carried)
    | st.binary(max_size=10)
    | st.integers(200, 300).map(lambda n: b"\x01" * n)
    | st.just(encode_frame(b"\x03\x01\x00\x00" + encode_envelope(RadioConfirm(handle=1, status=0)))),
    max_size=8,
)


@given(
    streams,
    st.lists(st.tuples(st.integers(0, 3000), st.integers(0, 2), st.integers(0, 255)), max_size=5),
    st.lists(st.integers(0, 3000), max_size=5),
    st.booleans(),
)
def test_compiled_and_plain_say_the_same(
    library: CDLL, pieces: list[bytes], damages: list[tuple[int, int, int]], cuts: list[int], is_bare: bool
) -> None:
    stream = bytearray(b"".join(pieces))
    for at, how, byte in damages:
        place = at % (len(stream) + 1)
        stream[place : place + (how > 0)] = bytes([byte] * (how < 2))
    places = sorted(cut % (len(stream) + 1) for cut in cuts)
    chunks = [bytes(stream[begin:end]) for begin, end in zip([0, *places], [*places, len(stream)], strict=True)]
    compiled, plain = CompiledDecoder(library, is_bare=is_bare), PlainDecoder(is_bare=is_bare)

    whole = merged([PlainDecoder(is_bare=is_bare).feed(bytes(stream))])

    assert merged([compiled.feed(chunk) for chunk in chunks]) == merged([plain.feed(chunk) for chunk in chunks]) == whole


def test_columns_tell_what_the_messages_say(library: CDLL) -> None:
    batch = EncounterBatch(entries=(replace(ENTRY, is_ongoing=True), ENTRY))
    paths = EncounterBatchWithPaths(entries=(replace(ENTRY, path_mm=321),))
    stream = (
        carried(encode_uplink(HEADER, batch))
        + encode_frame(b"\x04\x01\x00\x00")
        + carried(encode_uplink(HEADER, TimeSyncReply(token=1, received_ms=Milliseconds(2))))
        + carried(encode_uplink(HEADER, paths))
    )

    columns = CompiledDecoder(library, is_bare=False).feed(stream)

    assert list(columns.status) == [UPLINK, OTHER, UPLINK, UPLINK]
    assert list(columns.type) == [2, 0, 5, 8]
    assert list(columns.source) == [0x1234, NO_SOURCE, 0x1234, 0x1234]
    assert list(columns.entries_end) == [2, 2, 2, 3]
    assert list(columns.duration_ms) == [70_000] * 3
    assert list(columns.is_ongoing) == [1, 0, 0]
    assert list(columns.path_mm) == [NO_PATH, NO_PATH, 321]


def test_more_frames_than_one_call_takes_come_in_order(library: CDLL) -> None:
    """A call takes 65,536 frames, and no more entries than that and four, of which there are two a frame here."""
    batch = EncounterBatch(entries=(ENTRY, ENTRY))
    n_frames = 70_000
    stream = b"".join(carried(encode_uplink(HEADER, batch), sequence=n) for n in range(256)) * (n_frames // 256 + 1)

    columns = CompiledDecoder(library, is_bare=False).feed(stream)

    n_whole = n_frames // 256 * 256 + 256
    assert len(columns.status) == n_whole
    assert set(columns.status) == {UPLINK}
    assert list(columns.entries_end) == list(range(2, 2 * n_whole + 2, 2))


def test_a_library_of_other_sources_is_not_used(tmp_path: Path) -> None:
    broken = tmp_path / "_bulk.so"
    broken.write_bytes(b"\x7fELF of a copy that was cut short")

    with pytest.raises(LibraryMissing):
        load_library(broken)
