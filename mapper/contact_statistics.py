"""What encounters alone show of how a log came about: how unevenly nodes meet, how many at once, silences, and the grid of times."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from mapper.types import BoolArray, EncounterTable, IntArray

_MOST_NODES = 2_000  # a table of all pairs is kept
_FEWEST_NODES = 8  # with fewer, pairs show nothing
_SAMPLED = 400
_MOST_LOOKED_THROUGH = 100_000
# A silence of so many mean intervals is not chance, and shorter than this share of the record it does not matter.
_INTERVALS_OF_A_SILENCE = 20.0
_LEAST_SHARE_OF_A_SILENCE = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactStatistics:
    """Figures of a log.

    ``unevenness``: variance of how often each pair of walking nodes met, over its mean, had all met by chance and each as often as it did;
    1 by chance, None where there are too many nodes or too few.
    ``at_once``: with how many others the two of an encounter are in contact at its
    centre, the mean. ``silences_ns``: times without any contact that are too long for chance. ``grid_ns``: all times are whole multiples of
    it, from the first. ``interval_ns``: median time between encounters of one walking node. ``periods``: into how many periods without a
    common node the record falls, 1 where components are not parted by time.
    """

    n_nodes: int
    n_walking: int
    encounters_of_walking: float
    unevenness: float | None
    at_once: float
    silences_ns: tuple[int, ...]
    grid_ns: int
    interval_ns: float
    periods: int


def measure_contacts(table: EncounterTable, standing: IntArray) -> ContactStatistics:
    """Measure a table of at least one encounter; ``standing`` are the ids of nodes that stand still, ascending."""
    ids = np.unique(np.concatenate([table.id1, table.id2]))
    first, second = np.searchsorted(ids, table.id1), np.searchsorted(ids, table.id2)
    walks = ~np.isin(ids, standing)
    often = np.bincount(np.concatenate([first, second]), minlength=len(ids))
    return ContactStatistics(
        n_nodes=len(ids),
        n_walking=int(walks.sum()),
        encounters_of_walking=float(often[walks].mean()) if walks.any() else 0.0,
        unevenness=_unevenness(first, second, walks) if len(ids) <= _MOST_NODES else None,
        at_once=_at_once(table, first, second),
        silences_ns=_silences(table),
        grid_ns=_grid(table),
        interval_ns=_interval(table, first, second, walks),
        periods=_periods(table, first, second, n_nodes=len(ids)),
    )


def _unevenness(first: IntArray, second: IntArray, walks: BoolArray) -> float | None:
    n = len(walks)
    counts = np.bincount(first * n + second, minlength=n * n).reshape(n, n)[np.ix_(walks, walks)]
    counts = counts + counts.T
    often = counts.sum(axis=1).astype(np.float64)
    if np.count_nonzero(often) < _FEWEST_NODES:
        return None
    upper = np.triu_indices(len(often), 1)
    expected, met = (np.outer(often, often) / often.sum())[upper], counts[upper]
    is_likely = expected > 0
    return float(np.mean((met[is_likely] - expected[is_likely]) ** 2 / expected[is_likely]))


def _at_once(table: EncounterTable, first: IntArray, second: IntArray) -> float:
    """Look through the middle of the record: of some encounters, who else is with either of the two at the centre."""
    n = len(first)
    begin = max(0, (n - _MOST_LOOKED_THROUGH) // 2)
    part = slice(begin, min(n, begin + _MOST_LOOKED_THROUGH))
    start, end, one, other = table.t_start_ns[part], table.t_end_ns[part], first[part], second[part]
    m = len(start)
    sample = np.arange(min(m, _SAMPLED)) * m // min(m, _SAMPLED)
    found = 0
    for row in sample.tolist():
        centre = start[row] + (end[row] - start[row]) // 2
        last = int(np.searchsorted(start, centre, side="right"))
        is_with = (one[:last] == one[row]) | (one[:last] == other[row]) | (other[:last] == one[row]) | (other[:last] == other[row])
        found += int(np.count_nonzero(is_with & (end[:last] >= centre))) - 1
    return found / len(sample)


def _silences(table: EncounterTable) -> tuple[int, ...]:
    over = np.maximum.accumulate(table.t_end_ns)
    silent = table.t_start_ns[1:] - over[:-1]
    span = int(over[-1]) - int(table.t_start_ns[0])
    least = max(_INTERVALS_OF_A_SILENCE * span / len(over), _LEAST_SHARE_OF_A_SILENCE * span)
    return tuple(silent[silent > least].tolist()) if span else ()


def _grid(table: EncounterTable) -> int:
    origin = table.t_start_ns[0]
    return int(np.gcd(np.gcd.reduce(table.t_start_ns - origin), np.gcd.reduce(table.t_end_ns - origin)))


def _interval(table: EncounterTable, first: IntArray, second: IntArray, walks: BoolArray) -> float:
    n = min(len(first), _MOST_LOOKED_THROUGH)
    node = np.concatenate([first[:n], second[:n]])
    time = np.tile(table.t_start_ns[:n], 2)
    chosen = np.flatnonzero(walks[node])
    chosen = chosen[np.lexsort((time[chosen], node[chosen]))]
    steps = np.diff(time[chosen])[node[chosen][1:] == node[chosen][:-1]]
    return float(np.median(steps)) if len(steps) else 0.0


def _periods(table: EncounterTable, first: IntArray, second: IntArray, *, n_nodes: int) -> int:
    ones = np.ones(len(first), dtype=np.int8)
    n_parts, part = connected_components(csr_array((ones, (first, second)), shape=(n_nodes, n_nodes)), directed=False)
    if n_parts == 1:
        return 1
    of_row = part[first]
    begins, ends = np.full(n_parts, np.iinfo(np.int64).max), np.full(n_parts, np.iinfo(np.int64).min)
    np.minimum.at(begins, of_row, table.t_start_ns)
    np.maximum.at(ends, of_row, table.t_end_ns)
    order = np.argsort(begins, kind="stable")
    # Parts that overlap in time are of one period.
    return 1 + int(np.count_nonzero(begins[order][1:] > np.maximum.accumulate(ends[order])[:-1]))
