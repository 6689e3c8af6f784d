"""Pick few encounters that cover all others: maxmin (furthest-point) sampling."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from mapper.metric import EncounterMetric, Metric, ProfileMetric
from mapper.types import BoolArray, FloatArray, IntArray

# Numbers held for the distances from hubs: half a gigabyte.
_MAX_HUB_NUMBERS: Final = 2**26
_MIN_HUBS: Final = 8
# Every step of a search looks at all hubs.
_MAX_HUBS: Final = 64
# Of what most picks have to the next: no encounter stands for a pick that is further away.
_LONGEST_REACH: Final = 1.5


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
    metric
        No distance is below that in the plane, within a few percent.
    candidates
        Those that were picked from, shape (v,).
    doubt, xy
        Of every vertex: how badly it is known, shape (v,), and where it is in the plane [ticks], shape (v, 2).

    Returns
    -------
    IntArray
        Shape (m,), in the order of the picks. Each is no further from its pick than the next pick is, by the metric, nor than 1.5
        times that of most picks.

    Notes
    -----
    Maxmin picks the worst errors first, so a pick is a good place and a bad encounter. Filtering by doubt before would leave gaps that look
    like holes. No vertex stands for two picks: earlier ones choose first. Ties go to the earlier vertex.
    """
    chosen = sample.vertices.copy()
    if len(chosen) < 2:
        return chosen
    to_next = np.where(np.eye(len(chosen), dtype=bool), np.inf, sample.distances).min(axis=1)
    reach = np.minimum(to_next, _LONGEST_REACH * float(np.median(to_next)))
    eligible = np.flatnonzero(candidates)
    pick, other = _pairs_within(xy[chosen], xy[eligible], reach)
    other = eligible[other]
    is_around = np.abs(metric.profiles[chosen[pick]] - metric.profiles[other]).max(axis=1) < reach[pick]
    pick, other = pick[is_around], other[is_around]
    is_taken = np.zeros(len(candidates), dtype=bool)
    is_taken[chosen] = True
    order = np.lexsort((other, doubt[other], pick))
    bounds = np.searchsorted(pick[order], np.arange(len(chosen) + 1)).tolist()
    for row, (begin, end) in enumerate(pairwise(bounds)):
        nearby = other[order[begin:end]]
        free = nearby[~is_taken[nearby]]
        if len(free) and doubt[free[0]] < doubt[chosen[row]]:
            chosen[row] = free[0]
            is_taken[free[0]] = True
    return chosen


def _pairs_within(centres: FloatArray, places: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
    """List which places, shape (n, 2), are within reach of which centres, shape (m, 2), those of one centre together.

    Places are sorted into the squares of a grid, as wide as the longest reach, and only those of nine squares are measured.
    """
    width = float(reach.max())
    low = places.min(axis=0)
    column, line = (((places - low) / width).astype(np.int64) + 1).T
    n_lines = int(line.max(initial=0)) + 2
    square = column * n_lines + line
    order = np.argsort(square, kind="stable")
    in_order = square[order]
    at_column, at_line = (np.floor((centres - low) / width).astype(np.int64) + 1).T
    # Squares of one column are side by side in the order: three runs for each centre.
    runs = (at_column[:, None] + np.array([-1, 0, 1])) * n_lines + at_line[:, None]
    begin = np.searchsorted(in_order, (runs - 1).ravel(), side="left")
    size = np.searchsorted(in_order, (runs + 1).ravel(), side="right") - begin
    centre = np.repeat(np.repeat(np.arange(len(centres)), 3), size)
    place = order[np.arange(len(centre)) - np.repeat(np.cumsum(size) - size, size) + np.repeat(begin, size)]
    is_within = ((centres[centre] - places[place]) ** 2).sum(axis=1) < reach[centre] ** 2
    return centre[is_within], place[is_within]
