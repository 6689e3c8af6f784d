"""Persistence, Betti numbers, embedding and the drawn complex, on point sets of known shape."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.betti import judge_intervals, load_trained_rules, share_of_tau
from mapper.embedding import embed_in_plane
from mapper.persistence import rips_persistence
from mapper.skeleton import build_skeleton, choose_epsilon
from mapper.types import BettiRule, BettiRuleKind, FloatArray, Method, MetricKind

QUANTILE = BettiRule(kind=BettiRuleKind.QUANTILE, q=0.5, delta=0.01, tau=5)
RATIO = BettiRule(kind=BettiRuleKind.RATIO, q=0.5, delta=0.05, tau=1.5)
COORDINATE = st.floats(-100, 100, allow_nan=False, width=32)
POINTS = st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=12)


def _between(points: FloatArray) -> FloatArray:
    difference = points[:, None] - points[None]
    return np.asarray(np.sqrt((difference**2).sum(axis=2)))


def _ring(n: int, radius: float = 1.0) -> FloatArray:
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def test_a_ring_has_one_component_and_one_loop() -> None:
    diagram = rips_persistence(_between(_ring(24)))
    assert len(diagram.intervals[1]) == 1
    birth, death = diagram.intervals[1][0]
    # Born when neighbours join; a hexagon's worth of chord, sqrt(3) times the radius, fills a ring.
    assert birth == pytest.approx(2 * np.sin(np.pi / 24))
    assert death == pytest.approx(np.sqrt(3))
    assert np.isinf(diagram.intervals[0][:, 1]).sum() == 1
    for rule in (QUANTILE, RATIO):
        assert judge_intervals(diagram.intervals[1], rule, diameter=2.0).tolist() == [True]


@pytest.mark.parametrize("n", [1, 2, 3])
def test_one_to_three_points_have_a_component_and_no_loop(n: int) -> None:
    diagram = rips_persistence(_between(_ring(n) if n > 1 else np.zeros((1, 2))))
    assert diagram.intervals[0].shape == (n, 2)
    assert diagram.intervals[1].shape == (0, 2)
    assert diagram.birth_edges.shape == (0, 2)


def test_loops_of_the_projective_plane_count_over_two_elements() -> None:
    """The real projective plane on six vertices, subdivided once to be a flag complex, has a loop over Z/2 and none over other fields."""
    triangles = ["124", "126", "134", "135", "156", "235", "236", "245", "346", "456"]
    cells = {frozenset(part) for t in triangles for part in ([t[0]], [t[1]], [t[2]], t[:2], t[1:], t[::2], t)}
    order = sorted(cells, key=lambda cell: (len(cell), sorted(cell)))
    is_joined = np.array([[a < b or b < a for b in order] for a in order])
    distances = np.where(is_joined, 1.0, 2.0)
    np.fill_diagonal(distances, 0.0)
    assert rips_persistence(distances).intervals[1].tolist() == [[1.0, 2.0]]


@given(POINTS)
def test_dimension_zero_dies_along_a_minimum_spanning_tree(points: list[tuple[float, float]]) -> None:
    distances = _between(np.unique(np.array(points), axis=0))
    joined, tree = {0}, []
    while len(joined) < len(distances):
        length, new = min((distances[i, j], j) for i in joined for j in range(len(distances)) if j not in joined)
        joined.add(new)
        tree.append(length)
    intervals = rips_persistence(distances).intervals[0]
    assert intervals[0].tolist() == [0.0, np.inf]
    assert intervals[1:, 1].tolist() == pytest.approx(sorted(tree, reverse=True))


@given(POINTS)
def test_loops_are_sorted_and_born_by_the_edge_that_is_named(points: list[tuple[float, float]]) -> None:
    distances = _between(np.unique(np.array(points), axis=0))
    diagram = rips_persistence(distances)
    births, deaths = diagram.intervals[1].T
    assert (deaths > births).all()
    assert (np.diff(deaths - births) <= 0).all()
    assert np.array_equal(distances[tuple(diagram.birth_edges.T)], births)


def _loops(*lengths: float, birth: float = 1.0) -> FloatArray:
    return np.array([(birth, birth + length) for length in lengths])


def test_a_loop_is_real_when_it_exceeds_tau_times_the_quantile_of_all() -> None:
    """Diameter 10: shares 0.5, 0.02, 0.02, 0.02; the median 0.02 plus delta 0.01 times tau 5 is 0.15."""
    real = judge_intervals(_loops(5, 0.2, 0.2, 0.2), QUANTILE, diameter=10)
    assert real.tolist() == [True, False, False, False]


@given(st.lists(st.floats(0.01, 10), min_size=1, max_size=9), st.floats(0.01, 1000))
def test_scaling_the_metric_changes_no_judgement(lengths: list[float], scale: float) -> None:
    loops = _loops(*lengths)
    for rule in (QUANTILE, RATIO):
        plain, scaled = judge_intervals(loops, rule, diameter=20), judge_intervals(loops * scale, rule, diameter=20 * scale)
        assert np.count_nonzero(plain != scaled) <= (0 if scale == 1 else _at_the_limit(loops, rule))


@given(n=st.integers(1, 10**7), more=st.integers(0, 10**7))
def test_more_encounters_never_make_a_hole_doubtful_that_fewer_made_real(n: int, more: int) -> None:
    loops = _loops(3.0, 1.0, 0.5, 0.4, 0.3, 0.2, 0.1)
    rule = dataclasses.replace(QUANTILE, power=0.3)
    few, many = (judge_intervals(loops, rule, diameter=20, n_encounters=count) for count in (n, n + more))
    assert not (few & ~many).any()


def test_with_a_thousand_encounters_the_power_of_a_rule_changes_nothing_and_beyond_twenty_thousand_no_more() -> None:
    assert share_of_tau(1000, power=0.4) == 1.0
    assert share_of_tau(20_000, power=0.5) == share_of_tau(10**9, power=0.5) == pytest.approx(20**-0.5)


def _at_the_limit(loops: FloatArray, rule: BettiRule) -> int:
    """Count loops so near a limit that rounding may decide."""
    looser, stricter = (
        judge_intervals(loops, BettiRule(kind=rule.kind, q=rule.q, delta=rule.delta * f, tau=rule.tau * f), diameter=20)
        for f in (1 - 1e-9, 1 + 1e-9)
    )
    return int(np.count_nonzero(looser != stricter))


def test_all_parts_of_a_connected_graph_are_one_component() -> None:
    rule = BettiRule(kind=BettiRuleKind.CONNECTED, q=0.5, delta=0.0, tau=1.0)
    merges = np.array([(0, np.inf), (0, 9.0), (0, 0.1), (0, 0.1), (0, 0.1)])
    assert judge_intervals(merges, rule, diameter=10).tolist() == [True, False, False, False, False]


def test_with_fewer_than_three_loops_death_over_birth_above_two_decides() -> None:
    loops = np.array([(1.0, 2.5), (1.0, 1.9)])
    assert judge_intervals(loops, QUANTILE, diameter=10).tolist() == [True, False]


def test_intervals_of_no_length_are_not_real_and_stay_out_of_the_quantile() -> None:
    """With the three empty ones the median would be 0 and all three loops real; without them it is their own length."""
    loops = _loops(4, 4, 4, 0, 0, 0)
    assert judge_intervals(loops, QUANTILE, diameter=10).tolist() == [False] * 6


def test_an_infinite_interval_is_real_and_stays_out_of_the_quantile() -> None:
    merges = np.array([(0, np.inf), (0, 1.0), (0, 1.0), (0, 1.0), (0, 1.0)])
    assert judge_intervals(merges, QUANTILE, diameter=10).tolist() == [True, False, False, False, False]
    assert judge_intervals(merges[:1], QUANTILE, diameter=0).tolist() == [True]


def test_the_ratio_rule_wants_both_a_ratio_and_a_length() -> None:
    loops = np.array([(1.0, 2.0), (1.0, 1.4), (0.01, 0.1)])
    assert judge_intervals(loops, RATIO, diameter=10).tolist() == [True, False, False]


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize("metric", MetricKind)
def test_every_method_and_metric_ships_with_rules(method: Method, metric: MetricKind) -> None:
    trained = load_trained_rules(method, metric)
    assert all(rule.tau > 0 and rule.delta >= 0 and 0 <= rule.q <= 1 for rule in trained.rules)
    assert trained.trained_on


@given(POINTS)
def test_plane_points_embed_without_loss_up_to_motion_and_mirror(points: list[tuple[float, float]]) -> None:
    distances = _between(np.array(points))
    embedding = embed_in_plane(distances)
    assert _between(embedding.coordinates) == pytest.approx(distances, abs=1e-3)
    assert embedding.lost_spectrum == pytest.approx(0, abs=1e-6)


def test_a_corridor_embeds_as_a_line() -> None:
    at = np.array([0.0, 1.0, 2.5, 7.0])
    embedding = embed_in_plane(np.abs(at[:, None] - at))
    assert np.ptp(embedding.coordinates[:, 0]) == pytest.approx(7)
    assert np.ptp(embedding.coordinates[:, 1]) < 1e-5
    assert np.isfinite(embedding.coordinates).all()


def test_each_axis_points_to_its_largest_coordinate() -> None:
    distances = _between(np.random.default_rng(5).normal(size=(9, 2)))
    coordinates = embed_in_plane(distances).coordinates
    assert (coordinates[np.abs(coordinates).argmax(axis=0), [0, 1]] > 0).all()


def test_what_does_not_fit_the_plane_is_reported_as_lost() -> None:
    """A regular simplex of 4 points has three equal eigenvalues: two axes hold two thirds."""
    assert embed_in_plane(1.0 - np.eye(4)).lost_spectrum == pytest.approx(1 / 3)


@given(POINTS, st.floats(0, 150))
def test_the_skeleton_has_just_the_edges_and_triangles_within_epsilon(points: list[tuple[float, float]], epsilon: float) -> None:
    distances = _between(np.array(points))
    n = len(distances)
    edges = [[i, j] for i in range(n) for j in range(i + 1, n) if distances[i, j] <= epsilon]
    triangles = [[i, j, k] for i, j in edges for k in range(j + 1, n) if [i, k] in edges and [j, k] in edges]
    skeleton = build_skeleton(distances, epsilon=epsilon)
    assert skeleton.edges.tolist() == edges
    assert skeleton.triangles.tolist() == triangles


def test_the_drawn_scale_shows_the_holes_that_live_together() -> None:
    none = np.empty((0, 2))
    assert choose_epsilon(np.array([(1.0, 5.0), (2.0, 4.0)]), none, np.array([1.0])) == 3
    assert choose_epsilon(np.array([(1.0, 2.0), (3.0, 9.0)]), none, np.array([1.0])) == 3
    assert choose_epsilon(none, np.array([(1.0, 4.0)]), np.array([2.0])) == 4
    assert choose_epsilon(none, none, np.empty(0)) == 0
