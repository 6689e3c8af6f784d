"""Rows of one pair that are one contact become one encounter: those that overlap, touch or repeat, and sightings within a gap.

What tells the tick of sightings is how far those of one pair are apart.
"""

from dataclasses import dataclass

import numpy as np

from mapper.types import BoolArray, IntArray

# Own choice: one sighting may be lost, and every one be a quarter of a tick late.
TICKS_OF_A_GAP = 2.5
_BINS_PER_DOUBLING = 4
_LEAST_SHARE_OF_THE_TICK = 0.25
"""Of the distances between sightings of one pair, so many lie about the tick where there is one; else the gap is a guess."""
_FEWEST_DISTANCES = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contacts:
    """Encounters of n rows: columns of shape (m,), m <= n, sorted by pair and begin; ``n_repeated`` rows were equal to another one."""

    start_ns: IntArray
    end_ns: IntArray
    id1: IntArray
    id2: IntArray
    n_repeated: int
    n_joined: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Tick:
    """How far sightings of one pair are apart [ns]; ``is_clear`` where enough of them agree. 0: no pair was seen twice."""

    tick_ns: int
    is_clear: bool


def join_contacts(start: IntArray, end: IntArray, id1: IntArray, id2: IntArray, *, gap_ns: int) -> Contacts:
    """Join the rows of each pair that begin no later than ``gap_ns`` after all before them ended.

    Parameters
    ----------
    start, end
        [ns], shape (n,), ``start <= end``.
    id1, id2
        Shape (n,), in either order, different in each row.

    Returns
    -------
    Contacts
        Of each group the first begin and the last end. Without any row to join, the columns are those that were given, in their order.
    """
    low, high = np.minimum(id1, id2), np.maximum(id1, id2)
    order = sort_by_pair(low, high, start)
    is_same_pair = _is_same_pair(low[order], high[order])
    begun, ended = start[order], end[order]
    latest = _latest_end(ended, is_same_pair) if np.any((ended[:-1] > ended[1:]) & is_same_pair) else ended
    is_joined = is_same_pair & (begun[1:] <= latest[:-1] + gap_ns)
    if not is_joined.any():
        return Contacts(start_ns=start, end_ns=end, id1=id1, id2=id2, n_repeated=0, n_joined=0)
    n_repeated = _count_repeated(begun, ended, is_same_pair)
    first = np.flatnonzero(np.append(True, ~is_joined))
    last = np.append(first[1:], len(order)) - 1
    rows = order[first]
    return Contacts(
        start_ns=begun[first],
        end_ns=latest[last],
        id1=low[rows],
        id2=high[rows],
        n_repeated=n_repeated,
        n_joined=len(order) - len(first),
    )


def find_tick(start: IntArray, id1: IntArray, id2: IntArray) -> Tick:
    """Find how far apart the sightings of a contact are.

    Notes
    -----
    Those of one contact follow each other by the tick, those of different contacts by anything: the fullest bin of the logarithm of all
    distances, of a quarter of an octave and smoothed over three bins, holds the tick, and its median is the tick.
    """
    low, high = np.minimum(id1, id2), np.maximum(id1, id2)
    order = sort_by_pair(low, high, start)
    apart = np.diff(start[order])[_is_same_pair(low[order], high[order])]
    apart = apart[apart > 0]
    if len(apart) == 0:
        return Tick(tick_ns=0, is_clear=False)
    bins = np.rint(np.log2(apart) * _BINS_PER_DOUBLING).astype(np.int64)
    counts = np.bincount(bins, minlength=int(bins.max()) + 2).astype(np.int64)
    smoothed = counts + np.append(0, counts[:-1]) + np.append(counts[1:], 0)
    near = np.abs(bins - int(np.argmax(smoothed))) <= 1
    is_clear = len(apart) >= _FEWEST_DISTANCES and np.count_nonzero(near) >= _LEAST_SHARE_OF_THE_TICK * len(apart)
    return Tick(tick_ns=int(np.median(apart[near])), is_clear=bool(is_clear))


def sort_by_pair(low: IntArray, high: IntArray, start: IntArray) -> IntArray:
    """Return the rows by pair, those of one pair by begin, equal ones as they came."""
    by_start = np.arange(len(start), dtype=np.int64)
    if np.any(start[:-1] > start[1:]):
        by_start = np.argsort(start, kind="stable").astype(np.int64)
        low, high = low[by_start], high[by_start]
    n_bits = max(1, int(len(low) - 1).bit_length())
    widest = max(int(high.max(initial=0)), 1).bit_length()
    if 2 * widest + n_bits < 64:
        # Pair and place in one number: sorted at a fraction of the cost of finding an order.
        packed = np.sort((((low << widest) | high) << n_bits) | np.arange(len(low), dtype=np.int64))
        return np.asarray(by_start[packed & ((1 << n_bits) - 1)])
    return np.asarray(by_start[np.lexsort((high, low))])


def _is_same_pair(low: IntArray, high: IntArray) -> BoolArray:
    return np.asarray((low[1:] == low[:-1]) & (high[1:] == high[:-1]))


def _count_repeated(begun: IntArray, ended: IntArray, is_same_pair: BoolArray) -> int:
    """Count the rows that equal an earlier one, over rows sorted by pair and begin."""
    group = np.cumsum(np.append(0, ~(is_same_pair & (begun[1:] == begun[:-1]))))
    order = np.lexsort((ended, group))
    return int(np.count_nonzero((group[order][1:] == group[order][:-1]) & (ended[order][1:] == ended[order][:-1])))


def _latest_end(ended: IntArray, is_same_pair: BoolArray) -> IntArray:
    """Return the latest end so far in each pair, over rows sorted by pair, by ranks: sums with the times themselves would not fit."""
    times, rank = np.unique(ended, return_inverse=True)
    pair = np.cumsum(np.append(0, ~is_same_pair))
    highest = np.maximum.accumulate(pair * len(times) + rank)
    return np.asarray(times[highest - pair * len(times)], dtype=np.int64)
