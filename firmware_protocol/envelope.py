"""What base station and coordinator dongle say to each other in the native dialect (WIRE_FORMAT.md §4).

A radio payload travels inside ``RadioReceived`` and ``RadioSend``; other dialects have envelopes of their own and carry
the same payloads.
"""

import struct
from collections.abc import Callable
from enum import Enum, IntEnum
from typing import TypeAlias

from msgspec import Struct

from firmware_protocol.errors import EncodeError
from firmware_protocol.layout_codec import LayoutCodec, LayoutFault
from firmware_protocol.layouts import ENVELOPE_LAYOUTS
from firmware_protocol.units import RssiDbm, ShortAddress

BROADCAST_ADDRESS = ShortAddress(0xFFFF)

LEAVE_PAN_ID = 0xFFFF
LEAVE_CHANNEL = 0
LEAVE_JOINING = 255
"""What stands in a ConfigureCoordinator for a value that is to stay as it is."""


class EnvelopeFault(Enum):
    """Why a link payload is not an envelope."""

    UNKNOWN_TYPE = "unknown_envelope_type"
    BAD_LENGTH = "bad_envelope_length"
    BAD_VALUE = "bad_envelope_value"


class RadioStatus(IntEnum):
    """What the coordinator's radio says of a payload it was to send."""

    SENT = 0
    """A unicast was acknowledged by the next hop's radio; a broadcast has gone out."""
    NO_ACK = 1
    CHANNEL_BUSY = 2
    UNKNOWN_ADDRESS = 3
    QUEUE_FULL = 4
    TOO_LONG = 5
    OTHER = 255


class IdentifyRequest(Struct, frozen=True, kw_only=True, gc=False):
    """Ask the coordinator who it is (§4.1)."""


class CoordinatorHello(Struct, frozen=True, kw_only=True, gc=False):
    """Say what the coordinator is and which network it runs (§4.2). Sent when asked and whenever it starts."""

    firmware: int
    eui64: int
    pan_id: int
    channel: int
    max_radio_payload: int


class RadioSend(Struct, frozen=True, kw_only=True, gc=False):
    """Ask the coordinator to send a radio payload (§4.3)."""

    handle: int
    destination: ShortAddress
    payload: bytes


class RadioConfirm(Struct, frozen=True, kw_only=True, gc=False):
    """Say what became of a payload (§4.4)."""

    handle: int
    status: int
    """A ``RadioStatus`` value, or one of a newer firmware."""


class RadioReceived(Struct, frozen=True, kw_only=True, gc=False):
    """Hand over a radio payload that came in (§4.5)."""

    source: ShortAddress
    rssi_dbm: RssiDbm
    lqi: int
    payload: bytes


class CoordinatorLog(Struct, frozen=True, kw_only=True, gc=False):
    """Report something that a person may want to know (§4.6). The codes are the firmware's own."""

    level: int
    """0 debug, 1 info, 2 warning, 3 error."""
    code: int
    text: str = ""


class ConfigureCoordinator(Struct, frozen=True, kw_only=True, gc=False):
    """Set the network (§4.7); all of it or nothing, and answered with a CoordinatorConfigured."""

    token: int
    pan_id: int = LEAVE_PAN_ID
    channel: int = LEAVE_CHANNEL
    """11 to 26."""
    permit_join_s: int = LEAVE_JOINING
    """How long nodes may join [s]; 0: not at all, 254: until further notice."""


class CoordinatorConfigured(Struct, frozen=True, kw_only=True, gc=False):
    """Tell what became of a ConfigureCoordinator, and the values in force (§4.8)."""

    token: int
    result: int
    """0 done, 1 bad parameter, 2 not supported; on anything but 0, nothing has changed."""
    pan_id: int
    channel: int
    permit_join_s: int
    """How much is left of it [s]; 0: closed, 254: open until further notice."""


class NodeJoined(Struct, frozen=True, kw_only=True, gc=False):
    """Say that a node has joined the network, or has told both its addresses (§4.9)."""

    address: ShortAddress
    eui64: int


Envelope: TypeAlias = (
    IdentifyRequest
    | CoordinatorHello
    | RadioSend
    | RadioConfirm
    | RadioReceived
    | CoordinatorLog
    | ConfigureCoordinator
    | CoordinatorConfigured
    | NodeJoined
)

