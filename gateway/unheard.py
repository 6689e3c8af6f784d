"""How long before its first and after its last heard beacon two backpacks were near each other; and how many beacons are lost. Pure.

A backpack that senses by beacons dates an encounter from the first beacon that it heard to the last (WIRE_FORMAT.md §5.3). The two were
near each other already before, and still after, by less than the time to the beacon that was not heard for want of nearness. Where beacons
are lost, any number of them may have been sent in vain. So, with x the time before the first beacon of either side in units of the period,
and f how much later the other side's first one came, x has a density that is flat and falls by the share p of lost beacons at f, 1 + f, ...
seen from one beacon earlier: at 1 - f, 1, 2 - f, 2, ... An end is a begin seen backwards.
"""

from bisect import bisect_left
from dataclasses import dataclass, field
from functools import cache
from typing import TypeAlias

Guess: TypeAlias = tuple[float, float]
"""How much earlier an encounter began than its first beacon came, and how wrong that may be [beacon periods]."""

JITTER = 0.1
"""Senders delay a beacon by up to this share of the period at random, lest two collide for ever: as the simulator's backpacks do."""

_COVERED = 0.985
"""Probability that an encounter began within the bound; both ends together then come to 97 %."""

_JITTER_SLACK = 0.06
"""What the beacons' jitter adds to a bound: an interval between two of them is longer than 1.06 periods in 8 % of cases (a difference of
two uniform draws)."""

_LEVELS = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
_LOWEST = 0.012
"""An estimate below this, one lost beacon in 80, counts as no loss: so many gaps are those of insects that part and meet again."""

_N_STEPS = 32
_SHORT = 3.0
_SPLIT = 3e-4
_MAX_BRIDGED = 6
_LOST_GAP, _LONGEST_GAP, _FADING = 1.15, 5.5, 0.999


@dataclass(frozen=True, slots=True)
class Guesses:
    """What to take for the unheard part of an encounter, at one share of lost beacons.

    Parameters
    ----------
    of_short, of_alone
        Where one side reported, for less than three periods or for longer: then the other is out of range or silent, else it would have
        heard a beacon, and says nothing of what was missed before.
    of_both
        Where both did, by how much later the second came, in 32nds of a period.
    n_bridged, n_bridged_alone
        So many lost beacons in a row of each side do not end an encounter, or of one side where there is no other: with fewer, more than
        three beacons in 10,000 would find it torn apart.
    """

    loss: float
    of_short: Guess
    of_alone: Guess
    of_both: tuple[Guess, ...]
    n_bridged: int
    n_bridged_alone: int

    def of_one(self, duration: float) -> Guess:
        """Return the guess where only one side reported, for so many periods."""
        return self.of_short if duration < _SHORT else self.of_alone

    def between(self, gap: float) -> Guess:
        """Return the guess where the two sides' first beacons are ``gap`` periods apart."""
        later = gap - n_missed(gap)
        return self.of_both[_N_STEPS if later >= 1.0 else int(later * _N_STEPS)]


def n_missed(gap: float) -> int:
    """Return how many beacons of the later side cannot have been heard where the first ones are ``gap`` periods apart."""
    return int(gap - JITTER) if gap > JITTER else 0


@cache
def guesses(loss: float) -> Guesses:
    """Make the guesses for a share of lost beacons, from 0 up to, not including, 1."""
    n_bridged, n_alone = (next((n for n in range(_MAX_BRIDGED) if loss ** (k * (n + 1)) < _SPLIT), _MAX_BRIDGED) for k in (2, 1))
    of_both = tuple(_guess(loss, later=min(1.0, (step + 0.5) / _N_STEPS)) for step in range(_N_STEPS + 1))
    return Guesses(
        loss=loss,
        of_short=_guess(loss * loss, later=None),  # beacons of both were missed before
        of_alone=_guess(loss, later=None),
        of_both=of_both,
        n_bridged=n_bridged,
        n_bridged_alone=n_alone,
    )


def _guess(loss: float, *, later: float | None) -> Guess:
    """Return the median of x and the distance to the end of what is likely; ``later`` is f, None where there is no other side."""
    edges, weight, total = [0.0], 1.0, 0.0
    masses: list[float] = []
    while weight > 1e-6 or not masses:
        n = len(masses)
        end = float(n + 1) if later is None else (n + 2) // 2 - (later if n % 2 == 0 else 0.0)
        masses.append(weight * (end - edges[-1]))
        edges.append(end)
        total += masses[-1]
        weight *= loss
    middle, last = (_quantile(edges, masses, share * total) for share in (0.5, _COVERED))
    if loss == 0.0:
        last = edges[-1]
    half = max(middle, last - middle) + _JITTER_SLACK
    return middle, half + (0.0 if later is None else 0.5 / _N_STEPS)


def _quantile(edges: list[float], masses: list[float], mass: float) -> float:
    for begin, end, own in zip(edges, edges[1:], masses, strict=False):
        if mass <= own and own > 0.0:
            return begin + (end - begin) * mass / own
        mass -= own
    return edges[-1]


@dataclass(slots=True)
class BeaconLoss:
    """Estimates the share of beacons that are lost between two that are near each other, and has the guesses that go with it.

    Notes
    -----
    A backpack ends its report where a beacon is missing and begins another when it hears the next, so the gaps between reports of
    one side tell what was lost. Two that part and meet again within some periods count as well, but these are few beside the beacons
    heard. Where backpacks bridge lost beacons themselves, these are not seen, and the share is that of the gaps that are left. Older
    beacons fade, by half in about 700 reports.
    """

    now: Guesses = field(default_factory=lambda: guesses(0.0))
    _missed: float = 0.4  # as if 40 beacons had been heard before, and none lost but by chance
    _trials: float = 40.0

    @property
    def share(self) -> float:
        """Return the estimate."""
        return self._missed / self._trials

    def observe(self, *, duration: float, gap: float) -> None:
        """Take a final report that lasted so long, and how long before it the side had reported before [beacon periods]; 0: unknown."""
        missed = round(gap) - 1 if _LOST_GAP < gap < _LONGEST_GAP else 0
        # The first beacon of a report is no trial, for without it there were no report; behind a gap it is.
        self._trials = self._trials * _FADING + int(duration + 0.5) + (missed + 1 if missed else 0)
        self._missed = self._missed * _FADING + missed
        if missed or self.now.loss:
            share = self.share
            level = 0.0 if share < _LOWEST else _LEVELS[min(bisect_left(_LEVELS, share), len(_LEVELS) - 1)]
            if level != self.now.loss:
                self.now = guesses(level)
