"""Encounters to a graph: vertices are places in space-time, edges the time a biobot took from one to the next.

The definition ([Dir16] eq. 6-7) joins *every* two encounters that share a biobot. The graph here gives the same shortest paths with at
most 2n edges: the sums along one biobot's encounters telescope, so only consecutive ones are joined; and what lies at
distance zero (a landmark's community, equal times, a stop) is contracted to one vertex.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from firmware_protocol.contract.records import Cause, Mode
from mapper.types import BoolArray, EncounterTable, FloatArray, IntArray, ModeSpell


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncounterGraph:
    """Contracted encounter graph of n encounters and v vertices.

    Attributes
    ----------
    weights
        Symmetric, shape (v, v), no zeros and no duplicates; time between two vertices [ticks], whole numbers held as float64.
    first_encounter
        Row in the encounter table of the earliest encounter of each vertex, shape (v,), strictly ascending.
    multiplicity
        How many encounters each vertex stands for, shape (v,).
    landmarks
        Vertices at which a landmark stood, shape (l,), ascending. Landmarks that met while standing share one.
    """

    weights: csr_array[np.float64]
    first_encounter: IntArray
    multiplicity: IntArray
    landmarks: IntArray

    @property
    def n_vertices(self) -> int:
        """Count the vertices."""
        return len(self.first_encounter)

    @property
    def n_encounters(self) -> int:
        """Count the encounters that the vertices stand for."""
        return int(self.multiplicity.sum())


def build_encounter_graph(table: EncounterTable, spells: Sequence[ModeSpell], *, moving_time: bool) -> EncounterGraph:
    """Join the encounters that follow each other for one biobot, and contract those at distance zero.

    Parameters
    ----------
    spells
        Static spells by command make landmarks: the encounters of that biobot whose centre lies in the spell are one place ([Dir16]
        eq. 5, 7). Walking spells carry no information here.
    moving_time
        Weigh an edge by the time its biobot spent walking in between, in place of the elapsed time.

    Notes
    -----
    A biobot with several commanded spells makes one place for each. Spells that touch or overlap count as one.
    Weights are exact up to 2**53 ticks (52 days); longer ones are rounded to float64.
    """
    n = len(table)
    origin = int(table.t_start_ns.min()) if n else 0
    centre = (table.t_start_ns - origin) + (table.t_end_ns - origin)
    biobots, biobot_of = np.unique(np.concatenate([table.id1, table.id2]), return_inverse=True)
    encounter_of = np.tile(np.arange(n), 2)
    order = np.lexsort((encounter_of, centre[encounter_of], biobot_of))
    biobot_of, encounter_of = biobot_of[order], encounter_of[order]
    clock = centre[encounter_of].copy()
    place = np.full(2 * n, -1, dtype=np.int64)
    rows_of = _rows_of_biobots(biobot_of, len(biobots))
    last_ns = int(table.t_end_ns.max()) if n else 0
    n_places = 0
    for index, static, commanded in _static_spells(spells, biobots, origin=origin, last_ns=last_ns):
        rows = rows_of[index]
        at = clock[rows].copy()
        spell = np.searchsorted(commanded[:, 0], at, side="right") - 1
        inside = (spell >= 0) & (at <= commanded[spell, 1]) if len(commanded) else np.zeros(len(at), dtype=bool)
        place[rows] = np.where(inside, n_places + spell, -1)
        n_places += len(commanded)
        if moving_time:
            clock[rows] = at - _time_inside(static, at)
    return _contract(
        n=n,
        encounter_of=encounter_of,
        is_chained=biobot_of[1:] == biobot_of[:-1],
        step=np.diff(clock),
        is_one_place=(place[1:] >= 0) & (place[1:] == place[:-1]),
        landmark_encounters=encounter_of[place >= 0],
    )


def split_components(graph: EncounterGraph) -> tuple[EncounterGraph, ...]:
    """Take the connected components apart, the one with most encounters first; ties go to the earlier first encounter."""
    n_components, label = connected_components(graph.weights, directed=False)
    if n_components <= 1:
        return (graph,) if graph.n_vertices else ()
    size = np.bincount(label, weights=graph.multiplicity, minlength=n_components)
    members = np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))[:-1])
    is_landmark = np.zeros(graph.n_vertices, dtype=bool)
    is_landmark[graph.landmarks] = True
    # Sorted by component the matrix is block diagonal; each block is cut out without a look at the others.
    blocks = csr_array(graph.weights[np.concatenate(members)][:, np.concatenate(members)])
    ends = np.cumsum([len(inside) for inside in members])
    parts = []
    for component in sorted(range(n_components), key=lambda c: (-size[c], members[c][0])):
        inside, end = members[component], int(ends[component])
        begin = end - len(inside)
        edges = slice(blocks.indptr[begin], blocks.indptr[end])
        rows = blocks.indptr[begin : end + 1] - blocks.indptr[begin]
        parts.append(
            EncounterGraph(
                weights=csr_array((blocks.data[edges], blocks.indices[edges] - begin, rows), shape=(len(inside), len(inside))),
                first_encounter=graph.first_encounter[inside],
                multiplicity=graph.multiplicity[inside],
                landmarks=np.flatnonzero(is_landmark[inside]),
            )
        )
    return tuple(parts)


def _rows_of_biobots(biobot_of: IntArray, n_biobots: int) -> list[slice]:
    bounds = np.searchsorted(biobot_of, np.arange(n_biobots + 1))
    return [slice(a, b) for a, b in pairwise(bounds.tolist())]


def _static_spells(
    spells: Sequence[ModeSpell], biobots: IntArray, *, origin: int, last_ns: int
) -> Iterable[tuple[int, IntArray, IntArray]]:
    """Yield index of a biobot, its static spells and its commanded ones, merged, as (m, 2) [ticks since ``origin``]."""
    index_of = {int(node): index for index, node in enumerate(biobots)}
    static: dict[int, list[tuple[int, int]]] = {}
    commanded: dict[int, list[tuple[int, int]]] = {}
    for spell in spells:
        index = index_of.get(int(spell.node))
        if index is None or spell.mode is not Mode.S:
            continue
        end_ns = last_ns if spell.t_end_ns is None else min(spell.t_end_ns, last_ns)
        interval = (2 * (max(spell.t_start_ns, origin) - origin), 2 * (end_ns - origin))
        if interval[0] <= interval[1]:
            static.setdefault(index, []).append(interval)
            if spell.cause is Cause.COMMAND:
                commanded.setdefault(index, []).append(interval)
    for index in sorted(static):
        yield index, _merge(static[index]), _merge(commanded.get(index, []))


def _merge(intervals: list[tuple[int, int]]) -> IntArray:
    merged: list[list[int]] = []
    for begin, end in sorted(intervals):
        if merged and begin <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], end)
        else:
            merged.append([begin, end])
    return np.array(merged, dtype=np.int64).reshape(-1, 2)


def _time_inside(intervals: IntArray, at: IntArray) -> IntArray:
    """Measure how much of the time up to each instant lies inside disjoint sorted intervals."""
    begin, end = intervals[:, 0], intervals[:, 1]
    before = np.concatenate([[0], np.cumsum(end - begin)])
    started = np.searchsorted(begin, at, side="right")
    last = np.maximum(started - 1, 0)
    running = np.minimum(at, end[last]) - begin[last]
    return np.where(started > 0, before[last] + running, 0)


def _contract(
    *, n: int, encounter_of: IntArray, is_chained: BoolArray, step: IntArray, is_one_place: BoolArray, landmark_encounters: IntArray
) -> EncounterGraph:
    here, there = encounter_of[:-1], encounter_of[1:]
    is_zero = is_chained & (is_one_place | (step == 0))
    same = coo_array((np.ones(int(is_zero.sum()), dtype=bool), (here[is_zero], there[is_zero])), shape=(n, n))
    _, label = connected_components(same, directed=False)
    _, first, vertex_of = np.unique(label, return_index=True, return_inverse=True)
    # Vertices are numbered by their earliest encounter, so that "lowest index" means "earliest".
    rank = np.empty(len(first), dtype=np.int64)
    by_first = np.argsort(first)
    rank[by_first] = np.arange(len(first))
    vertex_of = rank[vertex_of]
    is_edge = is_chained & ~is_zero
    a, b = vertex_of[here[is_edge]], vertex_of[there[is_edge]]
    return EncounterGraph(
        weights=_symmetric_minimum(np.minimum(a, b), np.maximum(a, b), step[is_edge].astype(np.float64), n_vertices=len(first)),
        first_encounter=first[by_first].astype(np.int64),
        multiplicity=np.bincount(vertex_of, minlength=len(first)).astype(np.int64),
        landmarks=np.unique(vertex_of[landmark_encounters]),
    )


def _symmetric_minimum(low: IntArray, high: IntArray, weight: FloatArray, *, n_vertices: int) -> csr_array[np.float64]:
    """Keep the lightest of parallel edges (scipy would add them up) and store each edge both ways."""
    proper = low != high
    low, high, weight = low[proper], high[proper], weight[proper]
    order = np.lexsort((weight, high, low))
    low, high, weight = low[order], high[order], weight[order]
    is_first = np.ones(len(low), dtype=bool)
    is_first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    low, high, weight = low[is_first], high[is_first], weight[is_first]
    rows, columns = np.concatenate([low, high]), np.concatenate([high, low])
    return csr_array(coo_array((np.tile(weight, 2), (rows, columns)), shape=(n_vertices, n_vertices)))
