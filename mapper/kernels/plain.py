"""The kernels in numpy and scipy alone: for machines without the compiled ones, and for the tests to compare those with."""

import heapq
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mapper.groups import label_groups
from mapper.kernels.arrays import Contraction, Links, Picks, Rows, Stands, Tension, VertexArray
from mapper.kernels.plain_settling import settle
from mapper.types import BoolArray, FloatArray, IntArray, KernelsKind, ProfileNorm

_ROWS_AT_ONCE: Final = 4096
_BEYOND_ROUNDING: Final = 1 + 1e-9


class PlainKernels:
    """See `mapper.kernels.Kernels`; ``reason`` says why these are used, and what to do."""

    name: Final = KernelsKind.PLAIN

    def __init__(self, *, reason: str) -> None:
        self.shortfall: Final = f"plain kernels, 3 to 50 times slower than compiled ones: {reason}"

    def contract(
        self, centres: IntArray, id1: IntArray, id2: IntArray, *, still: Stands, commanded: Stands, moving_time: bool
    ) -> Contraction:
        """See `Kernels.contract`."""
        n = len(centres)
        biobots, biobot_of = np.unique(np.concatenate([id1, id2]), return_inverse=True)
        position = np.empty(n, dtype=np.int64)
        position[np.argsort(centres, kind="stable")] = np.arange(n)
        encounter_of = np.tile(np.arange(n), 2)
        order = np.lexsort((position[encounter_of], biobot_of))
        biobot_of, encounter_of = biobot_of[order], encounter_of[order]
        clock = centres[encounter_of]
        place = np.full(2 * n, -1, dtype=np.int64)
        bounds = np.searchsorted(biobot_of, np.arange(len(biobots) + 1)).tolist()
        for biobot, rows in zip(biobots.tolist(), (slice(a, b) for a, b in pairwise(bounds)), strict=True):
            at = clock[rows].copy()
            place[rows] = _find_places(commanded, biobot, at)
            if moving_time:
                clock[rows] = at - _time_inside(still, biobot, at)
        is_chained, step = biobot_of[1:] == biobot_of[:-1], np.diff(clock)
        is_zero = is_chained & ((step == 0) | ((place[1:] >= 0) & (place[1:] == place[:-1])))
        vertex_of, first = _merge(encounter_of[:-1][is_zero], encounter_of[1:][is_zero], n=n)
        is_edge = is_chained & ~is_zero
        source, target, times = vertex_of[encounter_of[:-1][is_edge]], vertex_of[encounter_of[1:][is_edge]], step[is_edge].astype(float)
        in_order = np.argsort(position[encounter_of[1:][is_edge]], kind="stable")
        in_order = in_order[(source != target)[in_order]]
        links = Links(
            sources=source[in_order].astype(np.int32),
            targets=target[in_order].astype(np.int32),
            times=np.asarray(times[in_order]),
            before=_links_before(biobot_of[1:][is_edge], in_order),
        )
        is_landmark = np.zeros(len(first), dtype=np.bool_)
        is_landmark[vertex_of[encounter_of[place >= 0]]] = True
        component, _ = _merge(links.sources, links.targets, n=len(first))
        return Contraction(
            links=links,
            rows=_make_rows(links, n_vertices=len(first)),
            first_encounter=first.astype(np.int32),
            multiplicity=np.bincount(vertex_of, minlength=len(first)).astype(np.int32),
            is_landmark=is_landmark,
            component=component.astype(np.int32),
            vertex_of=vertex_of.astype(np.int32),
        )

    def sweep_times(self, links: Links, *, n_vertices: int, sources: IntArray) -> FloatArray:
        """See `Kernels.sweep_times`."""
        return _search(_make_rows(links, n_vertices=n_vertices), sources).T

    def sum_neighbour_times(self, rows: Rows, multiplicity: VertexArray, *, k: int) -> FloatArray:
        """See `Kernels.sum_neighbour_times`.

        Each settled vertex keeps only its next edge in the heap, so a landmark with thousands of edges costs no more than another vertex.
        """
        starts, target, weight, counts = rows.starts.tolist(), rows.neighbours.tolist(), rows.times.tolist(), multiplicity.tolist()
        sums = np.zeros(len(counts))
        for source, own in enumerate(counts):
            wanted = k - (own - 1)
            total = 0.0
            settled = {source}
            edge = starts[source]
            heap = [(weight[edge], edge, 0.0, starts[source + 1])] if wanted > 0 and edge < starts[source + 1] else []
            while heap and wanted > 0:
                reached, edge, base, stop = heap[0]
                if edge + 1 < stop:
                    heapq.heapreplace(heap, (base + weight[edge + 1], edge + 1, base, stop))
                else:
                    heapq.heappop(heap)
                vertex = target[edge]
                if vertex in settled:
                    continue
                settled.add(vertex)
                total += reached * min(wanted, counts[vertex])
                wanted -= counts[vertex]
                if starts[vertex] < starts[vertex + 1]:
                    heapq.heappush(heap, (reached + weight[starts[vertex]], starts[vertex], reached, starts[vertex + 1]))
            sums[source] = total
        return sums

    def pick_along_graph(
        self,
        rows: Rows,
        links: Links,  # noqa: ARG002  # rows say as much
        candidates: BoolArray,
        *,
        hubs: IntArray,  # noqa: ARG002  # every search is over the whole graph here
        n_points: int,
    ) -> Picks:
        """See `Kernels.pick_along_graph`."""
        eligible = np.flatnonzero(candidates)
        picked: list[int] = []
        distances = np.zeros((n_points, n_points))
        nearest = np.full(len(eligible), np.inf)
        choice, radius = 0, float(nearest.max(initial=0.0))
        while len(picked) < n_points and radius > 0:
            row = _search(rows, eligible[choice : choice + 1])[0]
            distances[len(picked), : len(picked)] = distances[: len(picked), len(picked)] = row[picked]
            picked.append(int(eligible[choice]))
            np.minimum(nearest, row[eligible], out=nearest)
            choice = int(nearest.argmax())
            radius = float(nearest[choice])
        m = len(picked)
        return Picks(chosen=np.array(picked, dtype=np.int64), distances=distances[:m, :m].copy(), cover_radius=radius)

    def bracket(self, times: FloatArray, references: IntArray) -> tuple[FloatArray, FloatArray]:
        """See `Kernels.bracket`."""
        half_gap = np.zeros_like(times)
        between = times[references]
        n_references = times.shape[1]
        others = ~np.eye(n_references, dtype=bool)
        if n_references > 1:
            for begin in range(0, len(times), _ROWS_AT_ONCE):
                rows = slice(begin, begin + _ROWS_AT_ONCE)
                for k in range(n_references):
                    detour = times[rows][:, others[k]] - between[k, others[k]]
                    half_gap[rows, k] = (times[rows, k] + detour.min(axis=1)) / 2
        return times - half_gap, np.asarray(np.median(half_gap, axis=1))

    def pick_profiles(self, profiles: FloatArray, *, norm: ProfileNorm, n_points: int) -> Picks:
        """See `Kernels.pick_profiles`.

        Place by place: one column stays in the cache, the whole table would not.
        """
        columns = np.ascontiguousarray(profiles.T)
        picked: list[int] = []
        distances = np.zeros((n_points, n_points))
        nearest = np.full(len(profiles), np.inf)
        choice, radius = 0, float(nearest.max(initial=0.0))
        while len(picked) < n_points and radius > 0:
            row = compare_profiles(columns, choice, norm=norm)
            distances[len(picked), : len(picked)] = distances[: len(picked), len(picked)] = row[picked]
            picked.append(choice)
            np.minimum(nearest, row, out=nearest)
            choice = int(nearest.argmax())
            radius = float(nearest[choice])
        m = len(picked)
        return Picks(chosen=np.array(picked, dtype=np.int64), distances=distances[:m, :m].copy(), cover_radius=radius)

    def average_nearest(self, profiles: FloatArray, *, n_nearest: int) -> FloatArray:
        """See `Kernels.average_nearest`."""
        from scipy.spatial import cKDTree  # noqa: PLC0415  # a fifth of a second that the compiled kernels do without

        n = len(profiles)
        tree = cKDTree(profiles)
        means = np.empty_like(profiles)
        for begin in range(0, n, _ROWS_AT_ONCE):
            rows = profiles[begin : begin + _ROWS_AT_ONCE]
            # One more than is wanted: where it is no further than the last wanted one, that there is a tie.
            reach, nearest = (np.asarray(found) for found in tree.query(rows, k=np.arange(1, min(n_nearest + 1, n) + 1)))
            limit = reach[:, n_nearest - 1] * _BEYOND_ROUNDING
            nearest = nearest[:, :n_nearest]
            is_tied = reach[:, -1] <= limit
            if n_nearest < n and is_tied.any():
                tied = [np.sort(within) for within in tree.query_ball_point(rows[is_tied], limit[is_tied])]
                nearest[is_tied] = [
                    within[_rank(profiles[within], row)[:n_nearest]] for within, row in zip(tied, rows[is_tied], strict=True)
                ]
            total = np.zeros_like(rows)
            # Neighbour by neighbour: all of them at once would need rows * n_nearest * l numbers.
            for column in np.sort(nearest, axis=1).T:
                total += profiles[column]
            means[begin : begin + _ROWS_AT_ONCE] = total / n_nearest
        return means

    def settle_tracks(self, links: Links, start: FloatArray, pull: FloatArray, *, tension: Tension, rounds: int, steps: int) -> FloatArray:
        """See `Kernels.settle_tracks`."""
        return settle(links, start, pull, tension=tension, rounds=rounds, steps=steps)


