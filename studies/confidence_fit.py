"""Fit what says how sure a map is: logistic and log-linear models with small weights, by penalised maximum likelihood."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize

from mapper.confidence.model import Model
from mapper.types import BoolArray, FloatArray, IntArray

Columns = Mapping[str, FloatArray]
Term = tuple[str, ...]

N_FOLDS = 5
_STEPS = 100
_SETTLED = 1e-8
_CUT = (0.002, 0.998)  # quantiles to which numbers are cut: a map unlike all in training is taken for the one most like it
_PRIOR_SPREAD = 1e-3
_ROUNDED_CORNER = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Design:
    """Terms made of columns: ``matrix``, shape (n, terms), of what a model without weights and with these ``features`` sums."""

    features: dict[str, tuple[float, float, float, float]]
    terms: tuple[Term, ...]
    matrix: FloatArray

    def model(self, constant: float, weights: FloatArray) -> Model:
        """Make the model that gives these weights to the terms."""
        return Model(features=self.features, constant=float(constant), weights=dict(zip(self.terms, weights.tolist(), strict=True)))


def make_design(columns: Columns, terms: Sequence[Term]) -> Design:
    """Cut and standardise the columns that the terms name, and multiply them."""
    features = {name: _standard(columns[name]) for name in dict.fromkeys(name for term in terms for name in term)}
    standard = {name: (np.clip(columns[name], low, high) - mean) / spread for name, (low, high, mean, spread) in features.items()}
    matrix = np.column_stack([np.prod([standard[name] for name in term], axis=0) for term in terms])
    return Design(features=features, terms=tuple(terms), matrix=matrix)


def fit_logistic(columns: Columns, is_so: BoolArray, terms: Sequence[Term], *, penalty: float) -> Model:
    """Fit odds: Newton's method on the logarithmic likelihood less half the penalty times the sum of squared weights."""
    design = make_design(columns, terms)
    with_constant = np.column_stack([np.ones(len(is_so)), design.matrix])
    ridge = np.full(with_constant.shape[1], penalty)
    ridge[0] = _PRIOR_SPREAD
    weights = np.zeros(len(ridge))
    for _ in range(_STEPS):
        chance = 1.0 / (1.0 + np.exp(-np.clip(with_constant @ weights, -30.0, 30.0)))
        slope = with_constant.T @ (chance - is_so) + ridge * weights
        curvature = (with_constant.T * (chance * (1.0 - chance))) @ with_constant + np.diag(ridge)
        step = np.linalg.solve(curvature, slope)
        weights -= step / max(1.0, float(np.abs(step).max()) / 2.0)
        if np.abs(step).max() < _SETTLED:
            break
    return design.model(weights[0], weights[1:])


def choose_penalty(columns: Columns, is_so: BoolArray, fold: IntArray, terms: Sequence[Term], *, penalties: Sequence[float]) -> float:
    """Choose the penalty under which folds that were left out are foretold best, by logarithmic loss."""

    def loss(penalty: float) -> float:
        chance = np.clip(foretell(columns, is_so, fold, terms, penalty=penalty), 1e-9, 1.0 - 1e-9)
        return -float(np.mean(np.where(is_so, np.log(chance), np.log(1.0 - chance))))

    return min(penalties, key=loss)


def foretell(columns: Columns, is_so: BoolArray, fold: IntArray, terms: Sequence[Term], *, penalty: float) -> FloatArray:
    """Give each row the probability that a model fitted to the other folds gives it; ``fold``, shape (n,)."""
    chance = np.zeros(len(is_so))
    for out in np.unique(fold):
        is_in = fold != out
        model = fit_logistic({name: column[is_in] for name, column in columns.items()}, is_so[is_in], terms, penalty=penalty)
        chance[~is_in] = model.probability({name: column[~is_in] for name, column in columns.items()})
    return chance


