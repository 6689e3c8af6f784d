"""What is known of gateways and biobots right now. Pure: what came in and the time are arguments."""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from firmware_protocol.contract.announcements import GatewayEvent, NeighbourReport
from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction
from firmware_protocol.contract.presence import Kind, Token
from firmware_protocol.contract.records import Cause, GatewayStatus, Mode, ModeRecord, NodeStatus
from firmware_protocol.units import RSSI_UNKNOWN, NodeId

# A gateway speaks every second; one that missed several is not there.
_SILENT_AFTER_NS = 5_000_000_000
_MAX_BIOBOTS = 65_536
_MAX_GATEWAYS = 1_024
_MAX_RADIOS = 256
_KEPT_EVENTS = 200
_KEPT_STOPS = 64
_HALTED_FROM_NS, _HALTED_TO_NS = -1_000_000_000, 30_000_000_000
"""A biobot that a stop of all halts stands from about that moment on, or when one of its repetitions has come; the clocks of backpacks are
fitted."""
_MAX_HEARERS = 32
"""Gateways of one biobot that are remembered."""

_ValueT = TypeVar("_ValueT")


@dataclass(frozen=True, slots=True, kw_only=True)
class BiobotView:
    """Last known state of a biobot; None where nobody has said it yet. Instants are on the wall clock [ns]."""

    node: NodeId
    gateway: str
    is_reachable: bool
    mode: Mode
    cause: Cause
    radio: str | None = None
    battery_mv: int | None = None
    rssi_dbm: int | None = None
    lqi: int | None = None
    last_heard_wall_ns: int | None = None
    silence_s: float | None = None
    """For how long it has not been heard, by the clock of the gateway that heard it last."""
    buffered: int | None = None
    dropped: int | None = None
    firmware: int | None = None
    n_neighbours: int | None = None
    n_encounters: int = 0
    is_halted: bool = False
    """It was told to stand still by a stop of all."""

    @property
    def is_landmark(self) -> bool:
        """Say whether it was told to stand still, and not because all were."""
        return self.mode is Mode.S and self.cause is Cause.COMMAND and not self.is_halted


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayView:
    """Last known state of a gateway. ``is_alive``: it is on the bus and has spoken lately. ``radios_up``: those whose token is there."""

    name: str
    is_alive: bool
    status: GatewayStatus | None
    radios_up: tuple[str, ...] = ()


@dataclass(slots=True)
class _Gateway:
    has_token: bool = False
    status: GatewayStatus | None = None
    heard_ns: int | None = None
    status_ns: int = 0
    """When the status came, on the monotonic clock."""
    radios_up: set[str] = field(default_factory=set)


