"""The mapper on Zenoh: what gateways publish comes in, history queries and commands go out (CONTRACT.md §2).

Zenoh calls back on threads of its own. Callbacks only put bytes into a bounded inbox and wake the event loop once; decoding happens there.
"""

import asyncio
import random
import threading
from collections import Counter, deque
from collections.abc import AsyncGenerator
from contextlib import aclosing, suppress
from functools import partial
from typing import Final, Self

import zenoh
import zenoh.ext

from firmware_protocol.contract.commands import CommanderBeat, CommandStage, StimulationRequest
from firmware_protocol.contract.keys import ANY, Stream, build_key
from firmware_protocol.contract.mission_orders import MissionAnswer, MissionOrder
from firmware_protocol.contract.presence import Kind, build_token_key, parse_token_key
from firmware_protocol.contract.recordings import RecordingList
from firmware_protocol.contract.records import HistoryRequest, RecordBatch, Watermark, decode_record, encode_record
from firmware_protocol.contract.sessions import TlsTable, ZenohTable, endpoint_problem
from firmware_protocol.errors import KeyExpressionError, RecordError
from mapper.arrivals import Arrival, decode_arrival
from mapper.bus_queries import Queries, Query, first_sentence
from mapper.bus_standing import Declared, StandingSession
from mapper.errors import BusError, QueryError
from mapper.log import EventLog

_log = EventLog(__name__)

_MAX_INBOX_MESSAGES: Final = 20_000
_MAX_INBOX_BYTES: Final = 64 * 2**20
# A session that was just connected learns within this who is alive; one that was killed is alive until its lease of 10 s is over.
_SETTLE_S: Final = 1.5
_PATIENCE_S: Final = 15.0
_MAX_SITES: Final = 1024
_MAX_SEEN: Final = 1024
"""Sites, and gateways of each, that are remembered."""
_LOOK_EVERY_S: Final = 0.1
_ALIVE_TIMEOUT_S: Final = 1.0

# What is decoded in one go, so that a flood never holds up a request: a few milliseconds.
_MAX_TAKEN_MESSAGES: Final = 500
_MAX_TAKEN_BYTES: Final = 2**18

_JOURNALED: Final = (Stream.ENCOUNTERS, Stream.MODES, Stream.MISSION)


