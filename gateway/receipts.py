"""Which payloads of a dongle can be confirmed: confirming one confirms all before it, so one waits for whatever those before it wait for.

Holds one entry for each write that is waited for, not for each payload: what is repeated while the disk is full waits for the same write,
and not every dialect has a dongle stall when nothing is confirmed.
"""

import asyncio
from collections import deque
from dataclasses import dataclass, field


@dataclass(slots=True)
class _Entry:
    """The last of some payloads in a row that wait for one write, or for nothing behind one that does."""

    number: int
    waits_for: "asyncio.Future[None]"


@dataclass(slots=True)
class Receipts:
    """See the module."""

    _waiting: deque[_Entry] = field(default_factory=deque)
    _ready: int | None = None

    def __len__(self) -> int:
        """Return how many entries wait."""
        return len(self._waiting)

    def add(self, number: int, waits_for: "asyncio.Future[None] | None") -> "asyncio.Future[None] | None":
        """Take the next payload's number and what it waits for; return that where nothing in the row before it waits for the same."""
        last = self._waiting[-1] if self._waiting else None
        if waits_for is None or waits_for.done():
            if last is None:
                self._ready = number
            else:
                last.number = number
            return None
        if last is not None and last.waits_for is waits_for:
            last.number = number
            return None
        self._waiting.append(_Entry(number, waits_for))
        return waits_for

    def take_ready(self) -> int | None:
        """Return the number of the last payload before which nothing waits any more; None where that was told already."""
        while self._waiting and self._waiting[0].waits_for.done():
            self._ready = self._waiting.popleft().number
        ready, self._ready = self._ready, None
        return ready

    def clear(self) -> None:
        """Forget all: the session that the numbers belong to is over."""
        self._waiting.clear()
        self._ready = None
