"""Everything the gateway says and hears on Zenoh (CONTRACT.md).

Zenoh calls back on threads of its own: callbacks only append to a bounded queue and wake the loop once. Puts come from one
thread, so a subscriber that is stuck blocks that thread alone; what overflows its queue is dropped and counted, since the journal
has it and readers fill gaps from the history. Answers to commands and history queries have threads of their own.
"""

import asyncio
import queue
import sqlite3
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Self

import zenoh
import zenoh.ext

from firmware_protocol.contract.access import Role, access_control
from firmware_protocol.contract.commands import CommandStage, StimulationAction, StimulationRequest
from firmware_protocol.contract.keys import ANY, Stream, build_key, parse_key
from firmware_protocol.contract.presence import Kind, build_token_key
from firmware_protocol.contract.records import (
    EncodedBatch,
    GatewayEvent,
    GatewayStatus,
    HistoryRequest,
    NeighbourReport,
    NodeStatus,
    Struct,
    Watermark,
    decode_record,
    encode_record,
)
from firmware_protocol.errors import KeyExpressionError, RecordError
from gateway.bus_session import ConnectionWatch, open_service
from gateway.config import GatewayConfig
from gateway.errors import BusError
from gateway.health import Health
from gateway.journal_file import Committed, Damage, JournalReader
from gateway.log import EventLog
from gateway.record_batches import batches_of, history_batches
from gateway.tls_files import check_tls_files, read_roster

_log = EventLog(__name__)

_PUT_QUEUE = 4096
"""Publications that may wait for the put thread."""

_CACHE = 512
"""Batches that late subscribers and those with a gap get without asking the history; at most 85 MB where each is as large as may be."""

_HEARTBEAT_S = 0.5
_CLOSE_S = 2.0
"""For what waits for the put thread when the bus is closed."""

_MAX_COMMANDS = 256
_MAX_STOPS = 4096
"""Commands that may wait when the next one is a STOP: it passes where any other is refused."""

_MAX_HISTORY_QUERIES = 16
_MAX_WATERMARKS = 64
_NAME_CHECK_S = 1.5


class CommandAnswer:
    """Where the stages of one command go; may be called from the loop only."""

    def __init__(self, *, query: zenoh.Query, key: str, executor: ThreadPoolExecutor) -> None:
        self._query = query
        self._key = key
        self._executor = executor

    def tell(self, stage: CommandStage) -> None:
        """Reply with a stage; the final one ends the query."""
        self._executor.submit(self._reply, stage)

    def _reply(self, stage: CommandStage) -> None:
        try:
            self._query.reply(self._key, encode_record(stage))
            if stage.is_final:
                self._query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub has no annotation
        except zenoh.ZError as error:
            _log.warning("bus.reply_lost", command=stage.command_id, stage=stage.stage.value, reason=str(error))


