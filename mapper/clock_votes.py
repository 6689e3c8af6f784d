"""How far two gateways' wall clocks are apart, by the encounters that both heard of. Pure.

Whatever two gateways record of one encounter has the same two biobots and almost the same length. The difference of the two middles is a
vote for the difference of the clocks. True votes agree within the gap between two beacons; chance coincidences of the same pair lie
anywhere. So the difference is the one place where votes crowd, however many hours it is from zero; where no place is crowded, nothing
is said. Monotonic clocks of two machines drift apart, so within the crowd the difference is followed through time, block by block.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from mapper.types import IntArray

MIN_VOTES: Final = 5
"""Fewer shared encounters prove no difference, and place no knot."""
_WINDOW_NS: Final = 2_000_000_000
"""True votes lie within this of each other: two sides' first and last beacons differ by a beacon period or two, at most a second."""
_LENGTH_TOLERANCE_NS: Final = 1_000_000_000
_MAX_DRIFT: Final = 200e-6
"""Difference in rate of two hosts: at most 100 ppm each, as `gateway.clocks` takes it for host and backpack."""
_MAX_CANDIDATES: Final = 400_000
_SHORTEST_BLOCK_NS: Final = 1_800_000_000_000
_MAX_BLOCKS: Final = 64
_MAX_BLOCK_VOTES: Final = 4_096
_EDGE_KNOTS: Final = 8
"""The drift beyond the first and the last knot is that over so many knots: over a few hours the noise of a knot makes no slope."""
FLOOR_NS: Final = 10_000_000
"""No difference is known better: gateways take the fastest uplink to need up to 10 ms (`gateway.clocks`), and each may be wrong alone."""
# Three standard errors of a median: sigma is 1.4826 times the median deviation, and that of the median 1.2533 sigma / sqrt(n).
_ERRORS: Final = 3 * 1.2533 * 1.4826


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClockSample:
    """Some encounters of one start of a gateway, on its own wall clock.

    Arrays have shape (n,): ``pair`` is the same number for the same two biobots everywhere; ``middle_ns`` and ``length_ns``. Pairs are
    drawn, not encounters: two samples of the same ``level`` have the same pairs.
    """

    pair: IntArray
    middle_ns: IntArray
    length_ns: IntArray

    def __len__(self) -> int:
        return len(self.pair)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClockDifference:
    """What to add to one wall clock to have another.

    ``t_ns``, ascending, on the one clock, and ``offset_ns`` there, both of shape (k,), k > 0; straight lines lie between. No offset is
    wrong by more than ``bound_ns`` (three standard errors, and what both gateways may be wrong by alone). ``n_votes`` encounters say so.
    """

    t_ns: IntArray
    offset_ns: IntArray
    bound_ns: int
    n_votes: int

    def at(self, t_ns: IntArray) -> IntArray:
        """Return the offset at instants of the one clock [ns]; beyond the knots it drifts on as it did, where it surely did."""
        base = int(self.t_ns[0])
        x, y = self.t_ns - base, self.offset_ns - int(self.offset_ns[0])
        wanted = t_ns - base
        offset = np.interp(wanted, x, y)
        inner = min(len(x) - 1, _EDGE_KNOTS)
        for edge, far, beyond in ((0, inner, wanted < x[0]), (-1, -1 - inner, wanted > x[-1])):
            if abs(int(y[edge] - y[far])) > self.bound_ns:
                slope = float(np.clip((y[edge] - y[far]) / (x[edge] - x[far]), -_MAX_DRIFT, _MAX_DRIFT))
                offset = np.where(beyond, y[edge] + slope * (wanted - x[edge]), offset)
        return np.rint(offset).astype(np.int64) + int(self.offset_ns[0])

    def reversed(self) -> "ClockDifference":
        """Return what to add to the other clock to have the one."""
        return ClockDifference(t_ns=self.t_ns + self.offset_ns, offset_ns=-self.offset_ns, bound_ns=self.bound_ns, n_votes=self.n_votes)

    def then(self, other: "ClockDifference") -> "ClockDifference":
        """Return the way from the one clock over the other's to a third."""
        onward = other.at(self.t_ns + self.offset_ns)
        return ClockDifference(
            t_ns=self.t_ns,
            offset_ns=self.offset_ns + onward,
            bound_ns=self.bound_ns + other.bound_ns,
            n_votes=min(self.n_votes, other.n_votes),
        )


def compare_clocks(one: ClockSample, other: ClockSample) -> ClockDifference | None:
    """Find what to add to the clock of ``one`` to have that of ``other``; None where they share too little to say.

    Notes
    -----
    The most crowded two seconds must have `MIN_VOTES` and more than twice as many votes as any other place that drift cannot explain.
    """
    t_ns, d_ns = _candidates(one, other)
    if len(d_ns) < MIN_VOTES:
        return None
    first, n_votes, counts = _crowd(d_ns)
    is_near = (d_ns >= d_ns[first]) & (d_ns <= d_ns[first] + _WINDOW_NS)
    slack_ns = _WINDOW_NS + int(_MAX_DRIFT * int(t_ns.max() - t_ns.min()))
    is_rival = (d_ns < d_ns[first] - slack_ns) | (d_ns > d_ns[first] + _WINDOW_NS + slack_ns)
    n_rival = int(counts[is_rival].max(initial=0))
    if n_votes < MIN_VOTES or n_votes < 2 * n_rival + 2:
        return None
    return _follow(t_ns, d_ns, is_near)


