"""Drop the encounters that distort the metric: those far from their nearest neighbours ([Dir16] VI, "Subsampling")."""

import numpy as np

from mapper.metric import EncounterMetric, Metric, ProfileMetric
from mapper.types import BoolArray, FloatArray, ProfileNorm


def keep_inliers(metric: Metric, *, k: int, q: float) -> BoolArray:
    """Say which vertices to keep: mean distance to the k nearest encounters within its q-quantile.

    The quantile is taken over encounters, so a vertex weighs as many as it stands for.

    Returns
    -------
    BoolArray
        Shape (v,); at least one is True.

    Notes
    -----
    [Dir16] sets the threshold on the mean but filters on the k-th distance, which keeps about 72 % where 90 % is meant.
    Here the mean is used for both.
    """
    mean = mean_neighbour_distance(metric, k=k)
    threshold = np.quantile(np.repeat(mean, metric.graph.multiplicity), q)
    return np.asarray(mean <= threshold)


def mean_neighbour_distance(metric: Metric, *, k: int) -> FloatArray:
    """Average the distances from an encounter of each vertex to the k encounters nearest to it.

    Other encounters of the same vertex are neighbours at distance zero. With fewer than k others, all of them are used.

    Returns
    -------
    FloatArray
        [ticks], shape (v,); 0 for a lone encounter.
    """
    k = min(k, metric.graph.n_encounters - 1)
    if k < 1:
        return np.zeros(metric.graph.n_vertices)
    match metric:
        case EncounterMetric():
            return metric.graph.kernels.sum_neighbour_times(metric.graph.rows, metric.graph.multiplicity, k=k) / k
        case ProfileMetric():
            return _sums_between_profiles(metric, k=k) / k


def _sums_between_profiles(metric: ProfileMetric, *, k: int) -> FloatArray:
    from scipy.spatial import cKDTree  # noqa: PLC0415  # only this way of finding outliers needs it

    n, n_references = metric.profiles.shape
    order, scale = (np.inf, 1.0) if metric.norm is ProfileNorm.MAX else (2.0, n_references**-0.5)
    tree = cKDTree(metric.profiles)
    distance, vertex = tree.query(metric.profiles, k=np.arange(1, min(k + 1, n) + 1), p=order)
    # One encounter of the nearest place, at distance zero, is the encounter itself: it is no neighbour.
    counted = np.minimum(np.cumsum(metric.graph.multiplicity[vertex], axis=1) - 1, k)
    taken = np.diff(counted, axis=1, prepend=0)
    return np.asarray((distance * scale * taken).sum(axis=1))
