"""Digi XBee API framing, modes 1 and 2 (WIRE_FORMAT.md §8.1).

On the line: ``7E length16 data sum8``; length, high byte first, and checksum are those of the data without escapes, and all bytes of data
and checksum together sum to 0xFF modulo 256. In mode 2 (``AP=2``) each 7E, 7D, 11 and 13 after the first byte goes as 7D and the byte XOR
0x20, so that a bare 7E always begins a frame. From Digi's XBee/XBee-PRO S2C Zigbee user guide (90002002), "API frame structure".

A *body* is the data: frame type and what follows it. Pure: bytes go in, bodies and faults come out; the buffers are bounded. A length above
``MAX_BODY_SIZE`` is damage, so that a damaged length does not swallow what follows.
"""

import re
from dataclasses import dataclass
from zlib import adler32

from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameDecoder, FrameFault

MAX_BODY_SIZE = 280
"""Longest frame data [B]: a 0x11 frame (20 bytes of header) with 256 bytes of RF data, and a little more."""

_START = b"\x7e"
_ESCAPE = b"\x7d"
_AROUND = 4
"""Octets of a frame besides its data: start, length, checksum."""

_EXACT_ADLER = 256
"""So many bytes of 255 sum to less than 65520."""

_TO_ESCAPE = re.compile(rb"[\x7e\x7d\x11\x13]")
_ESCAPED = {bytes([byte]): bytes([0x7D, byte ^ 0x20]) for byte in (0x7E, 0x7D, 0x11, 0x13)}
_BAD_ESCAPE = re.compile(rb"\x7d(?=[^\x5e\x5d\x31\x33])")
_GOOD_ESCAPE = re.compile(rb"\x7d([\x5e\x5d\x31\x33])")
_UNESCAPED = {0x5E: b"\x7e", 0x5D: b"\x7d", 0x31: b"\x11", 0x33: b"\x13"}


def encode_frame(body: bytes, *, is_escaped: bool) -> bytes:
    """Return ``body`` as it goes over the line in mode 2 (escaped) or 1.

    Raises
    ------
    EncodeError
        ``body`` is empty or longer than ``MAX_BODY_SIZE``.
    """
    if not 1 <= len(body) <= MAX_BODY_SIZE:
        raise EncodeError(field="XBee frame data size", value=len(body), limit=f"1 to {MAX_BODY_SIZE} bytes")
    rest = len(body).to_bytes(2, "big") + body + bytes([0xFF - sum(body) % 256])
    return _START + (_TO_ESCAPE.sub(lambda match: _ESCAPED[match[0]], rest) if is_escaped else rest)


def make_decoder(*, is_escaped: bool) -> FrameDecoder:
    """Return a decoder for mode 2 (escaped) or 1."""
    return EscapedDecoder() if is_escaped else PlainDecoder()


@dataclass(slots=True, kw_only=True)
class PlainDecoder:
    """Cut a stream of mode 1 into bodies.

    A start byte may stand anywhere in the data, so a claim to be a frame is believed only when its checksum fits; otherwise the search goes
    on one byte behind the false start. Holds at most ``MAX_BODY_SIZE + 3`` bytes between calls.
    """

    _rest: bytes = b""
    _is_noise: bool = False
    """The bytes before ``_rest`` were no frame, and that has been said."""

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        """Take the next bytes of the stream; return the bodies and faults they complete, in order."""
        results: list[bytes | FrameFault] = []
        data = self._rest + chunk if self._rest else chunk
        size = len(data)
        find = data.find
        at = 0
        while True:
            start = find(_START, at)
            if start != at:
                n_skipped = (size if start < 0 else start) - at
                if n_skipped and not self._is_noise:
                    self._is_noise = True
                    results.append(FrameFault.NOISE)
                at += n_skipped
            if size - at < _AROUND - 1:
                break
            length = data[at + 1] << 8 | data[at + 2]
            end = at + length + _AROUND
            if not 1 <= length <= MAX_BODY_SIZE:
                results.append(FrameFault.TOO_LONG if length else FrameFault.TOO_SHORT)
            elif end > size:
                break
            elif _sums_to_ff(data, at + 3, end):
                results.append(data[at + 3 : end - 1])
                self._is_noise = False
                at = end
                continue
            else:
                results.append(FrameFault.BAD_CRC)
            self._is_noise = True
            at += 1
        self._rest = data[at:]
        return results


