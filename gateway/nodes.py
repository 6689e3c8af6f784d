"""What is known of every biobot: who it is, how it is reached, how it fares. Pure; at most 65,535 of them, by their number."""

from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import msgspec

from firmware_protocol.contract.announcements import NeighbourEntry, NeighbourReport
from firmware_protocol.contract.records import BackpackConfiguration, BackpackLimits, Cause, Mode, ModeRecord, NodeStatus
from firmware_protocol.first_use import prepare
from firmware_protocol.messages import (
    LEAVE_PERIOD,
    LEAVE_RSSI,
    ConfigurationReport,
    Hello,
    Limits,
    Neighbours,
    Status,
    WireCause,
    WireMode,
)
from firmware_protocol.units import LAST_NODE_ADDRESS, NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.clocks import ClockMemory
from gateway.radio import strongest
from gateway.whereabouts import Place, Whereabouts

_PENDING_PARTS = 33
"""A neighbour report cannot have more parts under way than a backpack has messages outstanding (WIRE_FORMAT.md §5.1)."""

_MAX_DUPLICATES = 1024
"""Pairs of devices under one number that are told of; a flood of made-up ones is not."""

_MAX_EARLIER_BOOTS = 16

_SET_BACK_NS = 60 * NS_PER_S
"""A count of starts that is smaller than before is believed after so long a silence of the larger one: then it was set back, as by
writing a backpack's memory anew, and is not an old message from a dongle's queue."""

_N_BOOTS = 1 << 16


class NodeMemory(msgspec.Struct, frozen=True, kw_only=True):
    """What of a biobot outlives the gateway's process."""

    node: NodeId
    boot: BootId
    radio: str
    address: ShortAddress | None
    eui64: int
    firmware: int
    beacon_period_ms: int
    capabilities: int
    is_introduced: bool
    mode: ModeRecord | None = None
    """Its newest spell: it may be far older than the newest mode records of all."""
    limits: Limits | None = None
    """As last announced, by this boot or an earlier one: they bound what is sent until the next announcement."""
    clock: ClockMemory | None = None


prepare(NodeMemory)


@dataclass(slots=True, kw_only=True)
class Node:
    """A biobot as last heard. ``is_introduced``: its hello of this boot has come. ``address``: None where another biobot has it now."""

    node: NodeId
    boot: BootId
    radio: str
    address: ShortAddress | None
    sent_ms: Milliseconds
    """Latest tick of this boot at which it is known to have sent."""
    last_heard_wall_ns: Nanoseconds
    last_heard_ns: int
    """Monotonic; 0: not since the gateway started."""
    rssi_dbm: RssiDbm
    lqi: int
    heard_before_ns: int = 0
    """When an earlier process heard it last, or later than that [monotonic]."""
    is_introduced: bool = False
    eui64: int = 0
    firmware: int = 0
    beacon_period_ms: int = 0
    capabilities: int = 0
    mode: ModeRecord | None = None
    """The last record of its newest spell."""
    status: Status | None = None
    status_number: int | None = None
    """Unwrapped sequence number of ``status``, in this boot; the same of ``neighbours``, of its last part."""
    neighbours: tuple[NeighbourEntry, ...] | None = None
    neighbours_number: int | None = None
    neighbours_ns: int = 0
    """When the last part of ``neighbours`` came [monotonic]."""
    parts: dict[int, tuple[int, Neighbours]] = field(default_factory=dict)
    limits: Limits | None = None
    configuration: ConfigurationReport | None = None
    """As last told in this boot, and the unwrapped number of the message."""
    configuration_number: int | None = None
    earlier_boots: OrderedDict[BootId, None] = field(default_factory=OrderedDict)
    """Lives that are over, the latest last."""

    def memory(self, *, clock: ClockMemory | None = None) -> NodeMemory:
        """Return what is to be kept of it over a restart; ``clock`` is of its boot."""
        return NodeMemory(
            node=self.node,
            boot=self.boot,
            mode=self.mode,
            radio=self.radio,
            address=self.address,
            eui64=self.eui64,
            firmware=self.firmware,
            beacon_period_ms=self.beacon_period_ms,
            capabilities=self.capabilities,
            is_introduced=self.is_introduced,
            limits=self.limits,
            clock=clock,
        )


