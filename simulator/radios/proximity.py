"""A proximity logger, as a backpack's firmware runs it: beacons heard go in, encounters come out. No I/O, no clock.

An encounter is opened by beacons at least as strong as the enter threshold and kept by those at least as strong as the exit threshold.
A weaker beacon counts as none, as if it had been lost. An encounter lasts from the first of its beacons to the last: what was before
and after, a logger cannot know. Instants are whole numbers of one unit, whichever the caller keeps, on one clock that never goes back.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from simulator.errors import ParameterError

BRIDGED_PERIODS = 1.15
"""Gaps up to this many beacon periods are bridged when the reports of both sides are put together (Encounternet: 23 s at a pulse
every 20 s; Animal Biotelemetry 2015, s40317-015-0065-4). It is what gateways do."""

EXIT_PER_ENTER = 1.15
"""Without thresholds given, an encounter is kept as far as this many detection radii: own choice, 1.5 dB at an exponent of 2.4."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProximityConfig:
    """What a logger takes for near.

    Parameters
    ----------
    enter_dbm, exit_dbm
        Thresholds [dBm]; exit not above enter.
    gap
        An encounter ends when no beacon has kept it for longer than this [units of time].
    min_beacons
        So many beacons above the enter threshold, with no gap and none below it (but above exit) between them, open an encounter.
    """

    enter_dbm: float
    exit_dbm: float
    gap: int
    min_beacons: int = 1

    def __post_init__(self) -> None:
        if not self.exit_dbm <= self.enter_dbm:
            raise ParameterError(name="exit_dbm", got=self.exit_dbm, wanted=f"at most enter_dbm, {self.enter_dbm!r}")
        if self.gap < 1:
            raise ParameterError(name="gap", got=self.gap, wanted="at least one unit of time")
        if self.min_beacons < 1:
            raise ParameterError(name="min_beacons", got=self.min_beacons, wanted="at least 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """An encounter with ``peer`` has begun at ``start``; ``rssi_dbm`` is that of the beacon that opened it."""

    peer: int
    start: int
    rssi_dbm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Closed:
    """An encounter with ``peer`` went from ``start`` to ``end``, its first and last beacon; the strength is the mean of all of them."""

    peer: int
    start: int
    end: int
    mean_rssi_dbm: float
    n_beacons: int


@dataclass(slots=True, kw_only=True)
class _Contact:
    start: int
    last: int
    rssi_sum: float
    n_beacons: int
    is_open: bool = False


@dataclass(slots=True, kw_only=True)
class ProximityLogger:
    """See the module; one for each backpack."""

    config: ProximityConfig
    _contacts: dict[int, _Contact] = field(default_factory=dict)

    def hear(self, peer: int, *, at: int, rssi_dbm: float) -> list[Opened | Closed]:
        """Take a beacon of ``peer``."""
        if rssi_dbm < self.config.exit_dbm:
            return []
        changes: list[Opened | Closed] = []
        contact = self._contacts.get(peer)
        if contact is not None and at - contact.last > self.config.gap:
            changes += self._end(peer)
            contact = None
        is_strong = rssi_dbm >= self.config.enter_dbm
        if contact is None:
            if not is_strong:
                return changes
            contact = self._contacts[peer] = _Contact(start=at, last=at, rssi_sum=0.0, n_beacons=0)
        elif not contact.is_open and not is_strong:
            del self._contacts[peer]
            return changes
        contact.last = max(contact.last, at)
        contact.rssi_sum += rssi_dbm
        contact.n_beacons += 1
        if not contact.is_open and contact.n_beacons >= self.config.min_beacons:
            contact.is_open = True
            changes.append(Opened(peer=peer, start=contact.start, rssi_dbm=rssi_dbm))
        return changes

    def poll(self, *, now: int) -> list[Closed]:
        """Close what no beacon has kept for too long."""
        over = [peer for peer, contact in self._contacts.items() if now - contact.last > self.config.gap]
        return [closed for peer in over for closed in self._end(peer)]

    def close_all(self) -> list[Closed]:
        """End everything with its last beacon, as when the backpack is switched off."""
        return [closed for peer in list(self._contacts) for closed in self._end(peer)]

    def next_due(self) -> int | None:
        """Return when ``poll`` has something to do, or None."""
        return min((contact.last + self.config.gap + 1 for contact in self._contacts.values()), default=None)

    def _end(self, peer: int) -> list[Closed]:
        contact = self._contacts.pop(peer)
        if not contact.is_open:
            return []
        mean = contact.rssi_sum / contact.n_beacons
        return [Closed(peer=peer, start=contact.start, end=contact.last, mean_rssi_dbm=mean, n_beacons=contact.n_beacons)]


def unite(intervals: Iterable[tuple[int, int]], *, bridge: int) -> list[tuple[int, int]]:
    """Join intervals whose gap is at most ``bridge``: both sides' reports of one pair become its encounters, in order of time."""
    united: list[tuple[int, int]] = []
    for start, end in sorted(intervals):
        if united and start - united[-1][1] <= bridge:
            united[-1] = (united[-1][0], max(united[-1][1], end))
        else:
            united.append((start, end))
    return united


def common_time(one: Sequence[tuple[float, float]], other: Sequence[tuple[float, float]]) -> float:
    """Return how long two sets of intervals, each in order and without overlaps, hold at once."""
    total, i, j = 0.0, 0, 0
    while i < len(one) and j < len(other):
        total += max(0.0, min(one[i][1], other[j][1]) - max(one[i][0], other[j][0]))
        if one[i][1] <= other[j][1]:
            i += 1
        else:
            j += 1
    return total
