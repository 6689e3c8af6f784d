"""Payloads on their way to a Z-Stack dongle: which may be written next, and which wait to be confirmed (WIRE_FORMAT.md §9.5)."""

from collections import deque
from dataclasses import dataclass, field

from firmware_protocol.errors import LinkFullError
from firmware_protocol.units import BROADCAST, NS_PER_S, ShortAddress

MAX_QUEUE = 256
"""Payloads that wait to be written; more are refused."""

WINDOW = 4
"""Payloads whose confirm has not come: few, for a chip of 8 KiB has buffers for few. An urgent one waits for none of them."""

_CONFIRM_NS = 12 * NS_PER_S
"""After so long a payload holds its place in the window no more; Z-Stack's own last word, that an indirect transmission has expired, comes
after 8 s. The number of one that nobody waits for is given to another payload only then."""

_N_TRANSACTIONS = 256


@dataclass(slots=True)
class Unsent:
    """A payload that waits to be written."""

    ticket: int
    destination: ShortAddress
    payload: bytes


@dataclass(slots=True)
class _Unconfirmed:
    """A payload that was taken; ``until_ns`` is when it gives up its place in the window. Its confirm is good after that too."""

    one: Unsent
    is_urgent: bool
    until_ns: int
    is_forgotten: bool = False

    @property
    def ticket(self) -> int:
        return self.one.ticket


@dataclass(slots=True, kw_only=True)
class SendWindow:
    """See the module. Each payload gets a ticket; each that is written gets one of 256 transaction numbers, in turn, that is not in use.

    A number is in use until its confirm comes, or, where nobody waits for that, until it is overdue: also over a new opening.
    """

    next_transaction: int = 0
    _next_ticket: int = 1
    _urgent: deque[Unsent] = field(default_factory=deque)
    _unsent: deque[Unsent] = field(default_factory=deque)
    _unconfirmed: dict[int, _Unconfirmed] = field(default_factory=dict)
    _held_until_ns: int = 0

    @property
    def has_unsent(self) -> bool:
        """Something waits to be written."""
        return bool(self._urgent or self._unsent)

    @property
    def has_urgent(self) -> bool:
        """An urgent one does."""
        return bool(self._urgent)

    @property
    def is_broadcast_next(self) -> bool:
        """The next urgent one is for everybody."""
        return bool(self._urgent) and self._urgent[0].destination == BROADCAST

    def add(self, *, destination: ShortAddress, payload: bytes, is_urgent: bool) -> int:
        """Queue a payload and return its ticket.

        Raises
        ------
        LinkFullError
            ``MAX_QUEUE`` payloads wait. An urgent one is taken all the same.
        """
        if len(self._unsent) >= MAX_QUEUE and not is_urgent:
            raise LinkFullError(limit=MAX_QUEUE)
        ticket = self._next_ticket
        self._next_ticket += 1
        one = Unsent(ticket, destination, payload)
        if is_urgent and destination == BROADCAST:
            self._urgent.appendleft(one)
        else:
            (self._urgent if is_urgent else self._unsent).append(one)
        return ticket

    def forget(self, ticket: int) -> None:
        """Wait no more for what became of a payload that was taken."""
        for sent in self._unconfirmed.values():
            sent.is_forgotten |= sent.ticket == ticket

    def withdraw(self, ticket: int) -> bool:
        """Take back a payload that was not taken; return whether it was not."""
        for queue in (self._urgent, self._unsent):
            for one in queue:
                if one.ticket == ticket:
                    queue.remove(one)
                    return True
        return False

    def give_back(self, transaction: int) -> None:
        """Let a payload that was taken, and not written, wait again before the others."""
        taken = self._unconfirmed.pop(transaction)
        (self._urgent if taken.is_urgent else self._unsent).appendleft(taken.one)

    def free_at_ns(self) -> int | None:
        """Return from when on ``take`` gives the payload that is next; None: not before one is settled or forgotten."""
        free_at_ns = self._held_until_ns
        if len(self._unconfirmed) >= _N_TRANSACTIONS:
            numbers = [one.until_ns for one in self._unconfirmed.values() if one.is_forgotten]
            if not numbers:
                return None
            free_at_ns = max(free_at_ns, min(numbers))
        places = sorted(one.until_ns for one in self._unconfirmed.values() if not one.is_forgotten)
        return free_at_ns if self._urgent or len(places) < WINDOW else max(free_at_ns, places[-WINDOW])

    def take(self, now_ns: int) -> tuple[int, Unsent] | None:
        """Return the payload to be written now and its transaction number, or None."""
        is_urgent = bool(self._urgent)
        queue = self._urgent or self._unsent
        free_at_ns = self.free_at_ns()
        if not queue or free_at_ns is None or now_ns < free_at_ns:
            return None
        one = queue.popleft()
        for number in [number for number, sent in self._unconfirmed.items() if sent.is_forgotten and sent.until_ns <= now_ns]:
            del self._unconfirmed[number]
        while self.next_transaction in self._unconfirmed:
            self.next_transaction = (self.next_transaction + 1) % _N_TRANSACTIONS
        transaction = self.next_transaction
        self.next_transaction = (transaction + 1) % _N_TRANSACTIONS
        self._unconfirmed[transaction] = _Unconfirmed(one, is_urgent, now_ns + _CONFIRM_NS)
        return transaction, one

    def settle(self, transaction: int) -> int | None:
        """Return the ticket of a payload whose fate is told, and forget it; None where no payload has this number."""
        sent = self._unconfirmed.pop(transaction, None)
        return None if sent is None or sent.is_forgotten else sent.ticket

    def hold(self, until_ns: int) -> None:
        """Give nothing before ``until_ns``: the dongle has no room."""
        self._held_until_ns = until_ns

    def drop_all(self) -> tuple[int, ...]:
        """Forget everything; return the tickets whose fate is not known."""
        waited_for = [one for one in self._unconfirmed.values() if not one.is_forgotten]
        dropped = (*(one.ticket for one in waited_for), *(one.ticket for one in (*self._urgent, *self._unsent)))
        for sent in waited_for:
            sent.is_forgotten = True
        self._urgent.clear()
        self._unsent.clear()
        self._held_until_ns = 0
        return dropped
