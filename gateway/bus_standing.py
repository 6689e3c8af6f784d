"""What the gateway has declared on Zenoh: kept so that it can be declared anew where a router has lost it.

A router that stood still for longer than the lease finds the end of a session's old link and its new link at one moment; it may then
take the old one's end for the session's, and forget all that the session has declared (eclipse-zenoh 1.10): publications still go
through, but nobody sees its tokens, and its queryables are asked nothing. So after each new link a client's session asks the router
whether one's own token is there.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, TypeAlias

import zenoh

from gateway.health import Health
from gateway.log import EventLog

_log = EventLog(__name__)

Declared: TypeAlias = zenoh.Queryable[None] | zenoh.Subscriber[None] | zenoh.LivelinessToken

_LOOKS_S: Final = (2.0, 6.0, 20.0)
"""So long after a new link it is looked for."""

_AGAIN_S: Final = 2.0
"""What is not seen is looked for again after this, before it is declared anew: routers need a moment to tell each other."""

_LONGEST_WAIT_S: Final = 3600.0


class StandingDeclarations:
    """Declares by name, and all of it again when ``is_seen`` says that others do not see it; see the module.

    Parameters
    ----------
    is_seen
        Asks the router, on this object's thread; None: it could not be asked.
    """

    def __init__(self, session: zenoh.Session, *, is_seen: Callable[[], bool | None], health: Health) -> None:
        self._is_seen = is_seen
        self._health = health
        self._lock = threading.Lock()
        self._makers: dict[str, Callable[[], Declared]] = {}
        self._made: dict[str, Declared] = {}
        self._wake = threading.Condition()
        self._due_s: deque[float] = deque()
        self._is_closing = self._is_told = False
        self._links = session.info.declare_link_events_listener(self._on_link, history=True)
        self._thread = threading.Thread(target=self._run, name="standing", daemon=True)
        self._thread.start()

    def declare(self, name: str, make: Callable[[], Declared]) -> None:
        """Declare what ``make`` makes, under a name that is free; raises ``ZError`` where Zenoh does not take it."""
        with self._lock:
            self._made[name] = make()
            self._makers[name] = make

    def undeclare(self, name: str) -> None:
        """Take back what was declared under a name, if it was."""
        with self._lock:
            self._makers.pop(name, None)
            made = self._made.pop(name, None)
            if made is not None:
                made.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def is_declared(self, name: str) -> bool:
        """Whether something stands under a name."""
        return name in self._makers

    def close(self) -> None:
        """Take all of it back, the newest first."""
        with self._wake:
            self._is_closing = True
            self._wake.notify()
        self._thread.join(timeout=5.0)
        for name in reversed(list(self._makers)):
            self.undeclare(name)

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        """Runs on a thread of Zenoh."""
        if event.kind == zenoh.SampleKind.PUT:
            self._look_after(*_LOOKS_S)

    def _look_after(self, *pauses_s: float) -> None:
        now_s = time.monotonic()
        with self._wake:
            self._due_s = deque(now_s + pause_s for pause_s in pauses_s)
            self._wake.notify()

    def _run(self) -> None:
        n_unseen = 0
        while self._wait():
            is_seen = self._is_seen()
            n_unseen = n_unseen + 1 if is_seen is False else 0
            if n_unseen > 1:
                self._renew()
            elif is_seen and self._is_told:
                self._is_told = False
                _log.info("bus.seen_again")
            if n_unseen:
                with self._wake:
                    self._due_s.appendleft(time.monotonic() + _AGAIN_S)

    def _wait(self) -> bool:
        """Wait until it is time to look; False: never again."""
        with self._wake:
            while not self._is_closing:
                wait_s = self._due_s[0] - time.monotonic() if self._due_s else _LONGEST_WAIT_S
                if wait_s <= 0:
                    self._due_s.popleft()
                    return True
                self._wake.wait(wait_s)
            return False

    def _renew(self) -> None:
        self._health.count("bus.declared_anew")
        if not self._is_told:
            self._is_told = True
            _log.warning("bus.unseen", reason="the router is connected, and has lost what was declared to it; it is declared anew")
        with self._lock:
            for name, make in self._makers.items():
                try:
                    self._made[name].undeclare()  # type: ignore[no-untyped-call]  # same
                    self._made[name] = make()
                except zenoh.ZError as error:
                    _log.warning("bus.undeclared", name=name, reason=str(error))
