"""Metrics, outliers and the subsample, against slow versions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.encounter_graph import EncounterGraph, build_encounter_graph, split_components
from mapper.metric import EncounterMetric, Metric, profile_metric, shortest_times
from mapper.outliers import keep_inliers, mean_neighbour_distance
from mapper.subsampling import subsample_maxmin
from mapper.types import FloatArray, ModeSpell, ProfileNorm
from tests.mapper.worlds import Row, encounter_rows, mode_spells, table_of, walk_track


def _largest(rows: list[Row], spells: list[ModeSpell] | tuple[ModeSpell, ...]) -> EncounterGraph:
    return split_components(build_encounter_graph(table_of(rows), spells, moving_time=False))[0]


def _metrics(graph: EncounterGraph) -> list[Metric]:
    references = np.arange(0, graph.n_vertices, 2)
    profiles: list[Metric] = [profile_metric(graph, references, norm=norm) for norm in ProfileNorm]
    return [EncounterMetric(graph=graph), *profiles]


def _matrix(metric: Metric) -> FloatArray:
    return np.array([metric.distances_from(vertex) for vertex in range(metric.graph.n_vertices)])


@given(encounter_rows(max_size=14), mode_spells)
def test_every_metric_is_symmetric_and_obeys_the_triangle_inequality(rows: list[Row], spells: list[ModeSpell]) -> None:
    for metric in _metrics(_largest(rows, spells)):
        d = _matrix(metric)
        assert np.array_equal(d, d.T)
        assert not d.diagonal().any()
        assert (d[:, None, :] <= d[:, :, None] + d[None, :, :] + 1e-9).all()


@given(encounter_rows(max_size=14), mode_spells)
def test_the_profile_metric_never_exceeds_the_encounter_metric(rows: list[Row], spells: list[ModeSpell]) -> None:
    encounter, *profiles = _metrics(_largest(rows, spells))
    for profile in profiles:
        assert (_matrix(profile) <= _matrix(encounter) + 1e-9).all()


def test_with_every_vertex_as_reference_the_largest_profile_difference_is_the_encounter_metric() -> None:
    graph = _largest(*walk_track(n_landmarks=6, n_walkers=3, duration_s=20, seed=1, is_ring=True))
    profile = profile_metric(graph, np.arange(graph.n_vertices), norm=ProfileNorm.MAX)
    assert np.array_equal(_matrix(profile), _matrix(EncounterMetric(graph=graph)))


@given(encounter_rows(max_size=14), mode_spells, st.integers(1, 12))
def test_neighbour_means_count_encounters_with_multiplicity(rows: list[Row], spells: list[ModeSpell], k: int) -> None:
    graph = _largest(rows, spells)
    for metric in _metrics(graph):
        matrix = np.repeat(_matrix(metric), graph.multiplicity, axis=1)
        # The first of the sorted row is the encounter itself.
        nearest = np.sort(matrix, axis=1)[:, 1 : k + 1]
        wanted = nearest.mean(axis=1) if nearest.shape[1] else np.zeros(graph.n_vertices)
        assert mean_neighbour_distance(metric, k=k) == pytest.approx(wanted, abs=1e-9)


def test_neighbour_means_agree_with_full_runs_on_a_graph_with_hubs() -> None:
    graph = _largest(*walk_track(n_landmarks=12, n_walkers=9, duration_s=120, seed=2, is_ring=True))
    wanted = np.sort(np.repeat(shortest_times(graph, list(range(graph.n_vertices))), graph.multiplicity, axis=1), axis=1)[:, 1:11]
    assert np.array_equal(mean_neighbour_distance(EncounterMetric(graph=graph), k=10), wanted.mean(axis=1))


def _free_walk(n: int, seed: int) -> list[Row]:
    rng = np.random.default_rng(seed)
    return [(int(t), int(t) + 1, *map(int, rng.choice(np.arange(1, 9), 2, replace=False))) for t in rng.integers(0, 10**6, n)]  # type: ignore[misc]  # two ids


def test_the_quantile_keeps_its_share_of_the_encounters() -> None:
    graph = _largest(_free_walk(1000, seed=3), ())
    kept = graph.multiplicity[keep_inliers(EncounterMetric(graph=graph), k=10, q=0.9)].sum()
    assert kept / graph.n_encounters == pytest.approx(0.9, abs=0.005)


def test_at_least_one_encounter_is_kept() -> None:
    graph = _largest([(0, 0, 1, 2), (5, 5, 1, 2)], ())
    assert keep_inliers(EncounterMetric(graph=graph), k=10, q=0.01).any()


@given(encounter_rows(max_size=14), mode_spells, st.integers(1, 10), st.integers(0, 3))
def test_maxmin_picks_the_furthest_candidate_and_gives_ties_to_the_earlier(
    rows: list[Row], spells: list[ModeSpell], n_points: int, skipped: int
) -> None:
    for metric in _metrics(_largest(rows, spells)):
        matrix = _matrix(metric)
        candidates = np.arange(len(matrix)) % 3 != skipped
        candidates[-1] = True
        picked = [int(candidates.argmax())]
        while len(picked) < n_points and (gap := np.where(candidates, matrix[picked].min(axis=0), -1)).max() > 0:
            picked.append(int(gap.argmax()))
        sample = subsample_maxmin(metric, candidates, n_points=n_points)
        assert sample.vertices.tolist() == picked
        assert np.array_equal(sample.distances, matrix[np.ix_(picked, picked)])
        assert sample.cover_radius == matrix[np.ix_(picked, candidates)].min(axis=0).max()


@given(encounter_rows(max_size=20), mode_spells)
def test_the_cover_radius_never_grows_with_more_points(rows: list[Row], spells: list[ModeSpell]) -> None:
    metric = EncounterMetric(graph=_largest(rows, spells))
    everything = np.ones(metric.graph.n_vertices, dtype=bool)
    radii = [subsample_maxmin(metric, everything, n_points=n).cover_radius for n in range(1, 12)]
    assert radii == sorted(radii, reverse=True)
