"""The classifier of [Dir16] eq. 15-17 as published: which intervals count, and which parameters err least on runs with known holes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studies.truth import Floats

QUANTILES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
DELTAS = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 0.7, 1.0)
TAUS = tuple(np.geomspace(0.05, 60.0, 240).tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class Theta:
    """Parameters of eq. 15: an interval counts if its length over (the q-quantile of all lengths + delta) exceeds tau."""

    q: float
    delta: float
    tau: float


# [Dir16] VI, "Classification and Robustness" and "Example Scenarios": theta_1 as trained, and the threshold of the scenarios.
PUBLISHED = Theta(q=0.5, delta=0.7, tau=37.0)
PUBLISHED_IN_SCENARIOS = Theta(q=0.5, delta=0.7, tau=30.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """What brute force found: the parameters, and the mean of ``|found - true|`` of the training runs, eq. 17."""

    theta: Theta
    error: float


def count_holes(loops: Floats, theta: Theta) -> int:
    """Count the intervals of dimension 1, shape (m, 2), that eq. 15 calls real; lengths in whatever unit delta is in."""
    lengths = loops[:, 1] - loops[:, 0]
    if not len(lengths):
        return 0
    return int((_ratios(lengths, q=theta.q, delta=theta.delta) > theta.tau).sum())


def train(diagrams: Sequence[Floats], true_holes: Sequence[int]) -> Training:
    """Minimise eq. 17 by brute force over quantiles, deltas and taus.

    Parameters
    ----------
    diagrams
        Intervals of dimension 1 of each run, shape (m, 2), of which none is of zero length.
    true_holes
        How many holes there were.

    Notes
    -----
    The best triples are often many. Of those of one quantile and delta the middle one is taken; then the quantile and delta with most
    of them: the one furthest from its edges.
    """
    best: tuple[float, int] | None = None
    theta = PUBLISHED
    taus = np.array(TAUS)
    for q in QUANTILES:
        for delta in DELTAS:
            error = np.zeros(len(taus))
            for loops, holes in zip(diagrams, true_holes, strict=True):
                lengths = loops[:, 1] - loops[:, 0]
                ratios = _ratios(lengths, q=q, delta=delta) if len(lengths) else lengths
                error += np.abs((ratios[:, None] > taus).sum(axis=0) - holes)
            error /= len(diagrams)
            at_best = np.flatnonzero(error == error.min())
            rank = (-float(error.min()), len(at_best))
            if best is None or rank > best:
                best, theta = rank, Theta(q=q, delta=delta, tau=float(f"{taus[at_best[len(at_best) // 2]]:.3g}"))
    wrong = [abs(count_holes(loops, theta) - holes) for loops, holes in zip(diagrams, true_holes, strict=True)]
    return Training(theta=theta, error=float(np.mean(wrong)))


def _ratios(lengths: Floats, *, q: float, delta: float) -> Floats:
    return np.asarray(lengths / (np.quantile(lengths, q, method="lower") + delta or 1.0))
