"""The distribution of the number of holes: those that loops stand for, and those that no loop of the map shows."""

from collections.abc import Sequence
from math import exp, lgamma, log
from typing import Final

import numpy as np

from mapper.types import FloatArray

MOST_MISSED: Final = 12
"""More holes than this that no loop shows are not counted on: the most in any training run is half as many."""


def count_holes(probabilities: Sequence[float] | FloatArray, *, missed: float, sharpness: float) -> FloatArray:
    """Say how likely each number of holes is.

    Parameters
    ----------
    probabilities
        That each loop is a hole, shape (k,), in [0, 1].
    missed
        How many holes no loop shows, on average, at least 0.
    sharpness
        Power to which the distribution is raised: below 1 it is spread, because loops of one map err together.

    Returns
    -------
    FloatArray
        Shape (k + MOST_MISSED + 1,): the probability of 0, 1, 2, ... holes; they sum to 1.

    Notes
    -----
    The sum of independent yes-or-no numbers (Poisson's binomial distribution) and of a Poisson number, cut off at its upper end.
    """
    found = np.ones(1)
    for probability in probabilities:
        found = np.convolve(found, [1.0 - probability, probability])
    others = np.array([_poisson(number, missed) for number in range(MOST_MISSED + 1)])
    total = np.clip(np.convolve(found, others), 0.0, None) ** sharpness
    return np.asarray(total / total.sum())


def _poisson(number: int, mean: float) -> float:
    if mean <= 0.0:
        return float(number == 0)
    return exp(number * log(mean) - mean - lgamma(number + 1))
