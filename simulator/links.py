"""Who is within communication radius of whom: links between places, which walls do not hinder."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

# Up to so many places are compared each with each: a tenth of a millisecond, where to import what makes trees takes a fifth of a second.
_FEW: Final = 60


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
    find = _compare_all if len(places) <= _FEW else _ask_a_tree
    for first, second in find(places, radius=radius, side=side).tolist():
        links[ids[first]].add(ids[second])
        links[ids[second]].add(ids[first])
    return links


def _compare_all(places: NDArray[np.float64], *, radius: float, side: float | None) -> NDArray[np.intp]:
    apart = np.abs(places[:, None] - places)
    if side is not None:
        apart %= side
        apart = np.minimum(apart, side - apart)
    return np.argwhere(np.triu(apart[..., 0] ** 2 + apart[..., 1] ** 2 <= radius**2, k=1))


def _ask_a_tree(places: NDArray[np.float64], *, radius: float, side: float | None) -> NDArray[np.intp]:
    from scipy.spatial import cKDTree  # noqa: PLC0415  # a fifth of a second that small swarms do without

    tree = cKDTree(places) if side is None else cKDTree(np.mod(places, side), boxsize=np.array([side, side]))
    return tree.query_pairs(radius, output_type="ndarray")