class Bus:
    """A Zenoh session of the mapper; made by `open`.

    ``counters`` counts what was left out: ``overflow`` messages for which there was no room (history brings their records), ``unfit``
    ones that are no records or come from another gateway than their key says.
    """

    def __init__(self, *, site: str, loop: asyncio.AbstractEventLoop) -> None:
        self.counters: Counter[str] = Counter()
        self._site = site
        self._loop = loop
        self._session: StandingSession
        self._queries: Queries
        self._sites: dict[str, set[str]] = {}
        self._lock = threading.Lock()
        self._inbox: deque[tuple[str, bytes | bool]] = deque()
        self._inbox_bytes = 0
        self._has_arrivals = asyncio.Event()
        self._is_claimed = asyncio.Event()
        self._commander_key = ""

    @classmethod
    async def open(
        cls,
        *,
        site: str,
        connect: tuple[str, ...],
        listen: tuple[str, ...],
        tls: TlsTable | None = None,
        timing: ZenohTable | None = None,
        name: str | None = None,
    ) -> Self:
        """Join the bus; gateways and routers that are not there yet are connected to when they come.

        Raises
        ------
        BusError
            An endpoint cannot be understood, or cannot be listened on.
        """
        bus = cls(site=site, loop=asyncio.get_running_loop())
        echo = None if name is None else build_key(site=site, stream=Stream.ECHO, gateway=name)
        for reason in filter(None, (endpoint_problem(endpoint, listens=False) for endpoint in connect)):
            raise BusError(reason=reason, next_step="give endpoints such as tcp/127.0.0.1:7447")
        try:
            bus._session = await asyncio.to_thread(
                partial(StandingSession, connect=connect, listen=listen, tls=tls or TlsTable(), timing=timing, echo=echo)
            )
            bus._queries = Queries(bus._session, loop=bus._loop)
            await asyncio.to_thread(bus._declare)
        except zenoh.ZError as error:
            raise BusError(
                reason=f"Zenoh refuses connect={list(connect)}, listen={list(listen)}: {first_sentence(error)}",
                next_step="give endpoints such as tcp/127.0.0.1:7447",
            ) from error
        return bus

    async def aclose(self) -> None:
        """Leave the bus."""
        await asyncio.to_thread(self._session.close)

    @property
    def site(self) -> str:
        """The site whose gateways are heard."""
        return self._site

    @property
    def is_connected(self) -> bool:
        """Say whether any gateway or router is connected."""
        return self._session.is_connected

    async def claim(self, name: str, *, settle_s: float = _SETTLE_S, patience_s: float = _PATIENCE_S) -> None:
        """Be alive under a name, once somebody is connected and nobody else has been alive under it for ``settle_s`` to twice that.

        Gateways keep what a mapper of that name lacks: two would pass for one, and the records of the one that lags would be dropped.

        Raises
        ------
        BusError
            Somebody else is alive under it, and still is after ``patience_s``: a mapper that was killed may be for a while.
        """
        key = build_token_key(site=self._site, kind=Kind.MAPPER, name=name)

        def is_taken() -> bool:
            session = self._session.current
            return session is not None and any(reply.ok is not None for reply in session.liveliness().get(key, timeout=_ALIVE_TIMEOUT_S))

        settle_s *= random.uniform(1, 2)  # two that come to be connected at one moment are not to claim it at one moment
        free_since = taken_since = None
        while free_since is None or self._loop.time() - free_since < settle_s:
            now = self._loop.time()
            if not self.is_connected:
                free_since = taken_since = None
            elif await asyncio.to_thread(is_taken):
                if taken_since is None:
                    _log.warning("bus.name_taken", name=name)
                free_since, taken_since = None, taken_since or now
                if now - taken_since >= patience_s:
                    raise BusError(
                        reason=f"a mapper named {name!r} is alive at site {self._site!r} already", next_step="give this one another --name"
                    )
            else:
                free_since, taken_since = free_since or now, None
            await asyncio.sleep(_LOOK_EVERY_S)
        await asyncio.to_thread(self._session.hold_token, key)
        self._is_claimed.set()

    async def be_commander(self, name: str) -> None:
        """Hold the token of a commander, once `claim` has made sure that nobody else has that name: it must go when this process does."""
        await self._is_claimed.wait()
        key = build_token_key(site=self._site, kind=Kind.COMMANDER, name=name)
        await asyncio.to_thread(self._session.hold_token, key)
        self._commander_key = key

    async def resign(self) -> None:
        """Give the commander's token back; gateways stop whom it moved."""
        with suppress(zenoh.ZError):
            await asyncio.to_thread(self._session.undeclare, self._commander_key)

    def publish_beat(self, *, commander: str, number: int) -> None:
        """Say that a commander is there. It takes no longer than a millisecond: on a link that takes nothing it is dropped."""
        key = build_key(site=self._site, stream=Stream.BEAT, gateway=commander)
        session = self._session.current
        if session is None:
            return
        with suppress(zenoh.ZError):
            session.put(
                key,
                encode_record(CommanderBeat(number=number)),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )

    async def receive(self) -> list[Arrival]:
        """Wait until something came in, and return the first of it in order of arrival; what cannot be meant is counted and left out."""
        await self._has_arrivals.wait()
        raw: list[tuple[str, bytes | bool]] = []
        size = 0
        with self._lock:
            while self._inbox and len(raw) < _MAX_TAKEN_MESSAGES and size < _MAX_TAKEN_BYTES:
                key, payload = self._inbox.popleft()
                raw.append((key, payload))
                size += _size(payload)
            self._inbox_bytes -= size
            if not self._inbox:
                self._has_arrivals.clear()
        arrivals = [arrival for key, payload in raw if (arrival := decode_arrival(key, payload)) is not None]
        self.counters["unfit"] += len(raw) - len(arrivals)
        await asyncio.sleep(0)  # where more waits, nothing else would let requests in between
        return arrivals

    async def fetch_history(self, gateway: str, *, from_offset: int, limit: int, timeout_s: float = 10.0) -> list[RecordBatch]:
        """Ask a gateway for records of its journal; an empty list means that it is not there.

        Raises
        ------
        QueryError
            The answer was not brought to its end; nothing of it is returned.
        """
        key = build_key(site=self._site, stream=Stream.HISTORY, gateway=gateway)
        request = HistoryRequest(from_offset=from_offset, limit=limit)
        batches: list[RecordBatch] = []
        async with aclosing(self._queries.replies(self._queries.begin(key, encode_record(request), timeout_s=timeout_s))) as replies:
            async for payload in replies:
                if isinstance(payload, QueryError):
                    raise payload
                try:
                    batch = decode_record(payload, RecordBatch)
                except RecordError as error:
                    raise QueryError(key=key, reason=str(error), is_timeout=False) from error
                if batch.gateway == gateway:
                    batches.append(batch)
        return batches

    async def publish_watermark(self, *, gateway: str, journal: str, mapper: str, offset: int) -> None:
        """Tell a gateway how far a mapper has its records; one that is not there hears it the next time."""
        key = build_key(site=self._site, stream=Stream.WATERMARK, gateway=gateway, mapper=mapper)
        payload = encode_record(Watermark(mapper=mapper, journal=journal, offset=offset))
        session = self._session.current
        if session is not None:
            with suppress(zenoh.ZError):
                await asyncio.to_thread(session.put, key, payload)

    def send_command(
        self, request: StimulationRequest, *, gateway: str | None, timeout_s: float
    ) -> AsyncGenerator[CommandStage | QueryError, None]:
        """Send a command now, to a gateway or (None) to all, and return what yields the stages that they report.

        Commands leave in the order in which they are given, a stop never before a start that was given earlier, ahead of all else on the
        bus. None is waited for longer than a millisecond a link: where a link takes nothing it is dropped, and whoever gives a stop asks
        again.

        No stage at all means that nobody is there. An error is yielded for a gateway that refused the form of the request, and for no end
        of the answers within ``timeout_s``.
        """
        key = build_key(site=self._site, stream=Stream.COMMAND, gateway=gateway or ANY)
        return self._stages_of(request, self._queries.begin(key, encode_record(request), timeout_s=timeout_s, is_command=True))

    async def _stages_of(self, request: StimulationRequest, query: Query) -> AsyncGenerator[CommandStage | QueryError, None]:
        async with aclosing(self._queries.replies(query)) as replies:
            async for payload in replies:
                if isinstance(payload, QueryError):
                    yield payload
                    continue
                try:
                    stage = decode_record(payload, CommandStage)
                except RecordError as error:
                    yield QueryError(key=query.key, reason=str(error), is_timeout=False)
                    continue
                if stage.command_id == request.command_id:
                    yield stage

    async def send_order(self, order: MissionOrder, *, gateway: str | None, timeout_s: float) -> list[MissionAnswer]:
        """Give the mission of a gateway, or (None) of all, an order; an empty list means that nobody is there.

        Raises
        ------
        QueryError
            Nobody answered, but for an error.
        """
        key = build_key(site=self._site, stream=Stream.ORDERS, gateway=gateway or ANY)
        answers: list[MissionAnswer] = []
        fault: QueryError | None = None
        async with aclosing(self._queries.replies(self._queries.begin(key, encode_record(order), timeout_s=timeout_s))) as replies:
            async for payload in replies:
                if isinstance(payload, QueryError):
                    fault = payload
                    continue
                try:
                    answers.append(decode_record(payload, MissionAnswer))
                except RecordError as error:
                    fault = QueryError(key=key, reason=str(error), is_timeout=False)
        if fault is not None and not answers:
            raise fault
        return answers

    async def list_recordings(self, *, timeout_s: float = 5.0) -> list[RecordingList]:
        """Ask all gateways of the site which recordings they have; those that are not there, or do not answer, are left out."""
        key = build_key(site=self._site, stream=Stream.RECORDINGS, gateway=ANY)
        found: list[RecordingList] = []
        async with aclosing(self._queries.replies(self._queries.begin(key, b"", timeout_s=timeout_s))) as replies:
            async for payload in replies:
                with suppress(RecordError):
                    if not isinstance(payload, QueryError):
                        found.append(decode_record(payload, RecordingList))
        return sorted(found, key=lambda one: one.gateway)

    def sites(self) -> dict[str, list[str]]:
        """Name all sites whose gateways are seen on the bus, and these gateways; on a secured bus, this site alone."""
        with self._lock:
            return {site: sorted(gateways) for site, gateways in sorted(self._sites.items()) if gateways}

    def _declare(self) -> None:
        def pattern(stream: Stream, *, node: str | None = None) -> str:
            return build_key(site=self._site, stream=stream, gateway=ANY, node=node)

        advanced = [pattern(stream) for stream in _JOURNALED] + [pattern(Stream.STATUS), pattern(Stream.STATUS, node=ANY)]
        for key in advanced:
            self._session.subscribe_advanced(key, self._on_sample)
        plain = (
            pattern(Stream.NEIGHBOURS, node=ANY),
            pattern(Stream.EVENTS),
            pattern(Stream.STAGES),
            pattern(Stream.STIMULATION, node=ANY),
        )
        for key in plain:
            self._session.subscribe(key, self._on_sample)
        seen = (
            build_token_key(site=self._site, kind=Kind.GATEWAY, name=ANY),
            build_token_key(site=self._site, kind=Kind.RADIO, name=ANY, radio=ANY),
            build_token_key(site=self._site, kind=Kind.MAPPER, name=ANY),
            build_token_key(site=self._site, kind=Kind.COMMANDER, name=ANY),
        )
        for key in seen:
            self._session.subscribe_tokens(key, self._on_presence)
        self._session.declare("sites", self._watch_sites)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._push(str(sample.key_expr), sample.payload.to_bytes())

    def _on_presence(self, sample: zenoh.Sample) -> None:
        self._push(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    def _watch_sites(self, session: zenoh.Session) -> Declared:
        with self._lock:
            self._sites.clear()  # who left while there was no session is not told
        key = build_token_key(site=ANY, kind=Kind.GATEWAY, name=ANY)
        return session.liveliness().declare_subscriber(key, self._on_site, history=True)

    def _on_site(self, sample: zenoh.Sample) -> None:
        with suppress(KeyExpressionError):
            token = parse_token_key(str(sample.key_expr))
            with self._lock:
                seen = self._sites.setdefault(token.site, set()) if len(self._sites) < _MAX_SITES else self._sites.get(token.site, set())
                (seen.add if sample.kind == zenoh.SampleKind.PUT and len(seen) < _MAX_SEEN else seen.discard)(token.name)

    def _push(self, key: str, payload: bytes | bool) -> None:  # noqa: FBT001  # the payload of a liveliness sample is its kind
        size = _size(payload)
        with self._lock:
            if isinstance(payload, bytes) and (len(self._inbox) >= _MAX_INBOX_MESSAGES or self._inbox_bytes + size > _MAX_INBOX_BYTES):
                self.counters["overflow"] += 1
                return
            is_first = not self._inbox
            self._inbox.append((key, payload))
            self._inbox_bytes += size
        if is_first:
            with suppress(RuntimeError):  # the loop is closed: nobody listens any more
                self._loop.call_soon_threadsafe(self._has_arrivals.set)


def _size(payload: bytes | bool) -> int:  # noqa: FBT001  # see Bus._push
    return len(payload) if isinstance(payload, bytes) else 0
