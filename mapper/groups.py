"""Groups of what is joined: the connected components of a graph, in plain NumPy, so that no service waits for SciPy to be imported."""

import numpy as np
from numpy.typing import NDArray

from mapper.types import IntArray


def label_groups(first: NDArray[np.integer], second: NDArray[np.integer], *, n: int) -> IntArray:
    """Label each of n with its group: two are in one if a chain of pairs joins them.

    Parameters
    ----------
    first, second
        What is joined, shape (k,) each, from 0 to n - 1: in any order, and as often as you like.

    Returns
    -------
    IntArray
        Shape (n,), from 0: groups are numbered in order of their lowest members.

    Notes
    -----
    In every round each group takes the lowest label that it meets (Shiloach and Vishkin 1982, "An O(log n) parallel connectivity
    algorithm"). A group that keeps its label is lower than all that it meets, so at least half of those that meet any go into others.
    """
    lowest: IntArray = np.arange(n, dtype=np.int64)
    while first.size:
        one, other = lowest[first], lowest[second]
        is_apart = one != other
        first, second = first[is_apart], second[is_apart]
        low, high = np.minimum(one, other)[is_apart], np.maximum(one, other)[is_apart]
        np.minimum.at(lowest, high, low)
        while not np.array_equal(lowest, jumped := lowest[lowest]):
            lowest = jumped
    return np.asarray(np.unique(lowest, return_inverse=True)[1], dtype=np.int64)
