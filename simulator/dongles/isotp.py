"""One end of ISO-TP on CAN for short messages (ISO 15765-2, normal addressing, classic frames). No I/O, no clock.

Of the standard it has what a small coordinator needs: messages of up to 64 octets, one at a time in each direction.
"""

from collections import deque
from dataclasses import dataclass, field

from firmware_protocol.units import NS_PER_MS

MAX_MESSAGE = 64

_SINGLE, _FIRST, _CONSECUTIVE, _FLOW = 0, 1, 2, 3  # the upper four bits of a frame's first octet
_CONTINUE, _WAIT = 0, 1
_OVERFLOW_FRAME = bytes((_FLOW << 4 | 2, 0, 0))
_CONTINUE_FRAME = bytes((_FLOW << 4 | _CONTINUE, 0, 0))  # all that is left, without pauses
_TIMEOUT_NS = 1000 * NS_PER_MS  # N_Bs and N_Cr


@dataclass(slots=True)
class IsoTpEnd:
    """See the module; ``n_faults`` counts what came in and was no part of a message."""

    n_faults: int = 0
    _frames: deque[bytes] = field(default_factory=deque)
    _outgoing: bytes = b""
    """What is left to be sent of a long message; it waits for a flow control or for its next frame's time."""
    _sequence: int = 0
    _block: int = 0
    _pause_ns: int = 0
    _send_at_ns: int | None = None
    _give_up_at_ns: int | None = None
    _incoming: bytes = b""
    _size: int = 0
    _expected: int = 0
    _lost_at_ns: int | None = None

    def take(self, data: bytes, *, now_ns: int) -> bytes | None:
        """Take a frame's data; return the message that it completes."""
        kind = data[0] >> 4 if data else -1
        if kind == _SINGLE and 1 <= data[0] & 15 < len(data):
            return data[1 : 1 + (data[0] & 15)]
        if kind == _FIRST and len(data) == 8:
            self._begin((data[0] & 15) << 8 | data[1], data[2:], now_ns)
        elif kind == _CONSECUTIVE and self._size:
            return self._go_on(data, now_ns)
        elif kind == _FLOW and len(data) >= 3 and self._outgoing:
            self._obey(data[0] & 15, data[1], data[2], now_ns)
        else:
            self.n_faults += 1
        return None

    def send(self, message: bytes, *, now_ns: int) -> None:
        """Send a message of 1 to ``MAX_MESSAGE`` octets; one that is under way is given up."""
        if len(message) <= 7:
            self._frames.append(bytes((len(message),)) + message)
            return
        self._frames.append(bytes((_FIRST << 4, len(message))) + message[:6])
        self._outgoing, self._sequence = message[6:], 1
        self._send_at_ns, self._give_up_at_ns = None, now_ns + _TIMEOUT_NS

    def take_frames(self) -> list[bytes]:
        """Return the data of the frames that are to go out; each is handed out once."""
        frames = list(self._frames)
        self._frames.clear()
        return frames

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called, or None."""
        return min((at for at in (self._send_at_ns, self._give_up_at_ns, self._lost_at_ns) if at is not None), default=None)

    def handle_deadline(self, *, now_ns: int) -> None:
        """Send what is due; forget a message whose other end has fallen silent."""
        while self._send_at_ns is not None and now_ns >= self._send_at_ns:
            self._send_part(now_ns)
        if self._give_up_at_ns is not None and now_ns >= self._give_up_at_ns:
            self._outgoing, self._give_up_at_ns = b"", None
            self.n_faults += 1
        if self._lost_at_ns is not None and now_ns >= self._lost_at_ns:
            self._size, self._lost_at_ns = 0, None
            self.n_faults += 1

    def _begin(self, size: int, first: bytes, now_ns: int) -> None:
        if not 8 <= size <= MAX_MESSAGE:
            self._frames.append(_OVERFLOW_FRAME)
            self.n_faults += 1
            return
        self._incoming, self._size, self._expected = first, size, 1
        self._lost_at_ns = now_ns + _TIMEOUT_NS
        self._frames.append(_CONTINUE_FRAME)

    def _go_on(self, data: bytes, now_ns: int) -> bytes | None:
        if data[0] & 15 != self._expected:
            self._size, self._lost_at_ns = 0, None
            self.n_faults += 1
            return None
        self._incoming += data[1:]
        self._expected = (self._expected + 1) % 16
        self._lost_at_ns = now_ns + _TIMEOUT_NS
        if len(self._incoming) < self._size:
            return None
        message, self._size, self._lost_at_ns = self._incoming[: self._size], 0, None
        return message

    def _obey(self, status: int, block: int, pause: int, now_ns: int) -> None:
        if status == _CONTINUE:
            # STmin: 0 to 127 ms, or 100 to 900 us, which we round up; the values between are reserved and mean the longest
            self._pause_ns = (pause if pause < 0x80 else 1 if 0xF1 <= pause <= 0xF9 else 127) * NS_PER_MS
            self._block, self._give_up_at_ns, self._send_at_ns = block, None, now_ns
            self.handle_deadline(now_ns=now_ns)
        elif status == _WAIT:
            self._give_up_at_ns = now_ns + _TIMEOUT_NS
        else:
            self._outgoing, self._give_up_at_ns = b"", None
            self.n_faults += 1

    def _send_part(self, now_ns: int) -> None:
        self._frames.append(bytes((_CONSECUTIVE << 4 | self._sequence,)) + self._outgoing[:7])
        self._outgoing, self._sequence = self._outgoing[7:], (self._sequence + 1) % 16
        self._send_at_ns = now_ns + self._pause_ns if self._outgoing else None
        if self._block:
            self._block -= 1
            if not self._block and self._outgoing:
                self._send_at_ns, self._give_up_at_ns = None, now_ns + _TIMEOUT_NS
