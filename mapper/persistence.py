"""Rips persistence of a subsample in dimensions 0 and 1."""

from dataclasses import dataclass

import numpy as np

from mapper.filtration import Filtration, order_edges
from mapper.rips_engines import Engine, choose_engine
from mapper.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagram:
    """Persistence diagram in dimensions 0 and 1, in the unit of the distances.

    Parameters
    ----------
    intervals
        ``intervals[k]``, shape (m_k, 2): birth and death, longest first, none of zero length; exactly one death is inf, in dimension 0.
    birth_edges
        Shape (m_1, 2): the edge that closes the loop of each interval of dimension 1.
    filtration
        The order of the edges.
    loop_ranks
        Shape (k, 2), by birth: ranks of the edges that close and fill each loop, those of zero length included.
    """

    intervals: tuple[FloatArray, FloatArray]
    birth_edges: IntArray
    filtration: Filtration
    loop_ranks: IntArray


def rips_persistence(distances: FloatArray, *, engine: Engine | None = None) -> Diagram:
    """Compute the Vietoris-Rips persistence of a finite metric space over Z/2.

    Parameters
    ----------
    distances
        Shape (m, m), symmetric, finite, zero diagonal; m at least 1.
    engine
        What pairs the edges; None takes the fastest that is installed.

    Raises
    ------
    EngineMissingError
        No engine is installed.
    ValueError
        The engine cannot number so many edges (redzed-tda: about 5792 points).

    Notes
    -----
    The engine is given ranks in place of lengths (``order_edges``): so every engine gives the same diagram, in the precision of the
    distances, and births name their edges. Intervals of equal length are ordered by birth, then by birth edge.

    References
    ----------
    [Bau21] for the filtration and its refinement to one edge at a time.
    """
    filtration = order_edges(distances)
    pairs = (engine or choose_engine())(filtration)
    lengths = distances.ravel()[filtration.edges]
    merges = np.sort(lengths[pairs.merges - 1])[::-1]
    merges = merges[merges > 0]
    loop_ranks = pairs.loops[np.argsort(pairs.loops[:, 0])]
    loops = lengths[loop_ranks - 1]
    edges = filtration.ends(loop_ranks[:, 0])
    births, deaths = loops.T
    order = np.lexsort((edges[:, 1], edges[:, 0], births, births - deaths))
    order = order[deaths[order] > births[order]]
    return Diagram(
        intervals=(np.vstack([[[0.0, np.inf]], np.column_stack([np.zeros(len(merges)), merges])]), loops[order]),
        birth_edges=edges[order],
        filtration=filtration,
        loop_ranks=loop_ranks,
    )
