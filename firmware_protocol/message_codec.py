"""Radio messages to bytes and back (WIRE_FORMAT.md §5 and §6): one table of types, an encoder and a decoder each.

Every payload fits ``MAX_RADIO_PAYLOAD`` bytes including its own CRC-16. What arrives is never trusted: ``decode_uplink`` and
``decode_downlink`` return a ``MessageFault`` for anything that is not a message of this version.
"""

import struct
from collections.abc import Callable
from typing import TypeVar

from firmware_protocol.crc import append_crc, strip_crc
from firmware_protocol.errors import EncodeError
from firmware_protocol.messages import (
    MAX_ENCOUNTER_MS,
    MAX_ENCOUNTERS_PER_BATCH,
    MAX_NEIGHBOURS_PER_PART,
    MAX_RADIO_PAYLOAD,
    PROTOCOL_VERSION,
    Acknowledge,
    Action,
    Downlink,
    EncounterBatch,
    EncounterEntry,
    Hello,
    HelloRequest,
    MessageFault,
    Neighbour,
    Neighbours,
    Status,
    Stimulate,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    TimeSyncRequest,
    Uplink,
    UplinkHeader,
    WireCause,
    WireMode,
)
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm

_MessageT = TypeVar("_MessageT")

# --- layouts --------------------------------------------------------------------------------------------------------

_UPLINK_HEADER = struct.Struct("<BBHHHI")  # type, version, node, boot, sequence, sent_ms (§5.1)
_DOWNLINK_HEADER = struct.Struct("<BBH")  # type, version, sequence (§6.1)
_HELLO = struct.Struct("<QHHH")  # eui64, firmware, beacon_period_ms, capabilities (§5.2)
_ENCOUNTER = struct.Struct("<HIBHb")  # peer, start_ms, flags and high bits of duration, low bits, rssi (§5.3)
_STATUS = struct.Struct("<BBIHHH")  # mode, cause, mode_since_ms, battery_mv, buffered, dropped (§5.4)
_NEIGHBOURS = struct.Struct("<BB")  # part, n_parts (§5.5)
_NEIGHBOUR = struct.Struct("<Hb")  # node, rssi (§5.5)
_TIME_SYNC_REPLY = struct.Struct("<HI")  # token, received_ms (§5.6)
_STIMULATE_REPLY = struct.Struct("<IBIB")  # command, result, executed_ms, mode (§5.7)
_ACKNOWLEDGE = struct.Struct("<HHI")  # boot, next_sequence, bitmap (§6.3)
_TIME_SYNC_REQUEST = struct.Struct("<H")  # token (§6.4)
_STIMULATE = struct.Struct("<IBHIBHHH")  # command, action, ttl, hold, frequency, width, amplitude, duration (§6.5)
_ONGOING_BIT = 0x80


def encode_uplink(header: UplinkHeader, message: Uplink) -> bytes:
    """Return the radio payload of an uplink message.

    Raises
    ------
    EncodeError
        A value does not fit its field, or a list its message.
    """
    kind, encode = _UPLINK_ENCODERS[type(message)]
    head = _pack(_UPLINK_HEADER, "header", kind, PROTOCOL_VERSION, header.node, header.boot, header.sequence, header.sent_ms)
    return append_crc(head + encode(message))


def decode_uplink(payload: bytes) -> tuple[UplinkHeader, Uplink] | MessageFault:
    """Return header and message of a radio payload from a backpack, or why it is none."""
    body = _checked(payload, _UPLINK_HEADER)
    if isinstance(body, MessageFault):
        return body
    kind, _, node, boot, sequence, sent_ms = _UPLINK_HEADER.unpack_from(body)
    decode = _UPLINK_DECODERS.get(kind)
    if decode is None:
        return MessageFault.UNKNOWN_TYPE
    message = _decoded(decode, body[_UPLINK_HEADER.size :])
    if isinstance(message, MessageFault):
        return message
    return UplinkHeader(node=NodeId(node), boot=BootId(boot), sequence=sequence, sent_ms=Milliseconds(sent_ms)), message


def encode_downlink(sequence: int, message: Downlink) -> bytes:
    """Return the radio payload of a downlink message.

    Raises
    ------
    EncodeError
        A value does not fit its field.
    """
    kind, encode = _DOWNLINK_ENCODERS[type(message)]
    return append_crc(_pack(_DOWNLINK_HEADER, "header", kind, PROTOCOL_VERSION, sequence) + encode(message))


def decode_downlink(payload: bytes) -> tuple[int, Downlink] | MessageFault:
    """Return sequence number and message of a radio payload from the base station, or why it is none."""
    body = _checked(payload, _DOWNLINK_HEADER)
    if isinstance(body, MessageFault):
        return body
    kind, _, sequence = _DOWNLINK_HEADER.unpack_from(body)
    decode = _DOWNLINK_DECODERS.get(kind)
    if decode is None:
        return MessageFault.UNKNOWN_TYPE
    message = _decoded(decode, body[_DOWNLINK_HEADER.size :])
    return message if isinstance(message, MessageFault) else (sequence, message)


