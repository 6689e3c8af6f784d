"""Beacons in a world that goes on: who sends when, who hears it, and the reports that share the channel with them. No clock.

Time is moved in steps. Between two steps everybody is taken to move straight: 50 ms of a walk, as a swarm has it. What is heard is told
after the step in which it ended.
"""

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from firmware_protocol.units import NodeId
from simulator.arenas.arena import Arena
from simulator.clock import BackpackClock
from simulator.legs import Floats
from simulator.radios.beacons import BEACON_OCTETS, BeaconSchedule
from simulator.radios.bursts import BurstLoss
from simulator.radios.carrier_sense import CarrierSense
from simulator.radios.channel import Channel
from simulator.radios.medium import Medium, Sending
from simulator.radios.reception import Fate, Packets, Receiver
from simulator.radios.sensing import SensingConfig

COORDINATOR = 0
"""The base station's identity on the shared channel; no biobot has it."""

REPORT_OVERHEAD_OCTETS = 27
"""What ZigBee puts around a payload: 11 octets of MAC, 8 of network and 8 of application support, all without options."""

_LONGEST_PACKET_NS = 5_000_000  # 133 octets take 4.3 ms
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """``node`` heard ``peer``'s beacon at ``at_ns``."""

    node: NodeId
    peer: NodeId
    at_ns: int
    rssi_dbm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Carried:
    """What became of a report offered as ``ticket``: on the coordinator's side at ``at_ns``, or lost to others' packets."""

    ticket: int
    at_ns: int
    is_carried: bool


