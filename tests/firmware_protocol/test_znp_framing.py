"""MT framing: golden frames, chunking, damage."""

import random
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.framing.znp import MAX_BODY_SIZE, MAX_FRAME_SIZE, ZnpDecoder, encode_frame, exclusive_or

GOLDEN = [  # SYS_PING as SWRA198 lays it out; the others as chips send and hosts log them
    ("2101", "FE00210120"),
    ("61015906", "FE02610159063D"),
    ("4180020200020603", "FE064180020200020603C0"),
    ("45C009", "FE0145C0098D"),
    ("448000B107", "FE03448000B10771"),
]
PING = bytes.fromhex("FE00210120")

bodies = st.builds(lambda kind, rest: bytes((kind,)) + rest, st.integers(0x20, 0x7F), st.binary(min_size=1, max_size=MAX_BODY_SIZE - 1))


@pytest.mark.parametrize(("body", "frame"), GOLDEN)
def test_golden_frames(body: str, frame: str) -> None:
    assert encode_frame(bytes.fromhex(body)) == bytes.fromhex(frame)
    assert ZnpDecoder().feed(bytes.fromhex(frame)) == [bytes.fromhex(body)]


@given(st.binary(max_size=MAX_FRAME_SIZE))
def test_the_checksum_is_the_exclusive_or_of_all_bytes(data: bytes) -> None:
    expected = 0
    for byte in data:
        expected ^= byte
    assert exclusive_or(data) == expected


@given(bodies, st.integers(1, 255), st.data())
def test_a_single_damaged_byte_never_passes_the_checksum(body: bytes, flip: int, draw: st.DataObject) -> None:
    damaged = bytearray(encode_frame(body))
    damaged[draw.draw(st.integers(2, len(damaged) - 1))] ^= flip
    assert body not in ZnpDecoder().feed(bytes(damaged))


@given(st.lists(bodies | st.binary(min_size=1, max_size=40), max_size=8), st.data())
def test_chunking_never_changes_bodies_and_faults(parts: list[bytes], draw: st.DataObject) -> None:
    stream = b"".join(encode_frame(part) if len(part) > 1 and 0x20 <= part[0] < 0x80 else part for part in parts)
    cuts = sorted(draw.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    decoder = ZnpDecoder()
    results = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        results += decoder.feed(stream[start:end])
    whole = ZnpDecoder()
    assert results == whole.feed(stream)
    assert decoder.resynchronise() == whole.resynchronise()


@given(st.lists(bodies, max_size=8))
def test_decoding_inverts_encoding(sent: list[bytes]) -> None:
    assert ZnpDecoder().feed(b"".join(map(encode_frame, sent))) == sent


@given(bodies, st.binary(max_size=300), bodies)
def test_noise_costs_at_most_what_it_touches(before: bytes, noise: bytes, after: bytes) -> None:
    """Noise may claim to be a frame of 250 bytes and more to come; silence shows that it was none."""
    decoder = ZnpDecoder()
    results = decoder.feed(encode_frame(before) + noise.replace(b"\xfe", b"\xfd") + encode_frame(after))
    assert results[0] == before
    assert results[-1] == after


def obvious(stream: bytes) -> list[bytes]:
    """Try every place in turn, with the whole stream at hand."""
    found, at = [], 0
    while at < len(stream):
        end = at + stream[at + 1] + 5 if at + 1 < len(stream) else len(stream) + 1
        body = stream[at + 2 : end - 1]
        is_frame = stream[at] == 0xFE and end <= len(stream) and 2 <= len(body) <= MAX_BODY_SIZE and 0x20 <= body[0] < 0x80
        if is_frame and not exclusive_or(stream[at + 1 : end]):
            found.append(body)
            at = end
        else:
            at += 1
    return found


@given(st.lists(st.tuples(bodies, st.integers(0, 12), st.binary(max_size=5)), max_size=6), st.integers(1, 300))
def test_the_decoder_agrees_with_the_obvious_one_once_the_line_is_silent(parts: list[tuple[bytes, int, bytes]], chunk: int) -> None:
    """Frames that lost their ends, or have noise behind them."""
    stream = b"".join(encode_frame(body)[: -n_lost or None] + noise for body, n_lost, noise in parts)
    decoder = ZnpDecoder()
    results = [one for at in range(0, len(stream), chunk) for one in decoder.feed(stream[at : at + chunk])] + decoder.resynchronise()
    assert [one for one in results if isinstance(one, bytes)] == obvious(stream)


@given(st.lists(st.binary(max_size=400), max_size=20))
def test_no_input_crashes_the_decoder_or_grows_its_buffer(chunks: list[bytes]) -> None:
    decoder = ZnpDecoder()
    for chunk in chunks:
        decoder.feed(chunk)
        assert len(decoder._rest) < MAX_FRAME_SIZE
    decoder.resynchronise()
    assert not decoder._rest


def test_each_fault_is_named_once_a_run() -> None:
    assert ZnpDecoder().feed(b"abc" + PING) == [FrameFault.NOISE, b"\x21\x01"]
    assert ZnpDecoder().feed(b"\xfe\x00\x21\x01\x21" + PING) == [FrameFault.BAD_CRC, b"\x21\x01"]
    assert ZnpDecoder().feed(b"\xfe\xfb\x21" + PING) == [FrameFault.TOO_LONG, b"\x21\x01"]
    assert ZnpDecoder().feed(b"\xfe\x00\x01\x01" + PING) == [FrameFault.NOISE, b"\x21\x01"]
    decoder = ZnpDecoder()
    assert decoder.feed(b"\xfe\x40\x21\x01" + PING) == []
    assert decoder.resynchronise() == [FrameFault.TOO_SHORT, b"\x21\x01"]


@pytest.mark.parametrize("body", [b"", b"\x21", bytes([0x21]) + bytes(MAX_BODY_SIZE), b"\x01\x00", b"\x80\x00"])
def test_a_body_that_no_line_carries_is_refused(body: bytes) -> None:
    with pytest.raises(EncodeError):
        encode_frame(body)


def _flip(frame: bytearray, rng: random.Random) -> None:
    frame[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)


def _drop(frame: bytearray, rng: random.Random) -> None:
    del frame[rng.randrange(len(frame))]


def _insert(frame: bytearray, rng: random.Random) -> None:
    frame.insert(rng.randrange(len(frame)), rng.randrange(256))


def _truncate(frame: bytearray, rng: random.Random) -> None:
    del frame[rng.randrange(1, len(frame)) :]


@pytest.mark.parametrize("damage", [_flip, _drop, _insert, _truncate])
def test_damage_to_2_percent_of_4000_frames_costs_at_most_4_intact_ones(damage: Callable[[bytearray, random.Random], None]) -> None:
    """Each frame carries its number; 64 bytes at a time, as a driver hands them over."""
    rng = random.Random(20)
    stream = bytearray()
    intact = set()
    for number in range(4000):
        body = b"\x44\x81" + number.to_bytes(4, "little") + rng.randbytes(40)
        frame = bytearray(encode_frame(body))
        if rng.random() < 0.02:
            damage(frame, rng)
        else:
            intact.add(body)
        stream += frame
    decoder = ZnpDecoder()
    came = [one for at in range(0, len(stream), 64) for one in decoder.feed(bytes(stream[at : at + 64]))] + decoder.resynchronise()
    assert len(intact) > 3_800
    assert len(intact - {one for one in came if isinstance(one, bytes)}) <= 4
