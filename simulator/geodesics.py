"""Geodesics: lengths of shortest paths within an arena, exact but for rounding.

A shortest path runs straight from corner to corner and turns only at corners that stick into the arena, so the distances between
those corners, computed once, and what every point sees of them are enough.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from simulator.arena import Arena
from simulator.visibility import Bools, Floats, Viewpoints, Visibility

# Pairs of points looked at in one block: bounds memory to some tens of megabytes beside the result.
_BLOCK = 250_000


class Geodesics:
    """Shortest-path distances within one arena; knows those between its corners.

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
        i, j = np.nonzero(np.triu(useful & useful.T, k=1))
        seen = self._visibility.sees(self._corners, self._corners, i=i, j=j)
        i, j = i[seen], j[seen]
        n = len(self._corners.xy)
        edges = coo_array((_distance(self._corners.xy[i], self._corners.xy[j]), (i, j)), shape=(n, n))
        self._between_corners: Floats = dijkstra(edges.tocsr(), directed=False) if n else np.zeros((0, 0))

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
        lengths = np.full((len(one.xy), len(other.xy)), np.inf)
        block = max(1, _BLOCK // max(1, len(other.xy)))
        for k in range(0, len(one.xy), block):
            wanted = np.ones((min(block, len(one.xy) - k), len(other.xy)), dtype=bool)
            self._measure_in_sight(one, other, wanted=np.triu(wanted, k=k + 1) if is_same else wanted, first_row=k, lengths=lengths)
        if len(self._corners.xy):
            to_corners = self._measure_to_corners(other)
            from_corners = to_corners if is_same else self._measure_to_corners(one)
            for k in range(0, len(one.xy), block):
                self._go_round_corners(from_corners[k : k + block], to_corners, lengths=lengths[k : k + block])
        return lengths

    def _measure_in_sight(self, one: Viewpoints, other: Viewpoints, *, wanted: Bools, first_row: int, lengths: Floats) -> None:
        """Write straight distances into the rows of ``lengths`` from ``first_row`` on, where wanted and where nothing stands between."""
        i, j = np.nonzero(wanted)
        i += first_row
        seen = self._visibility.sees(one, other, i=i, j=j)
        i, j = i[seen], j[seen]
        lengths[i, j] = _distance(one.xy[i], other.xy[j])

    def _measure_to_corners(self, points: Viewpoints) -> Floats:
        to_corners = np.full((len(points.xy), len(self._corners.xy)), np.inf)
        useful = self._visibility.can_turn(points, self._corners)
        block = max(1, _BLOCK // len(self._corners.xy))
        for k in range(0, len(points.xy), block):
            self._measure_in_sight(points, self._corners, wanted=useful[k : k + block], first_row=k, lengths=to_corners)
        return to_corners

    def _go_round_corners(self, from_corners: Floats, to_corners: Floats, *, lengths: Floats) -> None:
        """Lower ``lengths`` (n, m) to the best way by one corner or more; the other two are distances to corners, (n, c) and (m, c)."""
        first = np.full_like(from_corners, np.inf)
        for corner in range(len(self._between_corners)):
            np.minimum(first, from_corners[:, corner, None] + self._between_corners[corner], out=first)
        for corner in range(len(self._between_corners)):
            np.minimum(lengths, first[:, corner, None] + to_corners[:, corner], out=lengths)


def geodesic_distances(arena: Arena, points_a: Floats, points_b: Floats | None = None) -> Floats:
    """Measure shortest paths within an arena once; see ``Geodesics`` to ask more than once."""
    return Geodesics(arena).distances(points_a, points_b)


def _distance(one: Floats, other: Floats) -> Floats:
    difference = one - other
    return np.asarray(np.sqrt(difference[:, 0] ** 2 + difference[:, 1] ** 2))
