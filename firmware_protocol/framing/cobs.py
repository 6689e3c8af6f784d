"""Native framing: COBS with a zero delimiter and CRC-16 (WIRE_FORMAT.md §2).

On the line: ``COBS(body + CRC-16) 00``. A sender may put a 00 in front as well, so that noise before a frame costs that
frame nothing. Pure: bytes go in, frames and faults come out; the buffer is bounded.
"""

from dataclasses import dataclass, field

from firmware_protocol.crc import append_crc, strip_crc
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameFault

MAX_BODY_SIZE = 250
"""Longest frame body [B] before CRC and stuffing (WIRE_FORMAT.md §2)."""

MAX_ENCODED_SIZE = MAX_BODY_SIZE + 2 + 1
"""Longest run between two delimiters: body, CRC, one COBS code byte (252 bytes need no second one)."""

_DELIMITER = 0
_MAX_BLOCK = 254


def encode_frame(body: bytes) -> bytes:
    """Return ``body`` as it goes over the line, with a delimiter before and after.

    Raises
    ------
    EncodeError
        ``body`` is empty or longer than ``MAX_BODY_SIZE``.
    """
    if not 1 <= len(body) <= MAX_BODY_SIZE:
        raise EncodeError(field="frame body size", value=len(body), limit=f"1 to {MAX_BODY_SIZE} bytes")
    return b"\x00" + cobs_encode(append_crc(body)) + b"\x00"


def cobs_encode(data: bytes) -> bytes:
    """Return ``data`` with every zero byte replaced, by consistent overhead byte stuffing [CB99]."""
    out = bytearray()
    for part in data.split(b"\x00"):
        rest = part
        while len(rest) >= _MAX_BLOCK:
            out.append(_MAX_BLOCK + 1)
            out += rest[:_MAX_BLOCK]
            rest = rest[_MAX_BLOCK:]
        out.append(len(rest) + 1)
        out += rest
    return bytes(out)


def cobs_decode(data: bytes) -> bytes | None:
    """Return what ``cobs_encode`` was given, or None where ``data`` is no such thing."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        end = at + code
        if code == _DELIMITER or end > len(data):
            return None
        out += data[at + 1 : end]
        if code <= _MAX_BLOCK and end < len(data):
            out.append(0)
        at = end
    if 0 in data:
        return None
    return bytes(out)


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
        for piece in complete:
            self._take(piece, results)
            if self._is_discarding:
                self._is_discarding = False
            elif self._buffer:
                results.append(_decode_body(bytes(self._buffer)))
            self._buffer.clear()
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
    stuffed = cobs_decode(encoded)
    if stuffed is None:
        return FrameFault.BAD_STUFFING
    if len(stuffed) < 3:
        return FrameFault.TOO_SHORT
    body = strip_crc(stuffed)
    return FrameFault.BAD_CRC if body is None else body
