"""How likely each number of holes is."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.confidence.counting import MOST_MISSED, count_holes

chances = st.lists(st.floats(0.0, 1.0), max_size=6)


@given(chances, st.floats(0.0, 5.0), st.floats(0.2, 1.0))
def test_the_probabilities_of_all_numbers_sum_to_one(probabilities: list[float], missed: float, sharpness: float) -> None:
    count = count_holes(probabilities, missed=missed, sharpness=sharpness)
    assert count.shape == (len(probabilities) + MOST_MISSED + 1,)
    assert count.sum() == pytest.approx(1.0)
    assert (count >= 0.0).all()


@given(chances)
def test_with_nothing_missed_it_is_the_sum_over_all_ways_to_be_right(probabilities: list[float]) -> None:
    expected = np.zeros(len(probabilities) + 1)
    for are_there in product([False, True], repeat=len(probabilities)):
        expected[sum(are_there)] += np.prod([p if is_there else 1.0 - p for p, is_there in zip(probabilities, are_there, strict=True)])
    count = count_holes(probabilities, missed=0.0, sharpness=1.0)
    assert count[: len(expected)] == pytest.approx(expected, abs=1e-12)
    assert count[len(expected) :] == pytest.approx(0.0)


def test_holes_that_no_loop_shows_are_added() -> None:
    """One certain hole, and on average one more: e^-1 that there is no other."""
    count = count_holes([1.0], missed=1.0, sharpness=1.0)
    assert count[:4] == pytest.approx([0.0, np.exp(-1), np.exp(-1), np.exp(-1) / 2], rel=1e-6)


def test_a_lower_sharpness_spreads_the_numbers() -> None:
    sharp, spread = (count_holes([0.9, 0.9, 0.1], missed=0.05, sharpness=sharpness) for sharpness in (1.0, 0.5))
    assert spread.max() < sharp.max()
    assert spread.argmax() == sharp.argmax() == 2
