"""What a map says of itself."""

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from firmware_protocol.units import NodeId
from mapper.confidence.assess import LEAST_CLAIMED, choose_holes
from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import compute_map
from mapper.report import summarize, to_json_object
from mapper.types import BettiRule, BettiRuleKind, MapResult, Method, ModeSpell
from tests.mapper.worlds import NS, Row, encounter_rows, mode_spells, table_of, walk_track

_RECIPE = make_recipe(RecipeConfig())


def _ring(*, n_walkers: int = 30, duration_s: float = 120, is_ring: bool = True) -> MapResult:
    rows, spells = walk_track(n_landmarks=20, n_walkers=n_walkers, duration_s=duration_s, seed=1, is_ring=is_ring)
    return compute_map(table_of(rows), spells, _RECIPE)


def test_the_hole_of_a_ring_that_many_walked_is_sure() -> None:
    result = _ring()
    (hole,) = result.holes
    assert hole.probability is not None
    assert hole.probability > 0.9
    assert result.hole_count is not None
    assert result.hole_count.value == int(np.argmax(result.hole_count.probabilities)) == 1


def test_where_biobots_notice_each_other_from_afar_no_number_is_sure_and_it_is_told_why() -> None:
    """Hissing cockroaches with a detection radius of a tenth of the arena: the counts were too low, told with up to 99 %."""
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    near = compute_map(table_of(rows), spells, _RECIPE)
    longer_ns = round(0.3 * near.components[0].diameter * NS)
    far = compute_map(table_of([(start - longer_ns, end + longer_ns, one, other) for start, end, one, other in rows]), spells, _RECIPE)
    assert far.hole_count is not None
    assert far.data is not None
    assert far.hole_count.is_known
    assert far.hole_count.probability < 0.7
    assert far.hole_count.value == int(np.argmax(far.hole_count.probabilities))
    assert not far.data.is_enough
    assert "of the time across the map" in far.data.reasons[0]
    assert "closer" in far.data.remedies[0]
    assert near.data is not None
    assert not any("across the map" in reason for reason in near.data.reasons)


def test_every_probability_is_one_and_those_of_all_numbers_sum_to_one() -> None:
    result = _ring(is_ring=False)
    told = [hole.probability for hole in (*result.holes, *result.possible_holes)]
    assert all(probability is not None and 0.0 <= probability <= 1.0 for probability in told)
    assert result.hole_count is not None
    assert sum(result.hole_count.probabilities) == pytest.approx(1.0)
    assert result.hole_count.probability == result.hole_count.probabilities[result.hole_count.value]


@pytest.mark.parametrize("n_landmarks", [0, 1, 2])
def test_where_nothing_is_known_no_loop_is_told_of_either(n_landmarks: int) -> None:
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    result = compute_map(table_of(rows), spells[:n_landmarks], _RECIPE)
    assert (result.holes, result.possible_holes) == ((), ())
    assert result.hole_count is not None
    assert not result.hole_count.is_known


def test_without_landmarks_no_hole_is_claimed() -> None:
    rows, _ = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    result = compute_map(table_of(rows), (), _RECIPE)
    assert result.holes == ()
    assert result.hole_count is not None
    assert result.hole_count.probability < 0.6
    assert result.data is not None
    assert not result.data.is_enough


@given(st.lists(st.floats(0.0, 1.0), max_size=8), st.lists(st.floats(0.01, 1.0), min_size=13, max_size=13))
def test_the_likeliest_loops_are_holes_as_many_as_is_most_probable_but_for_those_too_unlikely(
    chances: list[float], weights: list[float]
) -> None:
    distribution = np.array(weights) / sum(weights)
    chosen = choose_holes(np.array(chances), distribution, is_telling=True)
    most_probable = int(np.argmax(distribution[: len(chances) + 1]))
    assert chosen.sum() == min(most_probable, sum(chance >= LEAST_CLAIMED for chance in chances))
    inside = [chance for chance, is_hole in zip(chances, chosen, strict=True) if is_hole]
    outside = [chance for chance, is_hole in zip(chances, chosen, strict=True) if not is_hole]
    assert min(inside, default=1.0) >= max(outside, default=0.0)


