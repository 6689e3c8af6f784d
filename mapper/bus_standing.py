"""The mapper's Zenoh session, which may not be there yet, and what stands declared on it once it is.

A mapper that connects to one gateway or router is a *client* of Zenoh: a router that stood still for some seconds may forget for good what
another *router* has declared, or leave a *client* deaf or mute (ADR 0028). A client's session can be closed and opened anew, which heals
that. It opens only when somebody is there, so it is opened in the background, again and again. One that listens, or connects to several,
is a router, whose session opens at once, and stays.
"""

import json
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeAlias

import zenoh
import zenoh.ext

from firmware_protocol.contract.hearing import WHY, Hearing, Told
from firmware_protocol.contract.sessions import CLIENT, ROUTER, TlsTable, ZenohTable, mode_of_service, session_settings
from mapper.bus_echo import answer_echo, is_heard
from mapper.log import EventLog

_log = EventLog(__name__)

Declared: TypeAlias = "zenoh.Subscriber[None] | zenoh.ext.AdvancedSubscriber[None] | zenoh.LivelinessToken"
OnSample: TypeAlias = Callable[[zenoh.Sample], None]

_PAUSE_S: Final = 0.1
"""Between two attempts to open a client's session; each of them lasts for as long as a connection may take."""

_JOIN_S: Final = 3.0
_SETTLE_S: Final = 0.1
"""For Zenoh's threads to let go of what they called back: in an interpreter that ends meanwhile, they bring the process down."""


class StandingSession:
    """See the module. Its methods may be called from any thread, and wait for Zenoh.

    Parameters
    ----------
    echo
        A key of one's own, under which a client looks whether it is heard; None: it does not look.

    Raises
    ------
    ZError
        An endpoint cannot be understood, or cannot be listened on.
    """

    def __init__(
        self, *, connect: tuple[str, ...], listen: tuple[str, ...], tls: TlsTable, timing: ZenohTable | None, echo: str | None = None
    ) -> None:
        self._connect, self._tls, self._timing = connect, tls, timing
        self._lock = threading.RLock()
        self._closing, self._has_link = threading.Event(), threading.Event()
        self._hearing = Hearing()
        self._session: zenoh.Session | None = None
        self._makers: dict[str, Callable[[zenoh.Session], Declared]] = {}
        self._made: dict[str, Declared] = {}
        self._thread: threading.Thread | None = None
        if mode_of_service(listen=listen, connect=connect) == CLIENT:
            self._thread = threading.Thread(target=self._join, args=(echo,), name="joining", daemon=True)
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
            with suppress(zenoh.ZError):  # of a session that was closed meanwhile
                made.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def close(self) -> None:
        """Close the session, and open none any more."""
        self._closing.set()
        self._has_link.set()
        if self._thread is not None:
            self._thread.join(timeout=_JOIN_S)  # longer where it is trying to connect: it closes what it gets then
        # One by one, before the session is: what Zenoh's threads drop later, they would drop in an interpreter that is about to end.
        for name in reversed(list(self._makers)):
            self.undeclare(name)
        self._leave()
        time.sleep(_SETTLE_S)

    def _open(self, mode: str, *, listen: tuple[str, ...] = ()) -> zenoh.Session:
        timeout_ms = (self._timing or ZenohTable()).open_timeout_ms if mode == CLIENT else -1
        settings = session_settings(
            mode=mode, listen=listen, connect=self._connect, tls=self._tls, timing=self._timing, timeout_ms=timeout_ms
        )
        config = zenoh.Config()
        for name, value in settings.items():
            config.insert_json5(name, json.dumps(value))
        return zenoh.open(config)

    def _probe(self) -> zenoh.Session | None:
        try:
            return self._open(CLIENT)
        except zenoh.ZError:
            return None  # why, `ConnectionWatch` says

    def _join(self, echo: str | None) -> None:
        while not self._closing.is_set():
            session = self._probe()
            if session is None:
                self._closing.wait(_PAUSE_S)
                continue
            if self._closing.is_set():
                session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type
                return
            self._came(session)
            if echo is None:
                return
            self._keep(session, echo)
            if not self._closing.is_set():
                self._leave()

    def _came(self, session: zenoh.Session) -> None:
        with self._lock:
            self._made = {}
            for name, make in self._makers.items():
                try:
                    self._made[name] = make(session)
                except zenoh.ZError as error:
                    _log.error("bus.undeclared", name=name, reason=str(error))
            self._session = session  # connected is who can be heard

    def _leave(self) -> None:
        with self._lock:
            session, self._session = self._session, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]  # same

    def _keep(self, session: zenoh.Session, key: str) -> None:
        """Keep a session for as long as it is heard, and until this is closed."""
        held = [*answer_echo(session, key), session.info.declare_link_events_listener(self._on_link)]
        try:
            self._look(key)
        finally:
            # Before the session is closed: Zenoh's threads would call back into an interpreter that is about to end.
            for one in held:
                with suppress(zenoh.ZError):
                    one.undeclare()

    def _look(self, key: str) -> None:
        """Look now and then, and after each new link, whether one is heard; returns when it is to be joined anew."""
        self._hearing.begin()
        while not self._closing.is_set():
            if self._has_link.wait(self._hearing.pause_s()):
                self._has_link.clear()
                self._hearing.link()
                continue
            told = self._hearing.look(is_heard=is_heard(key, open_session=self._probe))
            if told is not None:
                say = {Told.UNHEARD: _log.warning, Told.DENIED: _log.error, Told.HEARD: _log.info}[told]
                say(told.value, reason=WHY[told])
            if self._hearing.joins_anew:
                return

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        """Runs on a thread of Zenoh."""
        if event.kind == zenoh.SampleKind.PUT:
            self._has_link.set()
