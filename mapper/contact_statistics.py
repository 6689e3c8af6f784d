"""What encounters alone show of how a log came about: how unevenly nodes meet, how many at once, silences, and the grid of times."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from mapper.groups import label_groups
from mapper.types import BoolArray, EncounterTable, FloatArray, IntArray, ModeSpell

# Own choices, between what random walkers show and what others do: docs/your-own-data.md.
MOST_UNEVENNESS: Final = 6.0
MOST_AT_ONCE: Final = 1.5
"""Others at once, and how many times as many as by chance: both must be exceeded."""
MOST_ALIKE: Final = 0.09

_MOST_NODES = 2_000  # a table of all pairs is kept
_FEWEST_NODES = 8  # with fewer, pairs show nothing
_SAMPLED = 400
_FEWEST_LENGTHS = 200
_FEWEST_OF_A_NODE = 5
_ALIKE = 0.02  # lengths within this share of each other are alike
_APART = 0.15  # and those apart by more are others: along walls insects may be a little slower
_MOST_LOOKED_THROUGH = 100_000
# A silence of so many mean intervals is not chance, and shorter than this share of the record it does not matter.
_INTERVALS_OF_A_SILENCE = 20.0
_LEAST_SHARE_OF_A_SILENCE = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactStatistics:
    """Figures of a log.

    ``unevenness``: variance of how often each pair of walking nodes met, over its mean, had all met by chance and each as often as it did;
    1 by chance, None where there are too many nodes or too few. ``at_once``: with how many others the two of an encounter are in contact
    at its centre, the mean, and ``at_once_by_chance``, had nobody sought or shunned anybody. ``alike_lengths``: share of the encounters of
    two walking nodes that last as long as each other, beyond what is usual: on a line all that go against each other do; None where there
    are too few, or times too coarse. ``silences_ns``: times without any contact that are too long for chance. ``grid_ns``: all times are
    whole multiples of it, from the first. ``interval_ns``: median time between encounters of one walking node. ``periods``: into how many
    periods without a common node the record falls, 1 where components are not parted by time. ``apart``: share of the
    encounters that are not of the largest group of nodes that encounters join. ``overlapping``: share of those that begin while another one
    of the same pair lasts.
    """

    n_nodes: int
    n_walking: int
    encounters_of_walking: float
    unevenness: float | None
    at_once: float
    at_once_by_chance: float
    alike_lengths: float | None
    silences_ns: tuple[int, ...]
    grid_ns: int
    interval_ns: float
    periods: int
    apart: float = 0.0
    overlapping: float = 0.0


def measure_contacts(table: EncounterTable, standing: IntArray) -> ContactStatistics:
    """Measure a table of at least one encounter; ``standing`` are the ids of nodes that stand still, ascending."""
    ids = np.unique(np.concatenate([table.id1, table.id2]))
    first, second = np.searchsorted(ids, table.id1), np.searchsorted(ids, table.id2)
    walks = ~np.isin(ids, standing)
    often = np.bincount(np.concatenate([first, second]), minlength=len(ids))
    grid_ns = _grid(table)
    lengths = (table.t_end_ns - table.t_start_ns).astype(np.float64)
    span = max(1, int(table.t_end_ns.max()) - int(table.t_start_ns.min()))
    return ContactStatistics(
        n_nodes=len(ids),
        n_walking=int(walks.sum()),
        encounters_of_walking=float(often[walks].mean()) if walks.any() else 0.0,
        unevenness=_unevenness(first, second, walks) if len(ids) <= _MOST_NODES else None,
        at_once=_at_once(table, first, second),
        # Each of the two is with so many others at any time.
        at_once_by_chance=2.0 * (2.0 * float(lengths.sum()) / (len(ids) * span)),
        alike_lengths=_alike(lengths[walks[first] & walks[second]], grid_ns=grid_ns),
        silences_ns=_silences(table),
        grid_ns=grid_ns,
        interval_ns=_interval(table, first, second, walks),
        periods=_periods(table, first, second, n_nodes=len(ids)),
        apart=_apart(first, second, n_nodes=len(ids)),
        overlapping=_overlapping(table, first, second),
    )


def measure_walkers(table: EncounterTable, spells: Sequence[ModeSpell]) -> ContactStatistics:
    """Measure a table of at least one encounter; those that stand by command in any spell stand still."""
    stood = {int(spell.node) for spell in spells if spell.mode is Mode.S and spell.cause is Cause.COMMAND}
    return measure_contacts(table, np.array(sorted(stood), dtype=np.int64))


def walks_at_random(statistics: ContactStatistics) -> bool:
    """Say whether contacts are like those of nodes that move at random: they keep no company, do not gather, and follow no lines."""
    return not (keeps_company(statistics) or gathers(statistics) or follows_lines(statistics))


def keeps_company(statistics: ContactStatistics) -> bool:
    """Say whether some pairs meet far more often than by chance."""
    return statistics.unevenness is not None and statistics.unevenness > MOST_UNEVENNESS


def gathers(statistics: ContactStatistics) -> bool:
    """Say whether nodes are with more others at once than by chance, and with many."""
    return statistics.at_once > MOST_AT_ONCE * max(1.0, statistics.at_once_by_chance)


def follows_lines(statistics: ContactStatistics) -> bool:
    """Say whether far more encounters than usual last equally long, as where nodes go along walls against each other."""
    return statistics.alike_lengths is not None and statistics.alike_lengths > MOST_ALIKE


def has_fine_times(statistics: ContactStatistics, *, tick_ns: int) -> bool:
    """Say whether times are told to half the interval between a node's encounters; ``tick_ns``: no finer than this."""
    grid_ns = max(tick_ns, statistics.grid_ns)
    return not (grid_ns > 0 and 2 * grid_ns > statistics.interval_ns)


