"""What all gateways of a site say of themselves, as it comes, for the status view; the other file here that imports Zenoh.

It is apart from ``bus`` because it is no part of a gateway: it only listens, and to all of a site. Zenoh calls back on threads of its own,
which only append to a bounded queue; what overflows it is the oldest, which newer states have replaced.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any, Self

import zenoh

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.keys import ANY, Stream, build_key, parse_key
from firmware_protocol.contract.records import GatewayStatus, decode_record
from firmware_protocol.contract.sessions import TlsTable, ZenohTable
from firmware_protocol.errors import KeyExpressionError, RecordError
from gateway.bus_session import ConnectionWatch, open_service
from gateway.health import Health
from gateway.site_view import Arrival, Presence

_MAX_WAITING = 1024


class SiteWatch:
    """Listens to a site until it is closed.

    Parameters
    ----------
    gateway
        The one that is listened to, or None for all.
    """

    def __init__(self, session: zenoh.Session, *, watch: ConnectionWatch, site: str, gateway: str | None) -> None:
        self._session = session
        self._watch = watch
        self._arrivals: deque[Arrival] = deque(maxlen=_MAX_WAITING)
        name = gateway or ANY
        # Kept, because a subscriber that nobody holds is undeclared.
        self._subscribers: list[zenoh.Subscriber[Any]] = [
            session.declare_subscriber(build_key(site=site, stream=Stream.STATUS, gateway=name), self._take_status),
            session.declare_subscriber(build_key(site=site, stream=Stream.EVENTS, gateway=name), self._take_event),
            session.liveliness().declare_subscriber(
                build_key(site=site, stream=Stream.ALIVE, gateway=name), self._take_presence, history=True
            ),
        ]

    @classmethod
    def open(cls, *, site: str, gateway: str | None, connect: Sequence[str], tls: TlsTable, timing: ZenohTable | None = None) -> Self:
        """Listen from now on; a gateway or router that is not there yet is connected to when it comes.

        Raises
        ------
        BusError
            ``connect`` is no endpoint.
        """
        session = open_service(listen=(), connect=connect, tls=tls, timing=timing)
        watch = ConnectionWatch(n_links=lambda: len(session.info.transports()), connect=connect, tls=tls, facts=None, health=Health())
        return cls(session, watch=watch, site=site, gateway=gateway)

    @property
    def is_connected(self) -> bool:
        """Whether any gateway or router is connected."""
        return bool(self._session.info.transports())

    @property
    def missing(self) -> str | None:
        """Say why nobody is connected, endpoint by endpoint, or None: somebody is, or the reason is not known yet."""
        return self._watch.missing

    def take(self) -> list[Arrival]:
        """Return what came in since the last call, in order."""
        arrivals = []
        while self._arrivals:
            arrivals.append(self._arrivals.popleft())
        return arrivals

    def close(self) -> None:
        """Listen no more."""
        self._watch.close()
        self._session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def _take_status(self, sample: zenoh.Sample) -> None:
        try:
            self._arrivals.append(decode_record(sample.payload.to_bytes(), GatewayStatus))
        except RecordError:
            return  # another version's, or nobody's: there is nothing to show of it

    def _take_event(self, sample: zenoh.Sample) -> None:
        try:
            self._arrivals.append(decode_record(sample.payload.to_bytes(), GatewayEvent))
        except RecordError:
            return

    def _take_presence(self, sample: zenoh.Sample) -> None:
        try:
            gateway = parse_key(str(sample.key_expr)).gateway
        except KeyExpressionError:
            return
        self._arrivals.append(Presence(gateway=gateway, is_alive=sample.kind == zenoh.SampleKind.PUT))
