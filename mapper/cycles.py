"""Shortest closed paths in a graph with marked edges."""

import numpy as np
from numpy.typing import NDArray

from mapper.types import BoolArray, FloatArray, IntArray

_Indices = NDArray[np.int32]


def shortest_odd_cycle(ends: IntArray, lengths: FloatArray, is_odd: BoolArray, *, n_points: int) -> IntArray:
    """Find the shortest closed path with an odd number of marked edges.

    Parameters
    ----------
    ends
        Both points of every edge, shape (e, 2), each edge once.
    lengths
        Shape (e,), above 0.
    is_odd
        Which edges are marked, shape (e,).
    n_points
        Points are numbered from 0 to this, less one.

    Returns
    -------
    IntArray
        The points in order, not closed, each once: beginning with the lowest, then the lower of its two neighbours on the path.

    Raises
    ------
    ValueError
        Every closed path has an even number of marked edges.

    Notes
    -----
    Each point is taken twice, and a marked edge leads from one copy to the other: a closed path with an odd number of them is a path from
    a point to its other copy. Every such path has an end of a marked edge, so the ends that cover all marked edges are enough to begin
    at. Marking the other edges of a point in place of those that are marked changes no closed path; it is done while it saves marks.
    Of paths of equal length that from the lowest beginning counts.
    """
    from scipy.sparse import csr_array  # noqa: PLC0415  # a third of a second that no service has to wait for when it starts
    from scipy.sparse.csgraph import dijkstra  # noqa: PLC0415  # same

    is_odd = _save_marks(ends, is_odd, n_points=n_points)
    doubled: csr_array = csr_array(_double(ends, lengths, is_odd, n_points=n_points), shape=(2 * n_points, 2 * n_points))
    best, shortest = None, np.inf
    for point in _cover(ends[is_odd], n_points=n_points):
        length, before = dijkstra(doubled, indices=np.array([point]), return_predecessors=True, limit=shortest)
        if length[0, point + n_points] < shortest:
            best, shortest = _path(before[0], point, point + n_points) % n_points, float(length[0, point + n_points])
    if best is None:
        raise ValueError(
            f"no closed path has an odd number of the {int(is_odd.sum())} marked edges; mark those of a cocycle of an open loop"
        )
    best = np.roll(best, -int(best.argmin()))
    return best if best[1] < best[-1] else np.roll(best[::-1], 1)


def _double(ends: IntArray, lengths: FloatArray, is_odd: BoolArray, *, n_points: int) -> tuple[FloatArray, _Indices, _Indices]:
    """Make the sparse matrix of two copies of every point, by rows; sorted here, it saves what scipy does for edges in any order."""
    a, b = ends.astype(np.int32).T
    across = np.where(is_odd, np.int32(n_points), np.int32(0))
    begin, end = np.concatenate([a, a + n_points]), np.concatenate([b + across, b + n_points - across])
    begin, end = np.concatenate([begin, end]), np.concatenate([end, begin])
    order = np.argsort(begin, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(begin, minlength=2 * n_points))])
    return np.tile(lengths, 4)[order], end[order], first.astype(np.int32)


def _save_marks(ends: IntArray, is_odd: BoolArray, *, n_points: int) -> BoolArray:
    """Swap marked and other edges of one point after the other while that leaves fewer marked."""
    degree = np.bincount(ends.ravel(), minlength=n_points)
    while True:
        saved = 2 * np.bincount(ends[is_odd].ravel(), minlength=n_points) - degree
        point = int(saved.argmax())
        if saved[point] <= 0:
            return is_odd
        is_odd = is_odd ^ (ends[:, 0] == point) ^ (ends[:, 1] == point)


def _cover(marked: IntArray, *, n_points: int) -> list[int]:
    """Choose points so that every marked edge has one of them, busiest first; return them in ascending order."""
    chosen = []
    while len(marked):
        chosen.append(int(np.bincount(marked.ravel(), minlength=n_points).argmax()))
        marked = marked[(marked[:, 0] != chosen[-1]) & (marked[:, 1] != chosen[-1])]
    return sorted(chosen)


def _path(before: NDArray[np.int32], begin: int, end: int) -> IntArray:
    """Follow predecessors from the end to the beginning; the beginning itself is left out."""
    path = [end]
    while (previous := int(before[path[-1]])) != begin:
        path.append(previous)
    return np.array(path, dtype=np.int64)
