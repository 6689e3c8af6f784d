"""Encounters to a graph: vertices are places in space-time, edges the time a biobot took from one to the next.

The definition ([Dir16] eq. 6-7) joins *every* two encounters that share a biobot. The graph here gives the same shortest paths with at
most 2n edges: the sums along one biobot's encounters telescope, so only consecutive ones are joined; and what lies at
distance zero (a landmark's community, equal times, a stop) is contracted to one vertex.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from mapper.kernels import Contraction, Kernels, Links, Rows, Stands, VertexArray, choose_kernels
from mapper.types import BoolArray, EncounterTable, IntArray, ModeSpell


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncounterGraph:
    """Contracted encounter graph of n encounters and v vertices.

    Attributes
    ----------
    rows
        Edges by vertex, both ways, each once; times [ticks], whole numbers held as float64.
    links
        The same steps in the order of time, for sweeps.
    first_encounter
        Row in the encounter table of the earliest encounter of each vertex, shape (v,), strictly ascending.
    multiplicity
        How many encounters each vertex stands for, shape (v,).
    landmarks
        Vertices at which a landmark stood, shape (l,), ascending. Landmarks that met while standing share one.
    stands
        Who stood at each when it was first met there, and from when to when [ticks since the first encounter of all]: shape (l, 3).
    kernels
        What computes on it.
    """

    rows: Rows
    links: Links
    first_encounter: VertexArray
    multiplicity: VertexArray
    landmarks: IntArray
    stands: IntArray
    kernels: Kernels

    @property
    def n_vertices(self) -> int:
        """Count the vertices."""
        return len(self.first_encounter)

    @property
    def n_encounters(self) -> int:
        """Count the encounters that the vertices stand for."""
        return int(self.multiplicity.sum())

    def busiest_landmarks(self, limit: int) -> IntArray:
        """Return no more than so many of the landmarks, ascending: those with most encounters, of equals the earlier."""
        if len(self.landmarks) <= limit:
            return self.landmarks
        busiest = np.argsort(-self.multiplicity[self.landmarks], kind="stable")[:limit]
        return np.sort(self.landmarks[busiest])


class Components(Sequence[EncounterGraph]):
    """The connected components of a graph, the one with most encounters first; each is cut out when it is asked for.

    ``sizes`` are their encounters. Components with as many are in the order of their first encounters.
    """

    def __init__(self, whole: Contraction, kernels: Kernels, stands: IntArray) -> None:
        self._whole = whole
        self._stands = stands
        self._kernels = kernels
        by_number = np.bincount(whole.component, weights=whole.multiplicity).astype(np.int64)
        # Numbers follow the first vertices, so a stable order gives ties to the earlier.
        self._numbers = np.argsort(-by_number, kind="stable")
        self.sizes: list[int] = by_number[self._numbers].tolist()

    @property
    def has_landmarks(self) -> bool:
        """Say whether any component has a landmark."""
        return bool(self._whole.is_landmark.any())

    def locate(self, encounters: IntArray) -> tuple[IntArray, IntArray]:
        """Say where some encounters, shape (k,), are: number of the component, and vertex within it, shape (k,) each."""
        vertices = self._whole.vertex_of[encounters]
        rank = np.empty(len(self._numbers), dtype=np.int64)
        rank[self._numbers] = np.arange(len(self._numbers))
        numbers = self._whole.component
        order = np.argsort(numbers, kind="stable")
        begins = np.searchsorted(numbers[order], np.arange(len(self._numbers)))
        within = np.empty(len(numbers), dtype=np.int64)
        within[order] = np.arange(len(numbers)) - begins[numbers[order]]
        return rank[numbers[vertices]], within[vertices]

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> EncounterGraph: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[EncounterGraph, ...]: ...
    def __getitem__(self, index: int | slice) -> EncounterGraph | tuple[EncounterGraph, ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        return self._cut_out(int(self._numbers[index]))

    def __iter__(self) -> Iterator[EncounterGraph]:
        return (self[i] for i in range(len(self)))

    def _cut_out(self, number: int) -> EncounterGraph:
        whole, rows, links = self._whole, self._whole.rows, self._whole.links
        if len(self) > 1:
            is_inside = whole.component == number
            new_number = np.cumsum(is_inside, dtype=np.int32) - np.int32(1)
            degrees = np.diff(rows.starts)
            is_edge, is_link = np.repeat(is_inside, degrees), is_inside[links.sources]
            rows = Rows(
                starts=np.concatenate([[0], np.cumsum(degrees[is_inside])]).astype(np.int64),
                neighbours=new_number[rows.neighbours[is_edge]],
                times=rows.times[is_edge],
            )
            links = select_links(links, is_link, new_number)
        else:
            is_inside = np.ones(len(whole.component), dtype=bool)
        return EncounterGraph(
            rows=rows,
            links=links,
            first_encounter=whole.first_encounter[is_inside],
            multiplicity=whole.multiplicity[is_inside],
            landmarks=np.flatnonzero(whole.is_landmark[is_inside]),
            stands=self._stands[is_inside[whole.is_landmark]],
            kernels=self._kernels,
        )


def select_links(links: Links, is_chosen: BoolArray, new_number: VertexArray) -> Links:
    """Take some of the links, shape (k,), between vertices numbered anew, shape (v,); a link whose one before is not taken has none."""
    number = np.where(is_chosen, np.cumsum(is_chosen, dtype=np.int32) - np.int32(1), np.int32(-1))
    before = links.before[is_chosen]
    return Links(
        sources=new_number[links.sources[is_chosen]],
        targets=new_number[links.targets[is_chosen]],
        times=links.times[is_chosen],
        before=np.where(before < 0, np.int32(-1), number[before]),
    )


def build_components(
    table: EncounterTable, spells: Sequence[ModeSpell], *, moving_time: bool, kernels: Kernels | None = None
) -> Components:
    """Join the encounters that follow each other for one biobot, contract those at distance zero, and take the components apart.

    Parameters
    ----------
    spells
        Static spells by command make landmarks: the encounters of that biobot whose centre lies in the spell are one place ([Dir16]
        eq. 5, 7). Walking spells carry no information here.
    moving_time
        Weigh an edge by the time its biobot spent walking in between, in place of the elapsed time.
    kernels
        What computes on the graphs; None takes the best there are.

    Notes
    -----
    A biobot with several commanded spells makes one place for each. Spells that touch or overlap count as one.
    Times are exact up to 2**53 ticks (52 days); longer ones are rounded to float64.
    """
    kernels = kernels or choose_kernels()
    origin = int(table.t_start_ns.min()) if len(table) else 0
    last_ns = int(table.t_end_ns.max()) if len(table) else 0
    centres = (table.t_start_ns - origin) + (table.t_end_ns - origin)
    still, commanded = _static_spells(spells, origin=origin, last_ns=last_ns)
    whole = kernels.contract(centres, table.id1, table.id2, still=still, commanded=commanded, moving_time=moving_time)
    rows = whole.first_encounter[whole.is_landmark]
    return Components(whole, kernels, _find_stands(centres[rows], table.id1[rows], table.id2[rows], commanded))


def _static_spells(spells: Sequence[ModeSpell], *, origin: int, last_ns: int) -> tuple[Stands, Stands]:
    """Return all static spells, and the commanded ones, merged."""
    static: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    commanded: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    for spell in spells:
        if spell.mode is not Mode.S:
            continue
        end_ns = last_ns if spell.t_end_ns is None else min(spell.t_end_ns, last_ns)
        interval = (2 * (max(spell.t_start_ns, origin) - origin), 2 * (end_ns - origin))
        if interval[0] <= interval[1]:
            static[spell.node].append(interval)
            if spell.cause is Cause.COMMAND:
                commanded[spell.node].append(interval)
    return _stands(static), _stands(commanded)


def _find_stands(centres: IntArray, id1: IntArray, id2: IntArray, commanded: Stands) -> IntArray:
    """Find the commanded stand that holds each of some encounters, shape (l,); the longer of two. As ``EncounterGraph.stands``."""
    found = np.zeros((len(centres), 3), dtype=np.int64)
    for row, (centre, nodes) in enumerate(zip(centres.tolist(), zip(id1.tolist(), id2.tolist(), strict=True), strict=True)):
        for node in nodes:
            first, last = np.searchsorted(commanded.nodes, [node, node + 1])
            place = int(np.searchsorted(commanded.begins[first:last], centre, side="right")) + int(first) - 1
            if place >= first and commanded.ends[place] >= centre:
                begin, end = int(commanded.begins[place]), int(commanded.ends[place])
                if end - begin >= found[row, 2] - found[row, 1]:
                    found[row] = node, begin, end
    return found


def _stands(intervals_of: dict[int, list[tuple[int, int]]]) -> Stands:
    rows = [(node, begin, end) for node in sorted(intervals_of) for begin, end in _merge(intervals_of[node])]
    columns = np.array(rows, dtype=np.int64).reshape(-1, 3)
    return Stands(nodes=columns[:, 0], begins=columns[:, 1], ends=columns[:, 2])


def _merge(intervals: list[tuple[int, int]]) -> list[list[int]]:
    merged: list[list[int]] = []
    for begin, end in sorted(intervals):
        if merged and begin <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], end)
        else:
            merged.append([begin, end])
    return merged