def _rank(rows: FloatArray, origin: FloatArray) -> IntArray:
    """Sort rows by their distance from one, ties by number: what comes where. Every fourth column goes to one of four sums, as in C."""
    sums = [np.zeros(len(rows)) for _ in range(4)]
    for place, column in enumerate(rows.T):
        sums[place % 4] += np.square(column - origin[place])
    return np.argsort((sums[0] + sums[1]) + (sums[2] + sums[3]), kind="stable")


def compare_profiles(columns: FloatArray, row: int, *, norm: ProfileNorm) -> FloatArray:
    """Measure from one profile to all: shape (v,); ``columns`` has shape (l, v)."""
    total = np.zeros(columns.shape[1])
    difference = np.empty(columns.shape[1])
    for column in columns:
        np.subtract(column, column[row], out=difference)
        match norm:
            case ProfileNorm.MAX:
                np.maximum(total, np.abs(difference, out=difference), out=total)
            case ProfileNorm.RMS:
                total += np.square(difference, out=difference)
    return total if norm is ProfileNorm.MAX else np.sqrt(total / len(columns))


def _find_node(nodes: IntArray, biobot: int) -> tuple[int, int]:
    # Not biobot + 1: the largest id has none.
    wanted = np.int64(biobot)
    return int(np.searchsorted(nodes, wanted, side="left")), int(np.searchsorted(nodes, wanted, side="right"))


