"""Metrics, outliers and the subsample, against slow versions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.encounter_graph import EncounterGraph
from mapper.kernels import Kernels
from mapper.metric import EncounterMetric, Metric, profile_metric
from mapper.outliers import keep_inliers, mean_neighbour_distance
from mapper.subsampling import subsample_maxmin
from mapper.types import ModeSpell, ProfileNorm
from tests.mapper.graphs import KERNELS, all_times, largest_of, matrix_of
from tests.mapper.worlds import Row, encounter_rows, mode_spells, table_of, walk_track

kinds_of_kernels = st.sampled_from(KERNELS)
with_all_kernels = pytest.mark.parametrize("kernels", KERNELS, ids=lambda kernels: kernels.name)


def _metrics(graph: EncounterGraph) -> list[Metric]:
    references = np.arange(0, graph.n_vertices, 2)
    profiles = [profile_metric(graph, references, norm=norm) for norm in ProfileNorm]
    return [EncounterMetric(graph=graph), *profiles]


@given(encounter_rows(max_size=14), mode_spells, kinds_of_kernels)
def test_every_metric_is_symmetric_and_obeys_the_triangle_inequality(rows: list[Row], spells: list[ModeSpell], kernels: Kernels) -> None:
    for metric in _metrics(largest_of(rows, spells, kernels)):
        d = matrix_of(metric)
        assert np.array_equal(d, d.T)
        assert not d.diagonal().any()
        assert (d[:, None, :] <= d[:, :, None] + d[None, :, :] + 1e-9).all()


@given(encounter_rows(max_size=14), mode_spells, kinds_of_kernels)
def test_the_profile_metric_never_exceeds_the_encounter_metric(rows: list[Row], spells: list[ModeSpell], kernels: Kernels) -> None:
    encounter, *profiles = _metrics(largest_of(rows, spells, kernels))
    for profile in profiles:
        assert (matrix_of(profile) <= matrix_of(encounter) + 1e-9).all()


@with_all_kernels
def test_with_every_vertex_as_reference_the_largest_profile_difference_is_the_encounter_metric(kernels: Kernels) -> None:
    graph = largest_of(*walk_track(n_landmarks=6, n_walkers=3, duration_s=20, seed=1, is_ring=True), kernels)
    profile = profile_metric(graph, np.arange(graph.n_vertices), norm=ProfileNorm.MAX)
    assert np.array_equal(matrix_of(profile), matrix_of(EncounterMetric(graph=graph)))


@given(encounter_rows(max_size=14), mode_spells, st.integers(1, 12), kinds_of_kernels)
def test_neighbour_means_count_encounters_with_multiplicity(rows: list[Row], spells: list[ModeSpell], k: int, kernels: Kernels) -> None:
    graph = largest_of(rows, spells, kernels)
    for metric in _metrics(graph):
        matrix = np.repeat(matrix_of(metric), graph.multiplicity, axis=1)
        # The first of the sorted row is the encounter itself.
        nearest = np.sort(matrix, axis=1)[:, 1 : k + 1]
        wanted = nearest.mean(axis=1) if nearest.shape[1] else np.zeros(graph.n_vertices)
        assert mean_neighbour_distance(metric, k=k) == pytest.approx(wanted, abs=1e-9)


@with_all_kernels
def test_neighbour_means_agree_with_full_runs_on_a_graph_with_hubs(kernels: Kernels) -> None:
    graph = largest_of(*walk_track(n_landmarks=12, n_walkers=9, duration_s=120, seed=2, is_ring=True), kernels)
    wanted = np.sort(np.repeat(all_times(graph), graph.multiplicity, axis=1), axis=1)[:, 1:11]
    assert np.array_equal(mean_neighbour_distance(EncounterMetric(graph=graph), k=10), wanted.mean(axis=1))


def _free_walk(n: int, seed: int) -> list[Row]:
    rng = np.random.default_rng(seed)
    return [(int(t), int(t) + 1, *map(int, rng.choice(np.arange(1, 9), 2, replace=False))) for t in rng.integers(0, 10**6, n)]  # type: ignore[misc]  # two ids


@with_all_kernels
def test_the_quantile_keeps_its_share_of_the_encounters(kernels: Kernels) -> None:
    graph = largest_of(_free_walk(1000, seed=3), (), kernels)
    kept = graph.multiplicity[keep_inliers(EncounterMetric(graph=graph), k=10, q=0.9)].sum()
    assert kept / graph.n_encounters == pytest.approx(0.9, abs=0.005)


@with_all_kernels
def test_at_least_one_encounter_is_kept(kernels: Kernels) -> None:
    graph = largest_of([(0, 0, 1, 2), (5, 5, 1, 2)], (), kernels)
    assert keep_inliers(EncounterMetric(graph=graph), k=10, q=0.01).any()


@given(encounter_rows(max_size=14), mode_spells, st.integers(1, 10), st.integers(0, 3), kinds_of_kernels)
def test_maxmin_picks_the_furthest_candidate_and_gives_ties_to_the_earlier(
    rows: list[Row], spells: list[ModeSpell], n_points: int, skipped: int, kernels: Kernels
) -> None:
    for metric in _metrics(largest_of(rows, spells, kernels)):
        matrix = matrix_of(metric)
        candidates = np.arange(len(matrix)) % 3 != skipped
        candidates[-1] = True
        picked = [int(candidates.argmax())]
        while len(picked) < n_points and (gap := np.where(candidates, matrix[picked].min(axis=0), -1)).max() > 0:
            picked.append(int(gap.argmax()))
        sample = subsample_maxmin(metric, candidates, n_points=n_points)
        assert sample.vertices.tolist() == picked
        assert np.array_equal(sample.distances, matrix[np.ix_(picked, picked)])
        assert sample.cover_radius == matrix[np.ix_(picked, candidates)].min(axis=0).max()


@given(encounter_rows(max_size=20), mode_spells, kinds_of_kernels)
def test_the_cover_radius_never_grows_with_more_points(rows: list[Row], spells: list[ModeSpell], kernels: Kernels) -> None:
    metric = EncounterMetric(graph=largest_of(rows, spells, kernels))
    everything = np.ones(metric.graph.n_vertices, dtype=bool)
    radii = [subsample_maxmin(metric, everything, n_points=n).cover_radius for n in range(1, 12)]
    assert radii == sorted(radii, reverse=True)


def _zigzag(n: int) -> list[Row]:
    """Each biobot has two encounters, one early and one late, so that the path along all of them turns at every one."""
    return [(10 * n * (i % 2) + i, 10 * n * (i % 2) + i, i + 1, i + 2) for i in range(n)]


@with_all_kernels
def test_paths_that_turn_at_every_encounter_are_measured_too(kernels: Kernels) -> None:
    """300 encounters; the gaps between one and the next are 10 n + 1 and 10 n - 1 in turns, and a tick is half of one."""
    n = 300
    graph = largest_of(_zigzag(n), (), kernels)
    place = table_of(_zigzag(n)).id1[graph.first_encounter] - 1
    gaps = [2 * (10 * n + (1 if i % 2 == 0 else -1)) for i in range(n - 1)]
    along = np.concatenate([[0], np.cumsum(gaps)])[place]
    assert np.array_equal(all_times(graph), np.abs(along[:, None] - along[None, :]))


def test_many_landmarks_and_landmarks_that_met_hardly_anybody_change_no_pick() -> None:
    """Hubs of all kinds: none, one that is on no path, one for every biobot; searches that meet no good hub end another way."""
    rows = [*_free_walk(1500, seed=4), (10, 11, 1, 99)]
    for nodes in ([], [99], [99, 1], range(1, 9)):
        spells = [ModeSpell(node=NodeId(node), t_start_ns=0, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for node in nodes]
        one, other = (
            subsample_maxmin(EncounterMetric(graph=graph), np.ones(graph.n_vertices, dtype=bool), n_points=40)
            for graph in (largest_of(rows, spells, kernels) for kernels in KERNELS)
        )
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.distances, other.distances)
        assert one.cover_radius == other.cover_radius


def test_more_sources_than_are_swept_at_once_measure_the_same() -> None:
    compiled, plain = (largest_of(_free_walk(400, seed=5), (), kernels) for kernels in KERNELS)
    assert np.array_equal(all_times(compiled), all_times(plain))


def test_the_busiest_landmarks_are_kept_and_equals_by_time() -> None:
    spells = [ModeSpell(node=NodeId(node), t_start_ns=0, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for node in (1, 2, 3)]
    rows: list[Row] = [(0, 0, 1, 9), (5, 5, 2, 9), (7, 7, 3, 9), (9, 9, 3, 8)]
    graph = largest_of(rows, spells, KERNELS[0])
    assert graph.landmarks.tolist() == [0, 1, 2]
    assert graph.busiest_landmarks(3).tolist() == [0, 1, 2]
    assert graph.busiest_landmarks(2).tolist() == [0, 2]
    assert graph.busiest_landmarks(1).tolist() == [2]
