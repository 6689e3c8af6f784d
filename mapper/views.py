"""How much of a map the swarm saw at one time: a swarm that is herded through a larger place sets its landmarks again and again.

What is judged against the size of the swarm's own view (which intervals are holes, over which area profiles are averaged, how many points
are needed) must not be judged against a map that was put together of many views.
"""

from dataclasses import dataclass

import numpy as np

from mapper.types import BoolArray, FloatArray, IntArray

# Places that cover one view, so that any other is within the median distance of one: of 20 landmarks in a square or a disc (own count).
_PLACES_OF_A_VIEW = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Views:
    """``reach``: size of one view as a share of the whole, in (0, 1]; ``number``: how many views side by side cover it, at least 1."""

    reach: float
    number: float


_MIN_PLACES = 3

ONE_VIEW = Views(reach=1.0, number=1.0)


def count_views(distances: FloatArray, stands: IntArray) -> Views:
    """Compare landmarks that stood at one time with all there were.

    Parameters
    ----------
    distances
        Between the l places where landmarks stood, shape (l, l), symmetric, finite.
    stands
        Begin and end of each stand, shape (l, 2), of any one clock.

    Returns
    -------
    Views
        ``ONE_VIEW``, exactly, where all stood at one time, and for fewer than three places.

    Notes
    -----
    ``reach`` is the median distance of landmarks from those that stood in the middle of their time, over that from all. Each counts the
    less the longer it stood: one that is left standing for the swarm to find again is seen in many views. ``number`` is how many places
    it takes for every landmark to be within such a median distance of one, over how many a single view takes.
    """
    if len(distances) < _MIN_PLACES:
        return ONE_VIEW
    begins, ends = stands.T
    middles = begins + (ends - begins) // 2
    at_once: BoolArray = (begins[None, :] <= middles[:, None]) & (middles[:, None] <= ends[None, :])
    if at_once.all():
        return ONE_VIEW
    weights = 1.0 / np.maximum(ends - begins, 1)
    others = ~np.eye(len(distances), dtype=bool)
    whole, near = (_median_distance(distances, weights, pairs & others) for pairs in (np.ones_like(at_once), at_once))
    if not 0.0 < near < whole:
        return ONE_VIEW
    return Views(reach=near / whole, number=max(1.0, _count_net(distances, near) / _PLACES_OF_A_VIEW))


def _median_distance(distances: FloatArray, weights: FloatArray, pairs: BoolArray) -> float:
    """Take the median over the places of each place's weighted median distance to those it is paired with; 0 where nothing is paired."""
    medians = []
    for row, paired in zip(distances, pairs, strict=True):
        if paired.any():
            order = np.argsort(row[paired], kind="stable")
            shares = np.cumsum(weights[paired][order])
            medians.append(row[paired][order][np.searchsorted(shares, shares[-1] / 2.0)])
    return float(np.median(medians)) if medians else 0.0


def _count_net(distances: FloatArray, radius: float) -> int:
    """Count picks, each the furthest from those before it, until everything is within ``radius`` of one."""
    to_nearest = distances[0]
    count = 1
    while to_nearest.max() > radius:
        to_nearest = np.minimum(to_nearest, distances[int(to_nearest.argmax())])
        count += 1
    return count
