"""What backpacks with drifting clocks say to a gateway through queues, and the records that it makes of that.

The gateway's own ``ClockBook`` and ``EncounterMerger`` are given the messages in the order in which they arrive. Nothing is left to
real time: one seed, one table.
"""

import heapq
import random
from collections.abc import Sequence
from dataclasses import dataclass

from firmware_protocol.contract.records import EncounterRecord
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm
from gateway.clocks import ClockBook
from gateway.encounters import EncounterMerger, SideReport, margin_of
from gateway.issuer import RecordIssuer
from simulator.clock import DriftingClock
from simulator.radios.sensing import Observation

_ZERO_NS = 1_000 * NS_PER_S
"""What the gateway's clock shows when the run begins."""

_WINDOW_NS = 300 * NS_PER_S
_STATUS_NS, _SYNC_NS, _URGENT_NS = 10 * NS_PER_S, 20 * NS_PER_S, NS_PER_S // 4
_RETRY_NS = NS_PER_S
_BUSY_SHARE, _BUSY_NS = 0.2, 400 * NS_PER_MS
_STALL_SHARE, _STALL_NS = 0.005, 4 * NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficConfig:
    """How backpacks and the way to the gateway are.

    Parameters
    ----------
    period_s
        Between beacons [s].
    drift_ppm
        Clocks run too fast or too slow by up to this, uniformly.
    restart_every_s
        A backpack restarts after exponential times of this mean [s]; what it had sensed and not finished is lost then.
    silent
        Whose encounters never come.
    """

    seed: int
    period_s: float
    until_s: float
    drift_ppm: float = 40.0
    restart_every_s: float = 900.0
    silent: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class Made:
    """The newest revision of every record that still counts, on the run's time, and how good the clocks were.

    Parameters
    ----------
    clock_errors_ns, clock_bounds_ns
        Of each report: how wrong its start was dated, and how wrong it was said to be at most [ns].
    rate_errors
        What is left unknown of each clock's rate in the end.
    loss
        Share of lost beacons as the gateway estimates it in the end.
    contradictions
        Revisions whose start is further from the one before than the bound of that allows.
    """

    records: tuple[EncounterRecord, ...]
    clock_errors_ns: tuple[int, ...]
    clock_bounds_ns: tuple[int, ...]
    rate_errors: tuple[float, ...]
    loss: float
    contradictions: int


@dataclass(frozen=True, slots=True)
class _Life:
    boot: BootId
    begun_ns: int
    clock: DriftingClock

    def tick(self, at_ns: int) -> Milliseconds:
        return self.clock.read_ms(at_ns - self.begun_ns)


def make_records(observations: Sequence[Observation], *, nodes: Sequence[int], config: TrafficConfig) -> Made:
    """Report what was observed, over busy queues and with restarts, and put it together as a gateway does."""
    return _Traffic(nodes, config).run(observations)