_SEND = struct.Struct("<BHH")  # type, handle, destination (§4.3)
_CONFIRM = struct.Struct("<BHB")  # type, handle, status (§4.4)
_RECEIVED = struct.Struct("<BHbB")  # type, source, rssi_dbm, lqi (§4.5)

_SEND_TYPE = 0x20
_CONFIRM_TYPE = 0x21
_RECEIVED_TYPE = 0x22


def encode_envelope(envelope: Envelope) -> bytes:
    """Return the link payload of an envelope.

    Raises
    ------
    EncodeError
        A value does not fit its field.
    """
    try:
        match envelope:
            case RadioSend():
                return _SEND.pack(_SEND_TYPE, envelope.handle, envelope.destination) + envelope.payload
            case RadioConfirm():
                return _CONFIRM.pack(_CONFIRM_TYPE, envelope.handle, envelope.status)
            case RadioReceived():
                return _RECEIVED.pack(_RECEIVED_TYPE, envelope.source, envelope.rssi_dbm, envelope.lqi) + envelope.payload
            case _:
                return _encode_by_table(envelope)
    except struct.error as error:
        raise EncodeError(field=type(envelope).__name__, value=envelope, limit=str(error)) from error


def decode_envelope(body: bytes) -> Envelope | EnvelopeFault:
    """Return the envelope in a link payload, or why it is none."""
    try:
        match body[:1]:
            case b"\x22":
                _, source, rssi, lqi = _RECEIVED.unpack_from(body)
                payload = body[_RECEIVED.size :]
                return RadioReceived(source=ShortAddress(source), rssi_dbm=RssiDbm(rssi), lqi=lqi, payload=payload)
            case b"\x20":
                _, handle, destination = _SEND.unpack_from(body)
                return RadioSend(handle=handle, destination=ShortAddress(destination), payload=body[_SEND.size :])
            case b"\x21":
                _, handle, status = _CONFIRM.unpack_from(body)
                return RadioConfirm(handle=handle, status=status)
            case _:
                return _decode_by_table(body)
    except struct.error:
        return EnvelopeFault.BAD_LENGTH


_FAULTS = {LayoutFault.BAD_LENGTH: EnvelopeFault.BAD_LENGTH, LayoutFault.BAD_VALUE: EnvelopeFault.BAD_VALUE}
_CLASSES: tuple[Callable[..., Envelope], ...] = (
    IdentifyRequest,
    CoordinatorHello,
    CoordinatorLog,
    ConfigureCoordinator,
    CoordinatorConfigured,
    NodeJoined,
)
_CODECS = {layout.name: LayoutCodec(layout) for layout in ENVELOPE_LAYOUTS}
_TABLE = {_CODECS[getattr(cls, "__name__", "")].layout.kind: (cls, _CODECS[getattr(cls, "__name__", "")]) for cls in _CLASSES}


def _encode_by_table(envelope: Envelope) -> bytes:
    codec = _CODECS[type(envelope).__name__]
    assert codec.layout.kind is not None, "every envelope has a type byte"
    fields = codec.write_fields([getattr(envelope, field.name) for field in codec.layout.fields])
    text = codec.write_text(envelope.text) if isinstance(envelope, CoordinatorLog) else b""
    return bytes([codec.layout.kind]) + fields + text


def _decode_by_table(body: bytes) -> Envelope | EnvelopeFault:
    known = _TABLE.get(body[0]) if body else None
    if known is None:
        return EnvelopeFault.UNKNOWN_TYPE
    cls, codec = known
    if codec.layout.text_limit is not None:
        read = codec.read_text(body[1:])
        if isinstance(read, LayoutFault):
            return _FAULTS[read]
        values, text = read
        return cls(**_named(codec, values), text=text.decode(errors="replace"))
    values_or_fault = codec.read_fields(body[1:])
    if isinstance(values_or_fault, LayoutFault):
        return _FAULTS[values_or_fault]
    return cls(**_named(codec, values_or_fault))


def _named(codec: LayoutCodec, values: tuple[int, ...]) -> dict[str, int]:
    return {field.name: value for field, value in zip(codec.layout.fields, values, strict=True)}
