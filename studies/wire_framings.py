"""Every framing there is, under one form: bodies to the bytes of a line and back."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from firmware_protocol.errors import EncodeError
from firmware_protocol.framing import cobs, xbee, znp
from firmware_protocol.framing.can import MAX_LINK_PAYLOAD, CanDecoder, encode_message
from firmware_protocol.framing.can_frame import Direction
from firmware_protocol.framing.interface import FrameDecoder


@dataclass(frozen=True, slots=True, kw_only=True)
class WireFraming:
    """How bodies stand on the line of a dialect."""

    name: str
    encode: Callable[[bytes], bytes]
    make_decoder: Callable[[], FrameDecoder]
    largest: int
    """Longest body [B]."""
    most_held: int
    """Bytes that a decoder keeps between two calls at most."""
    head: bytes = b""
    """What a body of a payload begins with, so that it can be framed."""

    def body_of(self, payload: bytes) -> bytes:
        """Return a body that the framing takes, made of a payload."""
        return (self.head + payload)[: self.largest]

    def frame_of(self, data: bytes) -> bytes:
        """Return a sound frame around any bytes: around nothing but them, where they can be a body."""
        try:
            return self.encode(data[: self.largest])
        except EncodeError:
            return self.encode(self.body_of(data or b"\x00"))


# A DATA frame of session 1, sequence 0 (WIRE_FORMAT.md §3.1), which is all that CAN carries; AF_INCOMING_MSG (§9).
_LINK_DATA = bytes((3, 1, 0, 0))
_INCOMING = bytes((0x44, 0x81))


def _can(name: str, *, is_fd: bool, direction: Direction = Direction.FROM_COORDINATOR) -> WireFraming:
    return WireFraming(
        name=name,
        encode=partial(encode_message, unit=1, direction=direction, is_fd=is_fd),
        make_decoder=CanDecoder,
        largest=4 + MAX_LINK_PAYLOAD,
        most_held=72 + 256 * 200,  # one record, and one message of at most eight parts for each priority, direction and unit
        head=_LINK_DATA,
    )


def _xbee(name: str, *, is_escaped: bool) -> WireFraming:
    return WireFraming(
        name=name,
        encode=partial(xbee.encode_frame, is_escaped=is_escaped),
        make_decoder=partial(xbee.make_decoder, is_escaped=is_escaped),
        largest=xbee.MAX_BODY_SIZE,
        most_held=2 * (xbee.MAX_BODY_SIZE + 3),
    )


FRAMINGS = {
    framing.name: framing
    for framing in (
        WireFraming(
            name="native", encode=cobs.encode_frame, make_decoder=cobs.CobsDecoder, largest=cobs.MAX_BODY_SIZE,
            most_held=cobs.MAX_ENCODED_SIZE,
        ),
        _xbee("xbee, AP=1", is_escaped=False),
        _xbee("xbee, AP=2", is_escaped=True),
        WireFraming(
            name="znp", encode=znp.encode_frame, make_decoder=znp.ZnpDecoder, largest=znp.MAX_BODY_SIZE, most_held=znp.MAX_FRAME_SIZE,
            head=_INCOMING,
        ),
        _can("can", is_fd=False),
        _can("canfd", is_fd=True),
    )
}  # fmt: skip

_CAN_TO_DONGLE = {name: _can(name, is_fd=name == "canfd", direction=Direction.TO_COORDINATOR) for name in ("can", "canfd")}


def framings_of(dialect: str, *, to_dongle: bool) -> tuple[WireFraming, ...]:
    """Return what the frames of a dialect may look like in one direction."""
    if to_dongle and dialect in _CAN_TO_DONGLE:
        return (_CAN_TO_DONGLE[dialect],)
    return tuple(framing for name, framing in FRAMINGS.items() if name.split(",")[0] == dialect)
