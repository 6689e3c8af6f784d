"""Judge which intervals of a diagram are real ([Dir16] VI.B, eq. 15)."""

import json
from dataclasses import dataclass
from importlib import resources
from math import inf
from typing import Any

import numpy as np

from mapper.types import BettiRule, BettiRuleKind, BoolArray, FloatArray, Method, MetricKind

REFERENCE_ENCOUNTERS = 1000
"""With so many, ``tau`` of a rule is what counts, whatever its ``power``."""
_MOST_ENCOUNTERS = 20_000  # of the training runs

_MIN_FOR_QUANTILE = 3
# On exact geodesics of 200 arenas, death over birth above 2 alone counts the holes right in 99.5 %.
_FEW_INTERVALS_RATIO = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainedRules:
    """Rules for dimensions 0 and 1, and where they come from."""

    rules: tuple[BettiRule, BettiRule]
    trained_on: str
    command: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Threshold:
    """What an interval must exceed, both: in its length as a share of the diameter, and in death over birth; -1 asks for nothing."""

    length_share: float
    ratio: float


def load_trained_rules(method: Method, metric: MetricKind) -> TrainedRules:
    """Read the rules that the package ships for one method and metric."""
    entry = read_rules()[f"{method}/{metric}"]
    merges, loops = (
        BettiRule(
            kind=BettiRuleKind(rule["rule"]),
            q=float(rule["q"]),
            delta=float(rule["delta"]),
            tau=float(rule["tau"]),
            power=float(rule["power"]),
        )
        for rule in (entry["dimension_0"], entry["dimension_1"])
    )
    return TrainedRules(rules=(merges, loops), trained_on=entry["trained_on"], command=entry["command"])


def read_rules() -> dict[str, Any]:
    """Read ``classifier.json`` as it is: an entry for each method and metric."""
    entries: dict[str, Any] = json.loads(resources.files("mapper").joinpath("data", "classifier.json").read_text(encoding="utf-8"))
    return entries


def judge_intervals(intervals: FloatArray, rule: BettiRule, *, diameter: float, n_encounters: int = REFERENCE_ENCOUNTERS) -> BoolArray:
    """Say which intervals of one dimension are real.

    Parameters
    ----------
    intervals
        Birth and death, shape (m, 2), in any one unit of length; a death of inf is one component that never merges.
    diameter
        Largest distance of the metric space, same unit.
    n_encounters
        Encounters that are no outliers: a rule with a ``power`` asks less where there are more, up to 20,000.

    Returns
    -------
    BoolArray
        Shape (m,). The Betti number is how many are True.

    Notes
    -----
    Lengths are divided by the diameter first, so that scaling the metric changes nothing. Intervals of zero length are never real and
    stay out of the quantile; infinite ones are always real and stay out of it too. The quantile is a length that occurs, the lower of two:
    a single real interval among few must not enter it. With fewer than three finite intervals a quantile
    means nothing: in dimension 1 death over birth above 2 decides; in dimension 0, where birth is 0, none is real.
    """
    births, deaths = intervals[:, 0], intervals[:, 1]
    is_infinite = np.isinf(deaths)
    is_finite, length = _measure(intervals, diameter=diameter)
    has_ratio = is_finite & (births > 0)
    ratio = np.divide(deaths, births, out=np.zeros(len(intervals)), where=has_ratio)
    threshold = find_threshold(intervals, rule, diameter=diameter, n_encounters=n_encounters)
    is_real = (length > threshold.length_share) & (ratio > threshold.ratio)
    return np.asarray((is_real & is_finite) | is_infinite)


def find_threshold(intervals: FloatArray, rule: BettiRule, *, diameter: float, n_encounters: int = REFERENCE_ENCOUNTERS) -> Threshold:
    """Say what an interval of a dimension must exceed to be real; parameters as in `judge_intervals`."""
    match rule.kind:
        case BettiRuleKind.CONNECTED:
            return Threshold(length_share=inf, ratio=-1.0)
        case BettiRuleKind.RATIO:
            return Threshold(length_share=rule.delta, ratio=rule.tau)
        case BettiRuleKind.QUANTILE:
            is_finite, length = _measure(intervals, diameter=diameter)
            if is_finite.sum() < _MIN_FOR_QUANTILE:
                return Threshold(length_share=-1.0, ratio=_FEW_INTERVALS_RATIO)
            scale = float(np.quantile(length[is_finite], rule.q, method="lower")) + rule.delta
            return Threshold(length_share=rule.tau * share_of_tau(n_encounters, power=rule.power) * scale, ratio=-1.0)


def _measure(intervals: FloatArray, *, diameter: float) -> tuple[BoolArray, FloatArray]:
    """Say which intervals are finite and have a length, and how long they are as shares of the diameter, shapes (m,)."""
    births, deaths = intervals[:, 0], intervals[:, 1]
    is_finite: BoolArray = ~np.isinf(deaths) & (deaths > births)
    return is_finite, np.where(is_finite, deaths - births, 0.0) / (diameter or 1.0)


def share_of_tau(n_encounters: int, *, power: float) -> float:
    """Return the factor to ``tau`` with so many encounters: 1 with a thousand, never less than with 20,000.

    Notes
    -----
    The more encounters there are, the less do the longest intervals of noise stand out from the others (docs/method.md).
    """
    return float((REFERENCE_ENCOUNTERS / min(max(n_encounters, 1), _MOST_ENCOUNTERS)) ** power)
