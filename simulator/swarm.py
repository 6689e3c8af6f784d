"""Insects, backpacks, air and coordinators as one machine that bytes and time go into and bytes come out of. No I/O, no clock.

The world may lag behind: it is advanced in bounded steps, so that a machine that is too slow still answers on its serial line.
What the insects then do is told late but dated right. Backpacks, air and coordinators always keep to the caller's time.
"""

import heapq
import math
from collections.abc import Callable, Sequence

from firmware_protocol.envelope import RadioReceived
from firmware_protocol.messages import EncounterBatch, EncounterBatchWithPaths, WireCause, WireMode
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from simulator.backpacks.backpack import Acknowledged, Backpack, BeaconsChanged, Effect, Transmission
from simulator.backpacks.stimulator import Actuation
from simulator.dongles.interface import Dongle
from simulator.errors import ParameterError
from simulator.events import BackpackSilenced, Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.habitat import Habitat
from simulator.radios.air import Air, DownlinkArrival, SendingDone, UplinkArrival
from simulator.radios.coverage import Coverage, CoverageConfig, Place, spread_places
from simulator.radios.live_sensing import LiveSensing
from simulator.radios.radio import Radio, lqi
from simulator.radios.sensing import SensingConfig
from simulator.reports import ReportLog
from simulator.steering import ExecutedActuation, Steering
from simulator.surroundings import Surroundings
from simulator.swarm_config import SwarmConfig, check_node_numbers, draw_clock, make_coordinators

_TICK_NS = 50 * NS_PER_MS
_LONGEST_STEP_NS = 200 * NS_PER_MS
_ASSOCIATION_NS = 500 * NS_PER_MS
"""How often backpacks compare coordinators."""

_NEVER_NS = 1 << 62

_EUI64_BASE = 0x00124B0000000000  # Texas Instruments' number

_WIRE_MODE = {Mode.CRW: WireMode.CRW, Mode.S: WireMode.S}
_WIRE_CAUSE = {Cause.NATURAL: WireCause.NATURAL, Cause.COMMAND: WireCause.COMMAND}


