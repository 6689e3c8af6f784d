"""Who stands still, found from encounters alone; or nobody, where the encounters do not prove it.

Nodes that stand still never meet each other, though they meet those that walk (`_candidates`); and they are as far apart in the second half
of the record as in the first (`_agreements`). A set of nodes is named where both hold beyond doubt, and none otherwise: a node that is
wrongly taken to stand joins places that have nothing to do with each other.
"""

from dataclasses import dataclass
from math import lgamma, log

import numpy as np

from mapper.kernels import Kernels, Links, choose_kernels
from mapper.types import BoolArray, EncounterTable, FloatArray, IntArray

FEWEST_STATIONARY = 5
"""With fewer there are too few distances between them to compare."""
LEAST_OWN_AGREEMENT = 0.8
"""Rank correlation of the distances of one of them to the others, first half of the record against the second."""
_LEAST_EVIDENCE, _LEAST_AGREEMENT = 0.0, 0.9
"""How unlikely it must be that so many nodes of those there are never met, had they walked like the others (negative natural logarithm of
the probability), and how well the distances between them must agree between the halves (correlation)."""
_LESS_EVIDENCE, _CLOSE_AGREEMENT, _LEAST_WEIGHT = -15.0, 0.97, 35.0
"""The same where only both together prove it. All thresholds: chosen on seeds 0-139 of `studies.stationary_check`."""

_MOST_NODES = 2_000
_FEWEST_VISITORS = 3  # of a place: whom one phone alone hears may go where its owner goes
_MOST_ENCOUNTERS = 50_000  # of each half: the distances are good long before
_MOST_CANDIDATES = 128  # the busiest: a table of times from all encounters to each is kept
_DROPPED_AT_ONCE = 10  # one in so many
_ALWAYS = 0.9  # of the record: two that are together for so long stand beside each other, and did not meet
_LEAST_SHARE_OF_PAIRS = 0.5  # of the distances between candidates: known in both halves
_BISECTIONS = 60
_LEAST_REST = 1e-6  # of the variance: a perfect correlation is no perfect proof


@dataclass(frozen=True, slots=True, kw_only=True)
class StationaryNodes:
    """What a search found.

    ``nodes`` ascending, empty where none is proven. ``reason`` says why, for a person. ``agreement`` and ``evidence`` are those of the best
    set that was looked at, None where there was none.
    """

    nodes: tuple[int, ...]
    reason: str
    agreement: float | None = None
    evidence: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Meetings:
    """Who met whom: ``ids`` (n,) ascending; ``counts`` (n, n), how often, symmetric; ``first`` and ``second`` are rows into ``ids``."""

    ids: IntArray
    counts: IntArray
    first: IntArray
    second: IntArray


def find_stationary(table: EncounterTable, *, kernels: Kernels | None = None) -> StationaryNodes:
    """Find the nodes that stood still for the whole record.

    Notes
    -----
    The answer does not depend on the order of rows, and on ids only in ties. Those that stood for a part of the record only are not found,
    nor those whom few met: see docs/your-own-data.md for how many are.
    """
    kernels = kernels or choose_kernels()
    ids = np.unique(np.concatenate([table.id1, table.id2]))
    if not 2 * FEWEST_STATIONARY <= len(ids) <= _MOST_NODES:
        limits = f"{2 * FEWEST_STATIONARY} to {_MOST_NODES}"
        return StationaryNodes(nodes=(), reason=f"whether any of {len(ids)} nodes stands still can be found for {limits} nodes only")
    meetings = _meetings(table, ids)
    found: list[StationaryNodes] = []
    best: StationaryNodes | None = None
    for candidates in _candidates(meetings.counts > 0):
        judged = _judge(table, meetings, candidates, kernels)
        if judged.nodes:
            found.append(judged)
        if best is None or (judged.agreement or -1.0) > (best.agreement or -1.0):
            best = judged
    if len(found) == 1:
        return found[0]
    if found:
        return StationaryNodes(nodes=(), reason="two sets of nodes, who meet each other only, both look as if they stood still")
    assert best is not None  # there is always a largest set
    return best


def _meetings(table: EncounterTable, ids: IntArray) -> _Meetings:
    n = len(ids)
    first, second = np.searchsorted(ids, table.id1), np.searchsorted(ids, table.id2)
    pair = first * n + second
    counts = np.bincount(pair, minlength=n * n).reshape(n, n)
    together = np.bincount(pair, weights=(table.t_end_ns - table.t_start_ns).astype(np.float64), minlength=n * n).reshape(n, n)
    span_ns = float(int(table.t_end_ns.max()) - int(table.t_start_ns.min()))
    counts = np.where(together >= _ALWAYS * span_ns, 0, counts) if span_ns > 0 else counts
    return _Meetings(ids=ids, counts=(counts + counts.T).astype(np.int64), first=first, second=second)


