"""CAN frames of a coordinator, and a CAN line as bytes (WIRE_FORMAT.md §10.1 and §10.2).

All of the system sees a line as bytes. Of a CAN line these are records in the form of Linux's ``struct can_frame`` (16 B) and
``struct canfd_frame`` (72 B) of ``<linux/can.h>``, little-endian, so that recording, replay and fault injection work as on any line.
"""

import struct
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from firmware_protocol.crc import crc6
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameFault

MAX_UNIT = 31
MAX_CLASSIC_DATA = 8
MAX_FD_DATA = 64
FD_SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Octets of data that a CAN FD frame can have [B] (ISO 11898-1, DLC 0 to 15)."""

CONFIGURATION_KIND = 7
"""Stands in the identifier's kind for an ISO-TP frame (§10.4); the link's kinds are 1 to 6."""

CLASSIC_RECORD = 16
FD_RECORD = 72
"""Sizes of a record [B]."""

_HEADER = struct.Struct("<IBBBB")  # can_id, len, flags, res0, res1; of a classic frame flags is padding and res1 is len8_dlc
_EFF_FLAG = 0x80000000  # <linux/can.h>: 29-bit identifier
_BRS, _ESI, _FDF = 0x01, 0x02, 0x04  # <linux/can.h>: second bit rate, error state indicator, this is a CAN FD frame
_FD_FLAGS = frozenset({_FDF, _FDF | _BRS, _FDF | _ESI, _FDF | _BRS | _ESI})
_ZEROS = bytes(MAX_FD_DATA)


class Direction(IntEnum):
    """Which way a frame goes; 0 wins the bus."""

    TO_COORDINATOR = 0
    FROM_COORDINATOR = 1


class CanId(NamedTuple):
    """The fields of an identifier (§10.1), most significant first; the six bits of the checksum follow them."""

    priority: int
    direction: int
    unit: int
    kind: int
    sequence: int
    part: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CanFrame:
    """A data frame with a 29-bit identifier; ``data`` has at most 8 bytes, of CAN FD one of ``FD_SIZES``."""

    can_id: int
    data: bytes
    is_fd: bool = False

    @property
    def fields(self) -> CanId:
        """The identifier, taken apart."""
        one = self.can_id
        return CanId(one >> 27, one >> 26 & 1, one >> 21 & 31, one >> 18 & 7, one >> 10 & 0xFF, one >> 6 & 15)


def make_frame(fields: CanId, data: bytes, *, is_fd: bool) -> CanFrame:
    """Return a frame of the link, with its checksum."""
    priority, direction, unit, kind, sequence, part = fields
    upper = priority << 21 | direction << 20 | unit << 15 | kind << 12 | sequence << 4 | part
    return CanFrame(can_id=upper << 6 | crc6(upper.to_bytes(3, "big") + data), data=data, is_fd=is_fd)


def configuration_id(*, unit: int, direction: Direction) -> int:
    """Return the identifier of a unit's ISO-TP frames in one direction (§10.4); sequence, part and checksum are 0."""
    return 3 << 27 | direction << 26 | unit << 21 | CONFIGURATION_KIND << 18


def is_sound(frame: CanFrame) -> bool:
    """Return whether a frame can be a coordinator's: its kind is one there is, and its checksum fits where it has one."""
    kind = frame.can_id >> 18 & 7
    if kind == CONFIGURATION_KIND:
        return not frame.is_fd and frame.can_id >> 27 == 3 and not frame.can_id & 0x3FFFF
    return kind != 0 and frame.can_id & 63 == crc6((frame.can_id >> 6).to_bytes(3, "big") + frame.data)


def encode_record(frame: CanFrame) -> bytes:
    """Return a frame as it stands on the line, 16 or 72 bytes.

    Raises
    ------
    EncodeError
        The data has a size that no such frame can have.
    """
    size = len(frame.data)
    if frame.is_fd:
        if size not in FD_SIZES:
            raise EncodeError(field="CAN FD data size", value=size, limit=f"one of {FD_SIZES}")
        return _HEADER.pack(frame.can_id | _EFF_FLAG, size, _FDF | _BRS, 0, 0) + frame.data + _ZEROS[size:]
    if size > MAX_CLASSIC_DATA:
        raise EncodeError(field="CAN data size", value=size, limit=f"0 to {MAX_CLASSIC_DATA} bytes")
    return _HEADER.pack(frame.can_id | _EFF_FLAG, size, 0, 0, 0) + frame.data + _ZEROS[size:MAX_CLASSIC_DATA]


@dataclass(slots=True, kw_only=True)
class RecordReader:
    """Cut a CAN line's bytes into frames.

    Any chunking gives the same result. Bytes that are no record of a sound frame are passed over one by one until they are; a run of them
    is one fault. Never holds more than one record.
    """

    _buffer: bytes = field(default=b"")
    _is_lost: bool = False

    def feed(self, chunk: bytes) -> list[CanFrame | FrameFault]:
        """Take the next bytes of the line; return the frames and faults they complete, in order."""
        results: list[CanFrame | FrameFault] = []
        data = self._buffer + chunk if self._buffer else chunk
        at, end = 0, len(data)
        while end - at >= _HEADER.size:
            size = _record_size(data, at)
            if end - at < size:
                break
            frame = _read_record(data, at, size) if size else None
            if frame is not None:
                results.append(frame)
                self._is_lost = False
                at += size
                continue
            if not self._is_lost:
                self._is_lost = True
                results.append(FrameFault.BAD_CRC if size else FrameFault.NOISE)
            at += 1
        self._buffer = data[at:]
        return results


def _record_size(data: bytes, at: int) -> int:
    """Return how long the record that begins here is [B]; 0: none can begin here."""
    can_id, size, flags, reserved, more = _HEADER.unpack_from(data, at)
    if can_id >> 29 != _EFF_FLAG >> 29 or reserved or more:
        return 0
    if flags == 0:
        return CLASSIC_RECORD if size <= MAX_CLASSIC_DATA else 0
    return FD_RECORD if flags in _FD_FLAGS and size in FD_SIZES else 0


def _read_record(data: bytes, at: int, size: int) -> CanFrame | None:
    start = at + _HEADER.size
    end = start + data[at + 4]
    if any(data[end : at + size]):
        return None
    can_id = int.from_bytes(data[at : at + 4], "little") & ~_EFF_FLAG
    frame = CanFrame(can_id=can_id, data=bytes(data[start:end]), is_fd=size == FD_RECORD)
    return frame if is_sound(frame) else None
