"""How much of a map the swarm saw at one time: a swarm that is herded through a larger place sets its landmarks again and again.

What is judged against the size of the swarm's own view (which intervals are holes, over which area profiles are averaged, how many points
are needed) must not be judged against a map that was put together of many views.
"""

from dataclasses import dataclass

import numpy as np

from mapper.types import BoolArray, FloatArray, IntArray

# Places within this share of a view's reach are told by one of them; three to six of them cover a view.
_NET_SHARE = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Views:
    """``reach``: size of one view as a share of the whole, in (0, 1]; ``number``: how many views side by side cover it, at least 1."""

    reach: float
    number: float


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
    ``reach`` is the median over the places of the distance to the furthest of those occupied at the same time, over the median of the
    distance to the furthest of all. ``number`` compares how many places are needed for every other to be within half of that reach: of
    all, and on average of those occupied at the same time as one.
    """
    if len(distances) < 3:
        return ONE_VIEW
    begins, ends = stands.T
    at_once: BoolArray = (begins[:, None] <= ends[None, :]) & (begins[None, :] <= ends[:, None])
    if at_once.all():
        return ONE_VIEW
    whole = float(np.median(distances.max(axis=1)))
    near = float(np.median(np.where(at_once, distances, 0.0).max(axis=1)))
    if near <= 0.0:
        return ONE_VIEW
    radius = _NET_SHARE * near
    of_one = [_count_net(distances[np.ix_(rows, rows)], radius) for rows in map(np.flatnonzero, at_once)]
    number = _count_net(distances, radius) / float(np.mean(of_one))
    return Views(reach=min(1.0, near / whole), number=max(1.0, number))


def _count_net(distances: FloatArray, radius: float) -> int:
    """Count picks, each the furthest from those before it, until everything is within ``radius`` of one."""
    to_nearest = distances[0]
    count = 1
    while to_nearest.max() > radius:
        to_nearest = np.minimum(to_nearest, distances[int(to_nearest.argmax())])
        count += 1
    return count
