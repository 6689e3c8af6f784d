"""Everything the gateway says and hears on Zenoh (CONTRACT.md).

Zenoh calls back on threads of its own: the doors beside this file (``bus_commands``, ``bus_history``, ``bus_presence``) only keep what
comes in bounded queues and wake the loop once. Puts come from one thread, so a subscriber that is stuck blocks that thread alone; what
overflows its queue is dropped and counted, since the journal has it and readers fill gaps from the history.
"""

import asyncio
import queue
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Self

import zenoh
import zenoh.ext

from firmware_protocol.contract.access import Role, access_control
from firmware_protocol.contract.announcements import GatewayEvent, NeighbourReport
from firmware_protocol.contract.commands import CommandStage, StimulationAccount
from firmware_protocol.contract.keys import ANY, Stream, build_key
from firmware_protocol.contract.presence import Kind, build_token_key
from firmware_protocol.contract.recordings import RecordingList
from firmware_protocol.contract.records import EncodedBatch, GatewayStatus, NodeStatus, Struct, encode_record
from gateway.bus_commands import CommandDoor, CommandTaker, OrderDoor, OrderTaker, TurnedAwayListener
from gateway.bus_history import HistoryDoor
from gateway.bus_presence import CommanderDoor, CommanderListener, WatermarkDoor
from gateway.bus_recordings import RecordingsDoor
from gateway.bus_session import ConnectionWatch
from gateway.bus_standing import ServiceSession, StandingDeclarations
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

_NAME_CHECK_S = 1.5


