"""The mapper's Zenoh session, which may not be there yet, and what stands declared on it once it is.

A mapper that connects to one gateway or router is a *client* of Zenoh: what a *router* of Zenoh has declared may be forgotten by
another one that stood still (ADR 0016). A client's session opens only when somebody is there, so it is opened in the background, again
and again. One that listens, or connects to several, is a router, whose session opens at once.
"""

import json
import threading
from collections.abc import Callable
from typing import Final, TypeAlias

import zenoh
import zenoh.ext

from firmware_protocol.contract.sessions import CLIENT, ROUTER, TlsTable, ZenohTable, mode_of_service, session_settings
from mapper.log import EventLog

_log = EventLog(__name__)

Declared: TypeAlias = "zenoh.Subscriber[None] | zenoh.ext.AdvancedSubscriber[None] | zenoh.LivelinessToken"
OnSample: TypeAlias = Callable[[zenoh.Sample], None]

_PAUSE_S: Final = 0.1
"""Between two attempts to open a client's session; each of them lasts for as long as a connection may take."""

_JOIN_S: Final = 5.0


class StandingSession:
    """See the module. Its methods may be called from any thread, and wait for Zenoh.

    Raises
    ------
    ZError
        An endpoint cannot be understood, or cannot be listened on.
    """

    def __init__(self, *, connect: tuple[str, ...], listen: tuple[str, ...], tls: TlsTable, timing: ZenohTable | None) -> None:
        self._connect, self._tls, self._timing = connect, tls, timing
        self._lock = threading.RLock()
        self._closing = threading.Event()
        self._session: zenoh.Session | None = None
        self._makers: dict[str, Callable[[zenoh.Session], Declared]] = {}
        self._made: dict[str, Declared] = {}
        self._thread: threading.Thread | None = None
        if mode_of_service(listen=listen, connect=connect) == CLIENT:
            self._thread = threading.Thread(target=self._join, name="joining", daemon=True)
            self._thread.start()
        else:
            self._session = self._open(ROUTER, listen=listen)

    @property
    def current(self) -> zenoh.Session | None:
        """The session, where it is open."""
        return self._session

    @property
    def is_connected(self) -> bool:
        """Say whether any gateway or router is connected."""
        session = self._session
        return session is not None and bool(session.info.transports())

    def subscribe(self, key: str, take: OnSample) -> None:
        """Subscribe to what is published under a key."""
        self.declare(key, lambda session: session.declare_subscriber(key, take))

    def subscribe_advanced(self, key: str, take: OnSample) -> None:
        """Subscribe so that the publisher's cache brings what was published before, and what was missed."""

        def make(session: zenoh.Session) -> Declared:
            return zenoh.ext.declare_advanced_subscriber(
                session,
                key,
                take,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
                recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            )

        self.declare(key, make)

    def subscribe_tokens(self, key: str, take: OnSample) -> None:
        """Hear of liveliness tokens that come and go, and of those that are there."""
        self.declare(f"tokens {key}", lambda session: session.liveliness().declare_subscriber(key, take, history=True))

    def hold_token(self, key: str) -> None:
        """Be alive under a key."""
        self.declare(key, lambda session: session.liveliness().declare_token(key))

    def declare(self, name: str, make: Callable[[zenoh.Session], Declared]) -> None:
        """Declare what ``make`` makes, under a name that is free, now or once there is a session."""
        with self._lock:
            self._makers[name] = make
            if self._session is not None:
                self._made[name] = make(self._session)

    def undeclare(self, name: str) -> None:
        """Take back what was declared under a name, if it was."""
        with self._lock:
            self._makers.pop(name, None)
            made = self._made.pop(name, None)
            if made is not None:
                made.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def close(self) -> None:
        """Close the session, and open none any more."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=_JOIN_S)
        with self._lock:
            session, self._session = self._session, None
            if session is not None:
                session.close()  # type: ignore[no-untyped-call]  # same

    def _open(self, mode: str, *, listen: tuple[str, ...] = ()) -> zenoh.Session:
        timeout_ms = (self._timing or ZenohTable()).open_timeout_ms if mode == CLIENT else -1
        settings = session_settings(
            mode=mode, listen=listen, connect=self._connect, tls=self._tls, timing=self._timing, timeout_ms=timeout_ms
        )
        config = zenoh.Config()
        for name, value in settings.items():
            config.insert_json5(name, json.dumps(value))
        return zenoh.open(config)

    def _join(self) -> None:
        while not self._closing.is_set():
            try:
                session = self._open(CLIENT)
            except zenoh.ZError:  # why, `ConnectionWatch` says
                self._closing.wait(_PAUSE_S)
                continue
            if self._closing.is_set():
                session.close()  # type: ignore[no-untyped-call]  # same
                return
            with self._lock:
                self._session = session
                for name, make in self._makers.items():
                    try:
                        self._made[name] = make(session)
                    except zenoh.ZError as error:
                        _log.error("bus.undeclared", name=name, reason=str(error))
            return
