"""Draw loops around holes: for each the shortest closed path that goes around it alone."""

from collections.abc import Iterator

import numpy as np

from mapper.cocycles import annotate_edges
from mapper.cycles import shortest_odd_cycle
from mapper.persistence import Diagram
from mapper.types import BoolArray, FloatArray, IntArray

# The part of a hole's life in which its outline may be drawn.
_BEGIN, _END = 0.25, 0.75


def outline_holes(distances: FloatArray, diagram: Diagram, rows: IntArray) -> tuple[IntArray, ...]:
    """Draw the outlines of some loops of a diagram.

    Parameters
    ----------
    distances
        Shape (m, m), symmetric, zero only on the diagonal: what ``diagram`` was made of.
    rows
        Which intervals of dimension 1 are holes, shape (k,).

    Returns
    -------
    tuple of IntArray
        For each hole, the points around it in order, not closed, at least 4: beginning with the lowest, then the lower of its neighbours.

    Notes
    -----
    Where holes live at one time, all are drawn in the complex of one scale, within the middle half of the life of each. Loops that are
    open at that scale are taken youngest first. The cocycle of a loop counts edges so that a closed path around it has an odd number,
    and so that the outlines found before have an even one; the outline is the shortest path with an odd number. Together these are a
    shortest basis of the open loops [DSW10], so no outline goes around two holes where one around each is shorter.

    In simulated arenas each outline goes around just one obstacle far more often than a path that closes the birth edge does:
    ``python -m studies.outlines``, docs/accuracy.md.
    """
    lengths = distances.ravel()[diagram.filtration.edges]
    n_points = len(distances)
    outlines: dict[int, IntArray] = {}
    for last_rank, births in _share_scales(diagram, rows, lengths):
        first_rank = int(births.min())
        annotation = annotate_edges(diagram.filtration, diagram.loop_ranks, first_rank=first_rank, last_rank=last_rank)
        ends = diagram.filtration.ends(np.arange(1, last_rank + 1))
        is_odd = np.zeros(last_rank, dtype=bool)
        drawn: list[tuple[BoolArray, IntArray]] = []
        for bit in annotation.open_bits[::-1]:
            cocycle = annotation.weigh(1 << bit)
            for other, path in drawn:
                if cocycle[path].sum() % 2:
                    cocycle ^= other
            is_odd[first_rank - 1 :] = cocycle
            outline = shortest_odd_cycle(ends, lengths[:last_rank], is_odd, n_points=n_points)
            outlines[int(annotation.closing[bit])] = outline
            path = diagram.filtration.between(outline, np.roll(outline, -1)) - first_rank
            drawn.append((cocycle, path[path >= 0]))
    return tuple(outlines[rank] for rank in diagram.filtration.between(*diagram.birth_edges[rows].T).tolist())


def _share_scales(diagram: Diagram, rows: IntArray, lengths: FloatArray) -> Iterator[tuple[int, IntArray]]:
    """Choose few scales so that each hole is in the middle of its life at one: rank of the last edge, and the birth ranks of its holes."""
    born = diagram.filtration.between(*diagram.birth_edges[rows].T)
    filled = diagram.loop_ranks[np.searchsorted(diagram.loop_ranks[:, 0], born), 1]
    births, deaths = diagram.intervals[1][rows].T
    earliest, latest = (np.searchsorted(lengths, births + share * (deaths - births), side="right") for share in (_BEGIN, _END))
    # Rounding must not put a scale outside a very short life.
    earliest, latest = np.clip(earliest, born, filled - 1), np.clip(latest, born, filled - 1)
    left = np.argsort(latest, kind="stable")
    while len(left):
        end = latest[left[0]]
        is_met = earliest[left] <= end
        begin = earliest[left[is_met]].max()
        middle = (lengths[begin - 1] + lengths[end - 1]) / 2
        yield int(np.clip(np.searchsorted(lengths, middle, side="right"), begin, end)), born[left[is_met]]
        left = left[~is_met]
