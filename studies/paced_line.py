"""A serial line between a port and a dongle, as slow as a real one: it takes no octet from the port before it has room for it.

The port's own buffers are the operating system's; what waits there is what an urgent frame stands behind.
"""

import fcntl
import os
import sys
import termios
from collections import deque
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from firmware_protocol.units import NS_PER_S

_FIFO: Final = 32
"""Octets that the line has taken and not sent, at most: as the transmitter of a UART or of a USB bridge holds."""
_PIECE: Final = 4
"""Octets that the dongle is given at once: so exact is the instant at which a frame's last octet has left."""


class Piece(NamedTuple):
    """Some octets, when the port had all of them, and when the last one has left it at the line's speed [ns, monotonic]."""

    octets: bytes
    written_ns: int
    left_ns: int


@dataclass(slots=True, kw_only=True)
class PacedLine:
    """See the module. Time is an argument; who calls ``read`` rarely makes the line look slower than it is."""

    bytes_per_s: float
    _n_taken: int = 0
    _n_come: int = 0
    _came: deque[tuple[int, int]] = field(default_factory=deque)
    """How many octets the port had been given by an instant, for each instant at which there were more."""
    _down_until_ns: int = 0
    _up_until_ns: int = 0

    def read(self, fd: int, now_ns: int) -> list[Piece]:
        """Take from the port what the line has room for now.

        Raises
        ------
        OSError
            Nobody has the port open.
        """
        octet_ns = NS_PER_S / self.bytes_per_s
        n_waiting = int.from_bytes(fcntl.ioctl(fd, termios.FIONREAD, bytes(4)), sys.byteorder)
        if self._n_taken + n_waiting > self._n_come:
            self._n_come = self._n_taken + n_waiting
            self._came.append((self._n_come, now_ns))
        n_room = _FIFO - int(max(0, self._down_until_ns - now_ns) / octet_ns)
        if not n_waiting or n_room <= 0:
            return []
        data = os.read(fd, n_room)
        begun_ns = max(self._down_until_ns, now_ns)
        pieces: list[Piece] = []
        for at in range(0, len(data), _PIECE):
            octets = data[at : at + _PIECE]
            self._n_taken += len(octets)
            while len(self._came) > 1 and self._came[0][0] < self._n_taken:
                self._came.popleft()
            pieces.append(Piece(octets, self._came[0][1] if self._came else now_ns, begun_ns + int((at + len(octets)) * octet_ns)))
        self._down_until_ns = begun_ns + int(len(data) * octet_ns)
        return pieces

    def room_up(self, now_ns: int) -> int:
        """Return how many octets the line takes now in the other direction."""
        return max(0, _FIFO - int(max(0, self._up_until_ns - now_ns) * self.bytes_per_s / NS_PER_S))

    def note_up(self, n_octets: int, now_ns: int) -> None:
        """Take note of octets that went in the other direction."""
        self._up_until_ns = max(self._up_until_ns, now_ns) + int(n_octets * NS_PER_S / self.bytes_per_s)