@dataclass(slots=True, kw_only=True)
class NodeBook:
    """All biobots that a gateway knows."""

    gateway: str
    _nodes: dict[NodeId, Node] = field(default_factory=dict)
    _duplicates: set[tuple[NodeId, int, int]] = field(default_factory=set)
    _whereabouts: Whereabouts = field(default_factory=Whereabouts)

    def heard(
        self,
        *,
        node: NodeId,
        boot: BootId,
        radio: str,
        address: ShortAddress,
        rssi_dbm: RssiDbm,
        lqi: int,
        sent_ms: Milliseconds,
        now_ns: int,
        now_wall_ns: Nanoseconds,
    ) -> tuple[Node, bool]:
        """Take note of any message from a biobot; return it, and whether what ``memory`` keeps has changed.

        A message that is older than another one that came before it, from a queue of a dongle that was away, changes nothing: the biobot is
        where it was heard since, and in the life that it was heard of since. Its boot is then not the node's.

        Parameters
        ----------
        sent_ms
            Tick of that boot at which the radio took this copy of the message.
        """
        known = self._nodes.get(node)
        if known is not None and (known.boot, known.radio, known.address) == (boot, radio, address) and known.sent_ms <= sent_ms:
            self._whereabouts.stay(node, radio=radio, heard_ns=now_ns)  # as most messages are
            known.sent_ms, known.rssi_dbm, known.lqi = sent_ms, rssi_dbm, lqi
            known.last_heard_ns, known.last_heard_wall_ns = now_ns, now_wall_ns
            return known, False
        place = Place(radio=radio, address=address, heard_ns=now_ns)
        if known is not None and (known.sent_ms > sent_ms if known.boot == boot else not _is_later_life(known, boot, now_ns=now_ns)):
            self._whereabouts.suspect(node, place)
            return known, False
        self._move(node, place)
        if known is None:
            known = self._nodes[node] = Node(
                node=node,
                boot=boot,
                radio=radio,
                address=address,
                sent_ms=sent_ms,
                last_heard_wall_ns=now_wall_ns,
                last_heard_ns=now_ns,
                rssi_dbm=rssi_dbm,
                lqi=lqi,
            )
            return known, True
        has_changed = (known.boot, known.radio, known.address) != (boot, radio, address)
        if known.boot != boot:
            known.is_introduced = False
            known.parts.clear()
            known.status_number = known.neighbours_number = known.configuration_number = None
            known.configuration = None
            _begin_life(known, boot)
        known.radio, known.address, known.sent_ms = radio, address, sent_ms
        known.last_heard_ns, known.last_heard_wall_ns = now_ns, now_wall_ns
        known.rssi_dbm, known.lqi = rssi_dbm, lqi
        return known, has_changed

    def find(self, node: NodeId) -> Node | None:
        """Return a biobot, or None where it was never heard of."""
        return self._nodes.get(node)

    def last_heard_ns(self, node: NodeId) -> int:
        """Return when a biobot was last heard, 0 where it was not since the gateway started."""
        known = self._nodes.get(node)
        return 0 if known is None else known.last_heard_ns

    def places_of(self, node: NodeId, *, now_ns: int) -> list[Place]:
        """Return where a biobot was heard within the last minutes, one place at each radio, the latest first."""
        return self._whereabouts.recent(node, now_ns=now_ns)

    def __len__(self) -> int:
        return len(self._nodes)

    def all(self) -> list[Node]:
        """Return all biobots, by number."""
        return [self._nodes[node] for node in sorted(self._nodes)]

    def status_of(self, node: Node) -> NodeStatus | None:
        """Return what is published of a biobot, or None before its first status."""
        status = node.status
        if status is None:
            return None
        return NodeStatus(
            gateway=self.gateway,
            radio=node.radio,
            node=node.node,
            eui64=node.eui64,
            boot=node.boot,
            mode=mode_of(status.mode),
            cause=cause_of(status.cause),
            battery_mv=status.battery_mv,
            rssi_dbm=node.rssi_dbm,
            lqi=node.lqi,
            last_heard_wall_ns=node.last_heard_wall_ns,
            buffered=status.buffered,
            dropped=status.dropped,
            firmware=node.firmware,
            capabilities=node.capabilities,
            limits=None if node.limits is None else _limits_record(node.limits),
            configuration=None if node.configuration is None else configuration_of(node.configuration),
            encounter_capacity=0 if node.limits is None else node.limits.encounter_capacity,
        )

    def take_status(self, node: Node, status: Status, *, number: int) -> bool:
        """Take a status by the unwrapped number of its message; False for one older than what is known."""
        if node.status_number is not None and number < node.status_number:
            return False
        node.status, node.status_number = status, number
        return True

    def take_limits(self, node: Node, limits: Limits) -> None:
        """Take what a backpack announces; it holds until the next announcement, also over restarts of backpack and gateway."""
        node.limits = limits

    def take_configuration(self, node: Node, report: ConfigurationReport, *, number: int) -> None:
        """Take a configuration report by the unwrapped number of its message; one older than what is known changes nothing."""
        if node.configuration_number is None or number > node.configuration_number:
            node.configuration, node.configuration_number = report, number

    def introduce(self, node: Node, hello: Hello) -> int | None:
        """Take note of a biobot's hello.

        Returns
        -------
        int or None
            EUI-64 of another device that had this biobot's number before; told once of each pair.
        """
        other = node.eui64
        pair = (node.node, min(other, hello.eui64), max(other, hello.eui64))
        node.is_introduced = True
        node.eui64 = hello.eui64
        node.firmware = hello.firmware
        node.beacon_period_ms = hello.beacon_period_ms
        node.capabilities = hello.capabilities
        if other in {0, hello.eui64} or pair in self._duplicates or len(self._duplicates) >= _MAX_DUPLICATES:
            return None
        self._duplicates.add(pair)
        return other

    def take_neighbours(self, node: Node, part: Neighbours, *, number: int, wall_ns: Nanoseconds) -> NeighbourReport | None:
        """Take a part of a neighbour report; return the whole when its last part has come.

        Parameters
        ----------
        number
            Unwrapped sequence number of the message: the parts of one report have consecutive ones (WIRE_FORMAT.md §5.5).
        """
        if part.n_parts > _PENDING_PARTS:
            return None
        node.parts[number] = (number, part)
        first = number - part.part
        members = [node.parts.get(first + index) for index in range(part.n_parts)]
        for old in [known for known in node.parts if known < number - 2 * _PENDING_PARTS]:
            del node.parts[old]
        found = [member[1] for member in members if member is not None and member[1].n_parts == part.n_parts]
        if len(found) < part.n_parts:
            return None
        for index in range(part.n_parts):
            del node.parts[first + index]
        if node.neighbours_number is not None and first < node.neighbours_number:
            return None  # it was repeated, and a later report came before it
        node.neighbours_number = first + part.n_parts - 1
        node.neighbours_ns = node.last_heard_ns
        heard: dict[NodeId, RssiDbm] = {}
        for one in (neighbour for member in found for neighbour in member.neighbours):
            heard[one.node] = strongest(one.rssi_dbm, heard.get(one.node, one.rssi_dbm))
        node.neighbours = tuple(NeighbourEntry(node=other, rssi_dbm=heard[other]) for other in sorted(heard))
        return NeighbourReport(gateway=self.gateway, node=node.node, wall_ns=wall_ns, neighbours=node.neighbours)

    def adjacency(self) -> dict[NodeId, frozenset[NodeId]]:
        """Return who hears whom, of all biobots that have reported neighbours."""
        return {
            node.node: frozenset(entry.node for entry in node.neighbours) for node in self._nodes.values() if node.neighbours is not None
        }

    def restore(self, memories: Iterable[NodeMemory], *, heard_ns: Mapping[NodeId, int], now_ns: int) -> None:
        """Know again the biobots of an earlier process; they count as not heard since. An address that two of them had is none's.

        ``heard_ns`` has when that process heard each last, or later; who is not in it may have been heard until now.
        """
        kept = list(memories)
        believed = self._whereabouts.restore(
            [
                (memory.node, Place(radio=memory.radio, address=memory.address, heard_ns=0))
                for memory in kept
                if memory.address is not None and memory.address <= LAST_NODE_ADDRESS
            ]
        )
        for memory in kept:
            self._nodes[memory.node] = Node(
                node=memory.node,
                boot=memory.boot,
                radio=memory.radio,
                address=memory.address if memory.node in believed else None,
                sent_ms=Milliseconds(0),
                last_heard_wall_ns=Nanoseconds(0),
                last_heard_ns=0,
                heard_before_ns=heard_ns.get(memory.node, now_ns),
                rssi_dbm=RssiDbm(0),
                lqi=0,
                is_introduced=memory.is_introduced,
                mode=memory.mode,
                eui64=memory.eui64,
                firmware=memory.firmware,
                beacon_period_ms=memory.beacon_period_ms,
                capabilities=memory.capabilities,
                limits=memory.limits,
            )

    def restore_earlier_boots(self, lives: Iterable[tuple[NodeId, BootId]]) -> None:
        """Know again which lives of the biobots are over: all but the one that each had last."""
        for node, boot in lives:
            known = self._nodes.get(node)
            if known is not None and known.boot != boot:
                known.earlier_boots[boot] = None

    def _move(self, node: NodeId, place: Place) -> None:
        """Let a biobot be at a place; whoever had that address is not reached under it any more."""
        before = self._whereabouts.move(node, place)
        former = None if before is None else self._nodes.get(before)
        if former is not None and (former.radio, former.address) == (place.radio, place.address):
            former.address = None