def _checked(payload: bytes, header: struct.Struct) -> bytes | MessageFault:
    if len(payload) > MAX_RADIO_PAYLOAD:
        return MessageFault.TOO_LONG
    body = strip_crc(payload)
    if body is None:
        return MessageFault.BAD_CRC
    if len(body) < header.size:
        return MessageFault.BAD_LENGTH
    if body[1] != PROTOCOL_VERSION:
        return MessageFault.UNKNOWN_VERSION
    return body


def _decoded(decode: Callable[[bytes], _MessageT], body: bytes) -> _MessageT | MessageFault:
    try:
        return decode(body)
    except struct.error:
        return MessageFault.BAD_LENGTH
    except ValueError:
        return MessageFault.BAD_VALUE


def _pack(layout: struct.Struct, name: str, *values: int) -> bytes:
    try:
        return layout.pack(*values)
    except struct.error as error:
        raise EncodeError(field=name, value=values, limit=f"layout {layout.format!r} ({error})") from error


def _encode_hello(message: Hello) -> bytes:
    return _pack(_HELLO, "hello", message.eui64, message.firmware, message.beacon_period_ms, message.capabilities)


def _decode_hello(body: bytes) -> Hello:
    eui64, firmware, beacon_period_ms, capabilities = _HELLO.unpack(body)
    return Hello(eui64=eui64, firmware=firmware, beacon_period_ms=beacon_period_ms, capabilities=capabilities)


def _encode_encounters(message: EncounterBatch) -> bytes:
    if not 1 <= len(message.entries) <= MAX_ENCOUNTERS_PER_BATCH:
        raise EncodeError(field="encounter batch", value=len(message.entries), limit=f"1 to {MAX_ENCOUNTERS_PER_BATCH} entries")
    out = b""
    for entry in message.entries:
        if not 0 <= entry.duration_ms <= MAX_ENCOUNTER_MS:
            raise EncodeError(field="duration_ms", value=entry.duration_ms, limit=f"0 to {MAX_ENCOUNTER_MS}")
        high = (entry.duration_ms >> 16) | (_ONGOING_BIT if entry.is_ongoing else 0)
        out += _pack(_ENCOUNTER, "encounter", entry.peer, entry.start_ms, high, entry.duration_ms & 0xFFFF, entry.rssi_dbm)
    return out


def _decode_encounters(body: bytes) -> EncounterBatch:
    if not body or len(body) % _ENCOUNTER.size or len(body) > MAX_ENCOUNTERS_PER_BATCH * _ENCOUNTER.size:
        raise struct.error
    entries = []
    for peer, start_ms, high, low, rssi in _ENCOUNTER.iter_unpack(body):
        entries.append(
            EncounterEntry(
                peer=NodeId(peer),
                start_ms=Milliseconds(start_ms),
                duration_ms=Milliseconds((high & 0x3F) << 16 | low),
                rssi_dbm=RssiDbm(rssi),
                is_ongoing=bool(high & _ONGOING_BIT),
            )
        )
    return EncounterBatch(entries=tuple(entries))


def _encode_status(message: Status) -> bytes:
    return _pack(
        _STATUS, "status", message.mode, message.cause, message.mode_since_ms, message.battery_mv, message.buffered, message.dropped
    )


def _decode_status(body: bytes) -> Status:
    mode, cause, mode_since_ms, battery_mv, buffered, dropped = _STATUS.unpack(body)
    return Status(
        mode=WireMode(mode),
        cause=WireCause(cause),
        mode_since_ms=Milliseconds(mode_since_ms),
        battery_mv=battery_mv,
        buffered=buffered,
        dropped=dropped,
    )


def _encode_neighbours(message: Neighbours) -> bytes:
    if len(message.neighbours) > MAX_NEIGHBOURS_PER_PART:
        raise EncodeError(field="neighbours", value=len(message.neighbours), limit=f"at most {MAX_NEIGHBOURS_PER_PART} a part")
    if not 0 <= message.part < message.n_parts:
        raise EncodeError(field="part", value=message.part, limit=f"0 to n_parts - 1 = {message.n_parts - 1}")
    out = _pack(_NEIGHBOURS, "neighbours", message.part, message.n_parts)
    return out + b"".join(_pack(_NEIGHBOUR, "neighbour", one.node, one.rssi_dbm) for one in message.neighbours)


