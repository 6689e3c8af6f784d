"""What the mapper has declared on Zenoh: kept so that it can be declared anew where a router has lost it.

A router that stood still for longer than the lease may forget what a session has declared, as it finds the end of its old link and its
new link at one moment (eclipse-zenoh 1.10, docs/zenoh.md): the mapper would be connected and hear nothing. So after each new link a
client's session asks whether one's own token is there.
"""

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeAlias

import zenoh
import zenoh.ext

from firmware_protocol.contract.sessions import CLIENT, TlsTable, ZenohTable, session_settings
from mapper.log import EventLog

_log = EventLog(__name__)

Declared: TypeAlias = "zenoh.Subscriber[None] | zenoh.ext.AdvancedSubscriber[None] | zenoh.LivelinessToken"
OnSample: TypeAlias = Callable[[zenoh.Sample], None]

_LOOKS_S: Final = (2.0, 4.0, 14.0)
"""Pauses after a new link, and after each look, before the next one."""

_AGAIN_S: Final = 2.0
"""What is not seen is looked for again after this, before it is declared anew: routers need a moment to tell each other."""

_CLIENT_TIMEOUT_MS: Final = 3000
_TOKEN_TIMEOUT_S: Final = 1.0


class StandingDeclarations:
    """Declares by name, and all of it again when others do not see the token ``own``; see the module. ``run`` is its task."""

    def __init__(self, session: zenoh.Session, *, connect: tuple[str, ...], tls: TlsTable, timing: ZenohTable | None) -> None:
        self.own: str | None = None
        """Key of the token that must be seen; None: there is none yet."""
        self.n_renewed = 0
        self._session = session
        self._connect, self._tls, self._timing = connect, tls, timing
        self._loop = asyncio.get_running_loop()
        self._has_link = asyncio.Event()
        self._makers: dict[str, Callable[[], Declared]] = {}
        self._made: dict[str, Declared] = {}
        self._links = session.info.declare_link_events_listener(self._on_link, history=True)

    def declare(self, name: str, make: Callable[[], Declared]) -> None:
        """Declare what ``make`` makes, under a name that is free; raises ``ZError`` where Zenoh does not take it."""
        self._made[name] = make()
        self._makers[name] = make

    def subscribe(self, key: str, take: OnSample) -> None:
        """Subscribe to what is published under a key."""
        self.declare(key, lambda: self._session.declare_subscriber(key, take))

    def subscribe_advanced(self, key: str, take: OnSample) -> None:
        """Subscribe so that the publisher's cache brings what was published before, and what was missed."""

        def make() -> Declared:
            return zenoh.ext.declare_advanced_subscriber(
                self._session,
                key,
                take,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
                recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            )

        self.declare(key, make)

    def subscribe_tokens(self, key: str, take: OnSample) -> None:
        """Hear of liveliness tokens that come and go, and of those that are there."""
        self.declare(f"tokens {key}", lambda: self._session.liveliness().declare_subscriber(key, take, history=True))

    def undeclare(self, name: str) -> None:
        """Take back what was declared under a name, if it was."""
        self._makers.pop(name, None)
        made = self._made.pop(name, None)
        if made is not None:
            made.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    async def run(self) -> None:
        """Look after each new link whether one is seen, until cancelled."""
        is_told, n_unseen = False, 0
        while True:
            await self._has_link.wait()
            self._has_link.clear()
            pauses_s = list(_LOOKS_S)
            while pauses_s and not self._has_link.is_set():
                await asyncio.sleep(pauses_s.pop(0))
                is_seen = await asyncio.to_thread(self._is_seen)
                n_unseen = n_unseen + 1 if is_seen is False else 0
                if n_unseen:
                    pauses_s.insert(0, _AGAIN_S)
                if n_unseen > 1:
                    if not is_told:
                        is_told = True
                        reason = "the router is connected, and has lost what was declared to it; it is declared anew"
                        _log.warning("bus.unseen", reason=reason)
                    await asyncio.to_thread(self._renew)
                elif is_seen and is_told:
                    is_told = False
                    _log.info("bus.seen_again")

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        """Runs on a thread of Zenoh."""
        if event.kind == zenoh.SampleKind.PUT:
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._has_link.set)

    def _is_seen(self) -> bool | None:
        """Ask whom this connects to; None: there is nobody, or nothing to ask for."""
        if self.own is None or not self._connect:
            return None
        timeout_ms = max(_CLIENT_TIMEOUT_MS, 0 if self._timing is None else self._timing.open_timeout_ms)
        settings = session_settings(
            mode=CLIENT, listen=(), connect=self._connect, tls=self._tls, timing=self._timing, timeout_ms=timeout_ms
        )
        settings["connect/exit_on_failure"] = True
        config = zenoh.Config()
        for name, value in settings.items():
            config.insert_json5(name, json.dumps(value))
        try:
            with zenoh.open(config) as session:
                replies = list(session.liveliness().get(self.own, timeout=_TOKEN_TIMEOUT_S))
        except zenoh.ZError:
            return None
        if any(reply.ok is not None for reply in replies):
            return True
        return None if replies else False  # an error: nobody has ended the query

    def _renew(self) -> None:
        self.n_renewed += 1
        for name, make in list(self._makers.items()):
            try:
                self._made[name].undeclare()  # type: ignore[no-untyped-call]  # same
                self._made[name] = make()
            except zenoh.ZError as error:
                _log.warning("bus.undeclared", name=name, reason=str(error))
