"""Which loops of a Rips complex an edge takes part in: cocycles over Z/2, by annotation of its edges."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapper.filtration import Filtration
from mapper.types import BoolArray, IntArray

WordArray = NDArray[np.uint64]

_WORD = 64

# Entries of the table of third corners that are compared at a time; keeps it in the processor's cache.
_BLOCK = 1 << 17


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Annotation:
    """How the edges of a complex count towards its loops.

    Parameters
    ----------
    first_rank
        Rank of the first edge that is annotated: one that closes a loop. Older ones count for nothing.
    closing
        Ranks of the edges that close a loop, from ``first_rank`` to the last edge of the complex, ascending.
    bits
        Shape (n, words), unsigned: for the edges from ``first_rank`` on, in order, the loops that each counts for; bit k stands for
        ``closing[k]``.
    relations
        Loops that are filled in the complex: sets of bits whose sum is zero, by the youngest bit in each.
    """

    first_rank: int
    closing: IntArray
    bits: WordArray
    relations: dict[int, int]

    @property
    def open_bits(self) -> list[int]:
        """The loops that are still open in the complex, oldest first."""
        return [bit for bit in range(len(self.closing)) if bit not in self.relations]

    def weigh(self, members: int) -> BoolArray:
        """Make the cocycle that is 1 on the closing edges of some open loops and 0 on those of all others.

        Parameters
        ----------
        members
            A set of bits of open loops.

        Returns
        -------
        BoolArray
            For the edges from ``first_rank`` on, whether the cocycle is 1 there; on older ones it is 0. Each triangle of the complex has
            an even number of such edges, and a closed path with an odd number of them goes around a hole.
        """
        chosen = members
        for youngest in sorted(self.relations):
            if (self.relations[youngest] & ~(1 << youngest) & chosen).bit_count() % 2:
                chosen |= 1 << youngest
        mask = np.array([chosen >> shift & (1 << _WORD) - 1 for shift in range(0, _WORD * self.bits.shape[1], _WORD)], dtype=np.uint64)
        return np.asarray(np.bitwise_count(self.bits & mask).sum(axis=1) % 2 == 1)


def annotate_edges(filtration: Filtration, loop_ranks: IntArray, *, first_rank: int, last_rank: int) -> Annotation:
    """Annotate the edges of the complex that ends with an edge.

    Parameters
    ----------
    loop_ranks
        Ranks of the edges that close and fill each loop, shape (k, 2), ascending: ``Diagram.loop_ranks``.
    first_rank
        Rank of an edge that closes a loop; loops that are older are not asked for.
    last_rank
        Rank of the last edge of the complex.

    Notes
    -----
    Every edge is new (it closes a loop or joins components) or the longest side of a triangle; of those triangles the one is taken
    whose longer other side is shortest, and the edge counts for what its other sides count for. That triangle about halves the length
    each time, so few rounds do for all edges at once. The other triangles of an edge say nothing new unless it fills a loop: then they
    make sums zero, and the youngest loop in a sum is the one that is filled (the elder rule). This is annotation [DFW14], begun at an
    edge: a cocycle of a loop may be taken to be 0 on all edges older than that which closes it.
    """
    m = len(filtration.ranks)
    ranks = (filtration.ranks + filtration.ranks.T).astype(np.int32)
    np.fill_diagonal(ranks, filtration.n_edges + 1)
    own = np.arange(first_rank, last_rank + 1)
    ends = filtration.ends(own)
    closing = loop_ranks[(loop_ranks[:, 0] >= first_rank) & (loop_ranks[:, 0] <= last_rank), 0]
    words = -(-len(closing) // _WORD)
    start = np.zeros((len(own) + 1, words), dtype=np.uint64)
    index = np.arange(len(closing))
    start[closing - first_rank, index // _WORD] = np.left_shift(np.uint64(1), (index % _WORD).astype(np.uint64))
    sides = np.full((len(own), 2), len(own))
    for begin in range(0, len(own), block := max(1, _BLOCK // m)):
        rows = slice(begin, begin + block)
        one, other = ranks[ends[rows, 0]], ranks[ends[rows, 1]]
        longer = np.maximum(one, other)
        third = longer.argmin(axis=1)
        at = np.arange(len(third))
        is_side = longer[at, third] < own[rows]
        sides[rows][is_side] = np.column_stack([one[at, third], other[at, third]])[is_side] - first_rank
    sides[sides < 0] = len(own)
    bits = start
    while not np.array_equal(bits, bits := _step(start, bits, sides)):
        pass
    filling = loop_ranks[(loop_ranks[:, 1] >= first_rank) & (loop_ranks[:, 1] <= last_rank), 1]
    return Annotation(
        first_rank=first_rank,
        closing=closing,
        bits=bits[:-1],
        relations=_eliminate(_sums_of_triangles(filling, filtration.ends(filling), ranks, bits, first_rank)),
    )


def _step(start: WordArray, bits: WordArray, sides: IntArray) -> WordArray:
    """Add to every edge what its sides count for; the last row stands for edges that count for nothing."""
    return np.vstack([start[:-1] ^ bits[sides[:, 0]] ^ bits[sides[:, 1]], start[-1:]])


def _sums_of_triangles(longest: IntArray, ends: IntArray, ranks: NDArray[np.int32], bits: WordArray, first_rank: int) -> list[int]:
    """Sum what the sides count for, in every triangle with one of these longest sides; each sum once, as a set of bits."""
    one, other = ranks[ends[:, 0]], ranks[ends[:, 1]]
    edge, third = np.nonzero(np.maximum(one, other) < longest[:, None])
    sides = np.column_stack([longest[edge], one[edge, third], other[edge, third]]) - first_rank
    sides[sides < 0] = len(bits) - 1
    sums = np.unique(np.bitwise_xor.reduce(bits[sides], axis=1), axis=0)
    return [int.from_bytes(row.astype("<u8").tobytes(), "little") for row in sums]


def _eliminate(sums: Sequence[int]) -> dict[int, int]:
    """Bring sets of bits whose sums are zero to echelon form: one for each youngest bit."""
    relations: dict[int, int] = {}
    for total in sums:
        left = total
        while left and (youngest := left.bit_length() - 1) in relations:
            left ^= relations[youngest]
        if left:
            relations[youngest] = left
    return relations
