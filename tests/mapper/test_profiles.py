"""Bracketed profiles against their definition, and what they are for: taking away what a path is too long."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.config import RecipeConfig, make_recipe
from mapper.encounter_graph import EncounterGraph
from mapper.kernels import Kernels
from mapper.metric import times_to
from mapper.pipeline import count_points
from mapper.profiles import ProfileBracket, bracket_profiles, keep_well_bracketed
from mapper.types import FloatArray, IntArray, Method
from tests.mapper.graphs import KERNELS, all_times, largest_of
from tests.mapper.worlds import encounter_rows, mode_spells

with_all_kernels = pytest.mark.parametrize("kernels", KERNELS, ids=lambda kernels: kernels.name)


def _bracket(graph: EncounterGraph, n_references: int) -> tuple[FloatArray, ProfileBracket, IntArray]:
    references = np.arange(graph.n_vertices)[:: max(1, graph.n_vertices // n_references)]
    times = times_to(graph, references)
    return times, bracket_profiles(times.copy(), references, kernels=graph.kernels), references


graphs = st.builds(largest_of, encounter_rows(max_size=14), mode_spells, st.sampled_from(KERNELS))


@given(graphs, st.integers(1, 6))
def test_the_middle_is_half_way_between_the_bounds(graph: EncounterGraph, n_references: int) -> None:
    times, bracket, references = _bracket(graph, n_references)
    half_gap = np.zeros_like(times)
    for i in range(graph.n_vertices):
        for k in range(len(references)):
            lower = [times[references[k], m] - times[i, m] for m in range(len(references)) if m != k]
            half_gap[i, k] = (times[i, k] - max(lower)) / 2 if lower else 0.0
    assert (half_gap >= 0).all()
    assert np.array_equal(bracket.middle, times - half_gap)
    assert np.array_equal(bracket.doubt, np.median(half_gap, axis=1))


@given(graphs, st.integers(1, 6))
def test_the_middle_moves_no_faster_than_the_encounter_metric(graph: EncounterGraph, n_references: int) -> None:
    _, bracket, _ = _bracket(graph, n_references)
    apart = np.abs(bracket.middle[:, None] - bracket.middle[None]).max(axis=2)
    assert (apart <= all_times(graph) + 1e-6).all()


@given(graphs, st.integers(2, 6))
def test_nothing_is_in_doubt_at_a_reference_when_there_are_others(graph: EncounterGraph, n_references: int) -> None:
    times, bracket, references = _bracket(graph, n_references)
    away = ~np.eye(len(references), dtype=bool)
    assert np.array_equal(bracket.middle[references][away], times[references][away])


@given(st.lists(st.integers(1, 999), min_size=1, max_size=20), st.integers(0, 500))
def test_a_delay_common_to_all_paths_vanishes_between_references(places: list[int], delay: int) -> None:
    """References at 0, 0, 1000 and 1000 of a line: each has one that is at its place, and two beyond every point between."""
    at = np.array([0.0, 0.0, 1000.0, 1000.0, *places])
    times = np.abs(at[:, None] - at[None, :4])
    times[4:] += delay
    for kernels in KERNELS:
        bracket = bracket_profiles(times.copy(), np.arange(4), kernels=kernels)
        assert np.array_equal(bracket.middle[4:], np.abs(at[4:, None] - at[None, :4]))
        assert (bracket.doubt[4:] == delay).all()


@with_all_kernels
def test_blocks_of_rows_and_threads_change_nothing(kernels: Kernels) -> None:
    places = np.random.default_rng(0).uniform(0, 100, (45_000, 2))
    times = np.sqrt(((places[:, None] - places[None, :5]) ** 2).sum(axis=2))
    whole = bracket_profiles(times.copy(), np.arange(5), kernels=kernels)
    tail = bracket_profiles(np.vstack([times[:5], times[44_000:]]), np.arange(5), kernels=kernels)
    assert np.array_equal(whole.middle[44_000:], tail.middle[5:])
    assert np.array_equal(whole.doubt[44_000:], tail.doubt[5:])


@given(st.lists(st.floats(0, 100), min_size=1, max_size=30), st.floats(0.01, 1))
def test_the_vertices_kept_are_the_least_doubtful(doubt: list[float], q: float) -> None:
    bracket = ProfileBracket(middle=np.zeros((len(doubt), 1)), doubt=np.array(doubt))
    kept = keep_well_bracketed(bracket, q=q)
    assert kept.any()
    assert q < 1 or kept.all()
    assert max(bracket.doubt[kept]) < min(bracket.doubt[~kept], default=np.inf)


@given(st.integers(2, 10**6))
def test_the_subsample_grows_with_the_encounters_between_its_limits(n_encounters: int) -> None:
    recipe = make_recipe(RecipeConfig())
    points = count_points(n_encounters, recipe)
    assert 100 <= points <= recipe.n_points
    assert points <= count_points(n_encounters + 1, recipe)
    assert points * recipe.encounters_per_point <= n_encounters or points == 100


def test_the_paper_asks_for_its_150_points_whatever_there_is() -> None:
    assert count_points(2, make_recipe(RecipeConfig(method=Method.PAPER))) == 150


def test_few_points_asked_for_are_not_raised() -> None:
    assert count_points(10**6, make_recipe(RecipeConfig(n_points=20))) == 20


@given(graphs, st.integers(1, 6))
def test_compiled_and_plain_kernels_bracket_alike(graph: EncounterGraph, n_references: int) -> None:
    times, bracket, references = _bracket(graph, n_references)
    for kernels in KERNELS:
        other = bracket_profiles(times.copy(), references, kernels=kernels)
        assert np.array_equal(other.middle, bracket.middle)
        assert np.array_equal(other.doubt, bracket.doubt)