class _Traffic:
    def __init__(self, nodes: Sequence[int], config: TrafficConfig) -> None:
        self._config = config
        self._rng = random.Random(config.seed)
        self._book = ClockBook(window_ns=_WINDOW_NS)
        issuer = RecordIssuer(gateway="study", journal="study", boot=BootId(1), wall_anchor_ns=Nanoseconds(0))
        self._merger = EncounterMerger(issuer=issuer)
        self._lives = {node: self._draw_lives() for node in nodes}
        self._arrivals: list[tuple[int, int, str, int, tuple[int, ...]]] = []
        self._n = 0
        self._heard_boots: dict[int, set[BootId]] = {node: set() for node in nodes}
        self._errors: list[int] = []
        self._bounds: list[int] = []
        self._records: dict[object, EncounterRecord] = {}
        self._contradictions = 0

    def run(self, observations: Sequence[Observation]) -> Made:
        until_ns = int(self._config.until_s * NS_PER_S)
        for node in self._lives:
            for at_ns in range(self._rng.randrange(_STATUS_NS), until_ns, _STATUS_NS):
                self._send("status", node, sent_ns=at_ns)
        for one in observations:
            if one.node not in self._config.silent:
                closed_ns = one.end_ns + int(1.15 * self._config.period_s * NS_PER_S)
                self._send("report", one.node, one.peer, one.start_ns, one.end_ns, sent_ns=closed_ns + self._rng.randrange(NS_PER_S))
        while self._arrivals:
            at_ns, _, kind, node, facts = heapq.heappop(self._arrivals)
            self._take(kind, node, facts, at_ns=at_ns, until_ns=until_ns)
        clocks = [self._book.observe(node=NodeId(n), boot=x[-1].boot, sent_ms=x[-1].tick(until_ns), received_ns=until_ns + _ZERO_NS)
                  for n, x in self._lives.items()]  # fmt: skip
        return Made(
            records=tuple(one for one in self._records.values() if not one.is_void),
            clock_errors_ns=tuple(self._errors),
            clock_bounds_ns=tuple(self._bounds),
            rate_errors=tuple(clock.fitted.rate_error for clock in clocks if clock.fitted is not None),
            loss=self._merger.loss.share,
            contradictions=self._contradictions,
        )

    def _draw_lives(self) -> list[_Life]:
        starts: list[int] = []
        at_s = self._rng.expovariate(1 / self._config.restart_every_s)
        while at_s < self._config.until_s:
            starts.append(int(at_s * NS_PER_S))
            at_s += self._rng.expovariate(1 / self._config.restart_every_s)
        drift_ppb = round(self._rng.uniform(-1.0, 1.0) * self._config.drift_ppm * 1000)
        first = _Life(BootId(1), 0, DriftingClock(start_ms=self._rng.randrange(3_600_000), drift_ppb=drift_ppb))
        return [first, *(_Life(BootId(2 + k), at, DriftingClock(start_ms=0, drift_ppb=drift_ppb)) for k, at in enumerate(starts))]

    def _life(self, node: int, at_ns: int) -> _Life:
        return [life for life in self._lives[node] if life.begun_ns <= at_ns][-1]

    def _delay_ns(self) -> int:
        """Draw how long a payload is under way: some milliseconds, sometimes behind a queue, rarely behind a stalled dongle."""
        delay_ns = 5 * NS_PER_MS + int(self._rng.expovariate(1 / 3) * NS_PER_MS)
        draw = self._rng.random()
        if draw < _STALL_SHARE:
            return delay_ns + self._rng.randrange(_STALL_NS)
        return delay_ns + (self._rng.randrange(_BUSY_NS) if draw < _STALL_SHARE + _BUSY_SHARE else 0)

    def _push(self, at_ns: int, kind: str, node: int, *facts: int) -> None:
        self._n += 1
        heapq.heappush(self._arrivals, (at_ns, self._n, kind, node, facts))

    def _send(self, kind: str, node: int, *facts: int, sent_ns: int) -> None:
        self._push(sent_ns + self._delay_ns(), kind, node, sent_ns, *facts)

    def _take(self, kind: str, node: int, facts: tuple[int, ...], *, at_ns: int, until_ns: int) -> None:
        if kind == "sync":
            boot = self._life(node, at_ns).boot
            is_settled = self._book.is_settled(node=NodeId(node), boot=boot)
            token = self._book.begin_exchange(node=NodeId(node), now_ns=at_ns + _ZERO_NS)
            arrived_ns = at_ns + self._delay_ns()
            self._send("reply", node, token, arrived_ns, sent_ns=arrived_ns)
            if at_ns < until_ns and facts[0] == max(self._heard_boots[node]):
                self._push(at_ns + (_SYNC_NS if is_settled else _URGENT_NS), "sync", node, facts[0])
            return
        sent_ns = facts[0]
        life = self._life(node, sent_ns)
        if life.boot not in self._heard_boots[node]:
            self._heard_boots[node].add(life.boot)
            self._push(at_ns, "sync", node, life.boot)
        clock = self._book.observe(node=NodeId(node), boot=life.boot, sent_ms=life.tick(sent_ns), received_ns=at_ns + _ZERO_NS)
        if kind == "reply":
            self._book.end_exchange(node=NodeId(node), boot=life.boot, token=facts[1], arrived_ms=life.tick(facts[2]))
        elif kind == "report":
            peer, start_ns, end_ns = facts[1:]
            if self._life(node, start_ns) is not life:
                return  # it was in the memory of a backpack that has restarted
            if not clock.is_believed(now_ns=at_ns + _ZERO_NS):
                self._send(kind, node, *facts[1:], sent_ns=sent_ns + _RETRY_NS)
                return
            self._report(node, peer, clock.read_span(life.tick(start_ns), life.tick(end_ns)), start_ns=start_ns)

    def _report(self, node: int, peer: int, read: tuple[int, int, int], *, start_ns: int) -> None:
        t_start_ns, t_end_ns, error_ns = read
        self._errors.append(abs(t_start_ns - _ZERO_NS - start_ns))
        self._bounds.append(error_ns)
        period_ms = round(self._config.period_s * 1000)
        guesses = self._merger.loss.now
        n_bridged = guesses.n_bridged_alone if peer in self._config.silent else guesses.n_bridged
        margin_ns = margin_of(beacon_period_ms=period_ms, error_ns=error_ns, n_bridged=n_bridged)
        report = SideReport(
            node=NodeId(node), peer=NodeId(peer), t_start_ns=Nanoseconds(t_start_ns - _ZERO_NS),
            t_end_ns=Nanoseconds(t_end_ns - _ZERO_NS), error_ns=Nanoseconds(error_ns), rssi_dbm=RssiDbm(-60), is_ongoing=False,
            margin_ns=margin_ns, period_ns=period_ms * NS_PER_MS,
        )  # fmt: skip
        for record in self._merger.merge(report):
            before = self._records.get(record.identity)
            if before is not None and not record.is_void and record.t_start_ns > before.t_start_ns + before.error_ns:
                self._contradictions += 1
            self._records[record.identity] = record
