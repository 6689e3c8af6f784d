"""A coordinator on a CAN bus, looked at from beside the line: link frames in CAN frames (WIRE_FORMAT.md §10)."""

import struct
from functools import partial

from firmware_protocol.framing.can import CanDecoder
from firmware_protocol.framing.can_frame import CanFrame, RecordReader
from firmware_protocol.framing.interface import FrameFault
from gateway.recordings.dissection import Dialect
from gateway.recordings.native_line import dissect_native

# LINKTYPE_CAN_SOCKETCAN (tcpdump.org/linktypes/LINKTYPE_CAN_SOCKETCAN.html): as struct can_frame, with the identifier high byte first.
_HEADER = struct.Struct(">IBBBB")
_EXTENDED = 0x80000000
_FD, _BIT_RATE_SWITCH = 0x04, 0x01


def capture_bytes(frame: CanFrame) -> bytes:
    """Return a CAN frame as a capture has it."""
    flags = _FD | _BIT_RATE_SWITCH if frame.is_fd else 0
    return _HEADER.pack(frame.can_id | _EXTENDED, len(frame.data), flags, 0, 0) + frame.data


class CanCutter:
    """Cuts one direction of a CAN line into its frames, for captures; see ``RecordReader``."""

    def __init__(self) -> None:
        self._reader = RecordReader()

    def feed(self, chunk: bytes) -> list[tuple[bytes, str]]:
        """Take the next bytes; return each frame as a capture has it, with its fault, or nothing and a fault."""
        return [
            (b"", f"frame.{one.value}") if isinstance(one, FrameFault) else (capture_bytes(one), "") for one in self._reader.feed(chunk)
        ]


def can_dialect(unit: int | None) -> Dialect:
    """Return how a unit's line is looked at, or that of all units of a bus."""
    return Dialect(make_decoder=partial(CanDecoder, unit=unit), dissect=dissect_native, make_cutter=CanCutter)
