"""A Zenoh router as a service: carries many gateways, mappers and operators of many sites; secured, and heeding a roster alone."""

import contextlib
import os
import queue
import signal
import time
from collections.abc import Callable
from dataclasses import asdict
from enum import Enum
from types import FrameType

import msgspec
import zenoh

from firmware_protocol.contract.access import Identity, access_control, parse_identity
from firmware_protocol.contract.handshakes import CertificateFacts
from firmware_protocol.contract.sessions import SECURE_PREFIXES, host_and_port
from firmware_protocol.errors import KeyExpressionError
from gateway.bus_session import ConnectionWatch, open_client, open_service
from gateway.errors import BusError
from gateway.health import Health
from gateway.log import EventLog
from gateway.router_config import RouterConfig
from gateway.router_guests import Guest, GuestBook
from gateway.service_manager import ServiceManager
from gateway.tls_files import check_tls_files, read_roster
from gateway.zenoh_log import capture_zenoh_log

_log = EventLog(__name__)

_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}  # noqa: S104  # nothing is opened there: where a router that listens so is found


class _Order(Enum):
    STOP = "stop"
    RELOAD = "reload"


class Router:
    """An open router. What happens on it is put into ``happenings`` by Zenoh's threads and by signals, and handled by `run`."""

    def __init__(self, config: RouterConfig, *, manager: ServiceManager | None = None) -> None:
        self._config = config
        self._manager = manager or ServiceManager(address=None)
        self._health = Health()
        self._happenings: queue.SimpleQueue[_Order | zenoh.LinkEvent] = queue.SimpleQueue()
        self._members: list[Identity] = []
        self._facts: CertificateFacts | None = None
        self._guests = GuestBook()
        self._session: zenoh.Session
        self._watch: ConnectionWatch

    def stop(self) -> None:
        """Have `run` return; may be called from a signal handler."""
        self._happenings.put(_Order.STOP)

    def reload(self) -> None:
        """Read the roster again; may be called from a signal handler."""
        self._happenings.put(_Order.RELOAD)

    def run(self) -> None:
        """Carry messages until stopped.

        Raises
        ------
        BusError
            An endpoint cannot be listened on, or is none; the roster is unfit.
        """
        self._open(self._read_roster())
        # From here on the session is closed whatever happens: the process of an open one does not end.
        try:
            _log.info(
                "router.started",
                listen=", ".join(self._config.listen),
                connect=", ".join(self._config.connect),
                members=len(self._members) if self._config.roster is not None else "anybody",
            )
            self._warn_of_open_doors()
            self._manager.ready()
            while (happening := self._next()) is not _Order.STOP:
                if happening is _Order.RELOAD:
                    self._reload()
                elif isinstance(happening, zenoh.LinkEvent):
                    self._tell(happening)
                for guest in self._guests.stayed(now_s=time.monotonic()):
                    self._say_of(guest)("router.joined", **asdict(guest))
                # Zenoh is asked first: a router that hangs in it gives no sign of life.
                self._manager.tell(f"{len(self._session.info.transports())} connected")
                self._manager.give_sign()
        finally:
            self._manager.stopping()
            self._close()
        _log.info("router.stopped")

    def _next(self) -> "_Order | zenoh.LinkEvent | None":
        """Wait for what happens next; None: nothing did until a sign of life was due, or somebody had come to stay."""
        due_s = self._guests.next_s()
        waits_s = [] if due_s is None else [max(0.0, due_s - time.monotonic())]
        waits_s += [] if self._manager.sign_every_s is None else [self._manager.sign_every_s]
        try:
            return self._happenings.get(timeout=min(waits_s, default=None))
        except queue.Empty:
            return None

    def _open(self, members: list[Identity]) -> None:
        config = self._config
        access = None if config.roster is None else access_control(members)
        self._session = open_service(listen=config.listen, connect=config.connect, tls=config.tls, timing=config.zenoh, access=access)
        self._members = members
        self._facts = check_tls_files(config.tls, roles=()).facts
        self._watch = ConnectionWatch(
            n_links=lambda: len(self._session.info.transports()),
            connect=config.connect,
            tls=config.tls,
            facts=self._facts,
            health=self._health,
        )
        self._session.info.declare_link_events_listener(self._happenings.put, history=True)

    def _close(self) -> None:
        self._watch.close()
        self._session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def _read_roster(self) -> list[Identity]:
        if self._config.roster is None:
            return []
        members, problems = read_roster(self._config.roster)
        if problems:
            raise BusError("; ".join(problems))
        return members

    def _reload(self) -> None:
        """Zenoh's access control cannot be changed: the session is closed and opened again, and all connect again within a second."""
        try:
            members = self._read_roster()
        except BusError as error:
            _log.error("router.roster_unfit", reason=str(error), kept=len(self._members))
            return
        if members == self._members:
            _log.info("router.roster_unchanged", members=len(members))
            return
        self._close()
        self._guests.forget()
        self._open(members)
        _log.info("router.roster_read", members=len(members))

    def _tell(self, event: zenoh.LinkEvent) -> None:
        link = event.link
        guest = Guest(name=link.auth_identifier or "", address=link.dst, zid=str(link.zid))
        if event.kind == zenoh.SampleKind.DELETE:
            if self._guests.leave(guest):
                self._say_of(guest)("router.left", **asdict(guest))
            return
        stranger = self._why_stranger(guest.name)
        if stranger is None:
            self._guests.come(guest, now_s=time.monotonic())
            return
        self._health.count("router.strangers")
        if self._guests.come_stranger(guest.name, now_s=time.monotonic()):
            _log.warning("router.stranger", **asdict(guest), reason=stranger)

    def _say_of(self, guest: Guest) -> Callable[..., None]:
        """Return how to log who comes and goes: whoever shows this router's own certificate is `ping_router`, again and again."""
        return _log.debug if guest.name and self._facts is not None and guest.name == self._facts.common_name else _log.info

    def _why_stranger(self, common_name: str) -> str | None:
        if self._config.roster is None or common_name in {member.common_name for member in self._members}:
            return None
        try:
            parse_identity(common_name)
        except KeyExpressionError as error:
            return f"{error}; everything is denied to it"
        return f"{common_name} is not on the roster {self._config.roster}; everything is denied to it. Add the line and send SIGHUP"

    def _warn_of_open_doors(self) -> None:
        for endpoint in self._config.listen:
            host = endpoint.partition("/")[2].rpartition(":")[0]
            if not endpoint.startswith(SECURE_PREFIXES) and host not in _LOOPBACK:
                _log.warning("router.open", endpoint=endpoint, reason="whoever reaches it may do everything; see biobot-gateway certs")


