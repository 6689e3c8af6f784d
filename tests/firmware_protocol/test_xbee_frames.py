"""Frames as values: the user guides' examples, and digi-xbee's idea of the same frames."""

from typing import Any

import pytest
from digi.xbee.models import status
from digi.xbee.models.address import XBee16BitAddress, XBee64BitAddress
from digi.xbee.models.mode import OperatingMode
from digi.xbee.packets import common, factory
from digi.xbee.packets.base import XBeePacket
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dialects.xbee_frames import (
    AT_OK,
    UNKNOWN16,
    AtCommand,
    AtResponse,
    Endpoints,
    Frame,
    ModemStatus,
    NodeIdentification,
    Receive,
    TransmitRequest,
    TransmitStatus,
    XBeeFault,
    decode_xbee,
    encode_xbee,
    unpack_receive,
)
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.xbee import encode_frame, make_decoder
from tests.strategies import u8, u16, u64

NODE64, NODE16 = 0x0013A20040522BAA, 0x7D84

EXAMPLES: list[tuple[str, Frame]] = [
    # AP? and MY, and its answer: "AT Command", "AT Command Response".
    ("7E 00 04 08 01 41 50 65", AtCommand(frame_id=1, command="AP")),
    ("7E 00 04 08 52 4D 59 FF", AtCommand(frame_id=0x52, command="MY")),
    ("7E 00 07 88 52 4D 59 00 00 00 7F", AtResponse(frame_id=0x52, command="MY", status=AT_OK, value=b"\0\0")),
    ("7E 00 05 88 01 42 44 00 F0", AtResponse(frame_id=1, command="BD", status=AT_OK)),
    # "Queue AT Command": BD = 7.
    ("7E 00 05 09 01 42 44 07 68", AtCommand(frame_id=1, command="BD", value=b"\7", is_queued=True)),
    (
        "7E 00 16 10 01 00 13 A2 00 40 0A 01 27 FF FE 00 00 54 78 44 61 74 61 30 41 13",
        TransmitRequest(frame_id=1, destination64=0x0013A200400A0127, destination16=UNKNOWN16, payload=b"TxData0A"),
    ),
    (
        "7E 00 1A 11 01 00 00 00 00 00 00 00 00 FF FE A0 A1 15 54 C1 05 00 00 54 78 44 61 74 61 3A",
        TransmitRequest(
            frame_id=1, destination64=0, destination16=UNKNOWN16, payload=b"TxData", endpoints=Endpoints(
                source=0xA0, destination=0xA1, cluster=0x1554, profile=0xC105,
            ),
        ),
    ),
    ("7E 00 07 8B 01 7D 84 00 00 01 71", TransmitStatus(frame_id=1, destination16=NODE16, retries=0, delivery=0, discovery=1)),
    ("7E 00 02 8A 06 6F", ModemStatus(status=6)),
    (
        "7E 00 12 90 00 13 A2 00 40 52 2B AA 7D 84 01 52 78 44 61 74 61 0D",
        Receive(source64=NODE64, source16=NODE16, options=1, payload=b"RxData"),
    ),
    # DigiMesh: no 16-bit address.
    (
        "7E 00 12 90 00 13 A2 00 41 AE B5 4E FF FE C1 54 78 44 61 74 61 C4",
        Receive(source64=0x0013A20041AEB54E, source16=UNKNOWN16, options=0xC1, payload=b"TxData"),
    ),
    (
        "7E 00 18 91 00 13 A2 00 40 52 2B AA 7D 84 E0 E0 22 11 C1 05 02 52 78 44 61 74 61 52",
        Receive(
            source64=NODE64, source16=NODE16, options=2, payload=b"RxData",
            endpoints=Endpoints(source=0xE0, destination=0xE0, cluster=0x2211, profile=0xC105),
        ),
    ),
    (
        "7E 00 20 95 00 13 A2 00 40 52 2B AA 7D 84 02 7D 84 00 13 A2 00 40 52 2B AA 20 00 FF FE 01 01 C1 05 10 1E 1B",
        NodeIdentification(
            sender64=NODE64, sender16=NODE16, options=2, node16=NODE16, node64=NODE64, name=b" ", parent16=UNKNOWN16, kind=1, event=1,
        ),
    ),
]  # fmt: skip

