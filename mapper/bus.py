"""The mapper on Zenoh: what gateways publish comes in, history queries and commands go out (CONTRACT.md §2).

Zenoh calls back on threads of its own. Callbacks only put bytes into a bounded inbox and wake the event loop once; decoding happens there.
"""

import asyncio
import json
import random
import threading
from collections import Counter, deque
from collections.abc import AsyncGenerator
from contextlib import aclosing, suppress
from dataclasses import dataclass
from typing import Any, Final, Self, TypeAlias

import zenoh
import zenoh.ext

from firmware_protocol.contract.commands import CommandStage, StimulationRequest
from firmware_protocol.contract.keys import ANY, Key, Stream, build_key, parse_key
from firmware_protocol.contract.presence import Kind, Token, build_token_key, parse_token_key
from firmware_protocol.contract.records import (
    GatewayEvent,
    GatewayStatus,
    HistoryRequest,
    NeighbourReport,
    NodeStatus,
    RecordBatch,
    Watermark,
    decode_record,
    encode_record,
)
from firmware_protocol.contract.sessions import ROUTER, TlsTable, ZenohTable, session_settings
from firmware_protocol.errors import KeyExpressionError, RecordError
from mapper.errors import BusError, QueryError
from mapper.log import EventLog

_log = EventLog(__name__)

_MAX_INBOX_MESSAGES: Final = 20_000
_MAX_INBOX_BYTES: Final = 64 * 2**20
# Zenoh answers a query that nobody ends with this error (measured, eclipse-zenoh 1.10).
_TIMEOUT_PAYLOAD: Final = b"Timeout"
_DEADLINE_SLACK_S: Final = 2.0
# A session that was just connected learns within this who is alive; one that was killed is alive until its lease of 10 s is over.
_SETTLE_S: Final = 1.5
_PATIENCE_S: Final = 15.0
_LOOK_EVERY_S: Final = 0.1
_ALIVE_TIMEOUT_S: Final = 1.0

_JOURNALED: Final = (Stream.ENCOUNTERS, Stream.MODES, Stream.MISSION)


@dataclass(frozen=True, slots=True, kw_only=True)
class Presence:
    """A gateway, one of its radios or a mapper came to the bus, or left it."""

    token: Token
    is_alive: bool


Arrival: TypeAlias = RecordBatch | GatewayStatus | NodeStatus | NeighbourReport | GatewayEvent | Presence


