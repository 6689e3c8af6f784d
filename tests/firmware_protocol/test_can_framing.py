"""CAN framing: identifiers, records, parts, resynchronisation (WIRE_FORMAT.md §10)."""

import itertools
import random
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import firmware_protocol
from firmware_protocol.crc import crc6
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.can import MAX_LINK_PAYLOAD, CanDecoder, encode_message, priority_of
from firmware_protocol.framing.can_frame import (
    CLASSIC_RECORD,
    FD_RECORD,
    FD_SIZES,
    CanFrame,
    Direction,
    RecordReader,
    configuration_id,
    encode_record,
    is_sound,
    make_frame,
)
from firmware_protocol.framing.interface import FrameFault

UP, DOWN = Direction.FROM_COORDINATOR, Direction.TO_COORDINATOR

bodies = st.builds(
    lambda kind, session, sequence, payload: bytes([kind]) + session + bytes([sequence]) + payload,
    st.integers(1, 6),
    st.binary(min_size=2, max_size=2),
    st.integers(0, 255),
    st.binary(max_size=MAX_LINK_PAYLOAD),
)
units = st.integers(0, 31)
directions = st.sampled_from(Direction)


def a_body(sequence: int, size: int = 59) -> bytes:
    return bytes([3, 0x34, 0x12, sequence % 256]) + random.Random(sequence).randbytes(size)


def records(line: bytes) -> list[bytes]:
    size = FD_RECORD if line[5] else CLASSIC_RECORD
    return [line[at : at + size] for at in range(0, len(line), size)]


def test_the_identifiers_checksum_has_its_published_check_value() -> None:
    assert crc6(b"123456789") == 0x0D