at_names = st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ%0123456789", min_size=2, max_size=2)
payloads = st.binary(max_size=100)
endpoints = st.none() | st.builds(Endpoints, source=u8, destination=u8, cluster=u16, profile=u16)
frames: st.SearchStrategy[Frame] = st.one_of(
    st.builds(AtCommand, frame_id=u8, command=at_names, value=payloads, is_queued=st.booleans()),
    st.builds(AtResponse, frame_id=u8, command=at_names, status=u8, value=payloads),
    st.builds(
        TransmitRequest, frame_id=u8, destination64=u64, destination16=u16, payload=payloads, radius=u8, options=u8, endpoints=endpoints
    ),
    st.builds(TransmitStatus, frame_id=u8, destination16=u16, retries=u8, delivery=u8, discovery=u8),
    st.builds(ModemStatus, status=u8),
    st.builds(Receive, source64=u64, source16=u16, options=u8, payload=payloads, endpoints=endpoints),
    st.builds(
        NodeIdentification, sender64=u64, sender16=u16, options=u8, node16=u16, node64=u64,
        name=st.binary(max_size=20).map(lambda name: name.replace(b"\0", b"")), parent16=u16, kind=u8, event=u8, profile=u16,
        manufacturer=u16,
    ),
)  # fmt: skip


@pytest.mark.parametrize(("text", "frame"), EXAMPLES, ids=lambda one: one[:20] if isinstance(one, str) else "")
def test_the_user_guides_examples_say_what_they_should(text: str, frame: Frame) -> None:
    line = bytes.fromhex(text)
    (body,) = make_decoder(is_escaped=False).feed(line)
    assert isinstance(body, bytes)
    assert decode_xbee(body) == frame
    assert encode_frame(encode_xbee(frame), is_escaped=False) == line


def test_the_user_guides_example_of_escaping_goes_out_as_it_stands() -> None:
    frame = TransmitRequest(frame_id=1, destination64=0x0013A200400A0127, destination16=UNKNOWN16, payload=b"TxData0A")
    line = "7E 00 16 10 01 00 7D 33 A2 00 40 0A 01 27 FF FE 00 00 54 78 44 61 74 61 30 41 7D 33"
    assert encode_frame(encode_xbee(frame), is_escaped=True) == bytes.fromhex(line)


@given(frame=frames)
def test_decode_inverts_encode(frame: Frame) -> None:
    assert decode_xbee(encode_xbee(frame)) == frame


@given(body=st.binary(max_size=60) | st.tuples(st.sampled_from(b"\x08\x09\x10\x11\x88\x8a\x8b\x90\x91\x95"), st.binary(max_size=40)).map(
    lambda pair: bytes([pair[0]]) + pair[1]
))  # fmt: skip
def test_no_body_raises_and_what_is_understood_can_be_said_again(body: bytes) -> None:
    frame = decode_xbee(body)
    if isinstance(frame, XBeeFault):
        return
    again = encode_xbee(frame)
    assert decode_xbee(again) == frame
    assert body.startswith(again) if isinstance(frame, NodeIdentification) else again == body  # NO appends what we do not read


def test_bodies_that_are_no_frames_are_told_apart() -> None:
    assert decode_xbee(b"\x92\0\0") is XBeeFault.UNKNOWN_TYPE
    assert decode_xbee(b"\x90\0") is XBeeFault.BAD_LENGTH
    assert decode_xbee(b"\x8b\1\0\0\0\0\0\0") is XBeeFault.BAD_LENGTH
    assert decode_xbee(b"\x95" + bytes(21) + b"name") is XBeeFault.BAD_LENGTH