class Bus:
    """An open Zenoh session of a gateway."""

    def __init__(self, *, session: zenoh.Session, watch: ConnectionWatch, site: str, gateway: str, health: Health) -> None:
        self._session = session
        self._watch = watch
        self._site = site
        self._gateway = gateway
        self._health = health
        self._puts: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()  # a third of the cost of a Queue
        self._answers = ThreadPoolExecutor(max_workers=1, thread_name_prefix="answers")
        self._history = ThreadPoolExecutor(max_workers=1, thread_name_prefix="history")
        self._n_history = threading.BoundedSemaphore(_MAX_HISTORY_QUERIES)
        self._lock = threading.Lock()
        self._commands: deque[tuple[StimulationRequest, CommandAnswer]] = deque()
        self._watermarks: dict[str, int] = {}
        self._declared: list[zenoh.Queryable[None] | zenoh.Subscriber[None] | zenoh.LivelinessToken] = []
        self._radios: dict[str, zenoh.LivelinessToken] = {}
        self._publishers = {
            stream: zenoh.ext.declare_advanced_publisher(
                session,
                self._key(stream),
                congestion_control=zenoh.CongestionControl.BLOCK,
                cache=zenoh.ext.CacheConfig(_CACHE),
                sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=_HEARTBEAT_S, sporadic_heartbeat=None),
                publisher_detection=True,
            )
            for stream in (Stream.ENCOUNTERS, Stream.MODES, Stream.MISSION)
        }
        self._thread = threading.Thread(target=self._run_puts, name="puts", daemon=True)
        self._thread.start()

    @classmethod
    def open(cls, config: GatewayConfig, *, health: Health) -> Self:
        """Open the session; other sessions are connected to in the background, for as long as it takes.

        Raises
        ------
        BusError
            An endpoint cannot be listened on, or is none; certificates or roster are unfit; or a gateway of this name is alive at the
            site already.
        """
        report = check_tls_files(config.tls, roles=(Role.GATEWAY,), site=config.site, name=config.name)
        members, problems = ([], ()) if config.roster is None else read_roster(config.roster)
        if report.problems or problems:
            raise BusError("; ".join((*report.problems, *problems)))
        access = None if config.roster is None else access_control(members)
        session = open_service(listen=config.listen, connect=config.connect, tls=config.tls, timing=config.zenoh, access=access)
        if config.connect and _is_taken(session, build_key(site=config.site, stream=Stream.ALIVE, gateway=config.name)):
            session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type
            raise BusError(f"a gateway named {config.name!r} is alive at site {config.site!r} already; give this one another --name")
        watch = ConnectionWatch(session, connect=config.connect, tls=config.tls, facts=report.facts, health=health)
        return cls(session=session, watch=watch, site=config.site, gateway=config.name, health=health)

    def n_links(self) -> int:
        """Return how many other sessions are connected now."""
        return len(self._session.info.transports())

    def start(
        self,
        *,
        on_command: Callable[[StimulationRequest, CommandAnswer], None],
        open_reader: Callable[[], JournalReader],
        journal: str,
        on_watermark: Callable[[str, int], None] | None = None,
        on_damage: Callable[[Damage], None] | None = None,
    ) -> None:
        """Answer queries from now on, and be alive to others. All that is given is called in the running loop, but for ``open_reader``."""
        loop = asyncio.get_running_loop()
        command_key, history_key = self._key(Stream.COMMAND), self._key(Stream.HISTORY)

        def take_command(query: zenoh.Query) -> None:
            self._take_command(query, key=command_key, loop=loop, on_command=on_command)

        def take_history(query: zenoh.Query) -> None:
            self._take_history(query, key=history_key, answer=answer_history)

        def tell_damage(damage: Damage) -> None:
            if on_damage is not None:
                loop.call_soon_threadsafe(on_damage, damage)

        answer_history = partial(history_batches, open_reader=open_reader, gateway=self._gateway, journal=journal, on_damage=tell_damage)

        def take_watermark(sample: zenoh.Sample) -> None:
            if on_watermark is not None:
                self._take_watermark(sample, loop=loop, journal=journal, on_watermark=on_watermark)

        watermarks = build_key(site=self._site, stream=Stream.WATERMARK, gateway=self._gateway, mapper=ANY)
        self._declared.append(self._session.declare_subscriber(watermarks, take_watermark))
        self._declared.append(self._session.declare_queryable(command_key, take_command))
        self._declared.append(self._session.declare_queryable(history_key, take_history))
        self._declared.append(self._session.liveliness().declare_token(self._key(Stream.ALIVE)))

    @property
    def missing(self) -> str | None:
        """Say why nobody is connected who should be, or None."""
        return self._watch.missing

    def set_radio(self, radio: str, *, is_up: bool) -> None:
        """Have a radio's liveliness token there while it is up."""
        self._answers.submit(self._set_radio, radio, is_up=is_up)

    def publish_records(self, committed: Committed) -> None:
        """Publish records that are on disk, as they lie there: batches of one kind each."""
        for stream, batch in batches_of(committed, gateway=self._gateway):
            publisher = self._publishers[stream]
            self._queue_put(lambda publisher=publisher, batch=batch: publisher.put(encode_record(batch)))  # type: ignore[misc]

    def publish_gateway_status(self, status: GatewayStatus) -> None:
        """Publish the gateway's own state."""
        self._publish_state(self._key(Stream.STATUS), status)

    def publish_node_status(self, status: NodeStatus) -> None:
        """Publish a biobot's state."""
        self._publish_state(build_key(site=self._site, stream=Stream.STATUS, gateway=self._gateway, node=status.node), status)

    def publish_neighbours(self, report: NeighbourReport) -> None:
        """Publish whom a biobot hears."""
        self._publish_state(build_key(site=self._site, stream=Stream.NEIGHBOURS, gateway=self._gateway, node=report.node), report)

    def publish_event(self, event: GatewayEvent) -> None:
        """Publish something an operator may want to know."""
        self._publish_state(self._key(Stream.EVENTS), event)

    def close(self) -> None:
        """Send what waits, unless it takes long; then close."""
        self._watch.close()
        for declared in reversed(self._declared):
            declared.undeclare()  # type: ignore[no-untyped-call]  # same
        self._puts.put(None)
        self._thread.join(timeout=_CLOSE_S)
        if self._thread.is_alive():
            _log.warning("bus.unsent", waiting=self._puts.qsize())
        self._answers.shutdown(wait=True)
        self._history.shutdown(wait=True, cancel_futures=True)
        self._session.close()  # type: ignore[no-untyped-call]  # same

    def _key(self, stream: Stream) -> str:
        return build_key(site=self._site, stream=stream, gateway=self._gateway)

    def _set_radio(self, radio: str, *, is_up: bool) -> None:
        try:
            if is_up and radio not in self._radios:
                key = build_token_key(site=self._site, kind=Kind.RADIO, name=self._gateway, radio=radio)
                self._radios[radio] = self._session.liveliness().declare_token(key)
            elif not is_up and radio in self._radios:
                self._radios.pop(radio).undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
        except zenoh.ZError as error:
            _log.warning("bus.radio_untold", radio=radio, reason=str(error))

    def _publish_state(self, key: str, state: Struct) -> None:
        self._queue_put(lambda: self._session.put(key, encode_record(state)))

    def _queue_put(self, put: Callable[[], None]) -> None:
        if self._puts.qsize() >= _PUT_QUEUE:
            self._health.count("bus.dropped_puts")
            return
        self._puts.put(put)

    def _run_puts(self) -> None:
        while (put := self._puts.get()) is not None:
            try:
                put()
            except zenoh.ZError as error:
                self._health.count("bus.failed_puts")
                _log.debug("bus.failed_put", reason=str(error))

    def _take_command(
        self,
        query: zenoh.Query,
        *,
        key: str,
        loop: asyncio.AbstractEventLoop,
        on_command: Callable[[StimulationRequest, CommandAnswer], None],
    ) -> None:
        """Runs on a thread of Zenoh."""
        try:
            request = decode_record(_payload_of(query), StimulationRequest)
        except RecordError as error:
            self._refuse(query, str(error))
            return
        limit = _MAX_STOPS if request.action is StimulationAction.STOP else _MAX_COMMANDS
        with self._lock:
            if len(self._commands) >= limit:
                self._refuse(query, f"{limit} commands wait already; try again")
                return
            is_first = not self._commands
            self._commands.append((request, CommandAnswer(query=query, key=key, executor=self._answers)))
        if is_first:
            loop.call_soon_threadsafe(self._hand_over_commands, on_command)

    def _hand_over_commands(self, on_command: Callable[[StimulationRequest, CommandAnswer], None]) -> None:
        with self._lock:
            commands = list(self._commands)
            self._commands.clear()
        for request, answer in commands:
            on_command(request, answer)

    def _take_watermark(
        self, sample: zenoh.Sample, *, loop: asyncio.AbstractEventLoop, journal: str, on_watermark: Callable[[str, int], None]
    ) -> None:
        """Runs on a thread of Zenoh."""
        try:
            key, watermark = parse_key(str(sample.key_expr)), decode_record(sample.payload.to_bytes(), Watermark)
        except (KeyExpressionError, RecordError):
            self._health.count("bus.unfit_watermarks")
            return
        if watermark.mapper != key.mapper or watermark.journal != journal:
            return  # of a journal that this gateway wrote before
        with self._lock:
            is_first = not self._watermarks
            if len(self._watermarks) < _MAX_WATERMARKS or watermark.mapper in self._watermarks:
                self._watermarks[watermark.mapper] = watermark.offset
        if is_first:
            loop.call_soon_threadsafe(self._hand_over_watermarks, on_watermark)

    def _hand_over_watermarks(self, on_watermark: Callable[[str, int], None]) -> None:
        with self._lock:
            watermarks, self._watermarks = self._watermarks, {}
        for mapper, offset in watermarks.items():
            on_watermark(mapper, offset)

    def _take_history(self, query: zenoh.Query, *, key: str, answer: Callable[[HistoryRequest], Iterator[EncodedBatch]]) -> None:
        """Runs on a thread of Zenoh."""
        try:
            request = decode_record(_payload_of(query), HistoryRequest)
        except RecordError as error:
            self._refuse(query, str(error))
            return
        if not self._n_history.acquire(blocking=False):
            self._refuse(query, f"{_MAX_HISTORY_QUERIES} history queries wait already; try again")
            return
        self._history.submit(self._answer_history, query, request, key=key, answer=answer)

    def _answer_history(
        self, query: zenoh.Query, request: HistoryRequest, *, key: str, answer: Callable[[HistoryRequest], Iterator[EncodedBatch]]
    ) -> None:
        try:
            with query:
                for batch in answer(request):
                    query.reply(key, encode_record(batch))
        except zenoh.ZError as error:
            _log.debug("bus.history_lost", reason=str(error))
        except sqlite3.Error as error:
            self._health.count("bus.failed_history")
            _log.error("bus.history_failed", reason=str(error))
        finally:
            self._n_history.release()

    def _refuse(self, query: zenoh.Query, reason: str) -> None:
        self._health.count("bus.refused_queries")
        with query:
            query.reply_err(reason.encode())


def _is_taken(session: zenoh.Session, key: str) -> bool:
    """Whether somebody else holds a liveliness token; a session that was just opened learns of it once it is connected."""
    heard = threading.Event()
    subscriber = session.liveliness().declare_subscriber(key, lambda _sample: heard.set(), history=True)
    is_taken = heard.wait(_NAME_CHECK_S)
    subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
    return is_taken


def _payload_of(query: zenoh.Query) -> bytes:
    return b"" if query.payload is None else query.payload.to_bytes()
