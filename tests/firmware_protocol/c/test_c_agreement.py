"""Python and C say the same of every input, valid or not; a slow campaign of the same is ``python -m studies.wire_differences``."""

import struct

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.crc import append_crc
from firmware_protocol.envelope import encode_envelope
from firmware_protocol.framing.cobs import MAX_BODY_SIZE, encode_frame
from firmware_protocol.layouts import CARRIER_LAYOUTS, DOWNLINK_LAYOUTS, ENVELOPE_LAYOUTS, UPLINK_LAYOUTS
from firmware_protocol.message_codec import encode_downlink, encode_uplink
from firmware_protocol.messages import Downlink, Uplink, UplinkHeader
from studies.c_wire import Wire
from studies.wire_agreement import (
    Confirm,
    Garbage,
    Hear,
    Open,
    Operation,
    Say,
    Wait,
    compare_downlink,
    compare_envelope,
    compare_links,
    compare_stream,
    compare_uplink,
)
from tests.strategies import downlinks, envelopes, frame_bodies, u16, uplink_headers, uplinks

_KINDS = [layout.kind or 0 for layout in (*UPLINK_LAYOUTS, *DOWNLINK_LAYOUTS)]
_ENVELOPE_KINDS = [layout.kind or 0 for layout in (*ENVELOPE_LAYOUTS, *CARRIER_LAYOUTS)]


@st.composite
def payloads(draw: st.DrawFn) -> bytes:
    """Payloads with a good checksum and a known type, of any length and any contents, and now and then something else."""
    kind = draw(st.sampled_from(_KINDS) | st.integers(0, 255))
    version = draw(st.sampled_from((1, 1, 1, 1, 0, 2)))
    body = bytes([kind, version]) + draw(st.binary(max_size=60))
    return append_crc(body[: draw(st.integers(0, len(body)) | st.just(len(body)))])


@given(payloads() | st.binary(max_size=80))
def test_payloads_mean_the_same(wire: Wire, payload: bytes) -> None:
    assert (compare_uplink(wire, payload), compare_downlink(wire, payload)) == (None, None)


@given(uplink_headers, uplinks, st.integers(0, 57), st.integers(0, 255))
def test_uplinks_of_python_are_written_alike_and_damage_is_told_alike(
    wire: Wire, header: UplinkHeader, message: Uplink, at: int, by: int
) -> None:
    payload = encode_uplink(header, message)

    assert compare_uplink(wire, payload) is None
    assert wire.encode_again("uplink") == payload
    assert wire.encode_again("uplink", size=len(payload)) == payload
    assert wire.encode_again("uplink", size=len(payload) - 1) == b""
    damaged = bytearray(payload[:-2])
    damaged[at % len(damaged)] ^= by
    assert compare_uplink(wire, append_crc(bytes(damaged))) is None


@given(u16, downlinks, st.integers(0, 57), st.integers(0, 255))
def test_downlinks_of_python_are_written_alike_and_damage_is_told_alike(
    wire: Wire, sequence: int, message: Downlink, at: int, by: int
) -> None:
    payload = encode_downlink(sequence, message)

    assert compare_downlink(wire, payload) is None
    assert wire.encode_again("downlink") == payload
    damaged = bytearray(payload[:-2])
    damaged[at % len(damaged)] ^= by
    assert compare_downlink(wire, append_crc(bytes(damaged))) is None


@given(
    st.builds(lambda kind, rest: bytes([kind]) + rest, st.sampled_from(_ENVELOPE_KINDS), st.binary(max_size=70))
    | envelopes.map(encode_envelope)
    | st.binary(max_size=255)
)
def test_envelopes_mean_the_same(wire: Wire, body: bytes) -> None:
    assert compare_envelope(wire, body[:255]) is None


@given(frame_bodies)
def test_frames_are_written_alike(wire: Wire, body: bytes) -> None:
    assert wire.encode_frame(body) == encode_frame(body)


def test_no_frame_is_made_of_nothing_or_of_too_much(wire: Wire) -> None:
    assert wire.encode_frame(b"") == wire.encode_frame(bytes(MAX_BODY_SIZE + 1)) == b""


@given(
    st.lists(frame_bodies.map(encode_frame) | st.binary(max_size=20) | st.integers(240, 300).map(lambda n: b"\x01" * n), max_size=6),
    st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 2), st.integers(0, 255)), max_size=4),
    st.lists(st.integers(0, 2000), max_size=6),
)
def test_streams_are_cut_alike_whatever_their_damage_and_their_chunks(
    wire: Wire, pieces: list[bytes], damages: list[tuple[int, int, int]], cuts: list[int]
) -> None:
    stream = bytearray(b"".join(pieces))
    for at, how, byte in damages:
        place = at % (len(stream) + 1)
        stream[place : place + (how > 0)] = bytes([byte] * (how < 2))
    places = sorted(cut % (len(stream) + 1) for cut in cuts)
    chunks = [bytes(stream[begin:end]) for begin, end in zip([0, *places], [*places, len(stream)], strict=True)]

    assert compare_stream(wire, chunks) is None


operations: st.SearchStrategy[Operation] = st.one_of(
    st.builds(Wait, ms=st.sampled_from((0, 1, 299, 300, 301, 500, 600, 2000, 3000, 6000))),
    st.builds(
        Hear,
        kind=st.sampled_from((1, 2, 3, 3, 3, 4, 4, 5, 6, 0, 7)),
        session=st.sampled_from((0, 0, 0, 0, 1, -1, 300)),
        sequence=st.sampled_from((0, 0, 0, 1, 2, 16, 17, 255)),
        payload=st.binary(max_size=3),
    ),
    st.builds(Garbage, body=st.binary(max_size=250)),
    st.builds(Say, payload=st.binary(max_size=240), is_urgent=st.booleans()),
    st.builds(Say, payload=st.just(b"x")),
    st.builds(Confirm, but=st.integers(0, 3)),
    st.builds(Open),
)


@given(st.lists(operations, max_size=60), st.booleans(), st.sampled_from((0, 2**32 - 2500)))
def test_links_do_the_same_whatever_happens(wire: Wire, happenings: list[Operation], is_initiator: bool, start_ms: int) -> None:
    """Each event and frame and deadline of both roles is the same after every single thing that happens, also when the clock wraps."""
    if is_initiator:
        happenings = [Open(), Hear(kind=2, session=0, sequence=0, payload=b"\x01"), *happenings]
    else:
        happenings = [Hear(kind=1, session=5, sequence=0, payload=b"\x01"), *happenings]

    assert compare_links(wire, happenings, is_initiator=is_initiator, start_ms=start_ms) is None


def test_the_same_bytes_lie_at_any_address(wire: Wire) -> None:
    """The decoder reads byte by byte: a payload may begin at an odd address, as it does in an envelope."""
    payload = append_crc(struct.pack("<BBHHHIHI", 5, 1, 2, 3, 4, 5, 6, 7))
    envelope = b"\x22\x34\x12\xd8\x40" + payload

    carried = wire.decode_envelope(envelope)

    assert carried == ((0x22,), (0x1234, -40, 0x40), payload)
    assert wire.decode_uplink(payload) == ((5, 1, 2, 3, 4, 5), (6, 7), ())