def shows_fineness(statistics: ContactStatistics) -> bool:
    """Say whether there are encounters enough to see how finely times are told: of a few, any steps have a common measure."""
    return statistics.encounters_of_walking >= _FEWEST_OF_A_NODE


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


def _alike(lengths_ns: FloatArray, *, grid_ns: int) -> float | None:
    """Compare the most frequent length with the third: insects that also stand have two, beacons in steps have many."""
    some = np.log(np.sort(lengths_ns[lengths_ns > 0]))
    if len(some) < _FEWEST_LENGTHS or grid_ns > _ALIKE / 2.0 * float(np.exp(np.median(some))):
        return None
    close = np.searchsorted(some, some + _ALIKE) - np.arange(len(some))
    peaks = []
    for _ in range(3):
        peak = int(close.argmax())
        peaks.append(int(close[peak]))
        close[np.abs(some - some[peak]) <= _APART] = 0
    return (peaks[0] - peaks[2]) / len(some)


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
    part = label_groups(first, second, n=n_nodes)
    n_parts = int(part.max(initial=-1)) + 1
    if n_parts == 1:
        return 1
    of_row = part[first]
    begins, ends = np.full(n_parts, np.iinfo(np.int64).max), np.full(n_parts, np.iinfo(np.int64).min)
    np.minimum.at(begins, of_row, table.t_start_ns)
    np.maximum.at(ends, of_row, table.t_end_ns)
    order = np.argsort(begins, kind="stable")
    # Parts that overlap in time are of one period.
    return 1 + int(np.count_nonzero(begins[order][1:] > np.maximum.accumulate(ends[order])[:-1]))


def _apart(first: IntArray, second: IntArray, *, n_nodes: int) -> float:
    group = label_groups(first, second, n=n_nodes)
    return 1.0 - float(np.bincount(group[first]).max()) / len(first)


def _overlapping(table: EncounterTable, first: IntArray, second: IntArray) -> float:
    order = np.lexsort((table.t_start_ns, np.maximum(first, second), np.minimum(first, second)))
    low, high = np.minimum(first, second)[order], np.maximum(first, second)[order]
    is_same = (low[1:] == low[:-1]) & (high[1:] == high[:-1])
    return float(np.count_nonzero(is_same & (table.t_start_ns[order][1:] < table.t_end_ns[order][:-1]))) / len(first)
