"""Commands of a Z-Stack network processor to MT bodies and back (WIRE_FORMAT.md §9.2): one table of layouts, one encoder, one decoder."""

import struct
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TypeAlias, cast

from firmware_protocol.errors import EncodeError
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.frames import Reply, Report, Request, ZnpFault
from firmware_protocol.znp.numbers import ANSWER, Command

Message: TypeAlias = Request | Reply | Report

_SIZES = {"B": 1, "H": 2, "I": 4, "Q": 8}
_COUNTED_BYTES = "*"  # one byte with the count, then so many bytes
_COUNTED_WORDS = "@"  # one byte with the count, then so many 16-bit integers
_REST = "~"  # bytes to the end
_MAY_END = "?"  # what comes after was not always there; its fields have defaults


@dataclass(frozen=True, slots=True)
class _Row:
    """A command on the wire: its class, its number and its fields, one code each."""

    kind: type[Message]
    command: int
    codes: str


_ROWS = (
    _Row(znp.ResetRequest, Command.SYS_RESET_REQ, "B"),
    _Row(znp.ResetIndication, 0x4180, "BBBBBB"),
    _Row(znp.PingRequest, Command.SYS_PING, ""),
    _Row(znp.PingReply, Command.SYS_PING | ANSWER, "H"),
    _Row(znp.VersionRequest, Command.SYS_VERSION, ""),
    _Row(znp.VersionReply, Command.SYS_VERSION | ANSWER, "BBBBB?I"),
    _Row(znp.ExtendedAddressRequest, Command.SYS_GET_EXTADDR, ""),
    _Row(znp.ExtendedAddressReply, Command.SYS_GET_EXTADDR | ANSWER, "Q"),
    _Row(znp.NvInitRequest, Command.SYS_OSAL_NV_ITEM_INIT, "HH*"),
    _Row(znp.NvReadRequest, Command.SYS_OSAL_NV_READ, "HB"),
    _Row(znp.NvReadReply, Command.SYS_OSAL_NV_READ | ANSWER, "B*"),
    _Row(znp.NvWriteRequest, Command.SYS_OSAL_NV_WRITE, "HB*"),
    _Row(znp.NvDeleteRequest, Command.SYS_OSAL_NV_DELETE, "HH"),
    _Row(znp.NvLengthRequest, Command.SYS_OSAL_NV_LENGTH, "H"),
    _Row(znp.NvLengthReply, Command.SYS_OSAL_NV_LENGTH | ANSWER, "H"),
    _Row(znp.ExtendedNvLengthRequest, Command.SYS_NV_LENGTH, "BHH"),
    _Row(znp.ExtendedNvLengthReply, Command.SYS_NV_LENGTH | ANSWER, "I"),
    _Row(znp.ExtendedNvReadRequest, Command.SYS_NV_READ, "BHHHB"),
    _Row(znp.ExtendedNvReadReply, Command.SYS_NV_READ | ANSWER, "B*"),
    _Row(znp.RegisterRequest, Command.AF_REGISTER, "BHHBB@@"),
    _Row(znp.DataRequest, Command.AF_DATA_REQUEST, "HBBHBBB*"),
    _Row(znp.DataConfirm, 0x4480, "BBB"),
    _Row(znp.IncomingMessage, 0x4481, "HHHBBBBBIB*"),
    _Row(znp.StartupRequest, Command.ZDO_STARTUP_FROM_APP, "H"),
    _Row(znp.StateChange, 0x45C0, "B"),
    _Row(znp.DeviceAnnounced, 0x45C1, "HHQB"),
    _Row(znp.DeviceTrusted, 0x45CA, "HQH"),
    _Row(znp.PermitJoinRequest, Command.ZDO_MGMT_PERMIT_JOIN_REQ, "BHBB"),
    _Row(znp.PermitJoinAnswered, 0x45B6, "HB"),
    _Row(znp.NetworkInfoRequest, Command.ZDO_EXT_NWK_INFO, ""),
    _Row(znp.NetworkInfoReply, Command.ZDO_EXT_NWK_INFO | ANSWER, "HBHHQQB"),
    _Row(znp.DeviceInfoRequest, Command.UTIL_GET_DEVICE_INFO, ""),
    _Row(znp.DeviceInfoReply, Command.UTIL_GET_DEVICE_INFO | ANSWER, "BQHBB@"),
    _Row(znp.AssociatedRequest, Command.UTIL_ASSOC_FIND_DEVICE, "B"),
    _Row(znp.AssociatedReply, Command.UTIL_ASSOC_FIND_DEVICE | ANSWER, "~"),
    _Row(znp.CommissioningRequest, Command.APP_CNF_BDB_START_COMMISSIONING, "B"),
    _Row(znp.CommissioningReport, 0x4F80, "BBB"),
    _Row(znp.SetChannelRequest, Command.APP_CNF_BDB_SET_CHANNEL, "BI"),
    _Row(znp.RequireKeyExchangeRequest, Command.APP_CNF_BDB_SET_TC_REQUIRE_KEY_EXCHANGE, "B"),
)
_BY_KIND = {row.kind: row for row in _ROWS}
_BY_COMMAND = {row.command: row for row in _ROWS}

_STATUS_ANSWERS = {
    command | ANSWER: command
    for command in Command
    if command != Command.SYS_RESET_REQ and command | ANSWER not in _BY_COMMAND
}  # fmt: skip
"""Answers that are a status alone, and what they answer."""