def _candidates(has_met: BoolArray) -> list[IntArray]:
    """Return a large set of nodes that never met each other, and all the others where those never did so either, as in logs of readers.

    Notes
    -----
    The node that met fewest of those left is taken first, then all whom it met are left out, and so on; ties go to whoever met fewer in
    all, then to the lower id. Those that stand meet none of their own kind, so they come first.
    """
    n = len(has_met)
    is_left = np.ones(n, dtype=np.bool_)
    degree = has_met.sum(axis=1)
    left_degree = degree.astype(np.int64)
    chosen = np.zeros(n, dtype=np.bool_)
    while is_left.any():
        left = np.flatnonzero(is_left)
        node = int(left[np.lexsort((left, degree[left], left_degree[left]))[0]])
        chosen[node] = True
        goes = is_left & has_met[node]
        goes[node] = True
        is_left &= ~goes
        left_degree -= has_met[goes].sum(axis=0)
    others = np.flatnonzero(~chosen)
    sets = [np.flatnonzero(chosen)]
    if len(others) and not has_met[np.ix_(others, others)].any():
        sets.append(others)
    return sets


def _judge(table: EncounterTable, meetings: _Meetings, candidates: IntArray, kernels: Kernels) -> StationaryNodes:
    """Drop the candidates that are not where they were, one by one, and see whether what is left stands beyond doubt."""
    halves = _halves(table)
    candidates = candidates[(meetings.counts[candidates] > 0).sum(axis=1) >= _FEWEST_VISITORS]
    often = meetings.counts[candidates].sum(axis=1)
    kept = np.sort(candidates[np.argsort(-often, kind="stable")[:_MOST_CANDIDATES]])
    while len(kept) >= FEWEST_STATIONARY:
        early, late = (_distances(table, meetings, rows, kept, kernels) for rows in halves)
        agreement, own = _agreements(early, late)
        if own.min() >= LEAST_OWN_AGREEMENT:
            return _verdict(meetings, kept, agreement)
        worst = np.argsort(own, kind="stable")[: max(1, len(kept) // _DROPPED_AT_ONCE)]
        kept = np.delete(kept, worst[own[worst] < LEAST_OWN_AGREEMENT])
    return StationaryNodes(
        nodes=(), reason="no set of nodes that never met is as far apart in the second half of the record as in the first"
    )


def _verdict(meetings: _Meetings, kept: IntArray, agreement: float) -> StationaryNodes:
    evidence = _evidence(meetings.counts, kept)
    told = f"{len(kept)} nodes met others {int(meetings.counts[kept].sum())} times and never each other"
    # Points of a plane have two coordinates each, but for a motion of the whole: that many correlations are free.
    weight = evidence - (len(kept) - 1.5) * log(max(1.0 - agreement**2, _LEAST_REST))
    is_proven = evidence >= _LEAST_EVIDENCE and agreement >= _LEAST_AGREEMENT
    if not is_proven and not (evidence >= _LESS_EVIDENCE and agreement >= _CLOSE_AGREEMENT and weight >= _LEAST_WEIGHT):
        halves = f"their distances in the two halves of the record (correlation {agreement:.2f})"
        if agreement >= _LEAST_AGREEMENT:
            reason = f"{told}, and {halves} fit nodes that stand still; but so few may be so by chance: record for longer"
        else:
            reason = f"{told}, but {halves} do not prove that they stand still"
        return StationaryNodes(nodes=(), reason=reason, agreement=agreement, evidence=evidence)
    reason = f"{told}, and they are as far apart in the second half of the record as in the first (correlation {agreement:.2f})"
    return StationaryNodes(nodes=tuple(meetings.ids[kept].tolist()), reason=reason, agreement=agreement, evidence=evidence)


def _evidence(counts: IntArray, kept: IntArray) -> float:
    """Return the logarithm of how unlikely it is that these never met, over the number of sets of as many that there are.

    Notes
    -----
    Were all alike, i and j would meet ``d_i d_j / sum(d)`` times, d being how often each met anybody. Meetings come in bursts, so
    fewer pairs meet than that suggests: the others show by what factor. Where the others never meet either, there is nothing to show.
    """
    n = len(counts)
    others = np.setdiff1d(np.arange(n), kept)
    often = counts.sum(axis=1).astype(np.float64)
    expected = np.outer(often, often) / often.sum()
    upper = np.triu_indices(len(kept), 1)
    missing = float(expected[np.ix_(kept, kept)][upper].sum())
    among = np.triu_indices(len(others), 1)
    theirs = expected[np.ix_(others, others)][among]
    have_met = counts[np.ix_(others, others)][among] > 0
    factor = _burst_factor(theirs, int(np.count_nonzero(~have_met))) if have_met.any() else 1.0
    n_sets = lgamma(n + 1) - lgamma(len(kept) + 1) - lgamma(n - len(kept) + 1)
    return factor * missing - n_sets


def _burst_factor(expected: FloatArray, n_unmet: int) -> float:
    """Find the factor, at most 1, by which expected meetings must be taken for as many pairs not to meet as did not."""
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if float(np.exp(-middle * expected).sum()) > n_unmet else (low, middle)
    return (low + high) / 2


def _halves(table: EncounterTable) -> tuple[IntArray, IntArray]:
    """Return the rows of the first and the second half of the encounters, in the order of their centres; of many, the outer ones."""
    order = np.argsort(table.t_start_ns + (table.t_end_ns - table.t_start_ns) // 2, kind="stable")
    half = len(order) // 2
    size = min(half, _MOST_ENCOUNTERS)
    return order[:size], order[len(order) - size :]


def _distances(table: EncounterTable, meetings: _Meetings, rows: IntArray, places: IntArray, kernels: Kernels) -> FloatArray:
    """Measure shortest times between nodes taken for places [ticks], shape (p, p); inf where nobody went from one to the other."""
    start, end = table.t_start_ns[rows], table.t_end_ns[rows]
    centre = 2 * (start - int(table.t_start_ns[0])) + (end - start)
    place_of = np.full(len(meetings.ids), -1, dtype=np.int64)
    place_of[places] = np.arange(len(places))
    first, second = meetings.first[rows], meetings.second[rows]
    at = np.maximum(place_of[first], place_of[second])
    vertex = np.where(at >= 0, at, len(places) + np.arange(len(rows)))
    node = np.concatenate([first, second])
    step = np.tile(np.arange(len(rows)), 2)
    walks = np.flatnonzero(place_of[node] < 0)
    walks = walks[np.lexsort((step[walks], node[walks]))]
    node, step = node[walks], step[walks]
    is_next = node[1:] == node[:-1]
    before, after = step[:-1][is_next], step[1:][is_next]
    in_time = np.lexsort((before, after))
    before, after = before[in_time], after[in_time]
    moves = vertex[before] != vertex[after]
    before, after = before[moves], after[moves]
    links = Links(
        sources=vertex[before].astype(np.int32),
        targets=vertex[after].astype(np.int32),
        # What is at one instant is one place in the map; here a tick apart is as good.
        times=np.maximum(centre[after] - centre[before], 1).astype(np.float64),
        before=np.full(len(before), -1, dtype=np.int32),  # sweeps ask for no chains
    )
    times = kernels.sweep_times(links, n_vertices=len(places) + len(rows), sources=np.arange(len(places)))
    return np.asarray(times[: len(places)])


def _agreements(early: FloatArray, late: FloatArray) -> tuple[float, FloatArray]:
    """Return the correlation of two tables of distances, and for each place the rank correlation of its row; -1 where too few are known."""
    n = len(early)
    is_known = np.isfinite(early) & np.isfinite(late) & ~np.eye(n, dtype=np.bool_)
    own = np.full(n, -1.0)
    for place in range(n):
        row = is_known[place]
        if row.sum() >= max(FEWEST_STATIONARY - 1, _LEAST_SHARE_OF_PAIRS * (n - 1)):
            own[place] = _correlation(_ranks(early[place, row]), _ranks(late[place, row]))
    return _correlation(early[is_known], late[is_known]), own


def _ranks(values: FloatArray) -> FloatArray:
    """Rank values; equal ones share the mean of their ranks."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    return np.asarray((last - (count - 1) / 2)[place], dtype=np.float64)


def _correlation(one: FloatArray, other: FloatArray) -> float:
    """Return the correlation; -1 where either does not vary."""
    if len(one) < 2 or np.ptp(one) == 0 or np.ptp(other) == 0:
        return -1.0
    return float(np.corrcoef(one, other)[0, 1])