@dataclass(slots=True)
class Fleet:
    """Gateways and biobots by name; the newest report wins, whichever gateway it came through."""

    events: deque[GatewayEvent] = field(default_factory=lambda: deque(maxlen=_KEPT_EVENTS))
    n_ignored: int = 0
    _mappers: set[str] = field(default_factory=set)
    _commanders: set[str] = field(default_factory=set)
    _gateways: dict[str, _Gateway] = field(default_factory=dict)
    _nodes: dict[NodeId, NodeStatus] = field(default_factory=dict)
    _modes: dict[NodeId, ModeRecord] = field(default_factory=dict)
    _hearers: dict[NodeId, dict[str, None]] = field(default_factory=dict)
    _all_stopped_ns: dict[str, deque[int]] = field(default_factory=dict)
    """By gateway when it stopped all, on its wall clock: who stops all twice halts nobody anew the second time."""
    _stopped_ns: dict[NodeId, int] = field(default_factory=dict)
    """By biobot when it was last told to stop by itself, on the wall clock of the gateway that told it."""
    _neighbours: dict[NodeId, NeighbourReport] = field(default_factory=dict)
    _n_encounters: Mapping[NodeId, int] = field(default_factory=dict)
    _shifts_ns: Mapping[str, int] = field(default_factory=dict)

    def take_gateway_status(self, status: GatewayStatus, *, now_ns: int) -> None:
        """Note that a gateway spoke; ``now_ns`` is monotonic."""
        gateway = self._gateway(status.gateway)
        if gateway:
            gateway.status, gateway.heard_ns, gateway.status_ns = status, now_ns, now_ns

    def take_presence(self, token: Token, *, is_alive: bool, now_ns: int) -> None:
        """Note that a gateway, a radio, a mapper or a commander came to the bus or left it; ``now_ns`` is monotonic."""
        members = {Kind.MAPPER: self._mappers, Kind.COMMANDER: self._commanders}.get(token.kind)
        if members is not None:
            self._take_member(members, token.name, is_there=is_alive, limit=_MAX_GATEWAYS)
            return
        known = self._gateway(token.name)
        if known is None:
            return
        if token.radio is not None:
            self._take_member(known.radios_up, token.radio, is_there=is_alive, limit=_MAX_RADIOS)
        elif token.kind is Kind.GATEWAY:
            known.has_token = is_alive
            known.heard_ns = now_ns if is_alive else None

    def take_node_status(self, status: NodeStatus) -> None:
        """Note a biobot's state, unless a newer one is known."""
        self._note_hearer(status.node, status.gateway)
        known = self._nodes.get(status.node)
        if known is None or self._heard_ns(status) >= self._heard_ns(known):
            self._put(self._nodes, status.node, status)

    def take_neighbours(self, report: NeighbourReport) -> None:
        """Note whom a biobot has around it."""
        self._put(self._neighbours, report.node, report)

    def take_modes(self, records: Iterable[ModeRecord]) -> None:
        """Learn of biobots from records: after a restart they are known before they speak again."""
        for record in records:
            self._note_hearer(record.node, record.gateway)
            known = self._modes.get(record.node)
            if known is None or self._began_ns(record) >= self._began_ns(known):
                self._put(self._modes, record.node, record)

    def take_stage(self, stage: CommandStage) -> None:
        """Learn of stops of all: whom they halt is no landmark, unless it was told to stop by itself since."""
        if stage.stage is not Stage.ACCEPTED or stage.gateway not in self._gateways:
            return
        if stage.action is StimulationAction.STOP_ALL:
            self._all_stopped_ns.setdefault(stage.gateway, deque(maxlen=_KEPT_STOPS)).append(stage.wall_ns)
        elif stage.action is StimulationAction.STOP and not stage.part_of:
            self._put(self._stopped_ns, stage.node, stage.wall_ns)

    def set_encounter_counts(self, n_encounters_of: Mapping[NodeId, int]) -> None:
        """Set how many encounters each biobot has."""
        self._n_encounters = n_encounters_of

    def set_clock_shifts(self, shifts_ns: Mapping[str, int]) -> None:
        """Set what is to be added to the wall clocks of gateways that are wrong [ns]: a biobot belongs to the one that heard it last."""
        self._shifts_ns = shifts_ns

    def gateway_of(self, node: NodeId) -> str | None:
        """Name the gateway that heard a biobot last; None for an unknown one."""
        if node in self._nodes:
            return self._nodes[node].gateway
        return self._modes[node].gateway if node in self._modes else None

    def hearers_of(self, node: NodeId) -> list[str]:
        """Name the gateways that have spoken of a biobot, the one that heard it last first."""
        last = self.gateway_of(node)
        return [] if last is None else list(dict.fromkeys([last, *self._hearers.get(node, {})]))

    def gateways(self, *, now_ns: int) -> list[GatewayView]:
        """List all gateways by name."""
        return [
            GatewayView(name=name, is_alive=_is_alive(known, now_ns), status=known.status, radios_up=tuple(sorted(known.radios_up)))
            for name, known in sorted(self._gateways.items())
        ]

    def gateways_heard(self) -> list[str]:
        """Name all gateways that were on the bus since the start: what is for all of a site is for each of them."""
        return sorted(self._gateways)

    def is_on_bus(self, gateway: str) -> bool:
        """Say whether a gateway's token is there."""
        known = self._gateways.get(gateway)
        return known is not None and known.has_token

    def commanders(self) -> list[str]:
        """List the commanders on the bus by name: whoever may move biobots until it is gone."""
        return sorted(self._commanders)

    def mappers(self) -> list[str]:
        """List the mappers on the bus by name, this one among them."""
        return sorted(self._mappers)

    def biobots(self, *, now_ns: int) -> list[BiobotView]:
        """List all biobots by id."""
        reachable = {view.name for view in self.gateways(now_ns=now_ns) if view.is_alive}
        return [self._biobot(node, reachable, now_ns) for node in sorted(self._nodes.keys() | self._modes.keys())]

    def _biobot(self, node: NodeId, reachable: set[str], now_ns: int) -> BiobotView:
        neighbours = self._neighbours.get(node)
        n_neighbours = len(neighbours.neighbours) if neighbours else None
        status = self._nodes.get(node)
        if status is None:
            record = self._modes[node]
            return BiobotView(
                node=node,
                gateway=record.gateway,
                is_reachable=record.gateway in reachable,
                mode=record.mode,
                cause=record.cause,
                n_neighbours=n_neighbours,
                n_encounters=self._n_encounters.get(node, 0),
                is_halted=self._is_halted(node),
            )
        return BiobotView(
            node=node,
            gateway=status.gateway,
            is_reachable=status.gateway in reachable,
            mode=status.mode,
            cause=status.cause,
            radio=status.radio,
            battery_mv=status.battery_mv,
            rssi_dbm=None if status.rssi_dbm == RSSI_UNKNOWN else status.rssi_dbm,
            lqi=status.lqi,
            last_heard_wall_ns=self._heard_ns(status),
            silence_s=self._silence_s(status, now_ns),
            buffered=status.buffered,
            dropped=status.dropped,
            firmware=status.firmware,
            n_neighbours=n_neighbours,
            n_encounters=self._n_encounters.get(node, 0),
            is_halted=self._is_halted(node),
        )

    def _is_halted(self, node: NodeId) -> bool:
        spell = self._modes.get(node)
        if spell is None or spell.mode is not Mode.S or spell.cause is not Cause.COMMAND:
            return False
        if spell.is_halted:
            return True
        # A gateway that does not say so in its records told of the stops.
        began_ns, alone_ns = spell.t_start_ns + spell.wall_anchor_ns, self._stopped_ns.get(node)
        return any(
            _HALTED_FROM_NS <= began_ns - stopped_ns <= _HALTED_TO_NS and (alone_ns is None or alone_ns <= stopped_ns)
            for stopped_ns in self._all_stopped_ns.get(spell.gateway, ())
        )

    def _silence_s(self, status: NodeStatus, now_ns: int) -> float | None:
        home = self._gateways.get(status.gateway)
        if home is None or home.status is None:
            return None
        then_ns = home.status.wall_ns - status.last_heard_wall_ns
        return max(0, then_ns + now_ns - home.status_ns) / 1e9

    def _heard_ns(self, status: NodeStatus) -> int:
        return status.last_heard_wall_ns + self._shifts_ns.get(status.gateway, 0)

    def _began_ns(self, record: ModeRecord) -> int:
        return record.t_start_ns + record.wall_anchor_ns + self._shifts_ns.get(record.gateway, 0)

    def _take_member(self, members: set[str], name: str, *, is_there: bool, limit: int) -> None:
        if not is_there:
            members.discard(name)
        elif len(members) < limit or name in members:
            members.add(name)
        else:
            self.n_ignored += 1

    def _gateway(self, name: str) -> _Gateway | None:
        if name not in self._gateways and len(self._gateways) >= _MAX_GATEWAYS:
            self.n_ignored += 1
            return None
        return self._gateways.setdefault(name, _Gateway())

    def _note_hearer(self, node: NodeId, gateway: str) -> None:
        hearers = self._hearers.get(node, {})
        if gateway not in hearers and len(hearers) < _MAX_HEARERS:
            self._put(self._hearers, node, {**hearers, gateway: None})

    def _put(self, table: dict[NodeId, _ValueT], node: NodeId, value: _ValueT) -> None:
        if node not in table and len(table) >= _MAX_BIOBOTS:
            self.n_ignored += 1
        else:
            table[node] = value


def _is_alive(gateway: _Gateway, now_ns: int) -> bool:
    return gateway.has_token and gateway.heard_ns is not None and now_ns - gateway.heard_ns < _SILENT_AFTER_NS
