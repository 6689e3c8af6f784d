"""Bringing a map onto the truth."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from studies.comparison import fit_similarity

angles = st.floats(0, 6.28)
numbers = st.floats(-100, 100)


@given(angles, st.floats(0.01, 100), numbers, numbers, st.booleans(), st.integers(3, 20), st.integers(0, 1000))
def test_a_shifted_turned_scaled_and_mirrored_copy_is_brought_back(
    angle: float, scale: float, dx: float, dy: float, is_mirrored: bool, n: int, seed: int
) -> None:
    truth = np.random.default_rng(seed).normal(size=(n, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    copy = scale * truth @ turn + [dx, dy]
    if is_mirrored:
        copy = copy * [-1, 1]

    moved = fit_similarity(copy, truth)(copy)

    assert np.allclose(moved, truth, atol=1e-8)


def test_points_all_in_one_place_are_only_shifted() -> None:
    points = np.zeros((3, 2))

    assert np.allclose(fit_similarity(points, points + 5)(points), 5)
