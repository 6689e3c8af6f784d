"""How much each biobot was stimulated of late, and whether one more train is within the limits. Pure.

The limits, from the table in the configuration: a pause between two trains, and in any window a number of trains and a time of
stimulation. The envelope of 2 s, 30 trains and 9 s in 60 s is that of published gates for living insects. What a backpack announces may
make the pause longer and the stimulation in a minute less.
"""

from collections import deque
from dataclasses import dataclass, field

from firmware_protocol.messages import Limits
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from gateway.config import StimulationTable

_MINUTE_NS = 60 * NS_PER_S


@dataclass(slots=True, kw_only=True)
class TrainLedger:
    """Keeps the admitted trains of every biobot for as long as they count."""

    limits: StimulationTable
    _trains: dict[NodeId, deque[tuple[int, int]]] = field(default_factory=dict)

    def refusal(self, node: NodeId, *, train_ms: int, now_ns: int, announced: Limits | None = None) -> str | None:
        """Return why one more train would exceed a limit of the table or of the backpack, or None where it is within all of them."""
        limits = self.limits
        trains = self._trains.get(node, deque())
        window_ns = int(limits.window_s * NS_PER_S)
        recent = [(at_ns, ms) for at_ns, ms in trains if at_ns > now_ns - window_ns]
        if recent:
            since_ns = now_ns - max(at_ns + ms * NS_PER_MS for at_ns, ms in recent)
            gap_s = limits.min_gap_s if announced is None else max(limits.min_gap_s, announced.min_gap_ms / 1000)
            if since_ns < gap_s * NS_PER_S:
                wait_s = gap_s - since_ns / NS_PER_S
                whose = "" if gap_s == limits.min_gap_s else f" (the backpack says so; the configuration {limits.min_gap_s:g} s)"
                return f"the pause after the last train must be {gap_s:g} s at least{whose}; wait {wait_s:.1f} s"
        if len(recent) >= limits.max_trains:
            return f"{len(recent)} trains in the last {limits.window_s:g} s, the limit is {limits.max_trains}; let the animal rest"
        on_ms = sum(ms for _, ms in recent) + train_ms
        if on_ms > limits.max_on_s * 1000:
            return f"{on_ms / 1000:g} s of stimulation in {limits.window_s:g} s, the limit is {limits.max_on_s:g} s; let the animal rest"
        if announced is not None:
            minute_ms = sum(ms for at_ns, ms in recent if at_ns > now_ns - _MINUTE_NS) + train_ms
            if minute_ms > announced.max_on_ms_per_minute:
                limit = f"the backpack's limit is {announced.max_on_ms_per_minute / 1000:g} s, the configuration's {limits.max_on_s:g} s"
                return f"{minute_ms / 1000:g} s of stimulation in a minute, {limit}; let the animal rest"
        return None

    def admit(self, node: NodeId, *, train_ms: int, at_ns: int) -> None:
        """Count a train; those that count no longer are forgotten."""
        trains = self._trains.setdefault(node, deque())
        trains.append((at_ns, train_ms))
        while len(trains) > 1 and trains[0][0] < at_ns - int(self.limits.window_s * NS_PER_S):
            trains.popleft()
