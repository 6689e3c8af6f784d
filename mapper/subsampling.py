"""Pick few encounters that cover all others: maxmin (furthest-point) sampling."""

from dataclasses import dataclass

import numpy as np

from mapper.metric import Metric
from mapper.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Subsample:
    """A subsample of m vertices.

    ``vertices`` in order of choice, shape (m,); ``distances`` between them [ticks], shape (m, m), symmetric, zero only on the
    diagonal; ``cover_radius`` [ticks]: no candidate is further than this from a vertex of the subsample.
    """

    vertices: IntArray
    distances: FloatArray
    cover_radius: float


def subsample_maxmin(metric: Metric, candidates: BoolArray, *, n_points: int) -> Subsample:
    """Pick vertices that cover all candidates, each the furthest from those before it.

    Parameters
    ----------
    candidates
        Which vertices may be picked, shape (v,), at least one.
    n_points
        How many to pick, at least 1. Fewer are picked when every candidate is at distance zero from one already.

    Notes
    -----
    The first is the candidate with the earliest encounter, and ties go to the earlier. An outlier is picked early: drop outliers first.
    """
    eligible = np.flatnonzero(candidates)
    picked: list[int] = []
    distances = np.zeros((n_points, n_points))
    nearest = np.full(len(eligible), np.inf)
    choice = 0
    while len(picked) < n_points and nearest[choice] > 0:
        row = metric.distances_from(int(eligible[choice]))
        # Symmetric by construction: each distance is computed once, from the later pick to the earlier.
        distances[len(picked), : len(picked)] = distances[: len(picked), len(picked)] = row[picked]
        picked.append(int(eligible[choice]))
        np.minimum(nearest, row[eligible], out=nearest)
        choice = int(nearest.argmax())
    m = len(picked)
    return Subsample(vertices=np.array(picked, dtype=np.int64), distances=distances[:m, :m].copy(), cover_radius=float(nearest.max()))