class Bus:
    """An open Zenoh session of a gateway."""

    def __init__(self, *, session: ServiceSession, watch: ConnectionWatch, site: str, gateway: str, health: Health) -> None:
        self._session = session
        self._watch = watch
        self._site = site
        self._gateway = gateway
        self._health = health
        self._puts: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()  # a third of the cost of a Queue
        self._answers = ThreadPoolExecutor(max_workers=1, thread_name_prefix="answers")
        self._history: HistoryDoor | None = None
        self._recordings: RecordingsDoor | None = None
        self._commands: CommandDoor | None = None
        self._standing = StandingDeclarations(session)
        self._publishers: dict[Stream, zenoh.ext.AdvancedPublisher] = {}
        session.when_open(self._declare_publishers)
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
        session = ServiceSession(
            listen=config.listen,
            connect=config.connect,
            tls=config.tls,
            timing=config.zenoh,
            access=access,
            echo=build_key(site=config.site, stream=Stream.ECHO, gateway=config.name),
        )
        if config.connect and _is_taken(session, build_key(site=config.site, stream=Stream.ALIVE, gateway=config.name)):
            session.close()
            raise BusError(f"a gateway named {config.name!r} is alive at site {config.site!r} already; give this one another --name")
        watch = ConnectionWatch(n_links=session.n_links, connect=config.connect, tls=config.tls, facts=report.facts, health=health)
        return cls(session=session, watch=watch, site=config.site, gateway=config.name, health=health)

    def n_links(self) -> int:
        """Return how many other sessions are connected now."""
        return self._session.n_links()

    def start(
        self,
        *,
        on_command: CommandTaker,
        open_reader: Callable[[], JournalReader],
        journal: str,
        on_turned_away: TurnedAwayListener | None = None,
        on_order: OrderTaker | None = None,
        commanders: CommanderListener | None = None,
        on_watermark: Callable[[str, int], None] | None = None,
        on_damage: Callable[[Damage], None] | None = None,
        list_recordings: Callable[[], RecordingList] | None = None,
    ) -> None:
        """Answer queries from now on, and be alive to others.

        All that is given is called in the running loop, but for ``open_reader``, ``list_recordings`` and ``on_turned_away``.
        """
        loop, health, standing = asyncio.get_running_loop(), self._health, self._standing

        def tell_damage(damage: Damage) -> None:
            if on_damage is not None:
                loop.call_soon_threadsafe(on_damage, damage)

        if commanders is not None:
            door = CommanderDoor(loop=loop, health=health, listener=commanders)
            beats = build_key(site=self._site, stream=Stream.BEAT, gateway=ANY)
            tokens = build_token_key(site=self._site, kind=Kind.COMMANDER, name=ANY)
            standing.declare("beats", lambda session: session.declare_subscriber(beats, door.take_beat))

            def watch_tokens(session: zenoh.Session) -> zenoh.Subscriber[None]:
                door.begin_anew()
                return session.liveliness().declare_subscriber(tokens, door.take_token, history=True)

            standing.declare("commanders", watch_tokens)
        if on_watermark is not None:
            marks = WatermarkDoor(loop=loop, journal=journal, health=health, on_watermark=on_watermark)
            watermarks = build_key(site=self._site, stream=Stream.WATERMARK, gateway=self._gateway, mapper=ANY)
            standing.declare("watermarks", lambda session: session.declare_subscriber(watermarks, marks.take))
        answer = partial(history_batches, open_reader=open_reader, gateway=self._gateway, journal=journal, on_damage=tell_damage)
        command_key, order_key, history_key = map(self._key, (Stream.COMMAND, Stream.ORDERS, Stream.HISTORY))
        history = self._history = HistoryDoor(key=history_key, health=health, answer=answer)
        commands = self._commands = CommandDoor(
            loop=loop,
            key=command_key,
            executor=self._answers,
            health=health,
            on_command=on_command,
            on_turned_away=on_turned_away,
        )
        standing.declare("command", lambda session: session.declare_queryable(command_key, commands.take))
        if on_order is not None:
            first = commands.hand_over_stops
            orders = OrderDoor(
                loop=loop,
                key=order_key,
                executor=self._answers,
                health=health,
                on_order=on_order,
                before=first,
                on_turned_away=on_turned_away,
            )
            standing.declare("orders", lambda session: session.declare_queryable(order_key, orders.take))
        standing.declare("history", lambda session: session.declare_queryable(history_key, history.take))
        if list_recordings is not None:
            recordings_key = self._key(Stream.RECORDINGS)
            recordings = self._recordings = RecordingsDoor(key=recordings_key, health=health, answer=list_recordings)
            standing.declare("recordings", lambda session: session.declare_queryable(recordings_key, recordings.take))
        alive = self._key(Stream.ALIVE)
        standing.declare("alive", lambda session: session.liveliness().declare_token(alive))

    @property
    def n_waiting(self) -> int:
        """Return how many commands have come in that the loop has not taken yet."""
        return 0 if self._commands is None else len(self._commands)

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
            publisher = self._publishers.get(stream)
            if publisher is None:
                return  # nobody was ever there: whoever comes asks the history
            self._queue_put(partial(_put_batch, publisher, batch))

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

    def publish_stage(self, stage: CommandStage) -> None:
        """Publish how far a command has come, whoever gave it."""
        key, payload = self._key(Stream.STAGES), encode_record(stage)

        def put() -> None:
            session = self._session.current
            if session is not None:
                session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK, express=True)

        self._queue_put(put)

    def publish_account(self, account: StimulationAccount) -> None:
        """Publish how a biobot was stimulated."""
        self._publish_state(build_key(site=self._site, stream=Stream.STIMULATION, gateway=self._gateway, node=account.node), account)

    def close(self) -> None:
        """Send what waits, unless it takes long; then close."""
        self._watch.close()
        self._standing.close()
        self._puts.put(None)
        self._thread.join(timeout=_CLOSE_S)
        if self._thread.is_alive():
            _log.warning("bus.unsent", waiting=self._puts.qsize())
        self._answers.shutdown(wait=True)
        for door in (self._history, self._recordings):
            if door is not None:
                door.close()
        self._session.close()

    def _key(self, stream: Stream) -> str:
        return build_key(site=self._site, stream=stream, gateway=self._gateway)

    def _declare_publishers(self, session: zenoh.Session) -> None:
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

    def _set_radio(self, radio: str, *, is_up: bool) -> None:
        name = f"radio {radio}"
        key = build_token_key(site=self._site, kind=Kind.RADIO, name=self._gateway, radio=radio)
        try:
            if is_up and not self._standing.is_declared(name):
                self._standing.declare(name, lambda session: session.liveliness().declare_token(key))
            elif not is_up:
                self._standing.undeclare(name)
        except zenoh.ZError as error:
            _log.warning("bus.radio_untold", radio=radio, reason=str(error))

    def _publish_state(self, key: str, state: Struct) -> None:
        def put() -> None:
            session = self._session.current
            if session is not None:
                session.put(key, encode_record(state))

        self._queue_put(put)

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


def _put_batch(publisher: zenoh.ext.AdvancedPublisher, batch: EncodedBatch) -> None:
    publisher.put(encode_record(batch))


def _is_taken(service: ServiceSession, key: str) -> bool:
    """Whether somebody else holds a liveliness token; a session that was just opened learns of it once it is connected."""
    if not service.wait_open(_NAME_CHECK_S):
        return False
    heard = threading.Event()
    session = service.current
    assert session is not None
    subscriber = session.liveliness().declare_subscriber(key, lambda _sample: heard.set(), history=True)
    is_taken = heard.wait(_NAME_CHECK_S)
    subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
    return is_taken
