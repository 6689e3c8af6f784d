"""The two plain ways from encounters to the distances of a subsample, with scipy: what the map engine is compared with.

``dijkstra``: a full single-source search from every point of the subsample, which also gives the next point. ``all-pairs``: the method as
[Dir16] writes it, with a matrix of all encounters against all. Both share no line with the mapper, so they also check its results.

``python -m studies.plain_paths CUT.npz dijkstra|all-pairs --result OUT.npz`` runs one of them and tells times and memory as JSON.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from mapper.types import BoolArray, FloatArray, IntArray
from studies.cut import Cut, load_cut
from studies.peak_memory import peak_memory

_TICKS_PER_S = 2e9  # a tick is half a nanosecond: centres of encounters are whole numbers of them


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlainSample:
    """A subsample of m encounters.

    ``encounter``: rows of the table in order of choice, shape (m,); ``distances`` between them [s], shape (m, m). What it took, by
    the wall's clock and of the core [s]; for ``dijkstra`` without the graph.
    """

    encounter: IntArray
    distances: FloatArray
    wall_s: float
    core_s: float


def sample_by_dijkstra(cut: Cut, *, n_points: int) -> PlainSample:
    """Pick points by maxmin among all encounters of the largest component, with one search of the whole graph for each.

    Notes
    -----
    The graph has a vertex for all encounters at distance zero of each other, so no search does more than it must.
    """
    edges = chain_edges(cut)
    n_vertices, vertex_of, first = _contract(edges, n=len(cut.table))
    proper = vertex_of[edges.here] != vertex_of[edges.there]
    graph = _symmetric(vertex_of[edges.here[proper]], vertex_of[edges.there[proper]], edges.step[proper], n=n_vertices)
    inside = _largest_component(graph, weights=np.bincount(vertex_of, minlength=n_vertices))
    graph, first = csr_array(graph[inside][:, inside]), first[inside]
    begun = time.perf_counter(), time.process_time()
    picked: list[int] = []
    distances = np.zeros((n_points, n_points))
    nearest = np.full(len(inside), np.inf)
    choice = 0
    while len(picked) < n_points and nearest[choice] > 0:
        row = dijkstra(graph, indices=[choice])[0]
        distances[len(picked), : len(picked)] = distances[: len(picked), len(picked)] = row[picked]
        picked.append(choice)
        np.minimum(nearest, row, out=nearest)
        choice = int(nearest.argmax())
    wall_s, core_s = time.perf_counter() - begun[0], time.process_time() - begun[1]
    m = len(picked)
    return PlainSample(encounter=first[picked], distances=distances[:m, :m] / _TICKS_PER_S, wall_s=wall_s, core_s=core_s)


def sample_by_all_pairs(cut: Cut, *, n_points: int, k: int, q: float) -> PlainSample:
    """Pick points as [Dir16] writes: all distances, no encounter far from its neighbours, then maxmin.

    Parameters
    ----------
    k, q
        Encounters whose mean distance to their k nearest is above the q-quantile are dropped.

    Notes
    -----
    Needs 8 N^2 bytes. One favour is done: along a biobot only consecutive encounters are joined, where eq. 6 joins all.
    """
    begun = time.perf_counter(), time.process_time()
    edges = chain_edges(cut)
    graph = _symmetric(edges.here, edges.there, edges.step, n=len(cut.table))
    inside = _largest_component(graph, weights=np.ones(len(cut.table), dtype=np.int64))
    matrix = dijkstra(csr_array(graph[inside][:, inside]))
    neighbours = min(k, len(inside) - 1)
    # The nearest of all, at distance zero, is the encounter itself.
    mean = np.array([np.partition(row, neighbours)[: neighbours + 1].sum() / neighbours for row in matrix])
    kept = np.flatnonzero(_within_quantile(mean, q=q))
    picked: list[int] = []
    nearest = np.full(len(kept), np.inf)
    choice = 0
    while len(picked) < n_points and nearest[choice] > 0:
        picked.append(int(kept[choice]))
        np.minimum(nearest, matrix[picked[-1], kept], out=nearest)
        choice = int(nearest.argmax())
    distances = matrix[np.ix_(picked, picked)] / _TICKS_PER_S
    wall_s, core_s = time.perf_counter() - begun[0], time.process_time() - begun[1]
    return PlainSample(encounter=inside[picked], distances=distances, wall_s=wall_s, core_s=core_s)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChainEdges:
    """Pairs of encounters that follow each other for one biobot, as rows of the table, and the time between them [ticks]; shape (e,)."""

    here: IntArray
    there: IntArray
    step: IntArray


def chain_edges(cut: Cut) -> ChainEdges:
    """Join each biobot's encounters in the order of their centres; a landmark's are at distance zero of each other."""
    table = cut.table
    centre = table.t_start_ns + table.t_end_ns
    biobot, encounter = np.concatenate([table.id1, table.id2]), np.tile(np.arange(len(table)), 2)
    order = np.lexsort((encounter, centre[encounter], biobot))
    biobot, encounter = biobot[order], encounter[order]
    is_chained = biobot[1:] == biobot[:-1]
    here, there = encounter[:-1][is_chained], encounter[1:][is_chained]
    step = np.where(np.isin(biobot[1:][is_chained], cut.landmarks), 0, centre[there] - centre[here])
    return ChainEdges(here=here, there=there, step=step)


def _contract(edges: ChainEdges, *, n: int) -> tuple[int, IntArray, IntArray]:
    """Put encounters at distance zero together: number of vertices, vertex of each encounter, first encounter of each vertex."""
    zero = edges.step == 0
    links = coo_array((np.ones(int(zero.sum())), (edges.here[zero], edges.there[zero])), shape=(n, n))
    _, label = connected_components(links, directed=False)
    _, first, vertex_of = np.unique(label, return_index=True, return_inverse=True)
    by_first = np.argsort(first)
    rank = np.empty_like(by_first)
    rank[by_first] = np.arange(len(first))
    return len(first), rank[vertex_of], first[by_first]


def _symmetric(here: IntArray, there: IntArray, step: IntArray, *, n: int) -> csr_array[np.float64]:
    """Make the matrix of weights, both ways; of parallel edges the lightest counts, and a weight of zero is an edge."""
    low, high = np.minimum(here, there), np.maximum(here, there)
    order = np.lexsort((step, high, low))
    low, high, weight = low[order], high[order], step[order].astype(np.float64)
    is_first = np.ones(len(low), dtype=bool)
    is_first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    low, high, weight = low[is_first], high[is_first], weight[is_first]
    rows, columns = np.concatenate([low, high]), np.concatenate([high, low])
    return csr_array(coo_array((np.tile(weight, 2), (rows, columns)), shape=(n, n)))


def _largest_component(graph: csr_array[np.float64], *, weights: IntArray) -> IntArray:
    """List the vertices of the component with most encounters, ascending; of equals, that of the earliest."""
    links = csr_array((np.ones(len(graph.data)), graph.indices, graph.indptr), shape=graph.shape)
    _, label = connected_components(links, directed=False)
    return np.flatnonzero(label == np.bincount(label, weights=weights).argmax())


def _within_quantile(values: FloatArray, *, q: float) -> BoolArray:
    return np.asarray(values <= np.quantile(values, q))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one way; print seconds and peak memory as JSON."""
    parser = argparse.ArgumentParser(prog="python -m studies.plain_paths", description="Distances of a subsample, the plain ways.")
    parser.add_argument("cut", type=Path, metavar="CUT.npz", help="a table that studies.long_run wrote")
    parser.add_argument("way", choices=["dijkstra", "all-pairs"], help="a search per point, or all against all")
    parser.add_argument("--points", type=int, default=150, metavar="M", help="points of the subsample (default: %(default)s)")
    parser.add_argument("--outlier-k", type=int, default=10, metavar="K", help="neighbours, for all-pairs (default: %(default)s)")
    parser.add_argument("--outlier-q", type=float, default=0.9, metavar="Q", help="quantile, for all-pairs (default: %(default)s)")
    parser.add_argument("--result", type=Path, required=True, metavar="OUT.npz", help="where points and distances go")
    options = parser.parse_args(arguments)
    cut = load_cut(options.cut)
    if options.way == "dijkstra":
        sample = sample_by_dijkstra(cut, n_points=options.points)
    else:
        sample = sample_by_all_pairs(cut, n_points=options.points, k=options.outlier_k, q=options.outlier_q)
    np.savez(options.result, encounter=sample.encounter, distances=sample.distances)
    print(json.dumps({"wall_s": sample.wall_s, "core_s": sample.core_s, "peak_bytes": peak_memory()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
