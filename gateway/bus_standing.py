"""The Zenoh session of a service, which may not be there yet, and what stands declared on it once it is.

A service that only connects, to one router, is a *client* of Zenoh: a router that stood still for longer than the lease finds the end of
a link and the new link at one moment, and forgets for good what another *router* has declared (eclipse-zenoh 1.10, ADR 0016); of a client
it forgets nothing. A client's session opens only when somebody is there, so it is opened in the background, again and again. A service
that listens, or connects to several, is a router of Zenoh, whose session opens at once.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeAlias

import zenoh

from firmware_protocol.contract.sessions import CLIENT, TlsTable, ZenohTable, mode_of_service
from gateway.bus_session import open_service, try_client
from gateway.log import EventLog

_log = EventLog(__name__)

Declared: TypeAlias = zenoh.Queryable[None] | zenoh.Subscriber[None] | zenoh.LivelinessToken

_PAUSE_S: Final = 0.1
"""Between two attempts to open a client's session; each of them lasts for as long as a connection may take."""

_JOIN_S: Final = 5.0


class ServiceSession:
    """See the module. What others do with the session, they do by ``when_open``.

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
    ) -> None:
        self._lock = threading.RLock()
        self._is_open, self._closing = threading.Event(), threading.Event()
        self._todo: list[Callable[[zenoh.Session], None]] = []
        self._session: zenoh.Session | None = None
        self._thread: threading.Thread | None = None
        if mode_of_service(listen=listen, connect=connect) == CLIENT:
            self._thread = threading.Thread(target=self._join, args=(tuple(connect), tls, timing), name="joining", daemon=True)
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
        """Have something done with the session: now, or on a thread of its own once it is open."""
        with self._lock:
            if self._session is None:
                self._todo.append(do)
            else:
                do(self._session)

    def wait_open(self, timeout_s: float) -> bool:
        """Wait until it is open; False: it is not by then."""
        return self._is_open.wait(timeout_s)

    def close(self) -> None:
        """Close the session, and open none any more."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=_JOIN_S)
        with self._lock:
            session, self._session = self._session, None
            if session is not None:
                session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def _join(self, connect: tuple[str, ...], tls: TlsTable, timing: ZenohTable | None) -> None:
        while not self._closing.is_set():
            session = try_client(connect=connect, tls=tls, timing=timing)
            if session is not None:
                if self._closing.is_set():
                    session.close()  # type: ignore[no-untyped-call]  # same
                else:
                    self._came(session)
                return
            self._closing.wait(_PAUSE_S)

    def _came(self, session: zenoh.Session) -> None:
        with self._lock:
            self._session = session
            for do in self._todo:
                try:
                    do(session)
                except zenoh.ZError as error:
                    _log.error("bus.undeclared", reason=str(error))
            self._todo.clear()
        self._is_open.set()


class StandingDeclarations:
    """What is declared by name: on the session, or once there is one."""

    def __init__(self, session: ServiceSession) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._names: dict[str, Declared | None] = {}

    def declare(self, name: str, make: Callable[[zenoh.Session], Declared]) -> None:
        """Declare what ``make`` makes, under a name that is free; raises ``ZError`` where Zenoh does not take it."""
        with self._lock:
            self._names[name] = None

        def declare_now(session: zenoh.Session) -> None:
            with self._lock:
                if name in self._names:  # it may have been taken back before there was a session
                    self._names[name] = make(session)

        self._session.when_open(declare_now)

    def undeclare(self, name: str) -> None:
        """Take back what was declared under a name, if it was."""
        with self._lock:
            made = self._names.pop(name, None)
            if made is not None:
                made.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def is_declared(self, name: str) -> bool:
        """Whether something stands under a name, or will."""
        return name in self._names

    def close(self) -> None:
        """Take all of it back, the newest first."""
        for name in reversed(list(self._names)):
            self.undeclare(name)