def _decode_neighbours(body: bytes) -> Neighbours:
    part, n_parts = _NEIGHBOURS.unpack_from(body)
    rest = body[_NEIGHBOURS.size :]
    if len(rest) % _NEIGHBOUR.size or len(rest) > MAX_NEIGHBOURS_PER_PART * _NEIGHBOUR.size:
        raise struct.error
    if part >= n_parts:
        msg = f"part {part} of {n_parts}"
        raise ValueError(msg)
    neighbours = tuple(Neighbour(node=NodeId(node), rssi_dbm=RssiDbm(rssi)) for node, rssi in _NEIGHBOUR.iter_unpack(rest))
    return Neighbours(part=part, n_parts=n_parts, neighbours=neighbours)


def _encode_time_sync_reply(message: TimeSyncReply) -> bytes:
    return _pack(_TIME_SYNC_REPLY, "time sync reply", message.token, message.received_ms)


def _decode_time_sync_reply(body: bytes) -> TimeSyncReply:
    token, received_ms = _TIME_SYNC_REPLY.unpack(body)
    return TimeSyncReply(token=token, received_ms=Milliseconds(received_ms))


def _encode_stimulate_reply(message: StimulateReply) -> bytes:
    return _pack(_STIMULATE_REPLY, "stimulate reply", message.command, message.result, message.executed_ms, message.mode)


def _decode_stimulate_reply(body: bytes) -> StimulateReply:
    command, result, executed_ms, mode = _STIMULATE_REPLY.unpack(body)
    return StimulateReply(command=command, result=StimulationResult(result), executed_ms=Milliseconds(executed_ms), mode=WireMode(mode))


def _encode_hello_request(_message: HelloRequest) -> bytes:
    return b""


def _decode_hello_request(body: bytes) -> HelloRequest:
    if body:
        raise struct.error
    return HelloRequest()


def _encode_acknowledge(message: Acknowledge) -> bytes:
    return _pack(_ACKNOWLEDGE, "acknowledge", message.boot, message.next_sequence, message.bitmap)


def _decode_acknowledge(body: bytes) -> Acknowledge:
    boot, next_sequence, bitmap = _ACKNOWLEDGE.unpack(body)
    return Acknowledge(boot=BootId(boot), next_sequence=next_sequence, bitmap=bitmap)


def _encode_time_sync_request(message: TimeSyncRequest) -> bytes:
    return _pack(_TIME_SYNC_REQUEST, "time sync request", message.token)


def _decode_time_sync_request(body: bytes) -> TimeSyncRequest:
    (token,) = _TIME_SYNC_REQUEST.unpack(body)
    return TimeSyncRequest(token=token)


def _encode_stimulate(message: Stimulate) -> bytes:
    return _pack(
        _STIMULATE,
        "stimulate",
        message.command,
        message.action,
        message.ttl_ms,
        message.hold_ms,
        message.frequency_hz,
        message.pulse_width_us,
        message.amplitude_mv,
        message.duration_ms,
    )


def _decode_stimulate(body: bytes) -> Stimulate:
    command, action, ttl_ms, hold_ms, frequency_hz, pulse_width_us, amplitude_mv, duration_ms = _STIMULATE.unpack(body)
    return Stimulate(
        command=command,
        action=Action(action),
        ttl_ms=ttl_ms,
        hold_ms=hold_ms,
        frequency_hz=frequency_hz,
        pulse_width_us=pulse_width_us,
        amplitude_mv=amplitude_mv,
        duration_ms=duration_ms,
    )


# The one table of types. The annotations are loose because a table of different functions has no common argument type.
_UPLINK_TYPES: tuple[tuple[int, type, Callable[..., bytes], Callable[[bytes], Uplink]], ...] = (
    (0x01, Hello, _encode_hello, _decode_hello),
    (0x02, EncounterBatch, _encode_encounters, _decode_encounters),
    (0x03, Status, _encode_status, _decode_status),
    (0x04, Neighbours, _encode_neighbours, _decode_neighbours),
    (0x05, TimeSyncReply, _encode_time_sync_reply, _decode_time_sync_reply),
    (0x06, StimulateReply, _encode_stimulate_reply, _decode_stimulate_reply),
)
_DOWNLINK_TYPES: tuple[tuple[int, type, Callable[..., bytes], Callable[[bytes], Downlink]], ...] = (
    (0x81, HelloRequest, _encode_hello_request, _decode_hello_request),
    (0x82, Acknowledge, _encode_acknowledge, _decode_acknowledge),
    (0x83, TimeSyncRequest, _encode_time_sync_request, _decode_time_sync_request),
    (0x84, Stimulate, _encode_stimulate, _decode_stimulate),
)
_UPLINK_ENCODERS = {cls: (kind, encode) for kind, cls, encode, _ in _UPLINK_TYPES}
_UPLINK_DECODERS = {kind: decode for kind, _, _, decode in _UPLINK_TYPES}
_DOWNLINK_ENCODERS = {cls: (kind, encode) for kind, cls, encode, _ in _DOWNLINK_TYPES}
_DOWNLINK_DECODERS = {kind: decode for kind, _, _, decode in _DOWNLINK_TYPES}
