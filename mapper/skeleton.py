"""The Rips complex as it is drawn: its edges and triangles at one scale."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapper.types import FloatArray, IntArray

# Entries of the table of third corners that are looked at in one block; keeps it in the processor's cache.
_BLOCK = 1 << 17
# Of a map of many points on average: more give millions of triangles, which nobody can look at, and take gigabytes.
_EDGES_OF_A_POINT = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Skeleton:
    """Edges, shape (e, 2), and triangles, shape (t, 3): ascending indices of points, in lexicographic order."""

    edges: IntArray
    triangles: IntArray


NO_SKELETON = Skeleton(edges=np.empty((0, 2), dtype=np.int64), triangles=np.empty((0, 3), dtype=np.int64))


def build_skeleton(distances: FloatArray, *, epsilon: float) -> Skeleton:
    """Join points at most ``epsilon`` apart; three points in pairs are a triangle.

    Parameters
    ----------
    distances
        Shape (m, m), symmetric, in the unit of ``epsilon``.
    """
    is_near = np.triu(distances <= epsilon, k=1)
    edges = np.argwhere(is_near).astype(np.int64)
    triangles = [np.empty((0, 3), dtype=np.int64)]
    for begin in range(0, len(edges), block := max(1, _BLOCK // len(distances))):
        i, j = edges[begin : begin + block].T
        edge, third = np.nonzero(is_near[i] & is_near[j])
        triangles.append(np.column_stack([i[edge], j[edge], third]))
    return Skeleton(edges=edges, triangles=np.concatenate(triangles))


def choose_epsilon(real_loops: FloatArray, other_loops: FloatArray, merges: FloatArray) -> float:
    """Choose a scale at which the holes found are open, and where it can be, the other loops closed.

    Parameters
    ----------
    real_loops, other_loops
        Birth and death of the holes called real and of the other loops, shape (m, 2).
    merges
        Scales at which components merge, shape (m,).

    Notes
    -----
    Half way between the last birth and the first death of the real holes; their last birth where they do not live at one time.
    With no hole: the scale at which everything is joined and every loop closed.
    """
    if len(real_loops) == 0:
        return _largest([*merges, *other_loops[:, 1]])
    last_birth, first_death = float(real_loops[:, 0].max()), float(real_loops[:, 1].min())
    return (last_birth + first_death) / 2 if last_birth < first_death else last_birth


def limit_epsilon(distances: FloatArray, epsilon: float) -> float:
    """Take a smaller scale where more than 20 edges a point would be drawn at this one.

    Parameters
    ----------
    distances
        Shape (m, m), symmetric.
    """
    m = len(distances)
    lengths = distances[np.triu_indices(m, k=1)]
    last = _EDGES_OF_A_POINT * m
    return epsilon if last >= len(lengths) else min(epsilon, float(np.partition(lengths, last - 1)[last - 1]))


def _largest(values: Sequence[float]) -> float:
    return float(max(values, default=0.0))
