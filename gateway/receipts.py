"""Which payloads of a dongle can be confirmed: confirming one confirms all before it, so one waits for whatever those before it wait for.

A disk that takes nothing for longer than ``PATIENCE_NS`` is waited for no more until it has taken what was waited for: a native dongle
holds 16 payloads, and behind those that wait for a full disk would stand a biobot's answer to a stop, and the dongle's own word of what
it sent. That loses nothing. What was not written is kept in memory here, and in its backpack, which repeats it until it is told, after
the commit, that it is safe (ADR 36).

Holds one entry for each write that is waited for, not for each payload: what is repeated while the disk is full waits for the same write,
and not every dialect has a dongle stall when nothing is confirmed.
"""

import asyncio
from collections import deque
from dataclasses import dataclass, field
from typing import Final

from firmware_protocol.units import NS_PER_MS

PATIENCE_NS: Final = 250 * NS_PER_MS
"""How long a payload waits for the disk: longer than a commit takes on a disk that works, shorter than one waits who stops an animal."""


@dataclass(slots=True)
class _Entry:
    """The last of some payloads in a row that wait for one write, or for nothing behind one that does."""

    number: int
    waits_for: "asyncio.Future[None]"
    since_ns: int


@dataclass(slots=True)
class Receipts:
    """See the module."""

    _waiting: deque[_Entry] = field(default_factory=deque)
    _ready: int | None = None
    _stalled: "asyncio.Future[None] | None" = None
    """The write that has been waited for in vain; nothing waits until it is done."""

    def __len__(self) -> int:
        """Return how many entries wait."""
        return len(self._waiting)

    @property
    def next_deadline_ns(self) -> int | None:
        """When the oldest payload that waits is waited for no more."""
        return self._waiting[0].since_ns + PATIENCE_NS if self._waiting else None

    def add(self, number: int, waits_for: "asyncio.Future[None] | None", *, now_ns: int) -> "asyncio.Future[None] | None":
        """Take the next payload's number and what it waits for; return that where nothing in the row before it waits for the same."""
        last = self._waiting[-1] if self._waiting else None
        if waits_for is None or waits_for.done() or self._is_stalled:
            if last is None:
                self._ready = number
            else:
                last.number = number
            return None
        if last is not None and last.waits_for is waits_for:
            last.number = number
            return None
        self._waiting.append(_Entry(number, waits_for, now_ns))
        return waits_for

    def take_ready(self, *, now_ns: int) -> int | None:
        """Return the number of the last payload before which nothing waits any more; None where that was told already."""
        while self._waiting and self._waiting[0].waits_for.done():
            self._ready = self._waiting.popleft().number
        if self._waiting and now_ns - self._waiting[0].since_ns >= PATIENCE_NS:
            self._ready, self._stalled = self._waiting[-1].number, self._waiting[-1].waits_for
            self._waiting.clear()
        ready, self._ready = self._ready, None
        return ready

    def clear(self) -> None:
        """Forget all: the session that the numbers belong to is over."""
        self._waiting.clear()
        self._ready = self._stalled = None

    @property
    def _is_stalled(self) -> bool:
        if self._stalled is not None and self._stalled.done():
            self._stalled = None
        return self._stalled is not None
