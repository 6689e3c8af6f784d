"""The whole way from encounters to a map."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from firmware_protocol.units import NodeId
from mapper.config import RecipeConfig, make_recipe
from mapper.errors import TooFewEncountersError
from mapper.pipeline import compute_map, share_points
from mapper.report import summarize, to_json_object
from mapper.types import MapResult, Method, MetricKind, ModeSpell, Recipe
from mapper.window import absent_biobots, make_encounter_table, stationary_spells
from tests.mapper.graphs import KERNELS
from tests.mapper.worlds import NS, Row, encounter_rows, mode_spells, table_of, walk_track

_NAMED = [make_recipe(RecipeConfig(method=method, metric=metric)) for method in Method for metric in MetricKind]
_THINNED = dataclasses.replace(make_recipe(RecipeConfig()), max_candidates=160, smoothing_share=0.03)
RECIPES = [*_NAMED, _THINNED]
named = pytest.mark.parametrize(
    "recipe", RECIPES, ids=lambda recipe: f"{recipe.method}-{recipe.metric}" + "-thinned" * (recipe is _THINNED)
)


def _geometry(result: MapResult) -> object:
    """All but the names of the biobots."""
    content = to_json_object(result)
    assert isinstance(content["points"], list)
    assert isinstance(content["landmarks"], list)
    content["points"] = [{key: point[key] for key in ("x", "y", "t")} for point in content["points"] if isinstance(point, dict)]
    content["landmarks"] = [{key: one[key] for key in ("x", "y", "t_start")} for one in content["landmarks"] if isinstance(one, dict)]
    return content


@named
def test_a_ring_has_one_hole(recipe: Recipe) -> None:
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    result = compute_map(table_of(rows), spells, recipe)
    assert result.betti_numbers == (1, 1)
    (hole,) = result.holes
    # A loop around the ring passes every quarter of it.
    seen = {int(node - 1001) // 5 for node in result.points.id2[hole.outline]}
    assert seen == {0, 1, 2, 3}


@named
def test_a_corridor_has_no_hole_and_finite_coordinates(recipe: Recipe) -> None:
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=2, is_ring=False)
    result = compute_map(table_of(rows), spells, recipe)
    assert result.betti_numbers == (1, 0)
    assert np.isfinite([result.points.x, result.points.y]).all()
    assert np.ptp(result.points.y) < np.ptp(result.points.x)


@named
@given(encounter_rows(max_size=60, n_biobots=8), mode_spells)
@settings(max_examples=30)
def test_compiled_and_plain_kernels_make_the_same_map(recipe: Recipe, rows: list[Row], spells: list[ModeSpell]) -> None:
    assume(len(rows) > 1)
    compiled, plain = (to_json_object(compute_map(table_of(rows), spells, recipe, kernels=kernels)) for kernels in KERNELS)
    assert compiled == plain


@named
def test_compiled_and_plain_kernels_make_the_same_map_of_a_ring(recipe: Recipe) -> None:
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=5, is_ring=True)
    compiled, plain = (to_json_object(compute_map(table_of(rows), spells, recipe, kernels=kernels)) for kernels in KERNELS)
    assert compiled == plain


@named
def test_shuffling_rows_changes_nothing(recipe: Recipe) -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=3, is_ring=True)
    shuffled = [rows[i] for i in np.random.default_rng(0).permutation(len(rows))]
    swapped = [(start, end, second, first) for start, end, first, second in shuffled]
    assert to_json_object(compute_map(table_of(swapped), spells[::-1], recipe)) == to_json_object(
        compute_map(table_of(rows), spells, recipe)
    )


@named
def test_renaming_the_biobots_changes_nothing_but_their_names(recipe: Recipe) -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=4, is_ring=True)
    rng = np.random.default_rng(1)
    old = sorted({node for row in rows for node in row[2:]} | {int(spell.node) for spell in spells})
    name = dict(zip(old, rng.choice(10**6, len(old), replace=False).tolist(), strict=True))
    renamed = [(start, end, name[first], name[second]) for start, end, first, second in rows]
    stood = [dataclasses.replace(spell, node=NodeId(name[int(spell.node)])) for spell in spells]
    assert _geometry(compute_map(table_of(renamed), stood, recipe)) == _geometry(compute_map(table_of(rows), spells, recipe))


@named
def test_the_zero_of_the_clock_changes_only_the_times(recipe: Recipe) -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=5, is_ring=True)
    later = 1_790_000_000 * NS
    moved = [(start + later, end + later, first, second) for start, end, first, second in rows]
    stood = [dataclasses.replace(spell, t_start_ns=spell.t_start_ns + later) for spell in spells]
    a, b = compute_map(table_of(rows), spells, recipe), compute_map(table_of(moved), stood, recipe)
    assert np.array_equal(b.points.t_ns - later, a.points.t_ns)
    assert np.array_equal(b.points.x, a.points.x)
    assert b.betti_numbers == a.betti_numbers


@given(encounter_rows(max_size=25, n_biobots=8), mode_spells, st.sampled_from(RECIPES))
def test_no_encounters_crash_the_pipeline(rows: list[Row], spells: list[ModeSpell], recipe: Recipe) -> None:
    if len(rows) < 2:
        with pytest.raises(TooFewEncountersError):
            compute_map(table_of(rows), spells, recipe)
        return
    result = compute_map(table_of(rows), spells, recipe)
    json.dumps(to_json_object(result), allow_nan=False)
    assert summarize(result)
    assert result.n_used <= result.n_encounters == len(rows)
    assert result.betti_numbers[0] >= len(result.components) >= 1
    assert len(result.holes) == result.betti_numbers[1]
    assert all((result.points.component[hole.outline] == hole.component).all() for hole in result.holes)


def _two_rings(n_second: int) -> tuple[list[Row], tuple[ModeSpell, ...]]:
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=6, is_ring=True)
    other, standing = walk_track(n_landmarks=20, n_walkers=n_second, duration_s=120, seed=7, is_ring=True)
    apart = [(start, end, first + 10_000, second + 10_000) for start, end, first, second in other]
    return rows + apart, (*spells, *(dataclasses.replace(spell, node=NodeId(spell.node + 10_000)) for spell in standing))


def test_components_are_mapped_apart_and_their_betti_numbers_summed() -> None:
    rows, spells = _two_rings(n_second=29)
    result = compute_map(table_of(rows), spells, make_recipe(RecipeConfig()))
    assert result.betti_numbers == (2, 2)
    assert [hole.component for hole in result.holes] == [0, 1]
    assert len(result.points) <= 150
    assert result.points.x[result.points.component == 0].max() < result.points.x[result.points.component == 1].min()
    assert any("2 components" in warning for warning in result.warnings)


def test_a_tiny_component_is_left_out_and_said_so() -> None:
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=6, is_ring=True)
    result = compute_map(table_of([*rows, (0, NS, 777, 778)]), spells, make_recipe(RecipeConfig()))
    assert (result.n_components, len(result.components)) == (2, 1)
    assert any("1 with too few encounters (1 in all) left out" in warning for warning in result.warnings)


@given(st.lists(st.integers(1, 5000), min_size=1, max_size=60), st.integers(4, 300))
def test_points_are_shared_in_proportion_and_none_is_lost(sizes: list[int], n_points: int) -> None:
    sizes = sorted(sizes, reverse=True)
    shares = share_points(sizes, n_points=n_points)
    assert sum(shares) == n_points
    assert all(share >= 3 for share in shares[1:])
    total = sum(sizes[: len(shares)])
    assert all(abs(share - size * n_points / total) < 1 for share, size in zip(shares, sizes, strict=False))
    assert all(size * n_points < 3 * sum(sizes) for size in sizes[max(1, len(shares)) :])


def test_a_speed_turns_seconds_into_metres() -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=8, is_ring=True)
    seconds = compute_map(table_of(rows), spells, make_recipe(RecipeConfig()))
    metres = compute_map(table_of(rows), spells, make_recipe(RecipeConfig(speed_mps=0.04)))
    assert (seconds.length_unit, metres.length_unit) == ("s", "m")
    assert metres.diameter == pytest.approx(0.04 * seconds.diameter)
    assert metres.betti_numbers == seconds.betti_numbers


def test_without_landmarks_the_map_says_what_it_lacks() -> None:
    rows, _ = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=9, is_ring=True)
    result = compute_map(table_of(rows), (), make_recipe(RecipeConfig()))
    assert any(warning.startswith("no landmarks") for warning in result.warnings)
    assert any("component 0 has 0 of the 3 landmarks that profiles need" in warning for warning in result.warnings)


def test_many_components_without_landmarks_are_one_warning() -> None:
    rows, _ = _two_rings(n_second=29)
    result = compute_map(table_of(rows), (), make_recipe(RecipeConfig()))
    (told,) = [warning for warning in result.warnings if "profiles need" in warning]
    assert told.startswith("2 of the 2 components mapped have fewer than 3 landmarks, which profiles need")


def test_spells_of_another_clock_are_noticed() -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=9, is_ring=True)
    late = [dataclasses.replace(spell, t_start_ns=10**18) for spell in spells]
    result = compute_map(table_of(rows), late, make_recipe(RecipeConfig()))
    assert any("count time from the same instant" in warning for warning in result.warnings)


def test_progress_names_the_stages_and_never_goes_back() -> None:
    rows, spells = _two_rings(n_second=29)
    told: list[tuple[str, float]] = []
    compute_map(table_of(rows), spells, make_recipe(RecipeConfig()), progress=lambda stage, share: told.append((stage, share)))
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert (told[0], told[-1]) == (("graph", 0.0), ("done", 1.0))
    assert {"metric", "outliers", "subsample", "persistence", "embedding"} <= {stage for stage, _ in told}


def test_arrays_of_a_result_are_read_only() -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=9, is_ring=True)
    table = table_of(rows)
    result = compute_map(table, spells, make_recipe(RecipeConfig()))
    arrays = [result.points.x, result.points.t_ns, result.edges, result.triangles, table.t_start_ns, *result.components[0].intervals]
    assert not any(array.flags.writeable for array in arrays)


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        (((0, 1), (1,), (1, 2), (2, 3)), "one length for all"),
        (((5,), (1,), (1,), (2,)), "ends before it begins"),
        (((1,), (1,), (2,), (2,)), "meets itself"),
        (((0, 2**62), (0, 2**62), (1, 1), (2, 2)), "two clocks mixed"),
    ],
)
def test_a_table_is_not_made_of_what_cannot_be(columns: tuple[tuple[int, ...], ...], reason: str) -> None:
    start, end, id1, id2 = columns
    with pytest.raises(ValueError, match=reason):
        make_encounter_table(t_start_ns=start, t_end_ns=end, id1=id1, id2=id2)


def test_with_a_quantile_of_one_no_encounter_is_dropped() -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=9, is_ring=True)
    result = compute_map(table_of(rows), spells, make_recipe(RecipeConfig(outlier_q=1.0)))
    assert result.n_used == result.n_encounters


def test_in_an_empty_table_nobody_stands() -> None:
    assert stationary_spells(table_of([]), [1, 2]) == ()
    assert absent_biobots(table_of([]), []) == ()


def test_encounters_of_a_clock_that_is_years_off_are_warned_of() -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=10, duration_s=60, seed=3, is_ring=True)
    years = 60 * 86_400 * NS
    odd = [*rows, (rows[0][0] + years, rows[0][0] + years, rows[0][2], rows[0][3])]
    assert not any("clock" in warning for warning in compute_map(table_of(rows), spells, make_recipe(RecipeConfig())).warnings)
    (warning,) = [one for one in compute_map(table_of(odd), spells, make_recipe(RecipeConfig())).warnings if "clock" in one]
    assert "span 60 days; times beyond 52 are rounded" in warning
