"""What base station and coordinator dongle say to each other in the native dialect (WIRE_FORMAT.md §4).

A radio payload travels inside ``RadioReceived`` and ``RadioSend``; other dialects have envelopes of their own and carry
the same payloads.
"""

import struct
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import TypeAlias

from firmware_protocol.errors import EncodeError
from firmware_protocol.units import RssiDbm, ShortAddress

BROADCAST_ADDRESS = ShortAddress(0xFFFF)


class EnvelopeFault(Enum):
    """Why a link payload is not an envelope."""

    UNKNOWN_TYPE = "unknown_envelope_type"
    BAD_LENGTH = "bad_envelope_length"


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


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyRequest:
    """Ask the coordinator who it is (§4.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoordinatorHello:
    """Say what the coordinator is and which network it runs (§4.2). Sent when asked and whenever it starts."""

    firmware: int
    eui64: int
    pan_id: int
    channel: int
    max_radio_payload: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioSend:
    """Ask the coordinator to send a radio payload (§4.3)."""

    handle: int
    destination: ShortAddress
    payload: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioConfirm:
    """Say what became of a payload (§4.4)."""

    handle: int
    status: int
    """A ``RadioStatus`` value, or one of a newer firmware."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioReceived:
    """Hand over a radio payload that came in (§4.5)."""

    source: ShortAddress
    rssi_dbm: RssiDbm
    lqi: int
    payload: bytes


Envelope: TypeAlias = IdentifyRequest | CoordinatorHello | RadioSend | RadioConfirm | RadioReceived

_TYPE = struct.Struct("<B")
_HELLO = struct.Struct("<BHQHBB")
_SEND = struct.Struct("<BHH")
_CONFIRM = struct.Struct("<BHB")
_RECEIVED = struct.Struct("<BHbB")

_IDENTIFY_TYPE = 0x10
_HELLO_TYPE = 0x11
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
            case IdentifyRequest():
                return _TYPE.pack(_IDENTIFY_TYPE)
            case CoordinatorHello():
                return _HELLO.pack(
                    _HELLO_TYPE, envelope.firmware, envelope.eui64, envelope.pan_id, envelope.channel, envelope.max_radio_payload
                )
            case RadioSend():
                return _SEND.pack(_SEND_TYPE, envelope.handle, envelope.destination) + envelope.payload
            case RadioConfirm():
                return _CONFIRM.pack(_CONFIRM_TYPE, envelope.handle, envelope.status)
            case RadioReceived():
                return _RECEIVED.pack(_RECEIVED_TYPE, envelope.source, envelope.rssi_dbm, envelope.lqi) + envelope.payload
    except struct.error as error:
        raise EncodeError(field=type(envelope).__name__, value=envelope, limit=str(error)) from error


def decode_envelope(body: bytes) -> Envelope | EnvelopeFault:
    """Return the envelope in a link payload, or why it is none."""
    try:
        match body[:1]:
            case b"\x10":
                _TYPE.unpack(body)
                return IdentifyRequest()
            case b"\x11":
                _, firmware, eui64, pan_id, channel, size = _HELLO.unpack(body)
                return CoordinatorHello(firmware=firmware, eui64=eui64, pan_id=pan_id, channel=channel, max_radio_payload=size)
            case b"\x20":
                _, handle, destination = _SEND.unpack_from(body)
                return RadioSend(handle=handle, destination=ShortAddress(destination), payload=body[_SEND.size :])
            case b"\x21":
                _, handle, status = _CONFIRM.unpack(body)
                return RadioConfirm(handle=handle, status=status)
            case b"\x22":
                _, source, rssi, lqi = _RECEIVED.unpack_from(body)
                payload = body[_RECEIVED.size :]
                return RadioReceived(source=ShortAddress(source), rssi_dbm=RssiDbm(rssi), lqi=lqi, payload=payload)
            case _:
                return EnvelopeFault.UNKNOWN_TYPE
    except struct.error:
        return EnvelopeFault.BAD_LENGTH
