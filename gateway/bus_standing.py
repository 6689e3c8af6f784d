"""The Zenoh session of a service, which may not be there yet, and what stands declared on it once it is.

A service that only connects, to one router, is a *client* of Zenoh: a router that stood still for longer than the lease finds the end of
a link and the new link at one moment, and may forget for good what another *router* has declared, or leave a *client* deaf or mute
(eclipse-zenoh 1.10.2, ADR 0028). A client's session can be closed and opened anew, which heals that. It opens only when somebody is
there, so it is opened in the background, again and again. A service that listens, or connects to several, is a router of Zenoh, whose
session opens at once, and stays.
"""

import contextlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final, TypeAlias

import zenoh

from firmware_protocol.contract.hearing import WHY, Hearing, Told
from firmware_protocol.contract.sessions import CLIENT, TlsTable, ZenohTable, mode_of_service
from gateway.bus_echo import answer_echo, is_heard
from gateway.bus_session import open_service, try_client
from gateway.log import EventLog

_log = EventLog(__name__)

Declared: TypeAlias = zenoh.Queryable[None] | zenoh.Subscriber[None] | zenoh.LivelinessToken

_PAUSE_S: Final = 0.1
"""Between two attempts to open a client's session; each of them lasts for as long as a connection may take."""

_JOIN_S: Final = 3.0
_SETTLE_S: Final = 0.1
"""For Zenoh's threads to let go of what they called back: in an interpreter that ends meanwhile, they bring the process down."""


class ServiceSession:
    """See the module. What others do with the session, they do by ``when_open``.

    Parameters
    ----------
    echo
        A key of one's own, under which a client looks whether it is heard; None: it does not look.

    Raises
    ------
    BusError
        An endpoint cannot be listened on, or is none.
    """

    def __init__(
        self,
        *,
        listen: Sequence[str],
        connect: Sequence[str],
        tls: TlsTable,
        timing: ZenohTable | None = None,
        access: Mapping[str, object] | None = None,
        echo: str | None = None,
    ) -> None:
        self._lock = threading.RLock()
        self._is_open, self._closing, self._has_link = threading.Event(), threading.Event(), threading.Event()
        self._hearing = Hearing()
        self._hooks: list[Callable[[zenoh.Session], None]] = []
        self._session: zenoh.Session | None = None
        self._thread: threading.Thread | None = None
        self._probe = partial(try_client, connect=tuple(connect), tls=tls, timing=timing)
        if mode_of_service(listen=listen, connect=connect) == CLIENT:
            self._thread = threading.Thread(target=self._join, args=(echo,), name="joining", daemon=True)
            self._thread.start()
        else:
            self._came(open_service(listen=listen, connect=connect, tls=tls, timing=timing, access=access))

    @property
    def current(self) -> zenoh.Session | None:
        """The session, where it is open."""
        return self._session

    def n_links(self) -> int:
        """Return how many other sessions are connected now."""
        session = self._session
        return 0 if session is None else len(session.info.transports())

    def when_open(self, do: Callable[[zenoh.Session], None]) -> None:
        """Have something done with each session, in the order of these calls: now with the one that is open, and with those to come."""
        with self._lock:
            self._hooks.append(do)
            if self._session is not None:
                do(self._session)

    def wait_open(self, timeout_s: float) -> bool:
        """Wait until it is open; False: it is not by then."""
        return self._is_open.wait(timeout_s)

    def close(self) -> None:
        """Close the session, and open none any more."""
        self._closing.set()
        self._has_link.set()
        if self._thread is not None:
            self._thread.join(timeout=_JOIN_S)  # longer where it is trying to connect: it closes what it gets then
        self._leave()
        time.sleep(_SETTLE_S)

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
            self._session = session
            for do in self._hooks:
                try:
                    do(session)
                except (zenoh.ZError, RuntimeError) as error:  # RuntimeError: the event loop is closed already
                    _log.error("bus.undeclared", reason=str(error))
        self._is_open.set()

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
                with contextlib.suppress(zenoh.ZError):
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


class StandingDeclarations:
    """What is declared by name: on the session that is open, and on those to come."""

    def __init__(self, session: ServiceSession) -> None:
        self._session = session
        self._lock = threading.RLock()
        self._makers: dict[str, Callable[[zenoh.Session], Declared]] = {}
        self._made: dict[str, Declared] = {}
        self._made_on: zenoh.Session | None = None
        session.when_open(self._declare_all)

    def declare(self, name: str, make: Callable[[zenoh.Session], Declared]) -> None:
        """Declare what ``make`` makes, under a name that is free; raises ``ZError`` where Zenoh does not take it."""
        with self._lock:
            self._makers[name] = make
            if self._made_on is not None and self._made_on is self._session.current:  # else it is made with all the others
                self._made[name] = make(self._made_on)

    def undeclare(self, name: str) -> None:
        """Take back what was declared under a name, if it was."""
        with self._lock:
            self._makers.pop(name, None)
            made = self._made.pop(name, None)
        if made is not None:
            with contextlib.suppress(zenoh.ZError):  # of a session that was closed meanwhile
                made.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def is_declared(self, name: str) -> bool:
        """Whether something stands under a name, or will."""
        return name in self._makers

    def close(self) -> None:
        """Take all of it back, the newest first."""
        for name in reversed(list(self._makers)):
            self.undeclare(name)

    def _declare_all(self, session: zenoh.Session) -> None:
        with self._lock:
            self._made, self._made_on = {}, session
            for name, make in self._makers.items():
                self._made[name] = make(session)