def fit_band(columns: Columns, moves: FloatArray, fold: IntArray, terms: Sequence[Term], *, penalty: float, share: float) -> Model:
    """Fit the length within which a share of moves stays, given what describes a run.

    Parameters
    ----------
    moves
        Shape (n,), above 0.

    Notes
    -----
    Quantile regression of logarithms, its corner rounded; then the constant is set by what folds that were left out show.
    """

    def fit(is_in: BoolArray) -> Model:
        design = make_design({name: column[is_in] for name, column in columns.items()}, terms)
        wanted = np.log(moves[is_in])

        def loss(parameters: FloatArray) -> tuple[float, FloatArray]:
            beyond = wanted - parameters[0] - design.matrix @ parameters[1:]
            below = 1.0 / (1.0 + np.exp(np.clip(beyond / _ROUNDED_CORNER, -500.0, 500.0)))
            slope = share - below
            total = float(np.sum(share * beyond + _ROUNDED_CORNER * np.logaddexp(0.0, -beyond / _ROUNDED_CORNER)))
            grown = np.concatenate([[-slope.sum()], -design.matrix.T @ slope + penalty * parameters[1:]])
            return total + 0.5 * penalty * float(parameters[1:] @ parameters[1:]), grown

        begin = np.concatenate([[float(np.quantile(wanted, share))], np.zeros(len(terms))])
        best = minimize(loss, begin, jac=True, method="L-BFGS-B").x
        return design.model(best[0], best[1:])

    beyond = np.zeros(len(moves))
    for out in np.unique(fold):
        is_out = fold == out
        beyond[is_out] = np.log(moves[is_out]) - fit(~is_out).score({name: column[is_out] for name, column in columns.items()})
    model = fit(np.ones(len(moves), dtype=bool))
    constant = model.constant + float(np.quantile(beyond, share, method="higher"))
    return Model(features=model.features, constant=constant, weights=model.weights)


def fit_choice(columns: Columns, run: IntArray, is_true: BoolArray, terms: Sequence[Term], *, penalty: float) -> Model:
    """Fit scores of which the highest is to be the true one of each run, by the likelihood of choices in proportion to their exponentials.

    Parameters
    ----------
    columns
        What describes each number of each run, shape (n,) each.
    run
        Whose it is, shape (n,), ascending from 0.
    is_true
        Whether it is the true one, shape (n,): one of each run.
    """
    design = make_design(columns, terms)
    begins = np.flatnonzero(np.diff(run, prepend=-1))

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        score = design.matrix @ weights
        score -= np.maximum.reduceat(score, begins)[run]
        chance = np.exp(score)
        chance /= np.add.reduceat(chance, begins)[run]
        slope = design.matrix.T @ (chance - is_true) + penalty * weights
        return -float(np.log(chance[is_true] + 1e-300).sum()) + 0.5 * penalty * float(weights @ weights), slope

    best = minimize(loss, np.zeros(len(terms)), jac=True, method="L-BFGS-B", options={"maxiter": 1000}).x
    return design.model(0.0, best)


def spread_folds(seeds: IntArray, *, period: int) -> IntArray:
    """Put runs into folds; the settings come in turn with ``period``, so each fold has all of them."""
    return np.asarray(seeds // period % N_FOLDS)


def expected_calibration_error(chance: FloatArray, is_so: BoolArray, *, n_bins: int = 10) -> float:
    """Average, over bins of equal width and weighted by what is in them, how far the mean probability is from the share that is so."""
    total = 0.0
    for low, high in pairwise(np.linspace(0.0, 1.0, n_bins + 1)):
        inside = (chance >= low) & ((chance < high) | (high == 1.0))
        if inside.any():
            total += inside.mean() * abs(chance[inside].mean() - is_so[inside].mean())
    return float(total)


def brier_skill(chance: FloatArray, is_so: BoolArray) -> float:
    """Say by which share the mean squared error is below that of always telling the base rate; nan where that makes no error."""
    base = is_so.mean()
    return float(1.0 - np.mean((chance - is_so) ** 2) / (base * (1.0 - base))) if 0.0 < base < 1.0 else float("nan")


def area_under_roc(chance: FloatArray, is_so: BoolArray) -> float:
    """Say how often what is so has the higher probability than what is not, ties counting half; nan where all or none is so."""
    n_so, n_not = int(is_so.sum()), int((~is_so).sum())
    if not n_so or not n_not:
        return float("nan")
    values, place = np.unique(chance, return_inverse=True)
    counts = np.bincount(place, minlength=len(values))
    middle_rank = np.cumsum(counts) - (counts - 1) / 2.0
    return float((middle_rank[place][is_so].sum() - n_so * (n_so + 1) / 2.0) / (n_so * n_not))


def _standard(column: FloatArray) -> tuple[float, float, float, float]:
    low, high = np.quantile(column, _CUT)
    cut = np.clip(column, low, high)
    return float(low), float(high), float(cut.mean()), float(cut.std()) or 1.0
