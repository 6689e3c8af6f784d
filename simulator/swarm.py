"""Insects, backpacks, air and coordinator as one machine that bytes and time go into and bytes come out of. No I/O, no clock.

The world may lag behind: it is advanced in bounded steps, so that a machine that is too slow still answers on its serial line.
What the insects then do is told late but dated right. Backpacks, air and coordinator always keep to the caller's time.
"""

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from firmware_protocol.envelope import RadioReceived
from firmware_protocol.messages import EncounterBatch, Neighbour, WireCause, WireMode
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, NodeId
from simulator import chance
from simulator.air import Air, DownlinkArrival, SendingDone, UplinkArrival
from simulator.backpack import MAX_NODE, Acknowledged, Backpack, BackpackConfig, Effect, Transmission
from simulator.clock import BackpackClock, DriftingClock
from simulator.coordinator import Coordinator
from simulator.errors import ParameterError
from simulator.events import Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.legs import Floats
from simulator.live_sensing import LiveSensing
from simulator.radio import Radio, RadioConfig, lqi
from simulator.reports import ReportLog
from simulator.sensing import SensingConfig
from simulator.stimulator import Actuation
from simulator.wandering_clock import WanderingClock
from simulator.world import World

_CLOCK_STREAM = 220
_DRIFT_STREAM = 221

_TICK_NS = 50 * NS_PER_MS
_LONGEST_STEP_NS = 200 * NS_PER_MS
_NEVER_NS = 1 << 62

_EUI64_BASE = 0x00124B0000000000  # Texas Instruments' number

