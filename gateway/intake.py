"""What becomes of an uplink message: once into the journal, with all the records it brings about, then to whoever must know.

Each message is taken once, whatever the radio repeats. Its raw bytes, its records and its sequence number are one write: on
disk together or not at all. Only then is the biobot told, the dongle's payload confirmed and anything published.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TypeAlias

import msgspec

from firmware_protocol.contract.announcements import NeighbourReport
from firmware_protocol.contract.records import Cause, JournalRecord, NodeStatus
from firmware_protocol.layouts import UPLINK_LAYOUTS
from firmware_protocol.message_codec import build_uplink, decode_uplink_fields, read_encounters
from firmware_protocol.messages import (
    BROADCAST_NODE,
    ConfigurationReport,
    Diagnostic,
    Hello,
    Limits,
    Neighbours,
    Status,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    Uplink,
    UplinkHeader,
)
from firmware_protocol.units import LAST_NODE_ADDRESS, BootId, Milliseconds, NodeId
from gateway.clocks import ClockBook, NodeClock
from gateway.config import EncounterTable
from gateway.encounter_reports import MAX_AHEAD_MS, EncounterReports
from gateway.halts import Halts
from gateway.health import Health
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import JournalReader, JournalWrite, UplinkReport
from gateway.modes import ModeReport, ModeTracker
from gateway.nodes import Node, NodeBook, NodeMemory, cause_of, mode_of
from gateway.radio import RadioMessage
from gateway.sequences import SequenceWindow

_MAX_BOOTS = 4
"""Lives of one backpack whose messages are still taken: a dongle's queue may hold some from before a restart."""

_COUNTERS = {layout.kind or 0: f"message.{layout.name.lower()}" for layout in UPLINK_LAYOUTS}


@dataclass(slots=True)
class _Life:
    """What has come of one boot of one backpack, and what of it is on disk."""

    received: SequenceWindow = field(default_factory=SequenceWindow)
    committed: SequenceWindow = field(default_factory=SequenceWindow)


@dataclass(frozen=True, slots=True, kw_only=True)
class IntakeListeners:
    """Who is told, after the commit."""

    on_committed: Callable[[NodeId], None]
    on_status: Callable[[NodeStatus], None]
    on_neighbours: Callable[[NeighbourReport], None]
    on_reply: Callable[[NodeId, StimulateReply], None]
    on_answer: Callable[[NodeId, StimulateReply], None]
    """Told at once, and ``on_reply`` once more after the commit: what an animal does is worth knowing where the disk takes nothing."""
    on_duplicate: Callable[[NodeId, int, int], None]
    """A biobot's number came with one EUI-64 and then with another."""
    on_diagnostic: Callable[[NodeId, Diagnostic], None]
    on_configuration: Callable[[NodeId, ConfigurationReport], None]
    on_limits: Callable[[NodeId, Limits], None]
    on_unknown_clock: Callable[[NodeId], None]
    """Told at once: a report was not taken because its backpack's clock is not known yet."""


