"""What every virtual coordinator dongle offers the swarm, whatever dialect it speaks on its line. No I/O, no clock.

Its memory is bounded: where there is no room for a payload from the air it takes none, and the backpack, which hears no acknowledgement
from the base station, keeps what it has.
"""

from collections import Counter, deque
from typing import Protocol

from firmware_protocol.envelope import RadioReceived, RadioSend, RadioStatus
from firmware_protocol.units import ShortAddress


class Dongle(Protocol):
    """See the module. ``requests`` are what the base station wants sent; each must be answered with ``confirm``."""

    requests: deque[RadioSend]
    faults: Counter[str]
    """What came in and was of no use, and what had no room, by name."""

    @property
    def is_open(self) -> bool:
        """A base station is connected."""
        ...

    def start(self, *, now_ns: int) -> None:
        """Switch the dongle on, or on again after a reset: it forgets what it held in memory, and says so in the way of its kind."""
        ...

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """Take bytes from the line, cut anywhere."""
        ...

    def take_bytes(self) -> bytes:
        """Return what is to go out over the line; each byte is handed out once."""
        ...

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called, or None."""
        ...

    def handle_deadline(self, *, now_ns: int) -> None:
        """Do what is due."""
        ...

    def take_from_radio(self, received: RadioReceived, *, eui64: int, now_ns: int) -> bool:
        """Take a payload that the backpack with this EUI-64 sent; return False, and take nothing, where there is no room."""
        ...

    def confirm(self, handle: int, status: RadioStatus, *, now_ns: int) -> None:
        """Tell the base station what became of a request; the request leaves the radio's queue."""
        ...

    def node_joined(self, address: ShortAddress, *, eui64: int, now_ns: int) -> None:
        """Learn that a node has joined the network under a short address."""
        ...