_WIRE_MODE = {Mode.CRW: WireMode.CRW, Mode.S: WireMode.S}
_WIRE_CAUSE = {Cause.NATURAL: WireCause.NATURAL, Cause.COMMAND: WireCause.COMMAND}
_CAUSE = {wire: cause for cause, wire in _WIRE_CAUSE.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class SwarmConfig:
    """How the backpacks are made.

    Parameters
    ----------
    seed, boot
        For all draws; the count of starts that every backpack has reached.
    drift_ppm
        Clocks run too fast or too slow by up to this, drawn uniformly for each; crystals differ by about 10 ppm [Mar04].
    wander_ppm
        Their rates wander from that by up to this, in steps of a minute.
    switched_on_s
        Each backpack was switched on up to this long before the run, drawn uniformly [s].
    sensing
        How encounters are formed from beacons; None: they are exact.

    References
    ----------
    [Mar04] M. Maroti, B. Kusy, G. Simon, A. Ledeczi, "The flooding time synchronization protocol", SenSys 2004.
    """

    seed: int
    boot: BootId
    drift_ppm: float = 20.0
    wander_ppm: float = 0.0
    switched_on_s: float = 60.0
    backpack: BackpackConfig = field(default_factory=BackpackConfig)
    radio: RadioConfig = field(default_factory=RadioConfig)
    sensing: SensingConfig | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutedActuation:
    """An insect was stopped or started at ``t_s`` [s of the run]: by a command, or (None) because a hold was over."""

    t_s: float
    id: int
    command: int | None
    mode: str
    cause: str


class Swarm:
    """See the module. All instants are nanoseconds since the run began.

    Parameters
    ----------
    world
        Before its first ``advance``. Its unit of length counts as a metre for signal strengths.
    observe
        Is given the world's events as they happen.
    """

    def __init__(self, world: World, *, config: SwarmConfig, observe: Callable[[Sequence[Event]], None]) -> None:
        if world.ids[-1] > MAX_NODE:
            raise ParameterError(name="biobots", got=world.ids[-1], wanted=f"ids up to {MAX_NODE}: a node number has 16 bits")
        self.coordinator = Coordinator()
        self.reports = ReportLog()
        self.executed: list[ExecutedActuation] = []
        self._world = world
        self._observe = observe
        self._radio = Radio(seed=config.seed, config=config.radio)
        self._nodes = [NodeId(one) for one in world.ids]
        self._row = {node: row for row, node in enumerate(self._nodes)}
        self._clocks = {node: _draw_clock(node, config) for node in self._nodes}
        self._backpacks = {node: self._make_backpack(node, config) for node in self._nodes}
        self._air = Air(self._nodes, radio=self._radio, seed=config.seed)
        self._offered: dict[int, tuple[NodeId, RadioReceived]] = {}
        self._shares_air = config.radio.csma
        self._sensed_ns = 0
        self._dues: list[tuple[int, NodeId]] = []
        self._due_ns: dict[NodeId, int | None] = {}
        self._world_ns = 0
        self._end_ns = _NEVER_NS
        self.has_ended = False
        self._places_at_s = -1.0
        self._places: Floats = world.positions()
        low_x, low_y, high_x, high_y = world.arena.polygon.bounds
        self._centre = ((low_x + high_x) / 2, (low_y + high_y) / 2)
        self._sensing = None if config.sensing is None else LiveSensing(
            self._nodes, clocks=self._clocks, arena=world.arena, config=config.sensing, places=self._places, coordinator_place=self._centre
        )  # fmt: skip
        for node in self._nodes:
            self._plan(node)
        self.coordinator.start()

    @property
    def is_settled(self) -> bool:
        """The base station has everything the backpacks had to say."""
        return all(backpack.is_settled for backpack in self._backpacks.values())

    @property
    def n_dropped(self) -> int:
        """Encounters lost to full buffers, over all backpacks."""
        return sum(backpack.n_dropped for backpack in self._backpacks.values())

    @property
    def n_buffered(self) -> int:
        """Encounters that the base station does not have yet."""
        return sum(backpack.n_buffered for backpack in self._backpacks.values())

    @property
    def air_counts(self) -> dict[str, int] | None:
        """Packets sent and not sent on the shared channel, and their time on it [ns]; None where encounters are sensed without beacons."""
        if self._sensing is None:
            return None
        return {"sent": self._sensing.n_sent, "not_sent": self._sensing.n_not_sent, "airtime_ns": self._sensing.airtime_ns}

    def lag_ns(self, now_ns: int) -> int:
        """Return how far the world is behind [ns]."""
        return max(0, min(now_ns, self._end_ns) - self._world_ns)

    def end_at(self, at_ns: int) -> None:
        """Let the insects stand still for good from ``at_ns`` on; ``has_ended`` tells when the world has got there.

        Open encounters end then, and backpacks only finish what they began.
        """
        self._end_ns = max(at_ns, self._world_ns)

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """Take bytes from the base station."""
        self.coordinator.feed(chunk, now_ns=now_ns)
        self._launch_requests(now_ns)

    def step(self, now_ns: int) -> None:
        """Do everything that is due by now."""
        if not self.has_ended and now_ns >= min(self._world_ns + _TICK_NS, self._end_ns):
            self._advance_world(now_ns)
            if self._world_ns >= self._end_ns:
                self._end_world(now_ns)
        if self.has_ended and self._offered:
            self._sense(now_ns, now_ns=now_ns)
        self._deliver(now_ns)
        while self._dues and self._dues[0][0] <= now_ns:
            due_ns, node = heapq.heappop(self._dues)
            if self._due_ns[node] == due_ns:
                self._apply(node, self._backpacks[node].poll(now_ms=self._clocks[node].read_ms(now_ns)), now_ns=now_ns)
        deadline_ns = self.coordinator.next_deadline_ns()
        if deadline_ns is not None and deadline_ns <= now_ns:
            self.coordinator.handle_deadline(now_ns=now_ns)
        self._launch_requests(now_ns)

    def next_due_ns(self) -> int:
        """Return when ``step`` is to be called at the latest; a time already past means now."""
        dues = [] if self.has_ended else [min(self._world_ns + _TICK_NS, self._end_ns)]
        if self._dues:
            dues.append(self._dues[0][0])
        if self.has_ended and self._offered:
            dues.append(self._sensed_ns + _TICK_NS)
        dues += [due for due in (self._air.next_arrival_ns(), self.coordinator.next_deadline_ns()) if due is not None]
        return min(dues, default=_NEVER_NS)

    def _make_backpack(self, node: NodeId, config: SwarmConfig) -> Backpack:
        return Backpack(
            node=node, boot=config.boot, eui64=_EUI64_BASE + node, seed=config.seed, config=config.backpack,
            now_ms=self._clocks[node].read_ms(0), sense_neighbours=lambda: self._sense_neighbours(node),
        )  # fmt: skip

    def _end_world(self, now_ns: int) -> None:
        self.has_ended = True
        if self._sensing is not None:
            self._sensing.silence()
        for event in self._world.open_encounters() if self._sensing is None else ():
            self._part(event.id1, event.id2, end_ns=self._world_ns, now_ns=now_ns)
        for node, backpack in self._backpacks.items():
            backpack.stop_sensing(now_ms=self._clocks[node].read_ms(now_ns))
            backpack.quieten()
            self._plan(node)

    def _advance_world(self, now_ns: int) -> None:
        self._world_ns = min(now_ns, self._end_ns, self._world_ns + _LONGEST_STEP_NS)
        events = self._world.advance(self._world_ns / NS_PER_S)
        self._observe(events)
        for event in events:
            match event:
                case EncounterBegan() | EncounterEnded() if self._sensing is not None:
                    pass  # the backpacks have their beacons to go by
                case EncounterBegan(t_s=t_s, id1=id1, id2=id2):
                    self._meet(id1, id2, start_ns=round(t_s * NS_PER_S))
                case EncounterEnded(t_end_s=t_end_s, id1=id1, id2=id2):
                    self._part(id1, id2, end_ns=round(t_end_s * NS_PER_S), now_ns=now_ns)
                case ModeChanged(t_s=t_s, id=one, mode=mode, cause=cause):
                    node = NodeId(one)
                    at_ms = self._clocks[node].read_ms(round(t_s * NS_PER_S))
                    self._backpacks[node].change_mode(_WIRE_MODE[mode], _WIRE_CAUSE[cause], at_ms=at_ms)
                    self._plan(node)
        self._sense(self._world_ns, now_ns=now_ns)

    def _sense(self, until_ns: int, *, now_ns: int) -> None:
        """Let beacons, and the reports that share their channel, go on to ``until_ns``."""
        if self._sensing is None:
            return
        self._sensed_ns = until_ns
        heard, carried = self._sensing.advance(until_ns, places=self._current_places())
        for one in carried:
            node, received = self._offered.pop(one.ticket)
            if one.is_carried:
                self._air.send_up(received, node=node, now_ns=one.at_ns)
        if self.has_ended:
            return  # beacons that were still under way find no logger
        for beacon in heard:
            clock = self._clocks[beacon.node]
            self._backpacks[beacon.node].hear_beacon(
                beacon.peer, at_ms=clock.read_ms(beacon.at_ns), rssi_dbm=beacon.rssi_dbm, now_ms=clock.read_ms(now_ns)
            )
        for node, backpack in self._backpacks.items():
            clock = self._clocks[node]
            if backpack.sense_until(clock.read_ms(until_ns), now_ms=clock.read_ms(now_ns)):
                self._plan(node)
        for node in {beacon.node for beacon in heard}:
            self._plan(node)

    def _meet(self, id1: int, id2: int, *, start_ns: int) -> None:
        x1, y1 = self._place(NodeId(id1))
        x2, y2 = self._place(NodeId(id2))
        # The world tells of the meeting up to a step later; they may have come nearer or parted again by then.
        rssi_dbm = self._radio.rssi_dbm(min(math.hypot(x1 - x2, y1 - y2), self._world.ranges.detection))
        for node, peer in ((NodeId(id1), NodeId(id2)), (NodeId(id2), NodeId(id1))):
            self._backpacks[node].begin_encounter(peer, start_ms=self._clocks[node].read_ms(start_ns), rssi_dbm=rssi_dbm)
            self._plan(node)

    def _part(self, id1: int, id2: int, *, end_ns: int, now_ns: int) -> None:
        for node, peer in ((NodeId(id1), NodeId(id2)), (NodeId(id2), NodeId(id1))):
            clock = self._clocks[node]
            self._backpacks[node].end_encounter(peer, end_ms=clock.read_ms(end_ns), now_ms=clock.read_ms(now_ns))
            self._plan(node)

    def _deliver(self, now_ns: int) -> None:
        for arrival in self._air.take_arrived(now_ns):
            match arrival:
                case UplinkArrival(received=received):
                    self.coordinator.take_from_radio(received, now_ns=now_ns)
                case DownlinkArrival(node=node, payload=payload, is_broadcast=is_broadcast):
                    now_ms = self._clocks[node].read_ms(now_ns)
                    self._apply(node, self._backpacks[node].receive(payload, now_ms=now_ms, is_broadcast=is_broadcast), now_ns=now_ns)
                case SendingDone(handle=handle, status=status):
                    self.coordinator.confirm(handle, status, now_ns=now_ns)

    def _apply(self, node: NodeId, effects: Sequence[Effect], *, now_ns: int) -> None:
        for effect in effects:
            match effect:
                case Transmission():
                    self._transmit(node, effect, now_ns=now_ns)
                case Acknowledged(sequence=sequence, message=EncounterBatch()):
                    self.reports.acknowledge(node=node, sequence=sequence)
                case Acknowledged():
                    pass
                case Actuation():
                    self._actuate(node, effect, now_ns=now_ns)
        self._plan(node)

    def _actuate(self, node: NodeId, actuation: Actuation, *, now_ns: int) -> None:
        if self.has_ended:
            return
        self._advance_world(now_ns)
        cause = _CAUSE[actuation.cause]
        if actuation.mode is WireMode.S:
            self._world.stop(node, cause=cause)
        else:
            self._world.start(node, cause=cause)
        self.executed.append(
            ExecutedActuation(t_s=self._world.now_s, id=node, command=actuation.command, mode=actuation.mode.name, cause=cause.value)
        )

    def _transmit(self, node: NodeId, sent: Transmission, *, now_ns: int) -> None:
        if sent.is_first and isinstance(sent.message, EncounterBatch):
            self.reports.add(sent.message, node=node, boot=self._backpacks[node].boot, sequence=sent.sequence, clock=self._clocks[node])
        x, y = self._place(node)
        rssi_dbm = self._radio.rssi_dbm(math.hypot(x - self._centre[0], y - self._centre[1]))
        received = RadioReceived(source=self._air.address_of(node), rssi_dbm=rssi_dbm, lqi=lqi(rssi_dbm), payload=sent.payload)
        if self._sensing is None or not self._shares_air:
            self._air.send_up(received, node=node, now_ns=now_ns)
        else:
            ticket = self._sensing.offer(node, n_octets=len(sent.payload), now_ns=now_ns)
            self._offered[ticket] = (node, received)

    def _launch_requests(self, now_ns: int) -> None:
        while self.coordinator.requests:
            request = self.coordinator.requests.popleft()
            if self._sensing is not None and self._shares_air:
                self._sensing.occupy(n_octets=len(request.payload), now_ns=now_ns)
            self._air.send_down(request, now_ns=now_ns)

    def _plan(self, node: NodeId) -> None:
        due_ms = self._backpacks[node].next_due_ms()
        due_ns = None if due_ms is None else self._clocks[node].elapsed_ns(due_ms)
        if self._due_ns.get(node, -1) != due_ns:
            self._due_ns[node] = due_ns
            if due_ns is not None:
                heapq.heappush(self._dues, (due_ns, node))

    def _place(self, node: NodeId) -> tuple[float, float]:
        places = self._current_places()
        row = self._row[node]
        return float(places[row, 0]), float(places[row, 1])

    def _current_places(self) -> Floats:
        if self._places_at_s != self._world.now_s:
            self._places_at_s = self._world.now_s
            self._places = self._world.positions()
        return self._places

    def _sense_neighbours(self, node: NodeId) -> list[Neighbour]:
        places = self._current_places()
        offsets = places - places[self._row[node]]
        square_distances = (offsets**2).sum(axis=1).tolist()
        limit = self._world.ranges.communication**2
        return [
            Neighbour(node=other, rssi_dbm=self._radio.rssi_dbm(math.sqrt(square)))
            for other, square in zip(self._nodes, square_distances, strict=True)
            if square <= limit and other != node
        ]


def _draw_clock(node: NodeId, config: SwarmConfig) -> BackpackClock:
    since_boot = chance.uniform(seed=config.seed, biobot=node, stream=_CLOCK_STREAM, index=0)
    drift = 2 * chance.uniform(seed=config.seed, biobot=node, stream=_DRIFT_STREAM, index=0) - 1
    start_ms, drift_ppb = int(since_boot * config.switched_on_s * 1000), round(drift * config.drift_ppm * 1000)
    if not config.wander_ppm:
        return DriftingClock(start_ms=start_ms, drift_ppb=drift_ppb)
    wander_ppb = round(config.wander_ppm * 1000)
    return WanderingClock(start_ms=start_ms, drift_ppb=drift_ppb, wander_ppb=wander_ppb, seed=config.seed, node=node)
