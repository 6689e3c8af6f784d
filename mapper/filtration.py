"""The order in which the edges of a Rips complex enter: by length, and one after the other where lengths are equal."""

from dataclasses import dataclass

import numpy as np

from mapper.types import FloatArray, IntArray

# Sort keys hold a length in their upper and an edge's number in their lower bits; one more bit is the sign.
_KEY_BITS = 62


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Filtration:
    """Edges up to the enclosing radius, numbered from 1 in the order in which they enter; no two share a number.

    Parameters
    ----------
    edges
        ``edges[r - 1]`` is the edge of rank r: ``row * m + column`` with row > column, shape (e,).
    ranks
        Shape (m, m): rank of the edge between row and column below the diagonal, e + 1 for edges that never enter; 0 elsewhere.
    """

    edges: IntArray
    ranks: FloatArray

    @property
    def n_edges(self) -> int:
        """How many edges enter, which is the last rank."""
        return len(self.edges)

    def ends(self, rank: IntArray) -> IntArray:
        """Both points of the edges of given ranks, shape (k,): the smaller in column 0, the larger in column 1, shape (k, 2)."""
        larger, smaller = np.divmod(self.edges[rank - 1], len(self.ranks))
        return np.column_stack([smaller, larger])

    def between(self, one: IntArray, other: IntArray) -> IntArray:
        """Ranks of the edges between points, shape (k,), in either order; e + 1 where the edge never enters."""
        ranks: IntArray = self.ranks[np.maximum(one, other), np.minimum(one, other)].astype(np.int64)
        return ranks


def order_edges(distances: FloatArray) -> Filtration:
    """Number the edges of a complex in the order in which they enter.

    Parameters
    ----------
    distances
        Shape (m, m), symmetric, finite, zero diagonal; m at least 1. What is below the diagonal is read.

    Notes
    -----
    Only edges up to the enclosing radius ``min_i max_j d_ij`` enter: with them the complex is a cone and has no loops left.
    Of edges of equal length the one with the lower larger point comes first, then the one with the lower smaller point.

    With every edge at a place of its own, so is every birth and death of persistence, and each names the edge that causes it; which
    library paired them, and in which precision it counts, makes no difference. Ranks are exact in single precision up to 2^24 edges,
    that is with 5792 points. Lengths read back through the edges are those of the unnumbered filtration [Bau21]: intervals whose ends
    are different edges of one length have no length and are dropped.
    """
    m = len(distances)
    flat = np.ascontiguousarray(distances).ravel()
    radius = float(distances.max(axis=1).min())
    entering = np.flatnonzero(np.tril(distances <= radius, -1))
    edges = entering[_sort_stably(flat[entering], radius)]
    ranks = np.tril(np.full((m, m), len(edges) + 1.0), -1)
    ranks.ravel()[edges] = np.arange(1.0, len(edges) + 1.0)
    return Filtration(edges=edges, ranks=ranks)


def _sort_stably(lengths: FloatArray, longest: float) -> IntArray:
    """Sort lengths from 0 to ``longest``; equal ones stay in order. Does what a stable argsort does, in half its time."""
    if longest == 0:
        return np.arange(len(lengths))
    # Numbers sort faster than indices to them, so length and index share a number; which lengths are then one is checked below.
    bits = len(lengths).bit_length()
    keys = (lengths / longest * 2.0 ** (_KEY_BITS - bits)).astype(np.int64)
    keys <<= bits
    keys |= np.arange(len(lengths))
    keys.sort()
    keys &= (1 << bits) - 1
    ordered = lengths[keys]
    return keys if (ordered[1:] >= ordered[:-1]).all() else np.argsort(lengths, kind="stable")
