"""Geodesics: lengths of shortest paths within an arena, exact but for rounding.

A shortest path runs straight from corner to corner and turns only at corners that stick into the arena. Which of those see each other
is found once; then a search from every point by the corners it sees is enough.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from simulator.arenas.arena import Arena
from simulator.arenas.visibility import Bools, Floats, Indices, Viewpoints, Visibility

# Pairs of points looked at in one block: bounds memory to some tens of megabytes beside the result.
_BLOCK = 250_000
# Points times corners for which the ways from all to all are held at once: some hundred megabytes.
_MAX_TREES = 10_000_000

_SHORTEST = 1e-300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Edges:
    """Straight ways between two lists of points: rows in each, shape (k,), in ascending order of ``i``, and lengths [length]."""

    i: Indices
    j: Indices
    length: Floats


_NO_EDGES = _Edges(i=np.zeros(0, dtype=np.int64), j=np.zeros(0, dtype=np.int64), length=np.zeros(0))


class Geodesics:
    """Shortest-path distances within one arena; knows which of its corners see each other.

    Parameters
    ----------
    arena
        Any number of parts and holes.

    Notes
    -----
    Paths may run along walls and touch them. Where walls only touch in a point no path goes through; a point exactly there belongs to
    all sides, so that the triangle inequality does not hold across it.
    Doubles limit the accuracy to about 1e-11 of the arena's extent.
    """

    __slots__ = ("_between_corners", "_corners", "_visibility")

    def __init__(self, arena: Arena) -> None:
        self._visibility = Visibility(arena)
        self._corners = self._visibility.turning_corners()
        useful = self._visibility.can_turn(self._corners, self._corners)
        n = len(self._corners.xy)
        block = max(1, _BLOCK // max(1, n))
        found = [_NO_EDGES]
        for k in range(0, n, block):
            wanted = np.triu(useful[k : k + block] & useful[:, k : k + block].T, k=k + 1)
            found.append(self._find_edges(self._corners, self._corners, wanted=wanted, first_row=k))
        self._between_corners = _join_edges(found)

    def distances(self, points_a: Floats, points_b: Floats | None = None) -> Floats:
        """Measure from each of some points to each of others, or of the same.

        Parameters
        ----------
        points_a, points_b
            Shapes (n, 2) and (m, 2) [length], in the closed arena: on a wall and in a corner is inside. None takes ``points_a`` again.

        Returns
        -------
        Floats
            Shape (n, m) [length]; inf between points of different components. With one set of points it is symmetric with zero diagonal.

        Raises
        ------
        OutsideArenaError
            A point lies outside, or is not finite.
        """
        one = self._visibility.look_from(np.ascontiguousarray(points_a, dtype=np.float64).reshape(-1, 2))
        if points_b is None:
            lengths = self._join(one, one, is_same=True)
            lengths = np.minimum(lengths, lengths.T)
            np.fill_diagonal(lengths, 0.0)
            return lengths
        return self._join(one, self._visibility.look_from(np.ascontiguousarray(points_b, dtype=np.float64).reshape(-1, 2)), is_same=False)

    def _join(self, one: Viewpoints, other: Viewpoints, *, is_same: bool) -> Floats:
        if len(one.xy) > len(other.xy):
            return self._join(other, one, is_same=False).T
        lengths = np.full((len(one.xy), len(other.xy)), np.inf)
        block = max(1, _BLOCK // max(1, len(other.xy)))
        for k in range(0, len(one.xy), block):
            wanted = np.ones((min(block, len(one.xy) - k), len(other.xy)), dtype=bool)
            straight = self._find_edges(one, other, wanted=np.triu(wanted, k=k + 1) if is_same else wanted, first_row=k)
            lengths[straight.i, straight.j] = straight.length
        if len(self._corners.xy):
            to_corners = self._look_for_corners(other)
            self._go_round_corners(to_corners if is_same else self._look_for_corners(one), to_corners, lengths=lengths)
        return lengths

    def _find_edges(self, one: Viewpoints, other: Viewpoints, *, wanted: Bools, first_row: int) -> _Edges:
        """Find the straight ways from rows ``first_row`` and on of the one to the other, where wanted and where nothing is in the way."""
        i, j = np.nonzero(wanted)
        i += first_row
        seen = self._visibility.sees(one, other, i=i, j=j)
        i, j = i[seen], j[seen]
        return _Edges(i=i, j=j, length=_distance(one.xy[i], other.xy[j]))

    def _look_for_corners(self, points: Viewpoints) -> _Edges:
        useful = self._visibility.can_turn(points, self._corners)
        block = max(1, _BLOCK // len(self._corners.xy))
        starts = range(0, len(points.xy), block)
        return _join_edges(
            [_NO_EDGES] + [self._find_edges(points, self._corners, wanted=useful[k : k + block], first_row=k) for k in starts]
        )

    def _go_round_corners(self, from_one: _Edges, from_other: _Edges, *, lengths: Floats) -> None:
        """Lower ``lengths`` (n, m) to the best way by one corner or more; the other two lead from its rows and columns to corners."""
        n_corners = len(self._corners.xy)
        first_of = np.searchsorted(from_other.i, np.arange(lengths.shape[1] + 1))
        block = max(1, _MAX_TREES // (n_corners + 1))
        for k in range(0, len(lengths), block):
            rows = np.arange(k, min(k + block, len(lengths)))
            to_corners = self._measure_to_corners(from_one, rows=rows)
            for column in range(lengths.shape[1]):
                last = slice(first_of[column], first_of[column + 1])
                if last.start < last.stop:
                    ways = to_corners[:, from_other.j[last]] + from_other.length[last]
                    lengths[rows, column] = np.minimum(lengths[rows, column], ways.min(axis=1))

    def _measure_to_corners(self, edges: _Edges, *, rows: Indices) -> Floats:
        """Measure the shortest way from points to all corners, shape (rows, n_corners), given those of the first leg."""
        n_corners = len(self._corners.xy)
        between = self._between_corners
        own = slice(*np.searchsorted(edges.i, [rows[0], rows[-1] + 1]))
        tail = np.concatenate([between.i, between.j, n_corners + edges.i[own] - rows[0]])
        head = np.concatenate([between.j, between.i, edges.j[own]])
        # A point in a corner is no way from it, but a sparse matrix takes 0 for no edge.
        length = np.maximum(np.concatenate([between.length, between.length, edges.length[own]]), _SHORTEST)
        size = n_corners + rows.size
        graph = csr_array((length, (tail, head)), shape=(size, size))
        lengths: Floats = dijkstra(graph, indices=np.arange(n_corners, size))
        return lengths[:, :n_corners]


def geodesic_distances(arena: Arena, points_a: Floats, points_b: Floats | None = None) -> Floats:
    """Measure shortest paths within an arena once; see ``Geodesics`` to ask more than once."""
    return Geodesics(arena).distances(points_a, points_b)


def _join_edges(found: list[_Edges]) -> _Edges:
    return _Edges(
        i=np.concatenate([one.i for one in found]),
        j=np.concatenate([one.j for one in found]),
        length=np.concatenate([one.length for one in found]),
    )


def _distance(one: Floats, other: Floats) -> Floats:
    difference = one - other
    return np.asarray(np.sqrt(difference[:, 0] ** 2 + difference[:, 1] ** 2))
