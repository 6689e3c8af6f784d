"""How likely each number of holes is: every number is described, and a fitted model says how well each fits."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from mapper.confidence.model import Model
from mapper.types import FloatArray, IntArray

MOST_HOLES: Final = 12
"""Numbers up to this are told of, and up to a few more than the map has loops called real: twice the most in any training run."""

_LEAST_POINTS: Final = 10
_LEAST_LANDMARKS: Final = 3
_LEAST_WALKERS: Final = 6

COUNT_FEATURES: Final = (
    "sum of loops",
    "as counted",
    "more than counted",
    "fewer than counted",
    "drop of chances",
    "as in replicas",
    "off the replicas",
    "number",
    "none",
)

_ROOM = 6
_LEAST = 1e-3
_MOST_ODDS = 5.0
_BEYOND_TRAINING = 0.2
"""How far the loops' probabilities are not believed where they were not checked (own choice): with so much the prior holds all the
same. A map of a handful of points has no loop at all, which is no proof that there is no hole."""


def is_telling(*, n_points: int, n_landmarks: int, n_walkers: int) -> bool:
    """Say whether a map can tell anything of holes.

    Notes
    -----
    A ring takes about ten points (own choice). Distances to fewer than three landmarks fix no place, and without
    any a map shows time as much as place: 20 calves without beacons have a loop of three days. Of very few that walk the errors are alike
    all over the map, and no training run had fewer.
    """
    return n_points >= _LEAST_POINTS and n_landmarks >= _LEAST_LANDMARKS and n_walkers >= _LEAST_WALKERS


def describe_numbers(probabilities: FloatArray, *, counted: int, replicas: IntArray, run: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Describe each number of holes from 0 on.

    Parameters
    ----------
    probabilities
        That each loop is a hole, shape (k,), in any order.
    counted
        How many the map calls holes.
    replicas
        How many each replica calls holes, shape (r,).
    run
        What describes the run, by name, shape () each.

    Returns
    -------
    dict
        Shape (n,) each, n at least ``MOST_HOLES + 1``. ``drop of chances`` of a number is by how much the logarithmic odds fall from the
        loop that is the last hole, if there are so many, to the first that is none.
    """
    n = max(MOST_HOLES, counted + _ROOM) + 1
    number = np.arange(n)
    falling = np.sort(np.clip(probabilities, 1e-12, 1.0 - 1e-12))[::-1]
    odds = np.full(n + 1, -_MOST_ODDS)
    odds[0] = _MOST_ODDS
    shown = min(n, len(falling))
    odds[1 : shown + 1] = np.clip(np.log(falling / (1.0 - falling))[:shown], -_MOST_ODDS, _MOST_ODDS)
    sums = np.zeros(n)
    total = add_up(probabilities)[:n]
    sums[: len(total)] = total
    columns = {
        "sum of loops": np.log(sums + _LEAST),
        "as counted": (number == counted).astype(float),
        "more than counted": np.maximum(number - counted, 0).astype(float),
        "fewer than counted": np.maximum(counted - number, 0).astype(float),
        "drop of chances": odds[:-1] - odds[1:],
        "as in replicas": (number[:, None] == replicas).mean(axis=1) if len(replicas) else np.zeros(n),
        "off the replicas": np.abs(number - (replicas.mean() if len(replicas) else 0.0)),
        "number": number.astype(float),
        "none": (number == 0).astype(float),
    }
    return columns | {name: np.full(n, float(value)) for name, value in run.items()}


def count_holes(
    model: Model, columns: dict[str, FloatArray], *, prior: Sequence[float], is_telling: bool, alone: FloatArray | None
) -> FloatArray:
    """Say how likely each number of holes is, shape (n,): in proportion to the exponential of its score.

    Parameters
    ----------
    prior
        How likely each is before anything is known.
    is_telling
        The map can tell anything of holes; if not, the prior is all that is known.
    alone
        The probabilities of the loops where the map is unlike those of training: then they and the prior alone tell, the loops as if
        independent; None elsewhere.
    """
    if is_telling and alone is not None:
        total = np.zeros(len(columns["number"]))
        summed = add_up(alone)[: len(total)]
        total[: len(summed)] = summed
        return mix_with(total / total.sum(), prior, share=_BEYOND_TRAINING)
    if not is_telling:
        return mix_with(np.zeros(len(columns["number"])), prior, share=1.0)
    score = model.score(columns)
    weights = np.exp(score - score.max())
    return np.asarray(weights / weights.sum())


def mix_with(distribution: FloatArray, prior: Sequence[float], *, share: float) -> FloatArray:
    """Believe a distribution of numbers, shape (n,), but for a share, for which what is known before holds."""
    before = np.pad(np.array(prior, dtype=np.float64), (0, len(distribution) - len(prior)))
    return np.asarray((1.0 - share) * distribution + share * before)


def add_up(probabilities: FloatArray) -> FloatArray:
    """Return how likely 0, 1, ..., k of k independent things are so: Poisson's binomial distribution, shape (k + 1,)."""
    total = np.ones(1)
    for probability in probabilities.tolist():
        total = np.convolve(total, [1.0 - probability, probability])
    return total