def _is_later_life(known: Node, boot: BootId, *, now_ns: int) -> bool:
    """Whether a boot other than the one known is a later one. One that is known to be over is never taken for the present one again."""
    if (boot - known.boot) % _N_BOOTS < _N_BOOTS // 2:
        return True
    return boot not in known.earlier_boots and known.last_heard_ns < now_ns - _SET_BACK_NS


def _begin_life(known: Node, boot: BootId) -> None:
    if boot in known.earlier_boots:
        known.earlier_boots.clear()  # it was not over, so what was taken for later may have been older
    else:
        known.earlier_boots[known.boot] = None
        while len(known.earlier_boots) > _MAX_EARLIER_BOOTS:
            known.earlier_boots.popitem(last=False)
    known.boot = boot


def configuration_of(report: ConfigurationReport) -> BackpackConfiguration:
    """Return the record's form of the values in force."""
    return BackpackConfiguration(
        beacon_period_ms=_told(report.beacon_period_ms, LEAVE_PERIOD),
        rssi_enter_dbm=_told(report.rssi_enter_dbm, LEAVE_RSSI),
        rssi_exit_dbm=_told(report.rssi_exit_dbm, LEAVE_RSSI),
        gap_tolerance_ms=_told(report.gap_tolerance_ms, LEAVE_PERIOD),
        report_period_ms=_told(report.report_period_ms, LEAVE_PERIOD),
    )


def _told(value: int, missing: int) -> int | None:
    return None if value == missing else value


def _limits_record(limits: Limits) -> BackpackLimits:
    return BackpackLimits(**{name: getattr(limits, name) for name in BackpackLimits.__struct_fields__})


def mode_of(mode: WireMode) -> Mode:
    """Return the record's word for a mode on the wire."""
    return Mode.S if mode is WireMode.S else Mode.CRW


def cause_of(cause: WireCause) -> Cause:
    """Return the record's word for a cause on the wire."""
    return Cause.COMMAND if cause is WireCause.COMMAND else Cause.NATURAL