@given(bodies, units, directions, st.booleans())
def test_decode_inverts_encode(body: bytes, unit: int, direction: Direction, is_fd: bool) -> None:
    line = encode_message(body, unit=unit, direction=direction, is_fd=is_fd)

    assert CanDecoder(unit=unit, direction=direction).feed(line) == [body]
    assert CanDecoder().feed(line) == [body]
    assert CanDecoder(unit=unit ^ 1, direction=direction).feed(line) == []
    assert CanDecoder(unit=unit, direction=Direction(1 - direction)).feed(line) == []
    assert len(line) == FD_RECORD if is_fd else len(line) == CLASSIC_RECORD * -(-(len(body) - 2) // 8)


@given(st.lists(st.tuples(bodies, st.booleans()), max_size=6), st.data())
def test_chunking_never_changes_the_frames(messages: list[tuple[bytes, bool]], draw: st.DataObject) -> None:
    noise = draw.draw(st.binary(max_size=40))
    stream = noise + b"".join(encode_message(body, unit=1, direction=UP, is_fd=is_fd) for body, is_fd in messages)
    cuts = sorted(draw.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    decoder = CanDecoder()

    results = []
    for start, end in itertools.pairwise([0, *cuts, len(stream)]):
        results += decoder.feed(stream[start:end])

    assert results == CanDecoder().feed(stream)
    if not noise:
        assert results == [body for body, _ in messages]


@given(st.lists(st.binary(max_size=200), max_size=20))
def test_no_input_crashes_the_decoder_or_grows_its_buffer(chunks: list[bytes]) -> None:
    decoder = CanDecoder()
    for chunk in chunks:
        decoder.feed(chunk)
        assert len(decoder._reader._buffer) < FD_RECORD


@given(st.integers(0, 2**29 - 1), st.binary(max_size=8))
def test_any_frame_at_all_is_taken_or_refused_and_its_record_reads_back(can_id: int, data: bytes) -> None:
    frame = CanFrame(can_id=can_id, data=data)

    (read,) = RecordReader().feed(encode_record(frame))

    assert read == frame if is_sound(frame) else isinstance(read, FrameFault)
    assert len(CanDecoder().feed(encode_record(frame))) <= 1


@given(bodies, st.booleans(), st.data())
def test_up_to_six_neighbouring_damaged_bits_never_pass(body: bytes, is_fd: bool, draw: st.DataObject) -> None:
    (first, *_) = RecordReader().feed(encode_message(body, unit=5, direction=UP, is_fd=is_fd))
    assert isinstance(first, CanFrame)
    code = int.from_bytes((first.can_id >> 6).to_bytes(3, "big") + first.data, "big")
    burst = draw.draw(st.integers(1, 63)) << draw.draw(st.integers(0, 17 + 8 * len(first.data)))
    damaged = (code ^ burst).to_bytes(3 + len(first.data) + 1, "big")[1:]

    wrong = CanFrame(can_id=int.from_bytes(damaged[:3], "big") << 6 | first.can_id & 63, data=damaged[3:], is_fd=is_fd)

    assert not is_sound(wrong)


@given(st.lists(st.integers(0, 7), min_size=1, max_size=12), bodies, bodies)
def test_parts_lost_doubled_or_out_of_order_cost_their_message_alone(picks: list[int], before: bytes, after: bytes) -> None:
    parts = records(encode_message(a_body(7), unit=1, direction=UP, is_fd=False))
    before, after = (bytes([3, *body[1:3], sequence]) + body[4:] for sequence, body in ((6, before), (8, after)))
    jumble = b"".join(parts[pick] for pick in picks)
    stream = encode_message(before, unit=1, direction=UP, is_fd=False) + jumble + encode_message(after, unit=1, direction=UP, is_fd=False)

    found = [one for one in CanDecoder().feed(stream) if isinstance(one, bytes)]

    assert found[0] == before
    assert found[-1] == after
    assert all(one == a_body(7) for one in found[1:-1]), "nothing is put together wrongly"


def test_a_part_that_comes_twice_in_a_row_costs_nothing() -> None:
    parts = records(encode_message(a_body(1), unit=1, direction=UP, is_fd=False))

    assert CanDecoder().feed(b"".join(part + part for part in parts)) == [a_body(1)]


@settings(max_examples=20)
@given(st.data())
def test_messages_of_many_senders_and_priorities_may_be_mixed(draw: st.DataObject) -> None:
    keys = [(unit, direction, kind) for unit in (0, 3, 31) for direction in (UP, DOWN) for kind in (3, 4)]
    queues = []
    for unit, direction, kind in keys:
        body = bytes([kind]) + a_body(unit)[1:]
        queues.append(records(encode_message(body, unit=unit, direction=direction, is_fd=False)))
    stream = b""
    while any(queues):
        queue = draw.draw(st.sampled_from([one for one in queues if one]))
        stream += queue.pop(0)

    results = CanDecoder().feed(stream)

    assert sorted(map(repr, results)) == sorted(repr(bytes([kind]) + a_body(unit)[1:]) for unit, _, kind in keys)


Damage = Callable[[bytes, random.Random], bytes]


def flip_bit(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]


def drop_byte(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + data[at + 1 :]


def insert_byte(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + rng.randbytes(1) + data[at:]


def truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def drop_record(data: bytes, rng: random.Random) -> bytes:
    kept = records(data)
    kept.pop(rng.randrange(len(kept)))
    return b"".join(kept)


@pytest.mark.parametrize("is_fd", [False, True], ids=["classic", "fd"])
@pytest.mark.parametrize("damage", [flip_bit, drop_byte, insert_byte, truncate, drop_record])
def test_of_4000_messages_with_2_percent_damaged_at_most_4_intact_ones_are_lost(damage: Damage, is_fd: bool) -> None:
    rng = random.Random(9)
    intact, stream = [], bytearray()
    for number in range(4000):
        body = bytes([3]) + number.to_bytes(2, "little") + bytes([number % 256]) + rng.randbytes(rng.choice((5, 20, 59, 62)))
        line = encode_message(body, unit=2, direction=UP, is_fd=is_fd)
        if rng.random() < 0.02:
            stream += damage(line, rng)
        else:
            intact.append(body)
            stream += line

    decoder = CanDecoder(unit=2, direction=UP)
    found = set()
    for at in range(0, len(stream), 64):
        found |= {one for one in decoder.feed(bytes(stream[at : at + 64])) if isinstance(one, bytes)}

    assert len(set(intact) - found) <= 4
    assert len(intact) > 3800


def test_commands_win_the_bus_and_all_data_of_a_sender_is_of_one_priority() -> None:
    kinds = range(1, 7)
    assert {priority_of(kind, DOWN) for kind in kinds if kind == 3} == {0}
    assert {priority_of(kind, direction) for kind in kinds if kind != 3 for direction in Direction} == {1}
    assert priority_of(3, UP) == 2
    assert configuration_id(unit=0, direction=DOWN) >> 27 == 3


@pytest.mark.parametrize("direction", Direction)
def test_configuration_frames_are_sound_and_no_part_of_the_link(direction: Direction) -> None:
    frame = CanFrame(can_id=configuration_id(unit=9, direction=direction), data=b"\x30\x00\x00")

    assert RecordReader().feed(encode_record(frame)) == [frame]
    assert CanDecoder().feed(encode_record(frame)) == []


def test_each_fault_is_named() -> None:
    line = encode_message(a_body(1), unit=1, direction=UP, is_fd=False)
    frames = [frame for frame in RecordReader().feed(line) if isinstance(frame, CanFrame)]
    fd = RecordReader().feed(encode_message(a_body(1), unit=1, direction=UP, is_fd=True))[0]
    assert isinstance(fd, CanFrame)

    assert CanDecoder().feed(b"\xff" * 20) == [FrameFault.NOISE]
    assert CanDecoder().feed(line[:8] + b"\x00" + line[9:16] + line[16:32]) == [FrameFault.BAD_CRC, FrameFault.INCOMPLETE]
    assert CanDecoder().feed(encode_record(frames[1])) == [FrameFault.INCOMPLETE]
    assert CanDecoder().feed(encode_record(make_frame(fd.fields._replace(part=15), fd.data, is_fd=True))) == [FrameFault.BAD_STUFFING]
    assert CanDecoder().feed(encode_record(make_frame(fd.fields._replace(part=0), b"x", is_fd=True))) == [FrameFault.TOO_SHORT]
    assert CanDecoder().feed(encode_record(make_frame(frames[0].fields, b"short", is_fd=False))) == [FrameFault.INCOMPLETE]


@pytest.mark.parametrize("body", [b"\x03\x00\x00", bytes(4 + MAX_LINK_PAYLOAD + 1), b"\x07\x00\x00\x00", b"\x00\x00\x00\x00"])
def test_a_body_that_does_not_fit_is_refused(body: bytes) -> None:
    with pytest.raises(EncodeError, match="on CAN"):
        encode_message(body, unit=0, direction=UP, is_fd=True)


@pytest.mark.parametrize("frame", [CanFrame(can_id=1, data=bytes(9)), CanFrame(can_id=1, data=bytes(9), is_fd=True)])
def test_a_frame_that_cannot_be_is_refused(frame: CanFrame) -> None:
    assert 9 not in FD_SIZES
    with pytest.raises(EncodeError, match="size"):
        encode_record(frame)


def test_the_examples_of_the_wire_format_are_true() -> None:
    text = (Path(firmware_protocol.__file__).parent / "WIRE_FORMAT.md").read_text()
    examples = re.findall(
        r"unit (\d+), (to|from) the coordinator, body `([0-9A-F ]+)`: identifier `([0-9A-F]{8})`, data `([0-9A-F ]+)`", text
    )

    assert len(examples) == 2
    for unit, direction, body, can_id, data in examples:
        for is_fd in (False, True):
            line = encode_message(bytes.fromhex(body), unit=int(unit), direction=DOWN if direction == "to" else UP, is_fd=is_fd)
            (frame,) = RecordReader().feed(line)
            assert isinstance(frame, CanFrame)
            if not is_fd:
                assert f"{frame.can_id:08X}" == can_id
            assert frame.data == bytes.fromhex(data)