def _find_places(commanded: Stands, biobot: int, at: IntArray) -> IntArray:
    """Say in which of all commanded spells each instant of a biobot lies, -1 for none."""
    first, last = _find_node(commanded.nodes, biobot)
    if first == last:
        return np.full(len(at), -1, dtype=np.int64)
    spell = first + np.searchsorted(commanded.begins[first:last], at, side="right") - 1
    is_inside = (spell >= first) & (at <= commanded.ends[np.maximum(spell, first)])
    return np.where(is_inside, spell, -1)


def _time_inside(still: Stands, biobot: int, at: IntArray) -> IntArray:
    """Measure how much of the time up to each instant a biobot stood still."""
    first, last = _find_node(still.nodes, biobot)
    if first == last:
        return np.zeros(len(at), dtype=np.int64)
    begin, end = still.begins[first:last], still.ends[first:last]
    before = np.concatenate([[0], np.cumsum(end - begin)])
    started = np.searchsorted(begin, at, side="right")
    latest = np.maximum(started - 1, 0)
    running = np.minimum(at, end[latest]) - begin[latest]
    return np.where(started > 0, before[latest] + running, 0)


def _merge(one: NDArray[np.integer], other: NDArray[np.integer], *, n: int) -> tuple[IntArray, IntArray]:
    """Merge what is joined: the set of each of n, numbered by their first members, and those members."""
    set_of = label_groups(one, other, n=n)
    return set_of, np.unique(set_of, return_index=True)[1].astype(np.int64)


def _links_before(biobot_of: IntArray, in_order: IntArray) -> VertexArray:
    """Number the link before of the same biobot, -1 for none; steps are sorted by biobot, and links are some of them in another order."""
    number = np.full(len(biobot_of), -1, dtype=np.int32)
    number[in_order] = np.arange(len(in_order), dtype=np.int32)
    before = np.full(len(biobot_of), -1, dtype=np.int32)
    before[1:] = np.where(biobot_of[1:] == biobot_of[:-1], number[:-1], -1)
    return before[in_order]


def _make_rows(links: Links, *, n_vertices: int) -> Rows:
    """Store the shortest of parallel links both ways."""
    low, high = np.minimum(links.sources, links.targets), np.maximum(links.sources, links.targets)
    order = np.lexsort((links.times, high, low))
    low, high, times = low[order], high[order], links.times[order]
    is_first = np.ones(len(low), dtype=bool)
    is_first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    vertex = np.concatenate([low[is_first], high[is_first]])
    neighbour = np.concatenate([high[is_first], low[is_first]])
    time = np.tile(times[is_first], 2)
    order = np.lexsort((neighbour, time, vertex))
    starts = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=n_vertices))]).astype(np.int64)
    return Rows(starts=starts, neighbours=neighbour[order].astype(np.int32), times=np.asarray(time[order]))


def _search(rows: Rows, sources: IntArray) -> FloatArray:
    """Run Dijkstra from each source: shape (sources, v)."""
    from scipy.sparse import csr_array  # noqa: PLC0415  # half a second that the compiled kernels do without
    from scipy.sparse.csgraph import dijkstra  # noqa: PLC0415  # same

    n = len(rows.starts) - 1
    weights = csr_array((rows.times, rows.neighbours, rows.starts), shape=(n, n))
    return np.asarray(dijkstra(weights, directed=True, indices=np.asarray(sources, dtype=np.int64)))