@dataclass(slots=True, kw_only=True)
class EscapedDecoder:
    """Cut a stream of mode 2 into bodies.

    Every bare start byte begins a frame, whatever came before. A frame is handed out with its last byte, not with the next frame's first.
    Holds at most twice ``MAX_BODY_SIZE + 3`` bytes between calls.
    """

    _piece: bytes = b""
    """What has come of the frame since its start byte."""
    _is_over: bool = True
    """The frame has been handed out or given up; what comes before the next start byte is noise."""
    _is_noise_said: bool = False

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        """Take the next bytes of the stream; return the bodies and faults they complete, in order."""
        results: list[bytes | FrameFault] = []
        if not self._is_over:
            chunk = _START + self._piece + chunk
        if _ESCAPE in chunk:
            # For all frames at once: neither start bytes nor escape bytes come of these two, so that the rest reads as before.
            chunk = chunk.replace(b"\x7d\x33", b"\x13").replace(b"\x7d\x31", b"\x11")
        noise, *pieces = chunk.split(_START)
        if noise and not self._is_noise_said:
            self._is_noise_said = True
            results.append(FrameFault.NOISE)
        if not pieces:
            return results
        last = pieces.pop()
        for piece in pieces:
            size = len(piece)
            if (
                _AROUND <= size <= _EXACT_ADLER
                and piece[1] == size - 3
                and not piece[0]
                and _ESCAPE not in piece
                and not (adler32(piece) - piece[1]) & 0xFF
            ):  # the common case, without a call: a short frame, in which nothing is left to unescape
                results.append(piece[2:-1])
            elif (body := _decode_whole(piece)) is not None:
                results.append(body)
            elif piece:
                self._take(piece, results)
                if not self._is_over:  # this start byte ends it
                    fault, _ = _decode_begun(piece)
                    results.append(fault or (FrameFault.BAD_STUFFING if piece.endswith(_ESCAPE) else FrameFault.TOO_SHORT))
        self._take(last, results)
        return results

    def _take(self, piece: bytes, results: list[bytes | FrameFault]) -> None:
        """Take what has come of a frame since its start byte, all of it."""
        self._piece, self._is_over = piece, False
        if _is_certainly_short(piece):
            return
        result: bytes | FrameFault | None = _decode_whole(piece)
        n_left = 0
        if result is None:
            result, n_left = _decode_begun(piece)
            if result is None:
                return
        results.append(result)
        self._piece, self._is_over = b"", True
        self._is_noise_said = n_left > 0 or isinstance(result, FrameFault)  # what follows a fault belongs to the same damage
        if n_left and not isinstance(result, FrameFault):
            results.append(FrameFault.NOISE)


def _is_certainly_short(piece: bytes) -> bool:
    """Whether a frame that has begun cannot have ended, at a glance: escapes only make it longer."""
    return len(piece) < 2 or (piece[1] != 0x7D and len(piece) < (piece[0] << 8 | piece[1]) + 3 <= MAX_BODY_SIZE + 3)


def _decode_whole(piece: bytes) -> bytes | None:
    """Return the body where ``piece`` is a whole and sound frame without its start byte, and nothing more; None says nothing."""
    if _ESCAPE in piece:
        n_escapes = piece.count(_ESCAPE)
        plain = piece.replace(b"\x7d\x5e", _START).replace(b"\x7d\x31", b"\x11").replace(b"\x7d\x33", b"\x13").replace(b"\x7d\x5d", _ESCAPE)
        if len(piece) - len(plain) != n_escapes:
            return None
        piece = plain
    size = len(piece)
    if not _AROUND <= size <= MAX_BODY_SIZE + 3 or piece[1] + (piece[0] << 8) != size - 3:
        return None
    return piece[2:-1] if _sums_to_ff(piece, 2, size) else None


def _sums_to_ff(data: bytes, start: int, end: int) -> bool:
    """Whether the bytes from ``start`` up to ``end`` sum to 0xFF modulo 256.

    The low half of Adler-32 is 1 and the sum, modulo 65521: up to 256 bytes it is exact, and four times as fast as ``sum``.
    """
    if end - start <= _EXACT_ADLER:
        return not adler32(data[start:end]) & 0xFF
    return sum(data[start:end]) & 0xFF == 0xFF


def _decode_begun(piece: bytes) -> tuple[bytes | FrameFault | None, int]:
    """Return what a frame without its start byte comes to, and how many bytes are left over; None where it has not ended yet."""
    bad = _BAD_ESCAPE.search(piece)
    sound = piece[: bad.start()] if bad else piece
    plain = _GOOD_ESCAPE.sub(lambda match: _UNESCAPED[match[1][0]], sound)
    is_dangling = bad is None and sound.endswith(_ESCAPE)
    if is_dangling:
        plain = plain[:-1]
    if len(plain) >= 2:
        length = plain[0] << 8 | plain[1]
        if not 1 <= length <= MAX_BODY_SIZE:
            return (FrameFault.TOO_LONG if length else FrameFault.TOO_SHORT), 0
        if len(plain) >= length + 3:
            n_left = len(plain) - length - 3 + (bad is not None) + is_dangling
            is_sound = _sums_to_ff(plain, 2, length + 3)
            return (plain[2 : length + 2] if is_sound else FrameFault.BAD_CRC), n_left
    return (None, 0) if bad is None else (FrameFault.BAD_STUFFING, 0)
