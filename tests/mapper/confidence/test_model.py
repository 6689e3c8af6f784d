"""What the fitted models compute, and that those shipped fit the maps that are made."""

import numpy as np
import pytest

from mapper.confidence import Model, load_models
from mapper.confidence.counting import COUNT_FEATURES
from mapper.confidence.evidence import LOOP_FEATURES, POINT_FEATURES, RUN_FEATURES
from mapper.types import Method, MetricKind

_MODEL = Model(
    features={"a": (0.0, 10.0, 5.0, 2.0), "b": (-1.0, 1.0, 0.0, 1.0)},
    constant=0.5,
    weights={("a",): 1.0, ("a", "b"): -2.0, ("b", "b"): 0.25},
)


def test_a_score_is_the_sum_of_weighted_terms() -> None:
    """Where a is 7, 1 deviation above its mean, and b is 0.5: 0.5 + 1 - 2 * 1 * 0.5 + 0.25 * 0.25."""
    assert _MODEL.score({"a": np.array([7.0]), "b": np.array([0.5])}) == pytest.approx([0.5625])


def test_numbers_beyond_those_of_training_are_cut() -> None:
    beyond, at = ({"a": np.array([a]), "b": np.array([b])} for a, b in ((1e9, -50.0), (10.0, -1.0)))
    assert _MODEL.score(beyond) == _MODEL.score(at)


def test_a_probability_is_the_logistic_of_the_score() -> None:
    columns = {"a": np.array([5.0, 9.0]), "b": np.zeros(2)}
    assert _MODEL.probability(columns) == pytest.approx(1.0 / (1.0 + np.exp(-_MODEL.score(columns))))


def test_shipped_models_ask_for_what_maps_tell_and_are_of_the_default_method_alone() -> None:
    models = load_models(Method.DEFAULT, MetricKind.LANDMARK_PROFILE)
    assert models is not None
    assert set(models.loop.features) == {*LOOP_FEATURES, *RUN_FEATURES}
    assert set(models.point.features) == {*POINT_FEATURES, *RUN_FEATURES}
    assert set(models.count.features) == {*COUNT_FEATURES, *RUN_FEATURES}
    assert set(models.band.features) == set(RUN_FEATURES)
    assert load_models(Method.PAPER, MetricKind.ENCOUNTER) is None
