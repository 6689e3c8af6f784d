"""Which pulse trains each biobot has got, or may yet get, and whether one more is within the limits. Pure.

The law holds at the electrode, not at the desk: of a frame that was given to a dongle it is known only that its train begins before some
latest instant, until an answer says more. So the pause is counted from the latest end that the last train can have, and a train counts in
the window as long as any window that holds the new one may hold a part of it. docs/stimulation.md has the argument.

The limits, from the table in the configuration: a pause between two trains, and in any window a number of trains and a time of
stimulation. The envelope of 2 s, 30 trains and 9 s in 60 s is that of published gates for living insects. What a backpack announces may
make the pause longer and the stimulation in a minute less.
"""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, field

from firmware_protocol.contract.commands import Refusal
from firmware_protocol.messages import Limits
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.stimulation.verdict import Refused

_MINUTE_NS = 60 * NS_PER_S

_KEPT_WINDOWS = 4
"""Of a biobot at most so many times ``max_trains`` trains are kept, the latest: as many as that leave no room for another anyway."""


@dataclass(slots=True, kw_only=True, eq=False)
class Train:
    """A train that was given, or may be: it begins no later than ``latest_ns`` (monotonic)."""

    latest_ns: int
    duration_ms: int

    @property
    def end_ns(self) -> int:
        """The latest instant at which it can end."""
        return self.latest_ns + self.duration_ms * NS_PER_MS


