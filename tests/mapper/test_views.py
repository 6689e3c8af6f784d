"""How much of a map the swarm saw at one time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapper.types import FloatArray, IntArray
from mapper.views import ONE_VIEW, count_views


def _row(n: int) -> FloatArray:
    """Distances between places one apart in a row."""
    place = np.arange(n, dtype=float)
    return np.abs(place[:, None] - place)


def _moving(n: int, at_once: int) -> IntArray:
    """Stands of which each meets those within less than ``at_once`` places."""
    return np.array([(k, k + at_once - 1) for k in range(n)])


@settings(max_examples=20)
@given(st.integers(0, 30), st.integers(0, 99))
def test_landmarks_that_all_stood_at_one_time_are_one_view(n: int, end: int) -> None:
    assert count_views(_row(n), np.tile([0, end], (n, 1))) is ONE_VIEW


@settings(max_examples=20)
@given(st.integers(4, 12), st.integers(2, 10))
def test_a_swarm_that_moves_on_sees_as_many_views_as_it_goes_lengths(width: int, lengths: int) -> None:
    """In a row of ``width * lengths`` places of which ``width`` to either side stand with one. At the ends half of them: hence the room."""
    n = 2 * width * lengths
    views = count_views(_row(n), _moving(n, width))
    assert lengths / 2 <= views.number <= 2 * lengths + 1
    assert 0.5 / (2 * lengths) <= views.reach <= 2.5 / (2 * lengths)


@settings(max_examples=20)
@given(st.integers(3, 12), st.integers(1, 5), st.floats(0.1, 10), st.integers(-50, 50))
def test_neither_the_unit_of_length_nor_the_zero_of_time_matters(n: int, at_once: int, scale: float, zero: int) -> None:
    one, other = count_views(_row(n), _moving(n, at_once)), count_views(scale * _row(n), _moving(n, at_once) + zero)
    assert other.number == one.number
    assert other.reach == pytest.approx(one.reach)


def test_landmarks_that_stood_one_after_the_other_say_nothing() -> None:
    assert count_views(_row(5), np.array([(2 * k, 2 * k + 1) for k in range(5)])) is ONE_VIEW
