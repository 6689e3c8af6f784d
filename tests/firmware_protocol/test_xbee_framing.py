"""Laws of the XBee API framing, in both modes."""

import itertools
import random
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.framing.xbee import MAX_BODY_SIZE, encode_frame, make_decoder

both_modes = pytest.mark.parametrize("is_escaped", [False, True], ids=["AP=1", "AP=2"])

BODIES = st.binary(min_size=1, max_size=MAX_BODY_SIZE) | st.lists(
    st.sampled_from([0x7E, 0x7D, 0x11, 0x13, 0x5E, 0x5D, 0x31, 0x33, 0]), min_size=1, max_size=40
).map(bytes)
HOSTILE = st.lists(
    st.sampled_from([0x7E, 0x7D, 0x11, 0x13, 0x5E, 0x5D, 0x31, 0x33, 0x00, 0x01, 0x02, 0x03, 0xFF, 0xFC]) | st.integers(0, 255),
    max_size=120,
).map(bytes)


def chunks(stream: bytes, cuts: list[int]) -> Iterator[bytes]:
    places = sorted({0, len(stream), *(cut % (len(stream) + 1) for cut in cuts)})
    for begin, end in itertools.pairwise(places):
        yield stream[begin:end]


def decode(stream: bytes, cuts: list[int], *, is_escaped: bool) -> list[bytes | FrameFault]:
    decoder = make_decoder(is_escaped=is_escaped)
    return [result for chunk in chunks(stream, cuts) for result in decoder.feed(chunk)]