@dataclass(slots=True, kw_only=True)
class TrainLedger:
    """Keeps the trains of every biobot for as long as they count."""

    limits: StimulationTable
    unknown: Train | None = None
    """One that each biobot may have got without its being on record: the gateway before this one was killed."""
    _trains: dict[NodeId, list[Train]] = field(default_factory=dict)

    def refusal(self, node: NodeId, *, train_ms: int, now_ns: int, announced: Limits | None = None) -> Refused | None:
        """Return why a train that is given at ``now_ns`` or later would exceed a limit, or None where it is within all of them.

        Only its earliest instant matters: given later, it is further from those before it, and fewer of them are in a window with it.
        """
        if train_ms == 0:
            return None
        limits = self.limits
        trains = self._counting(node, now_ns=now_ns)
        if (refused := self._gap_refusal(trains, now_ns=now_ns, announced=announced)) is not None:
            return refused
        since_ns = now_ns - int(limits.window_s * NS_PER_S)
        recent = [train for train in trains if train.end_ns > since_ns]
        if len(recent) >= limits.max_trains:
            reason = f"{len(recent)} trains in the last {limits.window_s:g} s, the limit is {limits.max_trains}; let the animal rest"
            return Refused(refusal=Refusal.TRAINS, reason=reason)
        on_ms = sum(train.duration_ms for train in recent) + train_ms
        if on_ms > limits.max_on_s * 1000:
            reason = f"{on_ms / 1000:g} s of stimulation in {limits.window_s:g} s, the limit is {limits.max_on_s:g} s; let the animal rest"
            return Refused(refusal=Refusal.ON_TIME, reason=reason)
        if announced is not None:
            minute_ms = sum(train.duration_ms for train in trains if train.end_ns > now_ns - _MINUTE_NS) + train_ms
            if minute_ms > announced.max_on_ms_per_minute:
                limit = f"the backpack's limit is {announced.max_on_ms_per_minute / 1000:g} s, the configuration's {limits.max_on_s:g} s"
                reason = f"{minute_ms / 1000:g} s of stimulation in a minute, {limit}; let the animal rest"
                return Refused(refusal=Refusal.ON_TIME, reason=reason)
        return None

    def ready_ns(self, node: NodeId, *, train_ms: int, now_ns: int, announced: Limits | None = None) -> int | None:
        """Return the first instant from now on at which a train would be admitted; None: never, under these limits."""
        trains = self._counting(node, now_ns=now_ns)
        window_ns = int(self.limits.window_s * NS_PER_S)
        gap_ns = int(self._gap_s(announced) * NS_PER_S)
        # It is admitted for good as soon as it is once, and only at one of these does anything change.
        instants = sorted({now_ns, *(at for one in trains for at in self._changes(one, window_ns=window_ns, gap_ns=gap_ns) if at > now_ns)})

        def is_admitted(at_ns: int) -> bool:
            return self.refusal(node, train_ms=train_ms, now_ns=at_ns, announced=announced) is None

        at = bisect_left(instants, True, key=is_admitted)  # noqa: FBT003  # what is looked for
        return instants[at] if at < len(instants) else None

    def reserve(self, node: NodeId, *, train_ms: int, latest_ns: int, now_ns: int) -> Train:
        """Count a train that begins at ``latest_ns`` at the latest; those that count no longer are forgotten."""
        train = Train(latest_ns=latest_ns, duration_ms=train_ms)
        trains = self._trains[node] = [*self._counting_own(node, now_ns=now_ns), train]
        if len(trains) > _KEPT_WINDOWS * self.limits.max_trains:
            trains.remove(min(trains, key=lambda one: one.end_ns))
        return train

    def take_back(self, node: NodeId, train: Train) -> None:
        """Count a train no longer: it was not given, and never will be."""
        trains = self._trains.get(node, [])
        if train in trains:
            trains.remove(train)

    def in_window(self, node: NodeId, *, now_ns: int) -> tuple[int, int]:
        """Return how many trains count in the window that ends now, and their length [ms]."""
        since_ns = now_ns - int(self.limits.window_s * NS_PER_S)
        recent = [train for train in self._counting_own(node, now_ns=now_ns) if train.end_ns > since_ns]
        return len(recent), sum(train.duration_ms for train in recent)

    def _gap_refusal(self, trains: list[Train], *, now_ns: int, announced: Limits | None) -> Refused | None:
        last = max(trains, key=lambda train: train.end_ns, default=None)
        gap_s = self._gap_s(announced)
        if last is None or now_ns - last.end_ns >= gap_s * NS_PER_S:
            return None
        wait_s = gap_s + (last.end_ns - now_ns) / NS_PER_S
        whose = "" if gap_s == self.limits.min_gap_s else f" (the backpack says so; the configuration {self.limits.min_gap_s:g} s)"
        why = ""
        if last is self.unknown:
            why = "; the gateway was not stopped in good order before, and one may have been given since that is not on record"
        elif last.latest_ns > now_ns:
            why = "; the last one is not answered for yet, and may still come"
        reason = f"the pause after the last train must be {gap_s:g} s at least{whose}{why}; wait {wait_s:.1f} s"
        return Refused(refusal=Refusal.GAP, reason=reason)

    def _gap_s(self, announced: Limits | None) -> float:
        return self.limits.min_gap_s if announced is None else max(self.limits.min_gap_s, announced.min_gap_ms / 1000)

    def _counting(self, node: NodeId, *, now_ns: int) -> list[Train]:
        own = self._counting_own(node, now_ns=now_ns)
        return own if self.unknown is None or self._is_over(self.unknown, now_ns=now_ns) else [*own, self.unknown]

    def _counting_own(self, node: NodeId, *, now_ns: int) -> list[Train]:
        return [train for train in self._trains.get(node, []) if not self._is_over(train, now_ns=now_ns)]

    def _is_over(self, train: Train, *, now_ns: int) -> bool:
        """Whether a train can matter no more; a backpack's minute and its pause of up to 65.5 s are no longer than this."""
        longest_ns = max(int(max(self.limits.window_s, self.limits.min_gap_s) * NS_PER_S), _LONGEST_ANNOUNCED_NS)
        return train.end_ns < now_ns - longest_ns

    @staticmethod
    def _changes(train: Train, *, window_ns: int, gap_ns: int) -> Iterable[int]:
        return (train.end_ns + gap_ns, train.end_ns + window_ns, train.end_ns + _MINUTE_NS)


_LONGEST_ANNOUNCED_NS = 0xFFFF * NS_PER_MS
"""The longest pause that a backpack can announce (WIRE_FORMAT.md §5.8)."""
