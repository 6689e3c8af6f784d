"""Payloads on their way into an XBee's radio: a queue, a few in flight by frame id, and who is waiting for what (WIRE_FORMAT.md §8.5)."""

from collections import deque
from dataclasses import dataclass

from firmware_protocol.errors import LinkFullError
from firmware_protocol.units import BROADCAST, NS_PER_S, ShortAddress

WINDOW = 4
"""Transmit requests without a status: a module has few buffers. An urgent payload waits for no window, because those in flight may be for
biobots that are out of reach, whose statuses take seconds; a module that has no room for it says so."""
MAX_QUEUE = 256
STATUS_PATIENCE_NS = 15 * NS_PER_S
"""After this a status will not come: longer than a module takes for address discovery, route discovery and three tries."""

_FIRST_ID = 2
_N_IDS = 254
"""Frame ids 2 to 255: 0 asks for no status, and 1 is that of AT commands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sending:
    """A payload that a ticket was given for."""

    ticket: int
    destination: ShortAddress
    payload: bytes
    is_urgent: bool


@dataclass(slots=True)
class _InFlight:
    sending: Sending
    until_ns: int
    eui64: int
    is_forgotten: bool = False


class Sendings:
    """See the module. A frame id in flight stays taken over a new opening: the module may still tell what became of it.

    Parameters
    ----------
    first_id
        Where frame ids begin: anywhere else than in an earlier process, so that a late status does not settle another payload.
    """

    def __init__(self, *, first_id: int = 0) -> None:
        self._urgent: deque[Sending] = deque()
        self._waiting: deque[Sending] = deque()
        self._in_flight: dict[int, _InFlight] = {}
        """By frame id, in the order of their deadlines."""
        self._next_ticket = 1
        self._next_id = first_id % _N_IDS

    def queue(self, *, destination: ShortAddress, payload: bytes, is_urgent: bool) -> int:
        """Take a payload; return its ticket.

        Raises
        ------
        LinkFullError
            ``MAX_QUEUE`` payloads wait, and this one is not urgent.
        """
        if len(self._urgent) + len(self._waiting) >= MAX_QUEUE and not is_urgent:
            raise LinkFullError(limit=MAX_QUEUE)
        ticket = self._next_ticket
        self._next_ticket += 1
        sending = Sending(ticket=ticket, destination=destination, payload=payload, is_urgent=is_urgent)
        if is_urgent and destination == BROADCAST:
            self._urgent.appendleft(sending)
        else:
            (self._urgent if is_urgent else self._waiting).append(sending)
        return ticket

    @property
    def is_ready(self) -> bool:
        """Whether ``take`` gives one."""
        if not (self._urgent or self._waiting) or len(self._in_flight) >= _N_IDS:
            return False
        return bool(self._urgent) or sum(not entry.is_forgotten for entry in self._in_flight.values()) < WINDOW

    def take(self) -> Sending | None:
        """Return the payload that may go to the module now, or None; the caller launches it, or settles it himself."""
        if not self.is_ready:
            return None
        return (self._urgent or self._waiting).popleft()

    def launch(self, sending: Sending, *, eui64: int, now_ns: int) -> int:
        """Note that a payload which was taken goes to the module, for the node of this 64-bit address; return its frame id."""
        frame_id = self._take_id()
        self._in_flight[frame_id] = _InFlight(sending, now_ns + STATUS_PATIENCE_NS, eui64)
        return frame_id

    def settle(self, frame_id: int) -> tuple[Sending, int] | None:
        """Take the status of a frame id; return whose it is and the 64-bit address it was for, or None where nobody waits for it."""
        entry = self._in_flight.pop(frame_id, None)
        return None if entry is None or entry.is_forgotten else (entry.sending, entry.eui64)

    def forget(self, ticket: int) -> None:
        """Wait no more for a ticket in flight: its frame id stays taken until the status comes or is overdue, its place does not."""
        for entry in self._in_flight.values():
            if entry.sending.ticket == ticket:
                entry.is_forgotten = True

    def take_back(self, ticket: int) -> bool:
        """Take back a payload that was not taken; return whether it was not."""
        for queue in (self._urgent, self._waiting):
            for sending in queue:
                if sending.ticket == ticket:
                    queue.remove(sending)
                    return True
        return False

    def is_of(self, frame_id: int, *, ticket: int) -> bool:
        """Return whether a frame id in flight is that of a ticket."""
        entry = self._in_flight.get(frame_id)
        return entry is not None and entry.sending.ticket == ticket

    def give_up(self, *, now_ns: int) -> list[int]:
        """Return the tickets whose status is overdue; they are waited for no longer."""
        overdue = [frame_id for frame_id, entry in self._in_flight.items() if entry.until_ns <= now_ns]
        entries = [self._in_flight.pop(frame_id) for frame_id in overdue]
        return [entry.sending.ticket for entry in entries if not entry.is_forgotten]

    def next_deadline_ns(self) -> int | None:
        """Return when ``give_up`` has something to do."""
        return next((entry.until_ns for entry in self._in_flight.values()), None)

    def drop_all(self) -> tuple[int, ...]:
        """Forget all; return the tickets that were waited for."""
        flying = [entry.sending for entry in self._in_flight.values() if not entry.is_forgotten]
        tickets = tuple(sending.ticket for sending in (*flying, *self._urgent, *self._waiting))
        for entry in self._in_flight.values():
            entry.is_forgotten = True
        self._urgent.clear()
        self._waiting.clear()
        return tickets

    def _take_id(self) -> int:
        while self._next_id + _FIRST_ID in self._in_flight:
            self._next_id = (self._next_id + 1) % _N_IDS
        frame_id = self._next_id + _FIRST_ID
        self._next_id = (self._next_id + 1) % _N_IDS
        return frame_id