@both_modes
@given(bodies=st.lists(BODIES, max_size=8), cuts=st.lists(st.integers(0, 4000), max_size=20))
def test_what_was_encoded_comes_out_however_the_stream_is_cut(is_escaped: bool, bodies: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(encode_frame(body, is_escaped=is_escaped) for body in bodies)
    assert decode(stream, cuts, is_escaped=is_escaped) == bodies


@both_modes
@given(
    pieces=st.lists(HOSTILE | BODIES.map(lambda body: encode_frame(body, is_escaped=True)), max_size=6), cuts=st.lists(st.integers(0, 999))
)
def test_chunking_never_changes_what_comes_out_of_any_bytes(is_escaped: bool, pieces: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(pieces)
    whole = decode(stream, [], is_escaped=is_escaped)
    assert decode(stream, cuts, is_escaped=is_escaped) == whole
    assert decode(stream, list(range(len(stream))), is_escaped=is_escaped) == whole


def by_hand_escaped(stream: bytes) -> list[bytes]:
    """The bodies in a stream of mode 2, byte by byte as the user guide tells it."""
    bodies: list[bytes] = []
    for piece in stream.split(b"\x7e")[1:]:
        plain, is_escape = bytearray(), False
        for byte in piece:
            if is_escape and byte ^ 0x20 not in {0x7E, 0x7D, 0x11, 0x13}:
                break
            if is_escape or byte != 0x7D:
                plain.append(byte ^ 0x20 if is_escape else byte)
                is_escape = False
            else:
                is_escape = True
            if len(plain) >= 3:
                length = plain[0] << 8 | plain[1]
                if not 1 <= length <= MAX_BODY_SIZE:
                    break
                if len(plain) == length + 3:
                    if sum(plain[2:]) % 256 == 0xFF:
                        bodies.append(bytes(plain[2:-1]))
                    break
    return bodies


@given(pieces=st.lists(HOSTILE | BODIES.map(lambda body: encode_frame(body, is_escaped=True)), max_size=6))
def test_mode_2_agrees_with_a_decoder_that_goes_byte_by_byte(pieces: list[bytes]) -> None:
    stream = b"".join(pieces)
    assert [one for one in decode(stream, [], is_escaped=True) if isinstance(one, bytes)] == by_hand_escaped(stream)


def by_hand_plain(stream: bytes) -> list[bytes]:
    """The bodies in a stream of mode 1: every byte that is not inside a sound frame is tried as the start of one."""
    bodies: list[bytes] = []
    at = 0
    while at + 4 <= len(stream):
        length = int.from_bytes(stream[at + 1 : at + 3], "big")
        end = at + length + 4
        if stream[at] != 0x7E or not 1 <= length <= MAX_BODY_SIZE:
            at += 1
        elif end > len(stream):
            break  # more has to come before anything behind can be believed
        elif sum(stream[at + 3 : end]) % 256 == 0xFF:
            bodies.append(stream[at + 3 : end - 1])
            at = end
        else:
            at += 1
    return bodies


@given(pieces=st.lists(HOSTILE | BODIES.map(lambda body: encode_frame(body, is_escaped=False)), max_size=6))
def test_mode_1_agrees_with_a_decoder_that_tries_every_byte(pieces: list[bytes]) -> None:
    stream = b"".join(pieces)
    assert [one for one in decode(stream, [], is_escaped=False) if isinstance(one, bytes)] == by_hand_plain(stream)


def damage(frame: bytes, kind: str, rng: random.Random) -> bytes:
    at = rng.randrange(len(frame))
    match kind:
        case "flip":
            return frame[:at] + bytes([frame[at] ^ 1 << rng.randrange(8)]) + frame[at + 1 :]
        case "drop":
            return frame[:at] + frame[at + 1 :]
        case "insert":
            return frame[:at] + rng.randbytes(1) + frame[at:]
        case _:
            return frame[:at]


@both_modes
@pytest.mark.parametrize("kind", ["flip", "drop", "insert", "truncate"])
def test_of_4000_frames_with_2_percent_damaged_at_most_4_intact_ones_are_lost(is_escaped: bool, kind: str) -> None:
    rng = random.Random(5)
    stream, intact = bytearray(), set()
    for number in range(4000):
        body = b"\x90" + number.to_bytes(4, "big") + rng.randbytes(32)
        frame = encode_frame(body, is_escaped=is_escaped)
        if rng.random() < 0.02:
            stream += damage(frame, kind, rng)
        else:
            stream += frame
            intact.add(body)
    decoder = make_decoder(is_escaped=is_escaped)
    came = {one for at in range(0, len(stream), 64) for one in decoder.feed(bytes(stream[at : at + 64])) if isinstance(one, bytes)}
    assert len(intact - came) <= 4


@both_modes
def test_a_claim_to_be_longer_than_any_frame_holds_nothing_up(is_escaped: bool) -> None:
    decoder = make_decoder(is_escaped=is_escaped)
    assert decoder.feed(b"\x7e\xff\xff") == [FrameFault.TOO_LONG]
    assert decoder.feed(encode_frame(b"next", is_escaped=is_escaped)) == [b"next"]


def test_a_mode_2_frame_that_is_cut_off_ends_with_the_next_start_byte() -> None:
    decoder = make_decoder(is_escaped=True)
    cut = encode_frame(bytes(200), is_escaped=True)[:50]
    assert decoder.feed(cut + encode_frame(b"next", is_escaped=True)) == [FrameFault.TOO_SHORT, b"next"]
    assert decoder.feed(b"\x7e\x00\x02\x41\x7d\x7e\x00\x02\x41\x7d\x41") == [FrameFault.BAD_STUFFING, FrameFault.BAD_STUFFING]


@both_modes
def test_noise_between_frames_is_one_fault_and_costs_no_frame(is_escaped: bool) -> None:
    frame = encode_frame(b"body", is_escaped=is_escaped)
    assert decode(b"no" + frame + b"ise" + frame, [1, 12, 13], is_escaped=is_escaped) == [
        FrameFault.NOISE,
        b"body",
        FrameFault.NOISE,
        b"body",
    ]


@both_modes
def test_a_body_of_no_length_or_too_long_is_refused(is_escaped: bool) -> None:
    for size in (0, MAX_BODY_SIZE + 1):
        with pytest.raises(EncodeError, match=str(size)):
            encode_frame(bytes(size), is_escaped=is_escaped)


@both_modes
@given(stream=st.binary(max_size=5000))
def test_the_memory_of_a_decoder_is_bounded(is_escaped: bool, stream: bytes) -> None:
    decoder = make_decoder(is_escaped=is_escaped)
    for at in range(0, len(stream), 97):
        decoder.feed(stream[at : at + 97])
        held = getattr(decoder, "_piece" if is_escaped else "_rest")
        assert len(held) <= (2 if is_escaped else 1) * (MAX_BODY_SIZE + 3)
