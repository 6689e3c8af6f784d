"""Means over nearest profiles and the thinning before them, against their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapper.kernels import Kernels
from mapper.profiles import smooth_profiles, thin_out
from mapper.types import BoolArray, FloatArray
from tests.mapper.graphs import KERNELS

with_all_kernels = pytest.mark.parametrize("kernels", KERNELS, ids=lambda kernels: kernels.name)

shapes = st.tuples(st.integers(1, 70), st.integers(1, 21))
# Few values make many ties and many equal rows; profiles are halves of ticks, up to hours of them.
grids = shapes.flatmap(lambda shape: arrays(np.float64, shape, elements=st.integers(0, 2)))
half_ticks = shapes.flatmap(lambda shape: arrays(np.float64, shape, elements=st.integers(0, 2**45).map(lambda x: x / 2)))


def _literal_means(profiles: FloatArray, n_nearest: int) -> FloatArray:
    """All distances of all rows; every fourth column goes to one of four sums, and nearest rows are added in their order."""
    sums = [np.zeros((len(profiles), len(profiles))) for _ in range(4)]
    for k, column in enumerate(profiles.T):
        sums[k % 4] += (column[:, None] - column[None, :]) ** 2
    squares = (sums[0] + sums[1]) + (sums[2] + sums[3])
    nearest = np.sort(np.argsort(squares, axis=1, kind="stable")[:, :n_nearest], axis=1)
    total = np.zeros_like(profiles)
    for place in range(n_nearest):
        total += profiles[nearest[:, place]]
    return total / n_nearest


def _cloud(n: int, *, seed: int) -> FloatArray:
    """Times from places in a plane to twelve others [ticks], every tenth place very near to one of these, as near landmarks."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 50, (n, 2))
    landmarks = rng.uniform(0, 50, (12, 2))
    places[::10] = landmarks[rng.integers(0, 12, len(places[::10]))]
    times = np.sqrt(((places[:, None] - landmarks[None]) ** 2).sum(axis=2))
    return np.asarray(np.rint((times + rng.exponential(0.5, times.shape) * (np.arange(n) % 10 > 0)[:, None]) * 2e9))


@given(st.one_of(grids, half_ticks), st.data())
def test_all_kernels_average_the_nearest_rows_of_the_definition(profiles: FloatArray, data: st.DataObject) -> None:
    n_nearest = data.draw(st.integers(1, len(profiles)))
    wanted = _literal_means(profiles, n_nearest)
    for kernels in KERNELS:
        assert np.array_equal(kernels.average_nearest(profiles, n_nearest=n_nearest), wanted)


@with_all_kernels
@pytest.mark.parametrize("n_nearest", [1, 4, 150], ids=lambda n: f"{n} nearest")
def test_leaves_blocks_and_threads_change_nothing(kernels: Kernels, n_nearest: int) -> None:
    profiles = _cloud(1_700, seed=n_nearest)
    assert np.array_equal(kernels.average_nearest(profiles, n_nearest=n_nearest), _literal_means(profiles, n_nearest))


def test_compiled_and_plain_kernels_average_alike_where_many_profiles_are_the_same() -> None:
    profiles = np.repeat(_cloud(2_500, seed=1), 2, axis=0)
    compiled, plain = (kernels.average_nearest(profiles, n_nearest=7) for kernels in KERNELS)
    assert np.array_equal(compiled, plain)


@with_all_kernels
@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e100])
def test_the_unit_of_profiles_does_not_matter(kernels: Kernels, scale: float) -> None:
    profiles = _cloud(300, seed=2) * 2.0 ** round(np.log2(scale))
    assert np.array_equal(kernels.average_nearest(profiles, n_nearest=20), _literal_means(profiles, 20))


@given(grids, st.integers(0, 100), st.sampled_from(KERNELS))
def test_smoothing_averages_over_each_profile_and_its_neighbours(profiles: FloatArray, n_neighbours: int, kernels: Kernels) -> None:
    wanted = _literal_means(profiles, min(n_neighbours + 1, len(profiles)))
    assert np.array_equal(smooth_profiles(profiles, n_neighbours=n_neighbours, kernels=kernels), wanted)


@given(grids, st.integers(1, 5), st.integers(0, 3))
def test_passes_are_means_of_means(profiles: FloatArray, n_neighbours: int, n_passes: int) -> None:
    wanted = profiles
    for _ in range(n_passes):
        wanted = smooth_profiles(wanted, n_neighbours=n_neighbours, kernels=KERNELS[0])
    assert np.array_equal(smooth_profiles(profiles, n_neighbours=n_neighbours, n_passes=n_passes, kernels=KERNELS[0]), wanted)


masks = arrays(np.bool_, st.integers(1, 200))


@given(masks, st.integers(1, 250))
def test_thinning_takes_as_many_as_it_may_of_what_is_kept(kept: BoolArray, limit: int) -> None:
    thinned = thin_out(kept, limit=limit)
    assert not (thinned & ~kept).any()
    assert thinned.sum() == min(limit, kept.sum())


@given(masks, st.integers(1, 250))
def test_thinning_leaves_gaps_that_differ_by_one_at_most(kept: BoolArray, limit: int) -> None:
    steps = set(np.diff(np.flatnonzero(thin_out(kept, limit=limit)[kept])).tolist())
    assert len(steps) < 2 or max(steps) - min(steps) == 1


@given(masks, st.integers(0, 50))
def test_nothing_is_thinned_below_the_limit_or_without_one(kept: BoolArray, spare: int) -> None:
    assert np.array_equal(thin_out(kept, limit=0), kept)
    assert np.array_equal(thin_out(kept, limit=max(1, int(kept.sum())) + spare), kept)