class _Taken(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """A message that waits for the disk."""

    life: _Life
    number: int
    node: NodeId
    tell: Callable[[IntakeListeners], None] | None


_Made: TypeAlias = tuple[tuple[JournalRecord, ...], Callable[[IntakeListeners], None] | None]
"""The records that a message brings about, and whom to tell of it after the commit."""


class Intake:
    """Takes uplink messages; see the module's description. Belongs to one event loop."""

    def __init__(
        self,
        *,
        issuer: RecordIssuer,
        journal: Journal,
        reader: JournalReader,
        nodes: NodeBook,
        clocks: ClockBook,
        health: Health,
        config: EncounterTable,
        now_ns: int,
    ) -> None:
        self._issuer = issuer
        self._journal = journal
        self._reader = reader
        self._nodes = nodes
        self._clocks = clocks
        self._health = health
        self._reports = EncounterReports(issuer=issuer, reader=reader, nodes=nodes, health=health, config=config, now_ns=now_ns)
        self.halts = Halts()
        self._modes = ModeTracker(issuer=issuer, halts=self.halts)
        self._lives: dict[NodeId, OrderedDict[BootId, _Life]] = {}
        self._clock_news: set[NodeId] = set()
        """Whose clock is known better than the journal has it: their next report takes that along."""
        self._listeners: IntakeListeners | None = None
        self._awaited: tuple[asyncio.Future[None], list[_Taken]] | None = None
        """What the newest group of writes is made of."""
        self._repeaters: tuple[asyncio.Future[None], set[NodeId]] | None = None
        """Who repeated something while a group of writes waits for the disk: told once when it is there, however often it was said."""
        self._restore(now_ns)

    def connect(self, listeners: IntakeListeners) -> None:
        """Say who is told after commits; to be called before the first message."""
        self._listeners = listeners

    def window_of(self, node: NodeId) -> tuple[BootId, int, int] | None:
        """Return a biobot's newest boot and what of it is on disk, as an Acknowledge says it."""
        known = self._nodes.find(node)
        life = None if known is None else self._lives.get(node, OrderedDict()).get(known.boot)
        if known is None or life is None:
            return None
        return known.boot, *life.committed.acknowledgement()

    def take(self, message: RadioMessage) -> "asyncio.Future[None] | None":
        """Take a radio payload; the future is done when all of it is on disk. None: there is nothing to wait for.

        Where its records cannot be made, it is raised why, and the message itself goes into the journal all the same.
        """
        fields = decode_uplink_fields(message.payload)
        if not isinstance(fields, tuple):
            self._health.count(f"message.{fields.value}")
            return None
        kind, _, name, boot, sequence, sent_ms = fields[0]
        if message.source > LAST_NODE_ADDRESS:
            # Nobody's address: what is sent there reaches many or none. Not acknowledged, so it comes again from where it can be answered.
            self._health.count("message.impossible_source")
            return None
        entries = read_encounters(fields)
        uplink = None if entries is not None else build_uplink(fields)[1]
        if name == BROADCAST_NODE or self._journal.is_full:
            # Not acknowledged to the backpack, so it repeats what was dropped for want of room.
            self._health.count("message.nobodys" if name == BROADCAST_NODE else "message.no_room")
            if isinstance(uplink, StimulateReply) and name != BROADCAST_NODE:
                self._listeners_or_fail().on_reply(NodeId(name), uplink)  # what an animal does is worth knowing without a disk too
            return None
        name, boot, sent_ms = NodeId(name), BootId(boot), Milliseconds(sent_ms)
        wall_ns = self._issuer.to_wall_ns(message.received_ns)
        node, is_changed = self._nodes.heard(
            node=name,
            boot=boot,
            radio=message.radio,
            address=message.source,
            rssi_dbm=message.rssi_dbm,
            lqi=message.lqi,
            sent_ms=sent_ms,
            now_ns=message.received_ns,
            now_wall_ns=wall_ns,
        )
        clock = self._clocks.observe(node=name, boot=boot, sent_ms=sent_ms, received_ns=message.received_ns)
        if isinstance(uplink, TimeSyncReply):
            is_ours = self._clocks.end_exchange(node=name, boot=boot, token=uplink.token, arrived_ms=uplink.received_ms)
            self._health.count("message.time_sync_reply" if is_ours else "message.time_sync_unexpected")
            if is_ours and boot == node.boot:
                self._clock_news.add(name)
            return None
        is_dated = uplink is None or isinstance(uplink, Status)
        if is_dated and not clock.is_believed(now_ns=message.received_ns, goes_on=boot == node.boot):
            # Not acknowledged, so it comes again: a second later its times can be trusted.
            self._health.count("message.clock_unknown")
            self._listeners_or_fail().on_unknown_clock(name)
            return None
        life = self._life(name, boot)
        number = life.received.unwrap(sequence)
        if life.received.has(number):
            self._health.count("message.repeated")
            return self._tell_again(name)
        self._health.count(_COUNTERS[kind])
        made: _Made | Exception
        try:
            if uplink is None:
                made = tuple(self._reports.take(entries or (), node=node, sent_ms=sent_ms, clock=clock)), None
            else:
                header = UplinkHeader(node=name, boot=boot, sequence=sequence, sent_ms=sent_ms)
                made = self._digest(uplink, header=header, node=node, clock=clock, number=number)
        except Exception as error:  # noqa: BLE001  # raised again once the journal has the message
            made = error
        records, tell = ((), None) if isinstance(made, Exception) else made
        is_changed |= uplink is not None and _changes_memory(uplink, records, is_of_now=boot == node.boot)
        life.received.add(number)
        report = UplinkReport(
            node=name,
            boot=boot,
            number=number,
            next_number=life.received.next,
            received_wall_ns=wall_ns,
            radio=message.radio,
            address=message.source,
            rssi_dbm=message.rssi_dbm,
            lqi=message.lqi,
            payload=message.payload,
        )
        memory = self._memory_of(node, clock, is_of_now=boot == node.boot) if is_changed or name in self._clock_news else None
        done = self._journal.join(JournalWrite(records=records, report=report, node=memory))
        self._await(done, _Taken(life=life, number=number, node=name, tell=tell))
        if isinstance(made, Exception):
            raise made
        return done

    def _memory_of(self, node: Node, clock: NodeClock, *, is_of_now: bool) -> tuple[NodeId, bytes]:
        """Return what is to be kept of a biobot over a restart, its clock too."""
        self._clock_news.discard(node.node)
        kept = clock.memory(anchor_ns=self._issuer.wall_anchor_ns) if is_of_now else None
        return node.node, msgspec.msgpack.encode(node.memory(clock=kept))

    def forget_old(self, *, now_ns: int) -> None:
        """Drop encounters older than the window from memory; the journal knows them. To be called now and then."""
        if self._reports.begin_forgetting(now_ns=now_ns):  # what is not on disk yet could not be recalled
            self._journal.barrier().add_done_callback(lambda _: self._reports.forget_old())

    def _tell_again(self, node: NodeId) -> "asyncio.Future[None]":
        """Have a biobot that repeated something told once more, when all that came before is on disk; the future is done then."""
        barrier = self._journal.barrier()
        if self._repeaters is not None and self._repeaters[0] is barrier and not barrier.done():
            self._repeaters[1].add(node)
            return barrier
        nodes = {node}
        self._repeaters = (barrier, nodes)

        def tell(_: "asyncio.Future[None]") -> None:
            for one in sorted(nodes):
                self._listeners_or_fail().on_committed(one)

        barrier.add_done_callback(tell)
        return barrier

    def _restore(self, now_ns: int) -> None:
        memories = [msgspec.msgpack.decode(body, type=NodeMemory) for body in self._reader.read_nodes()]
        instant_of_run = self._journal.identity.instant_of_run
        heard_ns = {node: instant_of_run(ran_ns) for node, ran_ns in self._reader.read_last_heard().items()}
        self._nodes.restore(memories, heard_ns=heard_ns, now_ns=now_ns)
        for memory in memories:
            if memory.clock is not None and memory.clock.anchor_ns in self._issuer.earlier_anchors:
                self._clocks.restore(memory.clock, node=memory.node, boot=memory.boot, now_ns=now_ns)
        windows = self._reader.read_windows()
        self._nodes.restore_earlier_boots((node, boot) for node, boot, _, _ in windows)
        for node, boot, next_number, above in windows:
            life = self._life(node, boot)
            for window in (life.received, life.committed):
                window.next, window.is_fresh = next_number, False
                for number in above:
                    window.add(number)
        standing = [node.mode for node in self._nodes.all() if node.mode is not None]
        self._modes.restore((*standing, *self._reader.read_recent_modes(limit=10_000)))

    def _listeners_or_fail(self) -> IntakeListeners:
        assert self._listeners is not None, "connect() comes before the first message"
        return self._listeners

    def _await(self, done: "asyncio.Future[None]", taken: "_Taken") -> None:
        """Have a message's end told when its write is done: one callback for all that are committed together."""
        if self._awaited is None or self._awaited[0] is not done:
            self._awaited = (done, [])
            done.add_done_callback(partial(self._committed, self._awaited[1]))
        self._awaited[1].append(taken)

    def _committed(self, together: "list[_Taken]", done: "asyncio.Future[None]") -> None:
        is_stored = not done.cancelled() and done.exception() is None
        listeners, loop = self._listeners_or_fail(), asyncio.get_running_loop()
        for taken in together:
            taken.life.committed.add(taken.number)
            listeners.on_committed(taken.node)
            if not is_stored:
                # It can never be stored. The biobot is told to forget it, lest it repeat it and hold back what follows for ever.
                self._health.count("message.unstorable")
            elif taken.tell is not None:
                loop.call_soon(taken.tell, listeners)  # by itself: what fails there must not keep others from being told

    def _life(self, node: NodeId, boot: BootId) -> _Life:
        lives = self._lives.get(node)
        if lives is None:
            lives = self._lives[node] = OrderedDict()
        life = lives.get(boot)
        if life is None:
            life = lives[boot] = _Life()
            known = self._nodes.find(node)
            while len(lives) > _MAX_BOOTS:
                del lives[next(old for old in lives if known is None or old != known.boot)]
        return life

    def _digest(
        self, uplink: Uplink, *, header: UplinkHeader, node: Node, clock: NodeClock, number: int
    ) -> tuple[tuple[JournalRecord, ...], Callable[[IntakeListeners], None] | None]:
        """Return the records that a message brings about, and whom to tell of it after the commit.

        A message of a life that is over makes records, but says nothing of the biobot as it is now.
        """
        match uplink:
            case Hello() | Limits() | Neighbours() | ConfigurationReport() if header.boot != node.boot:
                return (), None
            case Hello() | Limits() | Diagnostic() | ConfigurationReport():
                return (), self._hear(uplink, node=node, number=number)
            case Status():
                is_newest = header.boot == node.boot and self._nodes.take_status(node, uplink, number=number)
                report = self._mode_report(uplink, header=header, clock=clock)
                records = () if report is None else self._take_mode(report, node=node)
                return records, self._tell_status(node) if is_newest else None
            case Neighbours():
                wall_ns = node.last_heard_wall_ns
                whole = self._nodes.take_neighbours(node, uplink, number=number, wall_ns=wall_ns)
                return (), None if whole is None else lambda listeners: listeners.on_neighbours(whole)
            case StimulateReply():
                asyncio.get_running_loop().call_soon(self._listeners_or_fail().on_answer, header.node, uplink)
                report = self._mode_report(uplink, header=header, clock=clock)
                records = () if report is None else self._take_mode(report, node=node)
                return records, lambda listeners: listeners.on_reply(header.node, uplink)
            case _:
                return (), None  # batches of encounters and time sync replies were taken before

    def _hear(
        self, said: Hello | Limits | Diagnostic | ConfigurationReport, *, node: Node, number: int
    ) -> Callable[[IntakeListeners], None] | None:
        """Take note of what a backpack says of itself; return whom to tell."""
        tellers: list[Callable[[IntakeListeners], None]] = []
        match said:
            case Hello():
                other = self._nodes.introduce(node, said)
                if other is not None:
                    tellers.append(lambda listeners: listeners.on_duplicate(node.node, other, said.eui64))
            case Limits():
                self._nodes.take_limits(node, said)
                tellers.append(lambda listeners: listeners.on_limits(node.node, said))
            case Diagnostic():
                return lambda listeners: listeners.on_diagnostic(node.node, said)
            case ConfigurationReport():
                self._nodes.take_configuration(node, said, number=number)
                tellers.append(lambda listeners: listeners.on_configuration(node.node, said))
        tell_status = self._tell_status(node)
        if tell_status is not None:
            tellers.append(tell_status)

        def tell(listeners: IntakeListeners) -> None:
            for one in tellers:
                one(listeners)

        return tell

    def _tell_status(self, node: Node) -> Callable[[IntakeListeners], None] | None:
        status = self._nodes.status_of(node)
        return None if status is None else lambda listeners: listeners.on_status(status)

    def _take_mode(self, report: ModeReport, *, node: Node) -> tuple[JournalRecord, ...]:
        records = self._modes.observe(report)
        if records:
            node.mode = self._modes.newest_record(node.node)
        return tuple(records)

    def _mode_report(self, uplink: Status | StimulateReply, *, header: UplinkHeader, clock: NodeClock) -> ModeReport | None:
        is_reply = isinstance(uplink, StimulateReply)
        if isinstance(uplink, StimulateReply):
            if uplink.result is not StimulationResult.DONE or not clock.is_settled:
                return None  # nothing has changed by it, or when is not known: the status that follows will tell
            since_ms, cause = uplink.executed_ms, Cause.COMMAND
        else:
            since_ms, cause = uplink.mode_since_ms, cause_of(uplink.cause)
        if since_ms > header.sent_ms + MAX_AHEAD_MS:
            self._health.count("mode.impossible")
            return None
        since = clock.read(since_ms)
        return ModeReport(
            node=header.node,
            boot=header.boot,
            since_ms=since_ms,
            t_start_ns=since.t_ns,
            error_ns=since.error_ns,
            mode=mode_of(uplink.mode),
            cause=cause,
            is_from_reply=is_reply,
        )


def _changes_memory(uplink: Uplink, records: tuple[JournalRecord, ...], *, is_of_now: bool) -> bool:
    """Whether what is kept of a biobot over a restart is other after a message."""
    return bool(records) or (isinstance(uplink, Hello | Limits) and is_of_now)
