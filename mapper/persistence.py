"""Rips persistence of a subsample in dimensions 0 and 1. The one module that knows which engine computes it."""

from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np

from mapper.errors import EngineMissingError
from mapper.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagram:
    """Persistence diagram in dimensions 0 and 1, in the unit of the distances.

    ``intervals[k]``, shape (m_k, 2): birth and death, longest first, none of zero length; exactly one death is inf, in dimension 0.
    ``birth_edges``, shape (m_1, 2): the edge that closes the loop of each interval of dimension 1.
    """

    intervals: tuple[FloatArray, FloatArray]
    birth_edges: IntArray


def name_engine() -> str:
    """Name the library that computes persistence, with its version; it is not loaded for that.

    Raises
    ------
    EngineMissingError
        GUDHI is not installed.
    """
    if find_spec("gudhi") is None:
        raise _missing()
    return f"gudhi {version('gudhi')}"


def rips_persistence(distances: FloatArray) -> Diagram:
    """Compute the Vietoris-Rips persistence of a finite metric space over Z/2.

    Parameters
    ----------
    distances
        Shape (m, m), symmetric, finite, zero diagonal; m at least 1.

    Raises
    ------
    EngineMissingError
        GUDHI is not installed.

    Notes
    -----
    The filtration stops at the enclosing radius ``min_i max_j d_ij``: from there on the complex is a cone and has no loops.
    Edges are collapsed before triangles are made [BP20], which changes no interval and saves nearly all the work: with 171 points
    0.02 s in place of 0.22 s (measured). A collapse delays only edges that are dominated when they enter, and an edge that gives
    birth to a loop is not, so its value is still its length; the value of a triangle is read from the collapsed complex.
    Intervals of equal length are ordered by birth, then by birth edge.
    """
    try:
        import gudhi  # noqa: PLC0415  # no wheel for every platform: the mapper must start without it
    except ImportError as error:
        raise _missing() from error
    radius = float(distances.max(axis=1).min())
    tree = gudhi.RipsComplex(distance_matrix=distances, max_edge_length=radius).create_simplex_tree(max_dimension=1)
    tree.collapse_edges()
    tree.expansion(2)
    # GUDHI's default field is Z/11; Betti numbers are meant over Z/2.
    tree.compute_persistence(homology_coeff_field=2, min_persistence=0.0, persistence_dim_max=False)
    components, by_dimension, _, _ = tree.flag_persistence_generators()
    components = np.asarray(components, dtype=np.int64).reshape(-1, 3)
    loops = np.asarray(by_dimension[0] if by_dimension else [], dtype=np.int64).reshape(-1, 4)
    merges = distances[components[:, 1], components[:, 2]]
    finite = np.column_stack([np.zeros(len(merges)), np.sort(merges)[::-1]])
    births = distances[loops[:, 0], loops[:, 1]]
    deaths = np.array([tree.filtration(edge) for edge in loops[:, 2:].tolist()], dtype=np.float64)
    edges = np.sort(loops[:, :2], axis=1)
    order = np.lexsort((edges[:, 1], edges[:, 0], births, births - deaths))
    return Diagram(
        intervals=(np.vstack([[[0.0, np.inf]], finite]), np.column_stack([births, deaths])[order]),
        birth_edges=edges[order],
    )


def _missing() -> EngineMissingError:
    next_step = "pip install gudhi where a wheel exists (not on Linux aarch64)"
    return EngineMissingError(library="gudhi", needed_for="persistence", next_step=next_step)
