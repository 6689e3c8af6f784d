"""What every dialect's framing offers: bytes go in, frame bodies and faults come out."""

from enum import Enum
from typing import Protocol


class FrameFault(Enum):
    """What was wrong with bytes that did not make a frame."""

    BAD_CRC = "bad_crc"
    """The frame's checksum, of whatever width its dialect has, does not fit."""
    BAD_STUFFING = "bad_stuffing"
    TOO_SHORT = "too_short"
    TOO_LONG = "too_long"
    NOISE = "noise"
    """A run of bytes outside any frame."""
    INCOMPLETE = "incomplete"
    """A part of a message that goes in several is missing, or came out of order."""


class FrameDecoder(Protocol):
    """Cuts a byte stream into frame bodies.

    Any chunking of the stream gives the same result. The memory is bounded by the longest frame. After damage it looks for the next frame
    one byte behind the place where it thought one began: a damaged frame costs itself alone.
    """

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        """Take the next bytes of the stream; return the bodies and faults they complete, in order."""
        ...
