"""How likely each number of holes is."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.confidence import Model
from mapper.confidence.counting import COUNT_FEATURES, MOST_HOLES, add_up, count_holes, describe_numbers

chances = st.lists(st.floats(0.0, 1.0), max_size=6)
_MODEL = Model(
    features={"sum of loops": (-10.0, 0.0, 0.0, 1.0), "as counted": (0.0, 1.0, 0.0, 1.0)},
    constant=0.0,
    weights={("sum of loops",): 1.0, ("as counted",): 0.5},
)


@given(chances)
def test_independent_loops_add_up_as_the_sum_over_all_ways_to_be_there(probabilities: list[float]) -> None:
    expected = np.zeros(len(probabilities) + 1)
    for are_there in product([False, True], repeat=len(probabilities)):
        expected[sum(are_there)] += np.prod([p if is_there else 1.0 - p for p, is_there in zip(probabilities, are_there, strict=True)])
    assert add_up(np.array(probabilities)) == pytest.approx(expected, abs=1e-12)


@given(chances, st.integers(0, 20), st.lists(st.integers(0, 9), max_size=3))
def test_the_probabilities_of_all_numbers_sum_to_one(probabilities: list[float], counted: int, replicas: list[int]) -> None:
    columns = describe_numbers(np.array(probabilities), counted=counted, replicas=np.array(replicas, dtype=np.int64), run={})
    assert set(columns) == set(COUNT_FEATURES)
    count = count_holes(_MODEL, columns, prior=(1.0,), is_telling=True, alone=None)
    assert len(count) > max(MOST_HOLES, counted)
    assert count.sum() == pytest.approx(1.0)
    assert np.isfinite(count).all()


def test_numbers_are_described_by_the_loops_and_by_what_map_and_replicas_count() -> None:
    """Odds of 0.9 are log 9 and those of 0.2 are log 1/4: they fall most behind the first loop, by log 36."""
    columns = describe_numbers(np.array([0.2, 0.9]), counted=1, replicas=np.array([1, 2]), run={"landmarks": np.array(3.0)})
    assert columns["drop of chances"][:3] == pytest.approx([5 - np.log(9), np.log(36), 5 - np.log(4)])
    assert columns["sum of loops"][:3] == pytest.approx(np.log([0.08 + 1e-3, 0.74 + 1e-3, 0.18 + 1e-3]))
    assert columns["as counted"][:3].tolist() == [0.0, 1.0, 0.0]
    assert columns["more than counted"][:4].tolist() == [0.0, 0.0, 1.0, 2.0]
    assert columns["fewer than counted"][:3].tolist() == [1.0, 0.0, 0.0]
    assert columns["as in replicas"][:4].tolist() == [0.0, 0.5, 0.5, 0.0]
    assert columns["off the replicas"][:3].tolist() == [1.5, 0.5, 0.5]
    assert set(columns["landmarks"].tolist()) == {3.0}


def test_chances_are_in_proportion_to_the_exponentials_of_scores() -> None:
    columns = {"sum of loops": np.log([0.1, 0.6, 0.3]), "as counted": np.array([0.0, 1.0, 0.0])}
    weights = np.array([0.1, 0.6 * np.exp(0.5), 0.3])
    count = count_holes(_MODEL, columns, prior=(1.0,), is_telling=True, alone=None)
    assert count == pytest.approx(weights / weights.sum())


def test_of_a_map_that_tells_nothing_only_what_is_usual_is_known() -> None:
    columns = describe_numbers(np.array([0.9]), counted=1, replicas=np.zeros(0, dtype=np.int64), run={})
    count = count_holes(_MODEL, columns, prior=(0.6, 0.4), is_telling=False, alone=None)
    assert count[:3].tolist() == [0.6, 0.4, 0.0]
    assert len(count) == len(columns["number"])


def test_of_a_map_unlike_those_of_training_the_loops_tell_and_a_little_what_is_usual() -> None:
    chances = np.array([0.9, 0.5, 0.2])
    columns = describe_numbers(chances, counted=3, replicas=np.zeros(0, dtype=np.int64), run={})
    count = count_holes(_MODEL, columns, prior=(0.6, 0.4), is_telling=True, alone=chances)
    assert count[:4] == pytest.approx(0.8 * add_up(chances) + 0.2 * np.array([0.6, 0.4, 0.0, 0.0]))
    assert count.sum() == pytest.approx(1.0)
    of_none = count_holes(_MODEL, columns, prior=(0.6, 0.4), is_telling=True, alone=np.zeros(0))
    assert of_none[:2] == pytest.approx([0.92, 0.08]), "a map without a loop is no proof that there is no hole"
