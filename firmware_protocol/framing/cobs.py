"""Native framing: COBS with a zero delimiter and CRC-16 (WIRE_FORMAT.md §2).

On the line: ``COBS(body + CRC-16) 00``. A sender may put a 00 in front as well, so that noise before a frame costs that
frame nothing. Pure: bytes go in, frames and faults come out; the buffer is bounded. The stuffing itself is the ``cobs`` package's, which
is in C where it can be and has the verdicts of the plain decoder in the tests.
"""

from binascii import crc_hqx
from dataclasses import dataclass, field

from cobs import cobs

from firmware_protocol.crc import CRC_INITIAL, CRC_SIZE, append_crc
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameFault

MAX_BODY_SIZE = 250
"""Longest frame body [B] before CRC and stuffing (WIRE_FORMAT.md §2)."""

MAX_ENCODED_SIZE = MAX_BODY_SIZE + 2 + 1
"""Longest run between two delimiters: body, CRC, one COBS code byte (252 bytes need no second one)."""

MIN_DECODED_SIZE = 1 + CRC_SIZE


def encode_frame(body: bytes) -> bytes:
    """Return ``body`` as it goes over the line, with a delimiter before and after.

    Raises
    ------
    EncodeError
        ``body`` is empty or longer than ``MAX_BODY_SIZE``.
    """
    if not 1 <= len(body) <= MAX_BODY_SIZE:
        raise EncodeError(field="frame body size", value=len(body), limit=f"1 to {MAX_BODY_SIZE} bytes")
    stuffed: bytes = cobs.encode(append_crc(body))
    return b"\x00" + stuffed + b"\x00"


@dataclass(slots=True, kw_only=True)
class CobsDecoder:
    """Cut a byte stream into frame bodies.

    Any chunking of the stream gives the same result. A damaged frame costs itself alone: decoding starts anew at the next
    delimiter. Never holds more than ``MAX_ENCODED_SIZE`` bytes.
    """

    _buffer: bytearray = field(default_factory=bytearray)
    _is_discarding: bool = False

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        """Take the next bytes of the stream; return the bodies and faults they complete, in order."""
        results: list[bytes | FrameFault] = []
        *complete, rest = chunk.split(b"\x00")
        if complete and (self._buffer or self._is_discarding):
            self._take(complete[0], results)
            if self._buffer:
                results.append(_decode_body(bytes(self._buffer)))
                self._buffer.clear()
            self._is_discarding = False
            del complete[0]
        for piece in complete:
            if len(piece) > MAX_ENCODED_SIZE:
                results.append(FrameFault.TOO_LONG)
            elif piece:
                results.append(_decode_body(piece))
        self._take(rest, results)
        return results

    def _take(self, piece: bytes, results: list[bytes | FrameFault]) -> None:
        if self._is_discarding:
            return
        if len(self._buffer) + len(piece) > MAX_ENCODED_SIZE:
            self._buffer.clear()
            self._is_discarding = True
            results.append(FrameFault.TOO_LONG)
        else:
            self._buffer += piece


def _decode_body(encoded: bytes) -> bytes | FrameFault:
    try:
        stuffed: bytes = cobs.decode(encoded)
    except cobs.DecodeError:
        return FrameFault.BAD_STUFFING
    if len(stuffed) < MIN_DECODED_SIZE:
        return FrameFault.TOO_SHORT
    return (
        FrameFault.BAD_CRC if crc_hqx(stuffed, CRC_INITIAL) else stuffed[:-CRC_SIZE]
    )  # a CRC without final XOR of data and its own CRC is zero
