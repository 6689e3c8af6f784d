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
# Candidates to choose among, for each that there is to a pick.
_NEARBY: Final = 2
_BETTER_SHARE: Final = 0.6


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


def stand_for(sample: Subsample, metric: ProfileMetric, candidates: BoolArray, *, doubt: FloatArray, xy: FloatArray) -> IntArray:
    """Choose which vertex stands for each of those picked: the one with least doubt among the candidates around it.

    Parameters
    ----------
    candidates
        Those that were picked from, shape (v,).
    doubt, xy
        Of every vertex: how badly it is known, shape (v,), and where it is in the plane [ticks], shape (v, 2).

    Returns
    -------
    IntArray
        Shape (m,), in the order of the picks. Each is among the candidates nearest in the plane, twice as many as there are for each pick,
        among the 60 % of all with least doubt, and no further from its pick than the next pick is, by the metric; or it is the pick.

    Notes
    -----
    Maxmin picks the worst errors first, so a pick is a good place and a bad encounter. Filtering by doubt before would leave gaps that look
    like holes. No vertex stands for two picks: earlier ones choose first. Ties go to the earlier vertex.
    """
    everyone = np.flatnonzero(candidates)
    better = everyone[doubt[everyone] <= np.quantile(doubt[everyone], _BETTER_SHARE)]
    n_nearby = min(len(better), _NEARBY * len(better) // len(sample.vertices))
    if n_nearby < 1 or len(sample.vertices) < 2:
        return sample.vertices
    own, other = xy[sample.vertices], xy[better]
    squared = own @ (-2.0 * other.T)
    squared += (other**2).sum(axis=1)
    nearby = better[np.sort(np.argpartition(squared, n_nearby - 1, axis=1)[:, :n_nearby], axis=1)]
    apart = np.abs(metric.profiles[nearby] - metric.profiles[sample.vertices][:, None]).max(axis=2)
    to_next = np.where(np.eye(len(own), dtype=bool), np.inf, sample.distances).min(axis=1)
    is_around = apart < to_next[:, None]
    is_taken = np.zeros(len(candidates), dtype=bool)
    is_taken[sample.vertices] = True
    chosen = sample.vertices.copy()
    for pick, row in enumerate(nearby):
        free = row[is_around[pick] & ~is_taken[row]]
        if len(free):
            best = free[doubt[free].argmin()]
            if doubt[best] < doubt[chosen[pick]]:
                chosen[pick] = best
                is_taken[best] = True
    return chosen
