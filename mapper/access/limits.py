"""Limits on how often one may ask: by token, or where there is none, by address. Stops have none."""

import time
from collections.abc import Callable
from typing import Final

from mapper.access.buckets import Buckets, Rate
from mapper.access.errors import RateLimitError
from mapper.access.roles import Person

WRONG_TOKENS: Final = Rate(per_s=0.2, burst=10.0)
"""A person who pastes the wrong thing does so a few times; a program that tries tokens is slowed to one in 5 s."""


class RateLimits:
    """Counts what each may still ask; raises ``RateLimitError`` where that is nothing."""

    def __init__(self, *, reads: Rate, writes: Rate, clock: Callable[[], float] = time.monotonic) -> None:
        self._reads, self._writes, self._wrong = Buckets(reads), Buckets(writes), Buckets(WRONG_TOKENS)
        self._clock = clock

    def take_read(self, person: Person, *, address: str) -> None:
        """Count a request that changes nothing."""
        self._take(self._reads, person.token_id or address, what=f"reads by {person.name}")

    def take_write(self, person: Person) -> None:
        """Count a request that changes something, and is no stop."""
        self._take(self._writes, person.token_id, what=f"writes by {person.name}")

    def take_wrong_token(self, *, address: str) -> bool:
        """Count a token that is none; say whether it is the first from there for a while, to be told in the log."""
        now_s = self._clock()
        is_first = self._wrong.level(address, now_s=now_s) >= WRONG_TOKENS.burst
        self._take(self._wrong, address, what=f"wrong tokens from {address}")
        return is_first

    def _take(self, buckets: Buckets, key: str | None, *, what: str) -> None:
        wait_s = buckets.take(key, now_s=self._clock())
        if wait_s > 0:
            raise RateLimitError(what=what, rate=buckets.rate.per_s, burst=buckets.rate.burst, wait_s=wait_s)
