"""Native framing: stuffing, checksum, resynchronisation."""

import re
from pathlib import Path

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

import firmware_protocol
from firmware_protocol.crc import append_crc, crc16, strip_crc
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.cobs import (
    MAX_BODY_SIZE,
    MAX_ENCODED_SIZE,
    CobsDecoder,
    encode_frame,
)
from firmware_protocol.framing.interface import FrameFault
from tests.strategies import frame_bodies

GOLDEN = [  # the examples of the COBS paper's encoding table, worked by hand
    (b"", b"\x01"),
    (b"\x00", b"\x01\x01"),
    (b"\x00\x00", b"\x01\x01\x01"),
    (b"\x11\x22\x00\x33", b"\x03\x11\x22\x02\x33"),
    (b"\x11\x00\x00\x00", b"\x02\x11\x01\x01\x01"),
    (bytes(range(1, 255)), b"\xff" + bytes(range(1, 255)) + b"\x01"),
]


def cobs_encode(data: bytes) -> bytes:
    """Stuff plainly, by the paper [CB99]."""
    out = bytearray()
    for part in data.split(b"\x00"):
        rest = part
        while len(rest) >= 254:
            out += b"\xff" + rest[:254]
            rest = rest[254:]
        out += bytes([len(rest) + 1]) + rest
    return bytes(out)


def cobs_decode(data: bytes) -> bytes | None:
    """Undo it plainly; None where ``data`` is no such thing."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        end = at + code
        if code == 0 or end > len(data):
            return None
        out += data[at + 1 : end]
        if code <= 254 and end < len(data):
            out.append(0)
        at = end
    return None if 0 in data else bytes(out)


def decode_plainly(stream: bytes) -> list[bytes | FrameFault]:
    """Cut a whole stream at its zeros, one byte after the other."""
    results: list[bytes | FrameFault] = []
    run = bytearray()
    for byte in stream:
        if byte:
            run.append(byte)
            if len(run) == MAX_ENCODED_SIZE + 1:
                results.append(FrameFault.TOO_LONG)
            continue
        if 0 < len(run) <= MAX_ENCODED_SIZE:
            stuffed = cobs_decode(bytes(run))
            if stuffed is None:
                results.append(FrameFault.BAD_STUFFING)
            elif len(stuffed) < 3:
                results.append(FrameFault.TOO_SHORT)
            else:
                results.append(strip_crc(stuffed) or FrameFault.BAD_CRC)
        run.clear()
    return results


def test_the_checksum_has_its_published_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1


@given(st.binary())
def test_stripping_inverts_appending(data: bytes) -> None:
    assert strip_crc(append_crc(data)) == data


@given(st.binary(min_size=1), st.data())
def test_a_single_bit_error_never_passes_the_checksum(data: bytes, draw: st.DataObject) -> None:
    checked = bytearray(append_crc(data))
    bit = draw.draw(st.integers(0, 8 * len(checked) - 1))
    checked[bit // 8] ^= 1 << bit % 8

    assert strip_crc(bytes(checked)) is None


@pytest.mark.parametrize(("plain", "stuffed"), GOLDEN)
def test_golden_stuffing(plain: bytes, stuffed: bytes) -> None:
    assert cobs_decode(cobs_encode(plain)) == plain
    if len(plain) < 254:
        assert cobs_encode(plain) == stuffed
    assert cobs_decode(stuffed) == plain


@given(st.binary(max_size=1000))
def test_unstuffing_inverts_stuffing_and_leaves_no_zero(data: bytes) -> None:
    stuffed = cobs.encode(data)

    assert 0 not in stuffed
    assert cobs.decode(stuffed) == cobs_decode(stuffed) == cobs_decode(cobs_encode(data)) == data


@given(st.binary(max_size=260) | st.lists(st.integers(0, 6), max_size=260).map(bytes))
def test_the_package_and_the_plain_decoder_agree_on_what_is_stuffing(data: bytes) -> None:
    plain = cobs_decode(data)

    if plain is None:
        with pytest.raises(cobs.DecodeError):
            cobs.decode(data)
    else:
        assert cobs.decode(data) == plain


@given(st.lists(frame_bodies.map(encode_frame) | st.binary(max_size=300) | st.just(b"\x01" * 254), max_size=6), st.data())
def test_any_stream_in_any_chunks_gives_what_the_plain_decoder_says(pieces: list[bytes], draw: st.DataObject) -> None:
    stream = b"".join(pieces)
    cuts = sorted(draw.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    decoder = CobsDecoder()

    results = [one for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True) for one in decoder.feed(stream[start:end])]

    assert results == decode_plainly(stream)


def test_the_example_of_the_wire_format_is_true() -> None:
    text = (Path(firmware_protocol.__file__).parent / "WIRE_FORMAT.md").read_text()
    match = re.search(r"body `([0-9A-F ]+)` has the CRC 0x([0-9A-F]{4}) and goes as `([0-9A-F ]+)`", text)

    assert match
    body = bytes.fromhex(match[1])
    assert crc16(body) == int(match[2], 16)
    assert encode_frame(body) == bytes.fromhex(match[3])


@given(st.lists(frame_bodies, max_size=8), st.data())
def test_chunking_never_changes_the_frames(bodies: list[bytes], draw: st.DataObject) -> None:
    stream = b"".join(encode_frame(body) for body in bodies)
    cuts = sorted(draw.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    decoder = CobsDecoder()

    results = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        results += decoder.feed(stream[start:end])

    assert results == bodies


@given(frame_bodies, st.binary(max_size=300), frame_bodies)
def test_noise_costs_at_most_the_frame_it_touches(before: bytes, noise: bytes, after: bytes) -> None:
    results = CobsDecoder().feed(encode_frame(before) + noise + encode_frame(after))

    assert results[0] == before
    assert results[-1] == after


@given(st.lists(st.binary(max_size=400), max_size=20))
def test_no_input_crashes_the_decoder_or_grows_its_buffer(chunks: list[bytes]) -> None:
    decoder = CobsDecoder()
    for chunk in chunks:
        decoder.feed(chunk)
        assert len(decoder._buffer) <= MAX_ENCODED_SIZE


def test_each_fault_is_named() -> None:
    good = encode_frame(b"abc")
    bad_crc = good.replace(b"b", b"x")

    assert CobsDecoder().feed(bad_crc) == [FrameFault.BAD_CRC]
    assert CobsDecoder().feed(b"\x05ab\x00") == [FrameFault.BAD_STUFFING]
    assert CobsDecoder().feed(b"\x02a\x00") == [FrameFault.TOO_SHORT]
    assert CobsDecoder().feed(b"\x01" * 300 + b"\x00" + good) == [FrameFault.TOO_LONG, b"abc"]


@pytest.mark.parametrize("size", [0, MAX_BODY_SIZE + 1])
def test_a_body_that_does_not_fit_is_refused(size: int) -> None:
    with pytest.raises(EncodeError, match=str(size)):
        encode_frame(bytes(size))