class LiveSensing:
    """See the module. All instants are nanoseconds since the run began.

    Parameters
    ----------
    clocks
        Of each node: beacons follow them.
    places
        Where all nodes are at first, shape (n, 2) [m], in the order of ``nodes``.
    coordinator_place
        Where reports are received [m].
    """

    def __init__(
        self, nodes: Sequence[NodeId], *, clocks: Mapping[NodeId, BackpackClock], arena: Arena, config: SensingConfig, places: Floats,
        coordinator_place: tuple[float, float],
    ) -> None:  # fmt: skip
        ids = [*nodes, COORDINATOR]
        self._nodes = tuple(nodes)
        self._row = {one: row for row, one in enumerate(ids)}
        self._clocks = clocks
        self._channel = Channel(config.radio, seed=config.seed, ids=ids, arena=arena)
        self._exit_dbm = config.proximity(per_s=1000).exit_dbm
        self._reach = self._channel.reach(self._exit_dbm)
        radio = config.radio
        bursts = BurstLoss(seed=config.seed, good_s=radio.burst_good_s, bad_s=radio.burst_bad_s) if radio.burst_bad_s else None
        self._receiver = Receiver(seed=config.seed, channel=self._channel, n_octets=BEACON_OCTETS, bursts=bursts)
        carrier_sense = CarrierSense(self._channel, ids=ids, place=self._place)
        self._medium = Medium(seed=config.seed, hears=carrier_sense if radio.hidden_nodes else None, is_shared=radio.csma)
        schedule = BeaconSchedule(seed=config.seed, period_ns=round(config.period_s * _NS_PER_S))
        self._schedules = dict.fromkeys(self._nodes, schedule)
        self._dues: list[tuple[int, int, int]] = []
        self._is_off: set[NodeId] = set()
        self._beacons: set[int] = set()
        self._reports: set[int] = set()
        self._recent: list[Sending] = []
        self._coordinator_place = coordinator_place
        self._now_ns = 0
        self._places = self._with_coordinator(places)
        self.n_sent = 0
        self.n_not_sent = 0
        self.airtime_ns = 0
        for node in nodes:
            self._plan_beacon(node, schedule.number_at(clocks[node].read_ms(0)))

    def offer(self, node: NodeId, *, n_octets: int, now_ns: int) -> int:
        """Let a report of ``n_octets`` of payload try for the channel; return its ticket."""
        ticket = self._medium.request(node, at_ns=now_ns, n_octets=n_octets + REPORT_OVERHEAD_OCTETS)
        self._reports.add(ticket)
        return ticket

    def occupy(self, *, n_octets: int, now_ns: int) -> None:
        """Let the coordinator's radio send ``n_octets`` of payload: it takes time on the channel; what comes of it is not decided here."""
        self._medium.request(COORDINATOR, at_ns=now_ns, n_octets=n_octets + REPORT_OVERHEAD_OCTETS)

    def silence(self) -> None:
        """Plan no more beacons."""
        self._dues.clear()

    def switch_off(self, node: NodeId) -> None:
        """Let a backpack send and hear no more beacons."""
        self._is_off.add(node)
        self._dues = [due for due in self._dues if due[1] != node]
        heapq.heapify(self._dues)

    def change_beacons(self, node: NodeId, *, period_ms: int, exit_dbm: float, now_ns: int) -> None:
        """Let a backpack send a beacon every ``period_ms`` of its clock from now on, and tell it of all that are at least so strong."""
        if exit_dbm < self._exit_dbm:
            self._exit_dbm = exit_dbm
            self._reach = self._channel.reach(exit_dbm)
        period_ns = period_ms * 1_000_000
        if node in self._is_off or period_ns == self._schedules[node].period_ns:
            return
        self._schedules[node] = replace(self._schedules[node], period_ns=period_ns)
        n_planned = len(self._dues)
        self._dues = [due for due in self._dues if due[1] != node]
        heapq.heapify(self._dues)
        if len(self._dues) < n_planned:  # none is planned any more once beacons are silenced
            now_ms = self._clocks[node].read_ms(now_ns)
            number = self._schedules[node].number_at(now_ms)
            is_begun = number > 0 and self._schedules[node].due_ms(node, number - 1) >= now_ms
            self._plan_beacon(node, number - 1 if is_begun else number)

    def advance(self, until_ns: int, *, places: Floats) -> tuple[list[Heard], list[Carried]]:
        """Move to ``until_ns``, where everybody is then at ``places`` (shape (n, 2) [m]); return what was heard, in order of time."""
        while self._dues and self._dues[0][0] <= until_ns:
            due_ns, node, number = heapq.heappop(self._dues)
            self._beacons.add(self._medium.request(node, at_ns=due_ns, n_octets=BEACON_OCTETS))
            self._plan_beacon(NodeId(node), number + 1)
        before, self._places = self._places, self._with_coordinator(places)
        ended = self._medium.run_until(until_ns)
        self.n_sent += sum(one.is_sent for one in ended)
        self.n_not_sent += sum(not one.is_sent for one in ended)
        self.airtime_ns += sum(one.end_ns - one.start_ns for one in ended)
        carried = [
            Carried(ticket=one.ticket, at_ns=one.end_ns, is_carried=False) for one in ended if not one.is_sent and self._is_report(one)
        ]
        on_air = sorted([*self._recent, *(one for one in ended if one.is_sent), *self._medium.under_way()], key=lambda one: one.start_ns)
        heard, more = self._receive(ended, on_air, before=before, until_ns=until_ns)
        for one in ended:
            self._beacons.discard(one.ticket)
            self._reports.discard(one.ticket)
        self._recent = [one for one in on_air if until_ns - _LONGEST_PACKET_NS < one.end_ns <= until_ns]
        self._now_ns = until_ns
        return heard, carried + more

    def _receive(
        self, ended: Sequence[Sending], on_air: Sequence[Sending], *, before: Floats, until_ns: int
    ) -> tuple[list[Heard], list[Carried]]:
        """Decide who heard what has just ended, among all that was on the air."""
        over = {one.ticket for one in ended}
        subject = [k for k, one in enumerate(on_air) if one.ticket in over and (one.ticket in self._beacons or one.ticket in self._reports)]
        if not subject:
            return [], []
        rows = np.array([(self._row[one.sender], one.number, one.start_ns, one.end_ns) for one in on_air], dtype=np.int64)
        packets = Packets(sender=rows[:, 0], number=rows[:, 1], start_ns=rows[:, 2], end_ns=rows[:, 3])
        at = np.array(subject)
        share = np.clip((packets.start_ns[at] - self._now_ns) / max(1, until_ns - self._now_ns), 0.0, 1.0)
        place = before + (self._places - before) * share[:, None, None]
        offset = place - place[np.arange(at.size), packets.sender[at]][:, None, :]
        is_near = np.sqrt((offset**2).sum(axis=2)) <= self._reach
        # Beacons are for backpacks, reports for the coordinator.
        is_report = np.array([on_air[k].ticket in self._reports for k in subject])
        is_near[:, -1] = False
        is_near[is_report] = False
        is_near[is_report, -1] = True
        is_near[np.arange(at.size), packets.sender[at]] = False
        packet, receiver = np.nonzero(is_near)
        fate, rssi_dbm, is_spoiled = self._receiver.decide(packets, subject=at, place=place, packet=packet, receiver=receiver)
        heard: list[Heard] = []
        carried: list[Carried] = []
        columns = (packet.tolist(), receiver.tolist(), fate.tolist(), rssi_dbm.tolist(), is_spoiled.tolist())
        for k, to, what, strength, spoiled in zip(*columns, strict=True):
            one = on_air[subject[k]]
            if self._is_report(one):
                carried.append(
                    Carried(ticket=one.ticket, at_ns=one.end_ns, is_carried=not spoiled)
                )  # what range and chance do to it is Air's to say
            elif self._nodes[to] not in self._is_off and what == Fate.HEARD and strength >= self._exit_dbm:
                heard.append(Heard(node=self._nodes[to], peer=NodeId(one.sender), at_ns=one.start_ns, rssi_dbm=strength))
        return heard, carried

    def _is_report(self, one: Sending) -> bool:
        return one.ticket in self._reports

    def _plan_beacon(self, node: NodeId, number: int) -> None:
        due_ns = self._clocks[node].elapsed_ns(self._schedules[node].due_ms(node, number))
        heapq.heappush(self._dues, (due_ns, node, number))

    def _with_coordinator(self, places: Floats) -> Floats:
        return np.vstack([places, self._coordinator_place])

    def _place(self, row: int, _at_ns: int) -> tuple[float, float]:
        """Return where a radio is at the end of the step: near enough for carrier sense."""
        x, y = self._places[row].tolist()
        return x, y
