"""Who is within communication radius of whom: links between places, which walls do not hinder."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree


def links_within(places: NDArray[np.float64], *, radius: float, ids: Sequence[int], side: float | None) -> dict[int, set[int]]:
    """Return each id's neighbours.

    Parameters
    ----------
    places
        Where each id is, shape (n, 2) [length].
    radius
        Those no further than this are neighbours [length].
    side
        Length of the side of a torus; None: a plane.
    """
    links: dict[int, set[int]] = {one: set() for one in ids}
    tree = cKDTree(places) if side is None else cKDTree(np.mod(places, side), boxsize=np.array([side, side]))
    for first, second in tree.query_pairs(radius, output_type="ndarray").tolist():
        links[ids[first]].add(ids[second])
        links[ids[second]].add(ids[first])
    return links
