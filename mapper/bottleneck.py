"""The bottleneck distance between persistence diagrams, exact."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def bottleneck_distance(one: Floats, other: Floats) -> float:
    """Find the least r for which the bars of two diagrams can be paired, none being moved by more than r.

    Parameters
    ----------
    one, other
        Births and deaths, shapes (n, 2) and (m, 2), all finite.

    Notes
    -----
    A bar moves by the larger of the changes of its birth and its death, or by half its length to the diagonal. So bars longer than 2 r must
    have a partner, and others may go without. Some pairing serves the long bars of both diagrams if one serves those of the first, and one
    those of the second (Mendelsohn and Dulmage 1958); for each, a largest matching tells. The answer is one of the moves.
    """
    moves = np.abs(one[:, None] - other[None]).max(axis=2)
    halves = (one[:, 1] - one[:, 0]) / 2, (other[:, 1] - other[:, 0]) / 2
    candidates = np.unique(np.concatenate([[0.0], moves.ravel(), *halves]))
    low, high = 0, len(candidates) - 1  # the last always serves: no bar needs a partner
    while low < high:
        middle = (low + high) // 2
        if _can_pair(moves, *halves, limit=float(candidates[middle])):
            high = middle
        else:
            low = middle + 1
    return float(candidates[low])


def _can_pair(moves: Floats, halves: Floats, other_halves: Floats, *, limit: float) -> bool:
    is_within = moves <= limit
    return _serves(is_within[halves > limit]) and _serves(is_within[:, other_halves > limit].T)


def _serves(may_pair: NDArray[np.bool_]) -> bool:
    """Tell whether every row can have a column of its own."""
    if not may_pair.size:
        return len(may_pair) == 0
    from scipy.sparse import csr_array  # noqa: PLC0415  # a third of a second that no service has to wait for when it starts
    from scipy.sparse.csgraph import maximum_bipartite_matching  # noqa: PLC0415  # same

    return bool((maximum_bipartite_matching(csr_array(may_pair), perm_type="column") >= 0).all())
