"""TI Z-Stack framing: the MT serial frame of a ZigBee network processor (WIRE_FORMAT.md §9.1).

On the line: ``FE length cmd0 cmd1 data fcs``; ``length`` counts the data alone, ``fcs`` is the exclusive or of all bytes from ``length`` to
the last of the data [SWRA198, 2.1]. There is no stuffing: FE may stand anywhere, so after damage the decoder looks for the next frame one
byte behind the FE it was wrong about. A body is ``cmd0 cmd1 data``. Pure: bytes go in, bodies and faults come out; the buffer is bounded.
"""

from dataclasses import dataclass

from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameFault

MAX_DATA_SIZE = 250
"""Longest data of a frame [B] [SWRA198, 2.1.1]."""

MAX_BODY_SIZE = MAX_DATA_SIZE + 2
MAX_FRAME_SIZE = MAX_BODY_SIZE + 3

_SOF = 0xFE
_SOF_BYTE = b"\xfe"
_TYPES = frozenset(kind | subsystem for kind in (0x20, 0x40, 0x60) for subsystem in range(0x20))
"""First command bytes there are: requests that are answered, requests and reports that are not, answers [SWRA198, 2.1.2]. A poll (0x00) has
a place on SPI alone."""


def encode_frame(body: bytes) -> bytes:
    """Return a body, ``cmd0 cmd1 data``, as it goes over the line.

    Raises
    ------
    EncodeError
        The body is shorter than 2 bytes or longer than ``MAX_BODY_SIZE``, or ``cmd0`` is none that a serial line carries.
    """
    if not 2 <= len(body) <= MAX_BODY_SIZE:
        raise EncodeError(field="frame body size", value=len(body), limit=f"2 to {MAX_BODY_SIZE} bytes")
    if body[0] not in _TYPES:
        raise EncodeError(field="cmd0", value=body[0], limit="0x20 to 0x7F: a synchronous or asynchronous request, or an answer")
    length = len(body) - 2
    return bytes((_SOF, length)) + body + bytes((length ^ exclusive_or(body),))


def exclusive_or(data: bytes) -> int:
    """Return the exclusive or of at most ``MAX_FRAME_SIZE`` bytes; 0 for none."""
    folded = int.from_bytes(data, "little")
    if len(data) > 64:
        folded ^= folded >> 1024
        folded ^= folded >> 512
    folded ^= folded >> 256
    folded ^= folded >> 128
    folded ^= folded >> 64
    folded ^= folded >> 32
    folded ^= folded >> 16
    return (folded ^ folded >> 8) & 0xFF


@dataclass(slots=True, kw_only=True)
class ZnpDecoder:
    """Cut a byte stream into MT bodies.

    Any chunking of the stream gives the same result. Bytes that are skipped between two good frames give one fault, named after what was
    wrong with the first of them. Never holds ``MAX_FRAME_SIZE`` bytes or more.
    """

    _rest: bytes = b""
    """Begins with FE, or is empty."""
    _is_skipping: bool = False

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        """Take the next bytes of the stream; return the bodies and faults they complete, in order."""
        data = self._rest + chunk
        results: list[bytes | FrameFault] = []
        size = len(data)
        at = 0
        while at + 2 < size:
            length = data[at + 1]
            if data[at] == _SOF and length <= MAX_DATA_SIZE and data[at + 2] in _TYPES:
                end = at + length + 5
                if end > size:
                    break
                if not exclusive_or(data[at + 1 : end]):
                    results.append(data[at + 2 : end - 1])
                    self._is_skipping = False
                    at = end
                    continue
            at = self._skip(data, at, _fault_of(data, at), results)
        while at < size and _is_false_start(data, at):  # the last two bytes, where they alone tell already
            at = self._skip(data, at, _fault_of(data, at), results)
        self._rest = data[at:]
        return results

    def resynchronise(self) -> list[bytes | FrameFault]:
        """Give up the frame that has begun: the line has been silent for longer than a frame takes. Look for others behind its start.

        A frame whose end was lost would otherwise swallow what follows until its length is made up.
        """
        results: list[bytes | FrameFault] = []
        while self._rest:
            rest, self._rest = self._rest, b""
            at = self._skip(rest, 0, FrameFault.TOO_SHORT, results)
            results += self.feed(rest[at:])
        return results

    def _skip(self, data: bytes, at: int, fault: FrameFault, results: list[bytes | FrameFault]) -> int:
        """Note what was wrong at ``at``, once a run, and return where a frame may begin next."""
        if not self._is_skipping:
            self._is_skipping = True
            results.append(fault)
        following = data.find(_SOF_BYTE, at + 1)
        return len(data) if following < 0 else following


def _is_false_start(data: bytes, at: int) -> bool:
    return data[at] != _SOF or (at + 1 < len(data) and data[at + 1] > MAX_DATA_SIZE)


def _fault_of(data: bytes, at: int) -> FrameFault:
    if data[at] != _SOF:
        return FrameFault.NOISE
    if at + 1 < len(data) and data[at + 1] > MAX_DATA_SIZE:
        return FrameFault.TOO_LONG
    if at + 2 < len(data) and data[at + 2] not in _TYPES:
        return FrameFault.NOISE
    return FrameFault.BAD_CRC
