"""The bounds of [Dir16], as published and as corrected, as plain formulas. Speed is 1: times are lengths.

What was published fails in five places, each met here by the least change that makes the proof sound:

- **Theorem 1, upper bound.** It is proved from steps of length about epsilon; the last step costs up to tau however short it is. So events
  close to each other may be tau apart, and ``+ tau`` is missing. Assumption 2, that all close events share a biobot, never holds; the
  proof works as well with tau measured along paths of the graph.
- **Theorems 1 and 2, lower bounds.** [Dir16] neglects r_d. An encounter stands for a disc: each change from one biobot to the next moves
  up to r_d at no cost, and so does crossing a landmark's community. The length with r_d added for each change is a bound.
- **Theorem 2, upper bound.** As Theorem 1; and the two communities must have events that are no further apart in time than in space.
- **Corollary 1.** Its proof goes to the nearest landmark and back, over ``delta_l / 2`` each: delta_l is twice the landmarks' covering
  radius, not the distance from a landmark to the next (Assumption 3). And an event is not as near to a landmark in d_GEL as it is in space:
  its biobots have to get there.
- **Theorem 3.** The error of the metric scales with the distances, so with the diameter; and a Rips diagram moves by twice the
  Hausdorff distance of samples, and by the largest change of any distance (Chazal et al. 2009, [Dir16] eq. 4).

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

import numpy as np

from studies.truth import Floats


def lambda_3(*, tau: float, epsilon: float, delta_e: float) -> float:
    """Return the factor of Theorem 1, less 1; it means something for ``4 delta_e < epsilon``."""
    return tau / epsilon - 1.0 + 4.0 * delta_e * tau / epsilon**2


def theorem_1(true: Floats, *, inflation: float, tau: float = 0.0) -> Floats:
    """Bound d_GE, or d_GEL between communities (Theorem 2), from above.

    Parameters
    ----------
    true
        Distances d_MxT = max(d_M, |dt|), or d_M between landmarks.
    inflation
        ``lambda_3``.
    tau
        0 as published; the largest d_GE of events within epsilon of each other as corrected.
    """
    return np.asarray((1.0 + inflation) * true + tau)


def corollary_1(true: Floats, *, inflation: float, delta_l: float) -> Floats:
    """Bound d_GEL between events from above, as published.

    Parameters
    ----------
    inflation
        lambda_3: how much d_GEL between communities exceeds d_M, as a share.
    delta_l
        The largest distance from a landmark to the next one as published; twice the landmarks' covering radius as the proof needs it.
    """
    return np.asarray((1.0 + inflation) * (true + 2.0 * delta_l))


def corollary_1_by_landmarks(true: Floats, *, inflation: float, delta_l: float, wait: float) -> Floats:
    """Bound d_GEL between events from above by the way over the landmarks that are nearest in truth.

    Parameters
    ----------
    delta_l
        Twice the landmarks' covering radius.
    wait
        The largest d_GEL from an event to the landmark that is nearest to it in truth.
    """
    return np.asarray((1.0 + inflation) * (true + delta_l) + 2.0 * wait)


def theorem_3_landmarks(*, inflation: float, delta_l: float) -> float:
    """Bound d_B(PD(M), PD(L)) as published."""
    return inflation * delta_l + delta_l


def theorem_3_encounters(*, inflation: float, delta_l: float, delta_e: float) -> float:
    """Bound d_B(PD(M), PD(E)) as published."""
    return (1.0 + inflation) * 2.0 * delta_l + (1.0 + inflation) * delta_e


def stability(*, metric_error: float, hausdorff: float) -> float:
    """Bound the bottleneck distance of two Rips diagrams.

    Parameters
    ----------
    metric_error
        Largest change of a distance between points of the sample.
    hausdorff
        Hausdorff distance of the two samples in the true metric.
    """
    return metric_error + 2.0 * hausdorff


def encounters_metric_error(*, inflation: float, delta_l: float, diameter: float) -> float:
    """Bound the largest ``d_GEL - d_M`` by Corollary 1, of events no further than ``diameter`` apart."""
    return inflation * diameter + (1.0 + inflation) * 2.0 * delta_l