def _candidates(one: ClockSample, other: ClockSample) -> tuple[IntArray, IntArray]:
    """Return instants on the one clock and differences of middles of all matches, in ascending order of the differences."""
    one, other = _only_shared(one, other)
    lasts, firsts = (np.searchsorted(other.pair, one.pair, side=side) for side in ("right", "left"))
    n_each = lasts - firsts
    n = int(n_each.sum())
    if n > _MAX_CANDIDATES:
        # The newest of both: there the two most surely overlap, whatever their clocks say.
        kept = (_MAX_CANDIDATES / n) ** 0.5
        return _candidates(_newest(one, kept), _newest(other, kept))
    left = np.repeat(np.arange(len(one)), n_each)
    right = np.arange(n) - np.repeat(np.cumsum(n_each) - n_each, n_each) + np.repeat(firsts, n_each)
    is_alike = np.abs(one.length_ns[left] - other.length_ns[right]) <= _LENGTH_TOLERANCE_NS
    left, right = left[is_alike], right[is_alike]
    t_ns, d_ns = one.middle_ns[left], other.middle_ns[right] - one.middle_ns[left]
    order = np.lexsort((t_ns, d_ns))
    return t_ns[order], d_ns[order]


def _only_shared(one: ClockSample, other: ClockSample) -> tuple[ClockSample, ClockSample]:
    """Keep pairs that both have, sorted by pair."""
    shared = np.intersect1d(one.pair, other.pair)

    def keep(sample: ClockSample) -> ClockSample:
        rows = np.flatnonzero(np.isin(sample.pair, shared))
        return _select(sample, rows[np.argsort(sample.pair[rows], kind="stable")])

    return keep(one), keep(other)


def _newest(sample: ClockSample, share: float) -> ClockSample:
    n = max(1, int(share * len(sample)))
    rows = np.lexsort((sample.length_ns, sample.pair, sample.middle_ns))[-n:]
    return _select(sample, rows)


def _select(sample: ClockSample, rows: IntArray) -> ClockSample:
    return ClockSample(pair=sample.pair[rows], middle_ns=sample.middle_ns[rows], length_ns=sample.length_ns[rows])


def _crowd(d_ns: IntArray) -> tuple[int, int, IntArray]:
    """Find the most crowded window of ascending differences, the first of several: its first place, its votes, and all counts."""
    counts = np.searchsorted(d_ns, d_ns + _WINDOW_NS, side="right") - np.arange(len(d_ns))
    first = int(np.argmax(counts))
    return first, int(counts[first]), counts


def _follow(t_ns: IntArray, d_ns: IntArray, is_near: IntArray) -> ClockDifference:
    """Place knots along the votes, from the crowd on as far as drift may have taken them."""
    centre_ns, since_ns = int(np.median(d_ns[is_near])), int(np.median(t_ns[is_near]))
    is_true = np.abs(d_ns - centre_ns) <= _WINDOW_NS + (_MAX_DRIFT * np.abs(t_ns - since_ns)).astype(np.int64)
    t_true, d_true = t_ns[is_true], d_ns[is_true]
    length_ns = _SHORTEST_BLOCK_NS
    while int(t_true.max() - t_true.min()) // length_ns >= _MAX_BLOCKS:
        length_ns *= 2
    block = t_true // length_ns
    knots = [knot for one in np.unique(block) if (knot := _knot(t_true[block == one], d_true[block == one])) is not None]
    if not knots:
        whole = _knot(t_ns[is_near], d_ns[is_near])
        assert whole is not None, "the crowd has MIN_VOTES"
        knots = [whole]
    t, d, bounds, n_votes = zip(*knots, strict=True)
    return ClockDifference(
        t_ns=np.array(t, dtype=np.int64), offset_ns=np.array(d, dtype=np.int64), bound_ns=max(bounds), n_votes=sum(n_votes)
    )


def _knot(t_ns: IntArray, d_ns: IntArray) -> tuple[int, int, int, int] | None:
    """Return instant, difference, bound and number of votes of the crowd in a block of time; None where there is none.

    Of the votes the first 2^k in time say where the knot is, so that it rests while more come, until they are twice as many.
    """
    first, n_votes, _ = _crowd(d_ns)
    if n_votes < MIN_VOTES:
        return None
    t, d = t_ns[first : first + n_votes], d_ns[first : first + n_votes]
    n_used = min(_MAX_BLOCK_VOTES, n_votes, max(MIN_VOTES, 1 << (n_votes.bit_length() - 1)))
    used = np.lexsort((d, t))[:n_used]
    offset = float(np.median(d[used] - d[0]))
    spread = float(np.median(np.abs(d[used] - d[0] - offset)))
    bound_ns = FLOOR_NS + int(_ERRORS * spread / n_used**0.5)
    return int(np.median(t[used] - t.min())) + int(t.min()), int(d[0]) + round(offset), bound_ns, n_votes