class Bus:
    """A Zenoh session of the mapper; made by `open`.

    ``counters`` counts what was left out: ``overflow`` messages for which there was no room (history brings their records), ``unfit``
    ones that are no records or come from another gateway than their key says.
    """

    def __init__(self, *, site: str, loop: asyncio.AbstractEventLoop) -> None:
        self.counters: Counter[str] = Counter()
        self._site = site
        self._loop = loop
        self._session: zenoh.Session
        self._declared: list[Any] = []
        self._lock = threading.Lock()
        self._inbox: deque[tuple[str, bytes | bool]] = deque()
        self._inbox_bytes = 0
        self._has_arrivals = asyncio.Event()

    @classmethod
    async def open(
        cls,
        *,
        site: str,
        connect: tuple[str, ...],
        listen: tuple[str, ...],
        tls: TlsTable | None = None,
        timing: ZenohTable | None = None,
    ) -> Self:
        """Join the bus; gateways and routers that are not there yet are connected to when they come.

        Raises
        ------
        BusError
            An endpoint cannot be understood, or cannot be listened on.
        """
        bus = cls(site=site, loop=asyncio.get_running_loop())
        try:
            config = _session_config(connect=connect, listen=listen, tls=tls or TlsTable(), timing=timing)
            bus._session = await asyncio.to_thread(zenoh.open, config)
            await asyncio.to_thread(bus._declare)
        except zenoh.ZError as error:
            raise BusError(
                reason=f"Zenoh refuses connect={list(connect)}, listen={list(listen)}: {_first_sentence(error)}",
                next_step="give endpoints such as tcp/127.0.0.1:7447",
            ) from error
        return bus

    async def aclose(self) -> None:
        """Leave the bus."""
        await asyncio.to_thread(self._session.close)

    @property
    def is_connected(self) -> bool:
        """Say whether any gateway or router is connected."""
        return bool(self._session.info.transports())

    async def claim(self, name: str, *, settle_s: float = _SETTLE_S, patience_s: float = _PATIENCE_S) -> None:
        """Be alive under a name, once somebody is connected and nobody else has been alive under it for ``settle_s`` to twice that.

        Gateways keep what a mapper of that name lacks: two would pass for one, and the records of the one that lags would be dropped.

        Raises
        ------
        BusError
            Somebody else is alive under it, and still is after ``patience_s``: a mapper that was killed may be for a while.
        """
        key = build_token_key(site=self._site, kind=Kind.MAPPER, name=name)
        liveliness = self._session.liveliness()

        def is_taken() -> bool:
            return any(reply.ok is not None for reply in liveliness.get(key, timeout=_ALIVE_TIMEOUT_S))

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
        self._declared.append(await asyncio.to_thread(liveliness.declare_token, key))

    async def receive(self) -> list[Arrival]:
        """Wait until something came in, and return all of it in order of arrival; what cannot be meant is counted and left out."""
        await self._has_arrivals.wait()
        with self._lock:
            self._has_arrivals.clear()
            raw, self._inbox = self._inbox, deque()
            self._inbox_bytes = 0
        arrivals = [arrival for key, payload in raw if (arrival := _decode(key, payload)) is not None]
        self.counters["unfit"] += len(raw) - len(arrivals)
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
        async with aclosing(self._query(key, encode_record(request), timeout_s=timeout_s)) as replies:
            async for payload in replies:
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
        with suppress(zenoh.ZError):
            await asyncio.to_thread(self._session.put, key, payload)

    async def send_command(self, request: StimulationRequest, *, gateway: str, timeout_s: float) -> AsyncGenerator[CommandStage, None]:
        """Send a command and yield the stages that its gateway reports; none at all means that it is not there.

        Raises
        ------
        QueryError
            The gateway refused the form of the request, or gave no final answer within ``timeout_s``.
        """
        key = build_key(site=self._site, stream=Stream.COMMAND, gateway=gateway)
        async with aclosing(self._query(key, encode_record(request), timeout_s=timeout_s)) as replies:
            async for payload in replies:
                try:
                    stage = decode_record(payload, CommandStage)
                except RecordError as error:
                    raise QueryError(key=key, reason=str(error), is_timeout=False) from error
                if stage.command_id == request.command_id:
                    yield stage

    async def _query(self, key: str, payload: bytes, *, timeout_s: float) -> AsyncGenerator[bytes, None]:
        replies: asyncio.Queue[zenoh.Reply | None] = asyncio.Queue()

        def hand_over(reply: zenoh.Reply | None) -> None:
            with suppress(RuntimeError):  # the loop is closed: nobody waits any more
                self._loop.call_soon_threadsafe(replies.put_nowait, reply)

        def ask() -> None:
            self._session.get(
                key,
                zenoh.handlers.Callback(hand_over, drop=lambda: hand_over(None)),
                payload=payload,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )

        try:
            async with asyncio.timeout(timeout_s + _DEADLINE_SLACK_S):
                await asyncio.to_thread(ask)
                while (reply := await replies.get()) is not None:
                    if reply.ok is not None:
                        yield reply.ok.payload.to_bytes()
                    elif reply.err is not None:
                        raise _query_error(key, reply.err.payload.to_bytes(), timeout_s=timeout_s)
        except TimeoutError as error:
            raise _query_error(key, _TIMEOUT_PAYLOAD, timeout_s=timeout_s) from error
        except zenoh.ZError as error:
            raise QueryError(key=key, reason=_first_sentence(error), is_timeout=False) from error

    def _declare(self) -> None:
        def pattern(stream: Stream, *, node: str | None = None) -> str:
            return build_key(site=self._site, stream=stream, gateway=ANY, node=node)

        advanced = [pattern(stream) for stream in _JOURNALED] + [pattern(Stream.STATUS), pattern(Stream.STATUS, node=ANY)]
        for key in advanced:
            self._declared.append(
                zenoh.ext.declare_advanced_subscriber(
                    self._session,
                    key,
                    self._on_sample,
                    history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
                    recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                )
            )
        for key in (pattern(Stream.NEIGHBOURS, node=ANY), pattern(Stream.EVENTS)):
            self._declared.append(self._session.declare_subscriber(key, self._on_sample))
        seen = (
            build_token_key(site=self._site, kind=Kind.GATEWAY, name=ANY),
            build_token_key(site=self._site, kind=Kind.RADIO, name=ANY, radio=ANY),
            build_token_key(site=self._site, kind=Kind.MAPPER, name=ANY),
        )
        for key in seen:
            self._declared.append(self._session.liveliness().declare_subscriber(key, self._on_presence, history=True))

    def _on_sample(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._push(str(sample.key_expr), sample.payload.to_bytes())

    def _on_presence(self, sample: zenoh.Sample) -> None:
        self._push(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    def _push(self, key: str, payload: bytes | bool) -> None:  # noqa: FBT001  # the payload of a liveliness sample is its kind
        size = len(payload) if isinstance(payload, bytes) else 0
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


def _decode(key_text: str, payload: bytes | bool) -> Arrival | None:  # noqa: FBT001  # see Bus._push
    try:
        if isinstance(payload, bool):
            return Presence(token=parse_token_key(key_text), is_alive=payload)
        key = parse_key(key_text)
        arrival = _decode_payload(key, payload)
    except (KeyExpressionError, RecordError) as error:
        _log.debug("bus.unfit", key=key_text, reason=str(error))
        return None
    is_about_its_key = arrival.gateway == key.gateway and getattr(arrival, "node", None) == key.node
    return arrival if is_about_its_key else None


def _decode_payload(key: Key, payload: bytes) -> RecordBatch | GatewayStatus | NodeStatus | NeighbourReport | GatewayEvent:
    match key.stream:
        case Stream.STATUS if key.node is None:
            return decode_record(payload, GatewayStatus)
        case Stream.STATUS:
            return decode_record(payload, NodeStatus)
        case Stream.NEIGHBOURS:
            return decode_record(payload, NeighbourReport)
        case Stream.EVENTS:
            return decode_record(payload, GatewayEvent)
        case _:
            return decode_record(payload, RecordBatch)


def _session_config(*, connect: tuple[str, ...], listen: tuple[str, ...], tls: TlsTable, timing: ZenohTable | None) -> zenoh.Config:
    config = zenoh.Config()
    for name, value in session_settings(mode=ROUTER, listen=listen, connect=connect, tls=tls, timing=timing).items():
        config.insert_json5(name, json.dumps(value))
    return config


def _query_error(key: str, payload: bytes, *, timeout_s: float) -> QueryError:
    if payload == _TIMEOUT_PAYLOAD:
        return QueryError(key=key, reason=f"no end of the answer within {timeout_s:g} s", is_timeout=True)
    return QueryError(key=key, reason=payload.decode(errors="replace"), is_timeout=False)


def _first_sentence(error: zenoh.ZError) -> str:
    # Zenoh appends the places in its own source.
    return str(error).split(" at /", maxsplit=1)[0]