def run_router(config: RouterConfig) -> None:
    """Run a router until SIGTERM or SIGINT; a second one ends the process at once. SIGHUP reads the roster again."""
    capture_zenoh_log()
    with contextlib.closing(ServiceManager.of(os.environ)) as manager:
        _run_until_signalled(Router(config, manager=manager))


def ping_router(config: RouterConfig) -> None:
    """Open a session with the router of this machine that runs with this configuration, as itself, and close it again.

    Raises
    ------
    BusError
        It does not answer; the reason is told for each endpoint.
    """
    # It is sought on loopback, which no certificate needs to name.
    tls = msgspec.structs.replace(config.tls, verify_name=False)
    for endpoint in config.listen:
        open_client(connect=[_way_in(endpoint)], tls=tls, timing=config.zenoh).close()  # type: ignore[no-untyped-call]  # as in _close


def _way_in(endpoint: str) -> str:
    """Return what to connect to for an endpoint that is listened on."""
    address = host_and_port(endpoint)
    if address is None or address[0] not in _EVERYWHERE:
        return endpoint
    return f"{endpoint.partition('/')[0]}/{_EVERYWHERE[address[0]]}:{address[1]}"


def _run_until_signalled(router: Router) -> None:
    def on_stop(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        router.stop()

    signal.signal(signal.SIGTERM, on_stop)
    signal.signal(signal.SIGINT, on_stop)
    signal.signal(signal.SIGHUP, lambda _number, _frame: router.reload())
    router.run()