_RPC_ERROR = 0x6000
_INCOMING = struct.Struct("<2xHHHBBBBBIBB")
_INCOMING_PREFIX = b"\x44\x81"


def encode_command(message: Message) -> bytes:
    """Return the MT body of a command.

    Raises
    ------
    EncodeError
        A value does not fit its field.
    """
    try:
        match message:
            case znp.StatusReply(command=command, status=status):
                return struct.pack(">HB", command | ANSWER, status)
            case znp.RpcError(error=error, command=command):
                return struct.pack(">HBH", _RPC_ERROR, error, command)
            case _:
                row = _BY_KIND[type(message)]
                values = (getattr(message, one.name) for one in fields(message))
                codes = row.codes.replace(_MAY_END, "")
                parts = [_pack(code, value) for code, value in zip(codes, values, strict=True)]
                return struct.pack(">H", row.command) + b"".join(parts)
    except (struct.error, ValueError) as error:
        raise EncodeError(field=type(message).__name__, value=message, limit=str(error)) from error


def decode_command(body: bytes) -> Message | ZnpFault:
    """Return the command in an MT body, or why it is none of ``frames``."""
    if body[:2] == _INCOMING_PREFIX:
        return _decode_incoming(body)
    if len(body) < 2:
        return ZnpFault.BAD_LENGTH
    command = body[0] << 8 | body[1]
    if command == _RPC_ERROR:
        return znp.RpcError(error=body[2], command=body[3] << 8 | body[4]) if len(body) >= 5 else ZnpFault.BAD_LENGTH
    if command in _STATUS_ANSWERS:
        return znp.StatusReply(command=_STATUS_ANSWERS[command], status=body[2]) if len(body) >= 3 else ZnpFault.BAD_LENGTH
    row = _BY_COMMAND.get(command)
    if row is None:
        return ZnpFault.UNKNOWN_COMMAND
    values = _unpack(row.codes, body)
    if values is None:
        return ZnpFault.BAD_LENGTH
    names = [one.name for one in fields(row.kind)]
    return cast("Callable[..., Message]", row.kind)(**dict(zip(names, values, strict=False)))


def unpack_incoming(body: bytes) -> tuple[int, int, int, bytes] | None:
    """Return cluster, source, link quality and data of an AF_INCOMING_MSG body, or None where it is none: for bulk work."""
    if body[:2] != _INCOMING_PREFIX or len(body) < _INCOMING.size or len(body) < _INCOMING.size + body[_INCOMING.size - 1]:
        return None
    _, cluster, source, _, _, _, lqi, _, _, _, length = _INCOMING.unpack_from(body)
    return cluster, source, lqi, body[_INCOMING.size : _INCOMING.size + length]


def _decode_incoming(body: bytes) -> znp.IncomingMessage | ZnpFault:
    """Decode what comes most often, and must be fast."""
    if len(body) < _INCOMING.size or len(body) < _INCOMING.size + body[_INCOMING.size - 1]:
        return ZnpFault.BAD_LENGTH
    group, cluster, source, source_endpoint, endpoint, was_broadcast, lqi, security, timestamp, sequence, length = _INCOMING.unpack_from(
        body
    )
    return znp.IncomingMessage(
        group=group, cluster=cluster, source=source, source_endpoint=source_endpoint, destination_endpoint=endpoint,
        was_broadcast=was_broadcast, lqi=lqi, security=security, timestamp=timestamp, sequence=sequence,
        data=body[_INCOMING.size : _INCOMING.size + length],
    )  # fmt: skip


def _pack(code: str, value: int | bytes | tuple[int, ...]) -> bytes:
    if code == _REST and isinstance(value, bytes):
        return value
    if isinstance(value, bytes):
        return bytes((len(value),)) + value
    if isinstance(value, tuple):
        return struct.pack(f"<B{len(value)}H", len(value), *value)
    return struct.pack(f"<{code}", value)


def _unpack(codes: str, body: bytes) -> list[int | bytes | tuple[int, ...]] | None:
    """Return the values in a body, fewer where those after ``_MAY_END`` are missing; None where the body is too short."""
    values: list[int | bytes | tuple[int, ...]] = []
    at, may_end = 2, False
    for code in codes:
        if code == _MAY_END:
            may_end = True
            continue
        if code == _REST:
            values.append(body[at:])
            break
        is_counted = code in {_COUNTED_BYTES, _COUNTED_WORDS}
        size = 1 if is_counted else _SIZES[code]
        if may_end and at + size > len(body):
            break
        number = int.from_bytes(body[at : at + size], "little")
        end = at + size + (number * (2 if code == _COUNTED_WORDS else 1) if is_counted else 0)
        if at + size > len(body) or end > len(body):
            return None
        content = body[at + size : end]
        if code == _COUNTED_BYTES:
            values.append(content)
        elif code == _COUNTED_WORDS:
            values.append(struct.unpack(f"<{number}H", content))
        else:
            values.append(number)
        at = end
    return values


def answered_command(reply: Reply) -> int:
    """Return the ``Command`` of the request that a reply answers."""
    if isinstance(reply, znp.StatusReply | znp.RpcError):
        return reply.command
    return _BY_KIND[type(reply)].command & ~ANSWER


def command_of(request: Request) -> int:
    """Return the ``Command`` of a request."""
    return _BY_KIND[type(request)].command
