"""Pick few encounters that cover all others: maxmin (furthest-point) sampling."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from mapper.metric import EncounterMetric, Metric, ProfileMetric
from mapper.types import BoolArray, FloatArray, IntArray

# Numbers held for the distances from hubs: half a gigabyte.
_MAX_HUB_NUMBERS: Final = 2**26
_MIN_HUBS: Final = 8
# Every step of a search looks at all hubs.
_MAX_HUBS: Final = 64


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
    match metric:
        case EncounterMetric(graph=graph):
            # Any set of vertices gives the same result: landmarks are those that most long paths go through.
            hubs = graph.busiest_landmarks(min(_MAX_HUBS, max(_MIN_HUBS, _MAX_HUB_NUMBERS // graph.n_vertices)))
            picks = graph.kernels.pick_along_graph(graph.rows, graph.links, candidates, hubs=hubs, n_points=n_points)
            return Subsample(vertices=picks.chosen, distances=picks.distances, cover_radius=picks.cover_radius)
        case ProfileMetric(graph=graph):
            eligible = np.flatnonzero(candidates)
            picks = graph.kernels.pick_profiles(metric.profiles[eligible], norm=metric.norm, n_points=n_points)
            return Subsample(vertices=eligible[picks.chosen], distances=picks.distances, cover_radius=picks.cover_radius)