@given(frame=st.builds(Receive, source64=u64, source16=u16, options=u8, payload=payloads))
def test_the_short_way_to_a_receive_frame_agrees_with_the_long_one(frame: Receive) -> None:
    assert unpack_receive(encode_xbee(frame)) == (frame.source64, frame.source16, frame.options, frame.payload)
    assert unpack_receive(b"\x91" + bytes(20)) is None
    assert unpack_receive(b"\x90" + bytes(10)) is None


def test_values_that_do_not_fit_are_refused() -> None:
    with pytest.raises(EncodeError, match="two characters"):
        encode_xbee(AtCommand(frame_id=1, command="APP"))
    with pytest.raises(EncodeError, match="TransmitStatus"):
        encode_xbee(TransmitStatus(frame_id=256, destination16=0, retries=0, delivery=0, discovery=0))
    with pytest.raises(EncodeError, match="zero byte"):
        encode_xbee(NodeIdentification(
            sender64=0, sender16=0, options=0, node16=0, node64=0, name=b"a\0b", parent16=0, kind=0, event=0,
        ))  # fmt: skip


def as_digi(frame: Frame) -> Any:
    """The same frame in digi-xbee's classes."""
    match frame:
        case AtCommand(is_queued=True):
            return common.ATCommQueuePacket(frame.frame_id, frame.command, frame.value)
        case AtCommand():
            return common.ATCommPacket(frame.frame_id, frame.command, frame.value)
        case TransmitRequest(endpoints=None):
            return common.TransmitPacket(
                frame.frame_id, _long(frame.destination64), _short(frame.destination16), frame.radius, frame.options, frame.payload
            )
        case TransmitRequest(endpoints=Endpoints() as ends):
            return common.ExplicitAddressingPacket(
                frame.frame_id, _long(frame.destination64), _short(frame.destination16), ends.source, ends.destination, ends.cluster,
                ends.profile, frame.radius, frame.options, frame.payload,
            )  # fmt: skip
        case Receive(endpoints=None):
            return common.ReceivePacket(_long(frame.source64), _short(frame.source16), frame.options, frame.payload)
        case Receive(endpoints=Endpoints() as ends):
            return common.ExplicitRXIndicatorPacket(
                _long(frame.source64), _short(frame.source16), ends.source, ends.destination, ends.cluster, ends.profile, frame.options,
                frame.payload,
            )  # fmt: skip
        case _:
            return None


def _long(address: int) -> Any:
    return XBee64BitAddress(address.to_bytes(8, "big"))


def _short(address: int) -> Any:
    return XBee16BitAddress(address.to_bytes(2, "big"))


def is_known_to_digi(frame: Frame) -> bool:
    """digi-xbee puts another number in the place of one that is not in its tables."""
    match frame:
        case ModemStatus(status=code):
            return any(code == one.code for one in status.ModemStatus)
        case TransmitStatus(delivery=delivery, discovery=discovery):
            return any(delivery == one.code for one in status.TransmitStatus) and any(
                discovery == one.code for one in status.DiscoveryStatus
            )
        case AtResponse(status=code):
            return any(code == one.code for one in status.ATCommandStatus)
        case _:
            return True


@pytest.mark.parametrize("is_escaped", [False, True], ids=["AP=1", "AP=2"])
@given(frame=frames.filter(is_known_to_digi))
def test_digi_xbee_and_we_put_the_same_frame_on_the_line(is_escaped: bool, frame: Frame) -> None:
    line = encode_frame(encode_xbee(frame), is_escaped=is_escaped)
    theirs = as_digi(frame)
    if theirs is not None:
        said = bytes(theirs.output(escaped=is_escaped))
        assert said == line
        assert [decode_xbee(body) for body in make_decoder(is_escaped=is_escaped).feed(said) if isinstance(body, bytes)] == [frame]
    if isinstance(frame, AtResponse | TransmitStatus | ModemStatus | Receive | NodeIdentification):
        plain = XBeePacket.unescape_data(bytearray(line)) if is_escaped else bytearray(line)
        understood = factory.build_frame(plain, OperatingMode.API_MODE)
        assert bytes(understood.output(escaped=is_escaped)) == line
