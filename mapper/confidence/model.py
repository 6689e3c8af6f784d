"""The fitted models: sums of weighted terms, each a number that describes a map or the product of two."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from mapper.types import FloatArray, Method, MetricKind

_FILE = "confidence.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """A weighted sum of terms.

    Parameters
    ----------
    features
        For each number by its name: the least and the greatest in training, to which it is cut, and its mean and deviation there, by which
        it is made standard.
    constant
        The sum where every number is as on average.
    weights
        Of each term, by the one or two names that are multiplied in it.
    """

    features: Mapping[str, tuple[float, float, float, float]]
    constant: float
    weights: Mapping[tuple[str, ...], float]

    def score(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """Sum the terms; all columns have one shape, and so has the answer."""
        standard = {
            name: (np.clip(columns[name], low, high) - mean) / deviation for name, (low, high, mean, deviation) in self.features.items()
        }
        total = np.full(np.shape(next(iter(standard.values()))), self.constant)
        for names, weight in self.weights.items():
            total += weight * np.prod([standard[name] for name in names], axis=0)
        return total

    def probability(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """Take the sum for the logarithm of odds."""
        return np.asarray(1.0 / (1.0 + np.exp(-self.score(columns))))


@dataclass(frozen=True, slots=True, kw_only=True)
class Models:
    """All that the package ships for one method and metric.

    Parameters
    ----------
    loop
        Odds that a loop goes around an obstacle.
    count
        How well a number of holes fits, as `mapper.confidence.counting` takes it.
    prior
        Shares of the training runs with 0, 1, 2, ... holes: what is known of a map of too few points.
    band
        Logarithm of the length, over the map's reach, that the diagram is not further than from the true one in 95 % of runs.
    point
        Odds that a point's distances are right.
    """

    loop: Model
    count: Model
    prior: tuple[float, ...]
    band: Model
    point: Model
    trained_on: str = ""
    command: str = ""


@cache
def load_models(method: Method, metric: MetricKind) -> Models | None:
    """Read the models that the package ships for one method and metric; None where there are none, for nobody trained them."""
    content = json.loads(resources.files("mapper").joinpath("data", _FILE).read_text(encoding="utf-8"))
    entry = content.get(f"{method}/{metric}")
    if entry is None:
        return None
    return Models(
        **{name: _read_model(entry[name]) for name in ("loop", "count", "band", "point")},
        prior=tuple(map(float, entry["prior"])),
        trained_on=entry["trained_on"],
        command=entry["command"],
    )


def _read_model(entry: Mapping[str, Mapping[str, object]]) -> Model:
    numbers = {name: tuple(map(float, four)) for name, four in entry["features"].items()}  # type: ignore[call-overload]
    weights = {tuple(names.split(" * ")): float(weight) for names, weight in entry["weights"].items()}  # type: ignore[arg-type]
    return Model(features=numbers, constant=float(entry["constant"]), weights=weights)  # type: ignore[arg-type]
