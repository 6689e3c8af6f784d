"""Digi XBee API frames as values (WIRE_FORMAT.md §8.2): what the host says, what the module says, and the bytes of both.

Integers go high byte first. Layouts from Digi's user guides 90002002 (XBee/XBee-PRO S2C Zigbee) and 90001539 (XBee 3 Zigbee), "API frames".
What a frame means is in ``xbee_meanings.py``.
"""

import struct
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from firmware_protocol.errors import EncodeError

BROADCAST64 = 0xFFFF
"""64-bit destination that stands for all."""
UNKNOWN64 = 0xFFFF_FFFF_FFFF_FFFF
COORDINATOR64 = 0
"""What a ZigBee network calls its coordinator, whichever that is."""
UNKNOWN16 = 0xFFFE
"""16-bit address that is not known, or that the module's protocol does not have (DigiMesh)."""

DATA_ENDPOINT = 0xE8
DATA_CLUSTER = 0x0011
DIGI_PROFILE = 0xC105
ZDO_PROFILE = 0x0000
"""Profile of the ZigBee stack's own messages, which a module with ``AO`` = 3 hands up too."""

AT_OK = 0
AT_ERROR = 1
AT_BAD_COMMAND = 2
AT_BAD_PARAMETER = 3


class XBeeFault(Enum):
    """Why a frame's data is no frame that we know."""

    UNKNOWN_TYPE = "unknown_frame_type"
    BAD_LENGTH = "bad_frame_length"


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoints:
    """Where in a node a payload belongs: ZigBee's application addressing."""

    source: int = DATA_ENDPOINT
    destination: int = DATA_ENDPOINT
    cluster: int = DATA_CLUSTER
    profile: int = DIGI_PROFILE


@dataclass(frozen=True, slots=True, kw_only=True)
class AtCommand:
    """Ask for a parameter, set it, or have something done (0x08). ``frame_id`` 0 asks for no answer.

    What is set by a queued command (0x09) takes effect with ``AC`` or the next command that is not queued.
    """

    frame_id: int
    command: str
    value: bytes = b""
    is_queued: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AtResponse:
    """Answer an AT command (0x88)."""

    frame_id: int
    command: str
    status: int
    value: bytes = b""


@dataclass(frozen=True, slots=True, kw_only=True)
class TransmitRequest:
    """Send RF data (0x10; 0x11 where ``endpoints`` are given). ``frame_id`` 0 asks for no status."""

    frame_id: int
    destination64: int
    destination16: int
    payload: bytes
    radius: int = 0
    options: int = 0
    endpoints: Endpoints | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TransmitStatus:
    """Say what became of a transmit request (0x8B). ``destination16`` is where it was delivered; 0xFFFD or 0xFFFE: not known."""

    frame_id: int
    destination16: int
    retries: int
    delivery: int
    discovery: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ModemStatus:
    """Say what happened to the module (0x8A)."""

    status: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Receive:
    """Hand over RF data (0x90; 0x91 where ``endpoints`` are given)."""

    source64: int
    source16: int
    options: int
    payload: bytes
    endpoints: Endpoints | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeIdentification:
    """Say that a node has joined or was made to identify itself (0x95)."""

    sender64: int
    sender16: int
    options: int
    node16: int
    node64: int
    name: bytes
    parent16: int
    kind: int
    """0 coordinator, 1 router, 2 end device."""
    event: int
    """1 button, 2 joining, 3 power cycle."""
    profile: int = DIGI_PROFILE
    manufacturer: int = 0x101E


ToModule: TypeAlias = AtCommand | TransmitRequest
FromModule: TypeAlias = AtResponse | TransmitStatus | ModemStatus | Receive | NodeIdentification
Frame: TypeAlias = ToModule | FromModule

_COMMAND = struct.Struct(">BB2s")
_RESPONSE = struct.Struct(">BB2sB")
_REQUEST = struct.Struct(">BBQHBB")
_EXPLICIT_REQUEST = struct.Struct(">BBQHBBHHBB")
_STATUS = struct.Struct(">BBHBBB")
_MODEM = struct.Struct(">BB")
_RECEIVE = struct.Struct(">BQHB")
_RECEIVE_FIELDS = struct.Struct(">xQHB")
_EXPLICIT_RECEIVE = struct.Struct(">BQHBBHHB")
_IDENTIFICATION = struct.Struct(">BQHBHQ")
_IDENTIFICATION_END = struct.Struct(">HBBHH")


def encode_xbee(frame: Frame) -> bytes:
    """Return the frame data of a frame.

    Raises
    ------
    EncodeError
        A value does not fit its field.
    """
    try:
        if isinstance(frame, AtCommand | TransmitRequest):
            return _encode_to_module(frame)
        return _encode_from_module(frame)
    except struct.error as error:
        raise EncodeError(field=type(frame).__name__, value=frame, limit=str(error)) from error


def decode_xbee(body: bytes) -> Frame | XBeeFault:
    """Return the frame in a body, or why it is none that we know."""
    try:
        match body[:1]:
            case b"\x90":
                return _decode_receive(body)
            case b"\x8b":
                _, frame_id, destination16, retries, delivery, discovery = _STATUS.unpack(body)
                return TransmitStatus(
                    frame_id=frame_id, destination16=destination16, retries=retries, delivery=delivery, discovery=discovery
                )
            case b"\x91":
                return _decode_explicit_receive(body)
            case b"\x88":
                _, frame_id, name, status = _RESPONSE.unpack_from(body)
                return AtResponse(frame_id=frame_id, command=name.decode("latin-1"), status=status, value=body[_RESPONSE.size :])
            case b"\x8a":
                return ModemStatus(status=_MODEM.unpack(body)[1])
            case b"\x95":
                return _decode_identification(body)
            case _:
                return _decode_to_module(body)
    except struct.error:
        return XBeeFault.BAD_LENGTH


