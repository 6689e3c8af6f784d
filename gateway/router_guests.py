"""Whom a router tells of as come and gone: who stays for some seconds, and a stranger once. Pure.

Operators' commands, health checks and the looks of clients whether they are heard connect for a moment, again and again.
"""

from dataclasses import dataclass, field
from typing import Final

STAYS_S: Final = 5.0
"""Who is connected for so long has come to stay."""

_QUIET_S: Final = 60.0
"""A stranger that was away for so long is told of anew."""

_MAX_STRANGERS: Final = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class Guest:
    """Somebody with a link: the common name of the certificate (empty: none was shown), address, and Zenoh's id of the session."""

    name: str
    address: str
    zid: str


@dataclass(slots=True)
class GuestBook:
    """Who is there, and of whom was told. Instants are monotonic [s]."""

    _waiting: dict[Guest, float] = field(default_factory=dict)
    _told: set[Guest] = field(default_factory=set)
    _strangers: dict[str, float] = field(default_factory=dict)

    def come(self, guest: Guest, *, now_s: float) -> None:
        """Take a link that came up."""
        self._waiting[guest] = now_s + STAYS_S

    def come_stranger(self, name: str, *, now_s: float) -> bool:
        """Take a link of somebody who is denied everything; returns whether to tell of it."""
        last_s = self._strangers.pop(name, None)
        self._strangers[name] = now_s
        if len(self._strangers) > _MAX_STRANGERS:
            del self._strangers[next(iter(self._strangers))]
        return last_s is None or now_s - last_s >= _QUIET_S

    def leave(self, guest: Guest) -> bool:
        """Take a link that went; returns whether to tell of it: it was told that it came."""
        self._waiting.pop(guest, None)
        if guest not in self._told:
            return False
        self._told.remove(guest)
        return True

    def stayed(self, *, now_s: float) -> list[Guest]:
        """Return who has come to stay since this was last asked."""
        stayed = [guest for guest, due_s in self._waiting.items() if due_s <= now_s]
        for guest in stayed:
            del self._waiting[guest]
            self._told.add(guest)
        return stayed

    def next_s(self) -> float | None:
        """Return when somebody will have come to stay, or None: nobody is waited for."""
        return min(self._waiting.values(), default=None)

    def forget(self) -> None:
        """Forget all: the session is another one."""
        self._waiting.clear()
        self._told.clear()
        self._strangers.clear()
