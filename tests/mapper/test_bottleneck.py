"""The bottleneck distance is that of the best of all pairings."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.bottleneck import Floats, bottleneck_distance


@st.composite
def diagrams(draw: st.DrawFn, most: int) -> Floats:
    bars = draw(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9)), max_size=most))
    return np.array([(birth, birth + length) for birth, length in bars], dtype=np.float64).reshape(-1, 2)


@given(diagrams(3), diagrams(3))
def test_it_is_the_least_over_all_pairings(one: Floats, other: Floats) -> None:
    """Every bar may be paired with its own place on the diagonal, and places on the diagonal with each other."""
    n, m = len(one), len(other)
    cost = np.full((n + m, n + m), np.inf)
    cost[:n, :m] = np.abs(one[:, None] - other).max(axis=2)
    cost[np.arange(n), m + np.arange(n)] = (one[:, 1] - one[:, 0]) / 2
    cost[n + np.arange(m), np.arange(m)] = (other[:, 1] - other[:, 0]) / 2
    cost[n:, m:] = 0.0
    wanted = min(max((cost[i, j] for i, j in enumerate(order)), default=0.0) for order in permutations(range(n + m)))
    assert bottleneck_distance(one, other) == wanted


@given(diagrams(12), diagrams(12))
def test_it_does_not_mind_which_comes_first(one: Floats, other: Floats) -> None:
    assert bottleneck_distance(one, other) == bottleneck_distance(other, one)
    assert bottleneck_distance(one, one) == 0.0


def test_a_hand_made_pair() -> None:
    """The long bars are 0.5 apart; the short one is a quarter from the diagonal."""
    assert bottleneck_distance(np.array([[0.0, 5.0], [1.0, 1.5]]), np.array([[0.5, 5.0]])) == pytest.approx(0.5)