def unpack_receive(body: bytes) -> tuple[int, int, int, bytes] | None:
    """Return source64, source16, options and payload of a 0x90 body, or None where it is none: for bulk work."""
    if len(body) < _RECEIVE.size or body[0] != 0x90:
        return None
    source64, source16, options = _RECEIVE_FIELDS.unpack_from(body)
    return source64, source16, options, body[12:]


def _encode_to_module(frame: ToModule) -> bytes:
    if isinstance(frame, AtCommand):
        return _COMMAND.pack(0x09 if frame.is_queued else 0x08, frame.frame_id, _name(frame.command)) + frame.value
    where = (frame.frame_id, frame.destination64, frame.destination16)
    ends = frame.endpoints
    if ends is None:
        return _REQUEST.pack(0x10, *where, frame.radius, frame.options) + frame.payload
    head = (ends.source, ends.destination, ends.cluster, ends.profile, frame.radius, frame.options)
    return _EXPLICIT_REQUEST.pack(0x11, *where, *head) + frame.payload


def _encode_from_module(frame: FromModule) -> bytes:
    match frame:
        case AtResponse():
            return _RESPONSE.pack(0x88, frame.frame_id, _name(frame.command), frame.status) + frame.value
        case TransmitStatus():
            return _STATUS.pack(0x8B, frame.frame_id, frame.destination16, frame.retries, frame.delivery, frame.discovery)
        case ModemStatus():
            return _MODEM.pack(0x8A, frame.status)
        case Receive():
            return _encode_receive(frame)
    return _encode_identification(frame)


def _encode_receive(frame: Receive) -> bytes:
    ends = frame.endpoints
    if ends is None:
        return _RECEIVE.pack(0x90, frame.source64, frame.source16, frame.options) + frame.payload
    head = (ends.source, ends.destination, ends.cluster, ends.profile, frame.options)
    return _EXPLICIT_RECEIVE.pack(0x91, frame.source64, frame.source16, *head) + frame.payload


def _decode_receive(body: bytes) -> Receive:
    _, source64, source16, options = _RECEIVE.unpack_from(body)
    return Receive(source64=source64, source16=source16, options=options, payload=body[_RECEIVE.size :])


def _decode_explicit_receive(body: bytes) -> Receive:
    _, source64, source16, source, destination, cluster, profile, options = _EXPLICIT_RECEIVE.unpack_from(body)
    endpoints = Endpoints(source=source, destination=destination, cluster=cluster, profile=profile)
    payload = body[_EXPLICIT_RECEIVE.size :]
    return Receive(source64=source64, source16=source16, options=options, payload=payload, endpoints=endpoints)


def _decode_to_module(body: bytes) -> ToModule | XBeeFault:
    match body[:1]:
        case b"\x08" | b"\x09":
            kind, frame_id, name = _COMMAND.unpack_from(body)
            return AtCommand(frame_id=frame_id, command=name.decode("latin-1"), value=body[_COMMAND.size :], is_queued=kind == 0x09)
        case b"\x10":
            _, frame_id, destination64, destination16, radius, options = _REQUEST.unpack_from(body)
            endpoints, payload = None, body[_REQUEST.size :]
        case b"\x11":
            _, frame_id, destination64, destination16, source, destination, cluster, profile, radius, options = (
                _EXPLICIT_REQUEST.unpack_from(body)
            )
            endpoints = Endpoints(source=source, destination=destination, cluster=cluster, profile=profile)
            payload = body[_EXPLICIT_REQUEST.size :]
        case _:
            return XBeeFault.UNKNOWN_TYPE
    return TransmitRequest(
        frame_id=frame_id, destination64=destination64, destination16=destination16, payload=payload, radius=radius, options=options,
        endpoints=endpoints,
    )  # fmt: skip


def _encode_identification(frame: NodeIdentification) -> bytes:
    if b"\x00" in frame.name:
        raise EncodeError(field="node identifier", value=frame.name, limit="text without a zero byte")
    head = _IDENTIFICATION.pack(0x95, frame.sender64, frame.sender16, frame.options, frame.node16, frame.node64)
    end = _IDENTIFICATION_END.pack(frame.parent16, frame.kind, frame.event, frame.profile, frame.manufacturer)
    return head + frame.name + b"\x00" + end


def _decode_identification(body: bytes) -> NodeIdentification | XBeeFault:
    _, sender64, sender16, options, node16, node64 = _IDENTIFICATION.unpack_from(body)
    name, zero, end = body[_IDENTIFICATION.size :].partition(b"\x00")
    if not zero:
        return XBeeFault.BAD_LENGTH
    parent16, kind, event, profile, manufacturer = _IDENTIFICATION_END.unpack_from(end)  # NO may append more
    return NodeIdentification(
        sender64=sender64, sender16=sender16, options=options, node16=node16, node64=node64, name=name, parent16=parent16, kind=kind,
        event=event, profile=profile, manufacturer=manufacturer,
    )  # fmt: skip


def _name(command: str) -> bytes:
    encoded = command.encode("latin-1", "replace")
    if len(encoded) != 2:
        raise EncodeError(field="AT command", value=command, limit="two characters")
    return encoded