class Swarm:
    """See the module. All instants are nanoseconds since the run began.

    Parameters
    ----------
    world
        Before its first ``advance``. Its unit of length counts as a metre for signal strengths.
    observe
        Is given the world's events as they happen.
    """

    def __init__(self, world: Habitat, *, config: SwarmConfig, observe: Callable[[Sequence[Event]], None]) -> None:
        check_node_numbers(world.ids)
        coverage = config.coverage or CoverageConfig(places=(_middle(world),))
        self.coordinators = make_coordinators(len(coverage.places), config)
        self.reports = ReportLog(keeps_rows=config.keeps_history)
        self._steering = Steering(
            world,
            seed=config.seed,
            response=config.response,
            metres_per_unit=config.metres_per_unit,
            speed_factor=config.speed_factor,
            keeps_history=config.keeps_history,
        )
        self.n_rejoined = 0
        """How often a backpack joined another coordinator, or one again."""
        self.silenced: dict[NodeId, str] = {}
        """Backpacks that are off, and why."""
        self.n_lost = 0
        """Encounters that were not handed over when their backpack fell silent."""
        self._world = world
        self._observe = observe
        self._radio = Radio(seed=config.seed, config=config.radio)
        self._nodes = [NodeId(one) for one in world.ids]
        self._surroundings = Surroundings(world, nodes=self._nodes, radio=self._radio)
        mm_per_unit = 1000.0 * config.metres_per_unit
        self._odometer = self._surroundings.make_odometer(mm_per_unit=mm_per_unit, seed=config.seed) if config.has_imu else None
        self._clocks = {node: draw_clock(node, config) for node in self._nodes}
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
        self._coverage = Coverage(coverage, strength_dbm=self._radio.strength_dbm)
        if not self._coverage.is_trivial and not self._surroundings.is_known:
            raise ParameterError(
                name="coordinators", got=coverage, wanted="one that covers everything, for it is not known where the biobots are"
            )
        self._associate_at_ns = 0
        self._associate(0)
        self._sensing = self._make_sensing(config.sensing, places=coverage.places)
        for node in self._nodes:
            self._plan(node)
        for coordinator in self.coordinators:
            coordinator.start(now_ns=0)

    @property
    def coordinator(self) -> Dongle:
        """The first coordinator."""
        return self.coordinators[0]

    @property
    def executed(self) -> Sequence[ExecutedActuation]:
        """What was done to insects so far, and what they made of it."""
        return self._steering.executed

    @property
    def is_settled(self) -> bool:
        """The base station has everything that it can ever get.

        Nothing more comes from silent backpacks, nor, once the world has ended and nobody walks any more, from those out of coverage.
        """
        return all(
            backpack.is_settled or node in self.silenced or (self.has_ended and self._air.home_of(node) is None)
            for node, backpack in self._backpacks.items()
        )

    @property
    def n_dropped(self) -> int:
        """Encounters lost to full buffers, over all backpacks."""
        return sum(backpack.n_dropped for backpack in self._backpacks.values())

    @property
    def n_buffered(self) -> int:
        """Encounters that the base station does not have yet, and may get."""
        return sum(backpack.n_buffered for node, backpack in self._backpacks.items() if node not in self.silenced)

    @property
    def n_uncovered(self) -> int:
        """Backpacks that no coordinator covers now."""
        return sum(self._air.home_of(node) is None for node in self._nodes)

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

    def feed(self, chunk: bytes, *, now_ns: int, coordinator: int = 0) -> None:
        """Take bytes from the base station at the line of a coordinator."""
        self.coordinators[coordinator].feed(chunk, now_ns=now_ns)
        self._launch_requests(now_ns)

    def step(self, now_ns: int) -> None:
        """Do everything that is due by now."""
        if not self.has_ended and now_ns >= min(self._world_ns + _TICK_NS, self._end_ns):
            self._advance_world(now_ns)
            if self._world_ns >= self._end_ns:
                self._end_world(now_ns)
        self._react(now_ns)
        if now_ns >= self._associate_at_ns:
            self._associate(now_ns)
        if self.has_ended and self._offered:
            self._sense(now_ns, now_ns=now_ns)
        self._deliver(now_ns)
        while self._dues and self._dues[0][0] <= now_ns:
            due_ns, node = heapq.heappop(self._dues)
            if self._due_ns[node] == due_ns:
                self._apply(node, self._backpacks[node].poll(now_ms=self._clocks[node].read_ms(now_ns)), now_ns=now_ns)
        for coordinator in self.coordinators:
            deadline_ns = coordinator.next_deadline_ns()
            if deadline_ns is not None and deadline_ns <= now_ns:
                coordinator.handle_deadline(now_ns=now_ns)
        self._launch_requests(now_ns)

    def next_due_ns(self) -> int:
        """Return when ``step`` is to be called at the latest; a time already past means now."""
        dues = [] if self.has_ended else [min(self._world_ns + _TICK_NS, self._end_ns)]
        if self._dues:
            dues.append(self._dues[0][0])
        if self.has_ended and self._offered:
            dues.append(self._sensed_ns + _TICK_NS)
        if not self._coverage.is_trivial:
            dues.append(self._associate_at_ns)
        deadlines = [coordinator.next_deadline_ns() for coordinator in self.coordinators]
        dues += [due for due in (self._air.next_arrival_ns(), self._steering.next_due_ns(), *deadlines) if due is not None]
        return min(dues, default=_NEVER_NS)

    def _make_backpack(self, node: NodeId, config: SwarmConfig) -> Backpack:
        odometer, clock = self._odometer, self._clocks[node]
        return Backpack(
            node=node, boot=config.boot, eui64=_EUI64_BASE + node, seed=config.seed, config=config.backpack,
            now_ms=self._clocks[node].read_ms(0), sense_neighbours=lambda: self._surroundings.neighbours(node, silent=self.silenced),
            read_path_mm=None if odometer is None else lambda at_ms: odometer.read_mm(node, clock.elapsed_ns(at_ms)),
        )  # fmt: skip

    def _make_sensing(self, config: SensingConfig | None, *, places: Sequence[Place]) -> LiveSensing | None:
        if config is None:
            return None
        arena = self._world.arena
        if arena is None:
            raise ParameterError(name="sensing", got="beacon", wanted="ideal, where it is not known where the biobots are")
        if len(places) > 1 and self._shares_air:
            raise ParameterError(name="csma", got=True, wanted="false with several coordinators: the shared medium knows one of them")
        return LiveSensing(
            self._nodes, clocks=self._clocks, arena=arena, config=config, places=self._surroundings.places(),
            coordinator_place=places[0],
        )  # fmt: skip

    def _end_world(self, now_ns: int) -> None:
        self.has_ended = True
        self._steering.end()
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
        if self._odometer is not None:
            self._odometer.advance(self._surroundings.places(), at_ns=self._world_ns)
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
                case BackpackSilenced(id=one, reason=reason):
                    self._silence(NodeId(one), reason.value)
        self._sense(self._world_ns, now_ns=now_ns)

    def _sense(self, until_ns: int, *, now_ns: int) -> None:
        """Let beacons, and the reports that share their channel, go on to ``until_ns``."""
        if self._sensing is None:
            return
        self._sensed_ns = until_ns
        heard, carried = self._sensing.advance(until_ns, places=self._surroundings.places())
        for one in carried:
            node, received = self._offered.pop(one.ticket)
            if one.is_carried:
                self._air.send_up(received, node=node, now_ns=one.at_ns)
        if self.has_ended:
            return  # beacons that were still under way find no logger
        for beacon in heard:
            if beacon.node in self.silenced:
                continue
            clock = self._clocks[beacon.node]
            self._backpacks[beacon.node].hear_beacon(
                beacon.peer, at_ms=clock.read_ms(beacon.at_ns), rssi_dbm=beacon.rssi_dbm, now_ms=clock.read_ms(now_ns)
            )
        for node, backpack in self._backpacks.items():
            if node in self.silenced:
                continue
            clock = self._clocks[node]
            if backpack.sense_until(clock.read_ms(until_ns), now_ms=clock.read_ms(now_ns)):
                self._plan(node)
        for node in {beacon.node for beacon in heard}:
            self._plan(node)

    def _meet(self, id1: int, id2: int, *, start_ns: int) -> None:
        rssi_dbm = self._surroundings.contact_rssi_dbm(NodeId(id1), NodeId(id2))
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
                case UplinkArrival(coordinator=coordinator, node=node, received=received):
                    self.coordinators[coordinator].take_from_radio(received, eui64=_EUI64_BASE + node, now_ns=now_ns)
                case DownlinkArrival(node=node) if node in self.silenced:
                    pass
                case DownlinkArrival(node=node, payload=payload, is_broadcast=is_broadcast):
                    now_ms = self._clocks[node].read_ms(now_ns)
                    self._apply(node, self._backpacks[node].receive(payload, now_ms=now_ms, is_broadcast=is_broadcast), now_ns=now_ns)
                case SendingDone(coordinator=coordinator, handle=handle, status=status):
                    self.coordinators[coordinator].confirm(handle, status, now_ns=now_ns)

    def _apply(self, node: NodeId, effects: Sequence[Effect], *, now_ns: int) -> None:
        for effect in effects:
            match effect:
                case Transmission():
                    self._transmit(node, effect, now_ns=now_ns)
                case Acknowledged(sequence=sequence, message=EncounterBatch() | EncounterBatchWithPaths()):
                    self.reports.acknowledge(node=node, sequence=sequence)
                case Acknowledged():
                    pass
                case Actuation():
                    self._actuate(node, effect, now_ns=now_ns)
                case BeaconsChanged(period_ms=period_ms, exit_dbm=exit_dbm) if self._sensing is not None:
                    self._sensing.change_beacons(node, period_ms=period_ms, exit_dbm=exit_dbm, now_ns=now_ns)
        self._plan(node)

    def _actuate(self, node: NodeId, actuation: Actuation, *, now_ns: int) -> None:
        if not self.has_ended:
            self._advance_world(now_ns)
            self._steering.actuate(node, actuation, now_ns=now_ns)

    def _react(self, now_ns: int) -> None:
        due_ns = self._steering.next_due_ns()
        if due_ns is not None and due_ns <= now_ns:
            self._advance_world(now_ns)
            self._steering.react(now_ns)

    def _silence(self, node: NodeId, reason: str) -> None:
        if node not in self.silenced:
            backpack = self._backpacks[node]
            self.n_lost += backpack.n_buffered + backpack.n_open
            self.silenced[node] = reason
            self._steering.silence(node)
            self._air.silence(node)
            if self._sensing is not None:
                self._sensing.switch_off(node)
            self._plan(node)

    def _associate(self, now_ns: int) -> None:
        """Let each backpack belong to the coordinator that suits it best by now."""
        self._associate_at_ns = now_ns + _ASSOCIATION_NS
        for node in self._nodes:
            home = self._air.home_of(node)
            if node in self.silenced or (home is not None and self._coverage.is_trivial):
                continue
            choice = self._coverage.choose(self._surroundings.place(node), home=home)
            if choice == home:
                continue
            if choice is None:
                self._air.leave(node)
                continue
            self._air.join(node, choice)
            self.coordinators[choice].node_joined(self._air.address_of(node), eui64=_EUI64_BASE + node, now_ns=now_ns)
            if now_ns > 0:
                self.n_rejoined += 1
                self._backpacks[node].rejoin(now_ms=self._clocks[node].read_ms(now_ns))
                self._plan(node)

    def _transmit(self, node: NodeId, sent: Transmission, *, now_ns: int) -> None:
        if sent.is_first and isinstance(sent.message, EncounterBatch | EncounterBatchWithPaths):
            self.reports.add(sent.message, node=node, boot=self._backpacks[node].boot, sequence=sent.sequence, clock=self._clocks[node])
        home, place = self._air.home_of(node), self._surroundings.place(node)
        if home is None or not self._coverage.covers(home, place):
            return  # out of hearing; what is kept will be repeated
        distance = self._coverage.distance(place, home)
        rssi_dbm = self._radio.rssi_dbm(0.0 if math.isnan(distance) else distance)
        received = RadioReceived(source=self._air.address_of(node), rssi_dbm=rssi_dbm, lqi=lqi(rssi_dbm), payload=sent.payload)
        if self._sensing is None or not self._shares_air:
            self._air.send_up(received, node=node, now_ns=now_ns)
        else:
            ticket = self._sensing.offer(node, n_octets=len(sent.payload), now_ns=now_ns)
            self._offered[ticket] = (node, received)

    def _launch_requests(self, now_ns: int) -> None:
        for index, coordinator in enumerate(self.coordinators):
            while coordinator.requests:
                request = coordinator.requests.popleft()
                if self._sensing is not None and self._shares_air:
                    self._sensing.occupy(n_octets=len(request.payload), now_ns=now_ns)
                self._air.send_down(request, coordinator=index, now_ns=now_ns)

    def _plan(self, node: NodeId) -> None:
        due_ms = None if node in self.silenced else self._backpacks[node].next_due_ms()
        due_ns = None if due_ms is None else self._clocks[node].elapsed_ns(due_ms)
        if self._due_ns.get(node, -1) != due_ns:
            self._due_ns[node] = due_ns
            if due_ns is not None:
                heapq.heappush(self._dues, (due_ns, node))


def _middle(world: Habitat) -> Place:
    return (0.0, 0.0) if world.arena is None else spread_places(world.arena.polygon.bounds, 1)[0]