@pytest.mark.parametrize("number", [0, 1, 3])
def test_a_map_is_drawn_with_the_holes_that_are_most_probable_whatever_the_rule_says(number: int) -> None:
    """With a rule that calls nothing a hole, or many loops, the ring's one hole is found all the same."""
    rule = BettiRule(kind=BettiRuleKind.QUANTILE, q=0.7, delta=0.005, tau={0: 1e6, 1: 4.0, 3: 0.5}[number])
    rules = (BettiRule(kind=BettiRuleKind.CONNECTED, q=0.7, delta=0.0, tau=1.0), rule)
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    result = compute_map(table_of(rows), spells, dataclasses.replace(_RECIPE, betti_rules=rules))
    assert result.hole_count is not None
    assert result.hole_count.value == len(result.holes) == result.betti_numbers[1] == result.components[0].betti_numbers[1]
    called = {(hole.birth, hole.death) for hole in result.holes}
    assert called.isdisjoint((hole.birth, hole.death) for hole in result.possible_holes)
    assert all((hole.probability or 0.0) >= (other.probability or 0.0) for hole in result.holes for other in result.possible_holes)


def test_possible_holes_are_loops_that_are_not_called_real_the_likeliest_first() -> None:
    result = _ring(n_walkers=6, duration_s=40)
    chances = [hole.probability or 0.0 for hole in result.possible_holes]
    assert chances == sorted(chances, reverse=True)
    called = {(hole.birth, hole.death) for hole in result.holes}
    for hole in result.possible_holes:
        assert [hole.birth, hole.death] in result.components[hole.component].intervals[1].tolist()
        assert (hole.birth, hole.death) not in called
        assert (result.points.component[hole.outline] == hole.component).all()


@given(encounter_rows(max_size=50, n_biobots=8), mode_spells)
@settings(max_examples=40)
def test_a_handful_of_encounters_is_never_enough_and_is_told_why(rows: list[Row], spells: list[ModeSpell]) -> None:
    assume(len(rows) > 1)
    result = compute_map(table_of(rows), spells, _RECIPE)
    assert result.data is not None
    assert not result.data.is_enough
    assert result.data.reasons
    assert result.data.remedies
    assert result.hole_count is not None
    assert result.hole_count.probability < 0.9
    assert all(part.stability_band is not None and part.stability_band >= 0.0 for part in result.components)
    text = summarize(result)
    assert "NOT ENOUGH DATA YET" in text.splitlines()[0]
    assert f"{result.hole_count.value}: {result.hole_count.probability:.0%}" in text or result.hole_count.is_known
    assert to_json_object(result)["data"] == {
        "is_enough": False,
        "reasons": list(result.data.reasons),
        "remedies": list(result.data.remedies),
    }


def test_two_rings_that_nobody_joins_are_judged_apart() -> None:
    rows, spells = walk_track(n_landmarks=20, n_walkers=20, duration_s=120, seed=1, is_ring=True)
    others = [(start, end, first + 5000, second + 5000) for start, end, first, second in rows]
    far = tuple(dataclasses.replace(one, node=NodeId(one.node + 5000)) for one in spells)
    result = compute_map(table_of([*rows, *others]), (*spells, *far), _RECIPE)
    alone = compute_map(table_of(rows), spells, dataclasses.replace(_RECIPE, n_points=len(result.points) // 2))
    assert [hole.component for hole in result.holes] == [0, 1]
    assert result.holes[0].probability == result.holes[1].probability
    assert alone.holes[0].birth == result.holes[0].birth
    assert result.data is not None
    assert any("not joined to the largest of 2 components" in reason for reason in result.data.reasons)


@pytest.mark.parametrize(
    "config", [RecipeConfig(replicates=0), RecipeConfig(method=Method.PAPER), RecipeConfig(method=Method.PAPER, replicates=2)]
)
def test_nothing_is_told_where_it_is_not_asked_for_or_nobody_trained_it(config: RecipeConfig) -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=12, duration_s=60, seed=4, is_ring=True)
    result = compute_map(table_of(rows), spells, make_recipe(config))
    assert (result.hole_count, result.data, result.possible_holes, result.points.is_well_seen) == (None, None, (), None)
    assert all(hole.probability is None for hole in result.holes)
    assert all(part.stability_band is None for part in result.components)
    assert "sure" not in summarize(result)


@given(st.integers(-(10**6), 10**6))
@settings(max_examples=5)
def test_the_zero_of_time_changes_nothing(shift_s: int) -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=8, duration_s=40, seed=4, is_ring=True)
    moved = [(start + shift_s * NS, end + shift_s * NS, first, second) for start, end, first, second in rows]
    late = tuple(dataclasses.replace(one, t_start_ns=one.t_start_ns + shift_s * NS) for one in spells)
    first, second = compute_map(table_of(rows), spells, _RECIPE), compute_map(table_of(moved), late, _RECIPE)
    assert [hole.probability for hole in first.holes] == [hole.probability for hole in second.holes]
    assert first.hole_count == second.hole_count
