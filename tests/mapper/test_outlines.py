"""Outlines are shortest paths around one hole each, found by cocycles that are cocycles."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.cocycles import annotate_edges
from mapper.cycles import shortest_odd_cycle
from mapper.outlines import outline_holes
from mapper.persistence import Diagram, rips_persistence
from mapper.types import FloatArray, IntArray
from tests.mapper.distance_matrices import matrices


def _between(points: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(*(np.subtract.outer(at, at) for at in points.T)), dtype=np.float64)


def _ring(n: int) -> FloatArray:
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _rank(diagram: Diagram, i: int, j: int) -> int:
    return int(diagram.filtration.ranks[max(i, j), min(i, j)])


@given(matrices(most=25), st.data())
def test_annotations_make_a_cocycle_of_every_open_loop(distances: FloatArray, data: st.DataObject) -> None:
    diagram = rips_persistence(distances)
    if not len(diagram.loop_ranks):
        return
    first, filled = diagram.loop_ranks[data.draw(st.integers(0, len(diagram.loop_ranks) - 1))].tolist()
    last = data.draw(st.integers(first, filled - 1))
    annotation = annotate_edges(diagram.filtration, diagram.loop_ranks, first_rank=first, last_rank=last)
    born = diagram.loop_ranks[(diagram.loop_ranks[:, 0] >= first) & (diagram.loop_ranks[:, 0] <= last)]
    assert annotation.closing.tolist() == born[:, 0].tolist()
    assert annotation.open_bits == np.flatnonzero(born[:, 1] > last).tolist()
    triangles = [
        ranks
        for triple in combinations(range(len(distances)), 3)
        if max(ranks := [_rank(diagram, i, j) for i, j in combinations(triple, 2)]) <= last
    ]
    for bit in annotation.open_bits:
        cocycle = np.concatenate([np.zeros(first, dtype=bool), annotation.weigh(1 << bit)])
        assert not any(cocycle[triangle].sum() % 2 for triangle in triangles)
        assert annotation.closing[annotation.open_bits][cocycle[annotation.closing[annotation.open_bits]]].tolist() == [
            annotation.closing[bit]
        ]


@given(matrices(most=25))
def test_every_loop_has_an_outline_within_its_life(distances: FloatArray) -> None:
    diagram = rips_persistence(distances)
    rows = np.arange(len(diagram.intervals[1]))
    filled = dict(diagram.loop_ranks.tolist())
    for edge, outline in zip(diagram.birth_edges.tolist(), outline_holes(distances, diagram, rows), strict=True):
        assert len(set(outline.tolist())) == len(outline) >= 4
        assert outline[0] == outline.min()
        assert outline[1] < outline[-1]
        assert diagram.filtration.between(outline, np.roll(outline, -1)).max() < filled[_rank(diagram, *edge)]


def _shortest_odd_length(ends: IntArray, lengths: FloatArray, is_odd: list[bool], n: int) -> float:
    """Floyd and Warshall over points and the parity of marks on the way."""
    ways = np.full((2 * n, 2 * n), np.inf)
    for (i, j), length, odd in zip(ends.tolist(), lengths.tolist(), is_odd, strict=True):
        for a, b in ((i, j + n * odd), (i + n, j + n * (not odd))):
            ways[a, b] = ways[b, a] = min(ways[a, b], length)
    for k in range(2 * n):
        ways = np.minimum(ways, ways[:, k, None] + ways[None, k, :])
    return float(ways[np.arange(n), np.arange(n) + n].min())


@given(st.integers(2, 7), st.data())
def test_the_shortest_odd_cycle_is_found(n: int, data: st.DataObject) -> None:
    edges = data.draw(st.lists(st.sampled_from(list(combinations(range(n), 2))), unique=True, min_size=1))
    ends = np.array(edges)
    lengths = np.array(data.draw(st.lists(st.integers(1, 9), min_size=len(edges), max_size=len(edges))), dtype=np.float64)
    is_odd = data.draw(st.lists(st.booleans(), min_size=len(edges), max_size=len(edges)))
    wanted = _shortest_odd_length(ends, lengths, is_odd, n)
    if np.isinf(wanted):
        with pytest.raises(ValueError, match="no closed path has an odd number"):
            shortest_odd_cycle(ends, lengths, np.array(is_odd), n_points=n)
        return
    cycle = shortest_odd_cycle(ends, lengths, np.array(is_odd), n_points=n).tolist()
    steps = [edges.index((min(step), max(step))) for step in zip(cycle, cycle[1:] + cycle[:1], strict=True)]
    assert lengths[steps].sum() == wanted
    assert sum(is_odd[step] for step in steps) % 2 == 1
    assert len(set(cycle)) == len(cycle)


def test_the_outline_of_a_ring_goes_around_it() -> None:
    """Neighbours are 15 degrees apart and chords of 120 fill the ring: half-way between, 45 degrees are the longest step there is."""
    distances = _between(_ring(24))
    (outline,) = outline_holes(distances, rips_persistence(distances), np.array([0]))
    assert len(outline) == 8
    assert set(np.diff(outline).tolist()) == {3}


def test_no_outline_goes_around_two_holes() -> None:
    """A frame of points with a sparser bar across: the loop that is born first goes around both halves, its outline around one."""
    across = np.arange(13.0)
    frame = [*((x, y) for x in across for y in (0.0, 6.0)), *((x, float(y)) for x in (0.0, 12.0) for y in range(1, 6))]
    points = np.array([*frame, *((5.0, y) for y in (1.2, 2.4, 3.6, 4.8))])
    distances = _between(points)
    diagram = rips_persistence(distances)
    outlines = outline_holes(distances, diagram, np.array([0, 1]))
    assert [sorted({bool(x > 5) for x in points[outline, 0] if x != 5}) for outline in outlines] in ([[False], [True]], [[True], [False]])


def test_without_holes_there_is_nothing_to_draw() -> None:
    assert outline_holes(1.0 - np.eye(3), rips_persistence(1.0 - np.eye(3)), np.empty(0, dtype=np.int64)) == ()
