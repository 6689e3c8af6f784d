"""How the confidence of maps is trained and judged."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.confidence.counting import count_holes
from mapper.config import RecipeConfig, make_recipe
from studies.confidence_check import report, tell
from studies.confidence_fit import (
    area_under_roc,
    brier_skill,
    expected_calibration_error,
    fit_band,
    fit_choice,
    fit_logistic,
    spread_folds,
)
from studies.confidence_runs import AS_IT_IS, WITNESSES, Witness, compute_witness, draw_mission, judge_points
from studies.reliability import draw_reliability
from studies.train_confidence import describe, train
from studies.trials import SETTINGS

_events = st.lists(st.tuples(st.integers(0, 8), st.booleans()), min_size=2, max_size=20)


@given(_events)
def test_the_area_under_the_curve_counts_pairs_in_the_right_order(events: list[tuple[int, bool]]) -> None:
    chance, is_so = np.array([value / 8 for value, _ in events]), np.array([so for _, so in events])
    pairs = [(a > b) + 0.5 * (a == b) for a in chance[is_so] for b in chance[~is_so]]
    expected = np.mean(pairs) if pairs else np.nan
    assert area_under_roc(chance, is_so) == pytest.approx(expected, nan_ok=True)


def test_a_calibration_error_is_the_mean_gap_in_the_bins() -> None:
    """Of ten told 0.25 two are so, gap 0.05; of ten told 0.95 nine, gap 0.05; the base rate told to all has no gap and no skill."""
    chance, is_so = np.repeat([0.25, 0.95], 10), np.array([True] * 2 + [False] * 8 + [True] * 9 + [False])
    assert expected_calibration_error(chance, is_so) == pytest.approx(0.05)
    base = np.full(20, is_so.mean())
    assert (expected_calibration_error(base, is_so), brier_skill(base, is_so)) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert brier_skill(is_so.astype(float), is_so) == 1.0


def test_odds_that_made_the_data_are_found_again() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(2, 20_000))
    score = 0.5 + 1.5 * x - y + 0.7 * x * y
    is_so = rng.random(20_000) < 1.0 / (1.0 + np.exp(-score))
    model = fit_logistic({"x": x, "y": y}, is_so, [("x",), ("y",), ("x", "y")], penalty=0.1)
    inside = (np.abs(x) < 2) & (np.abs(y) < 2)
    assert np.abs(model.score({"x": x, "y": y}) - score)[inside].mean() < 0.1


def test_a_band_holds_as_often_as_was_asked_for() -> None:
    rng = np.random.default_rng(2)
    x = rng.normal(size=4000)
    moves = np.exp(0.3 * x - 3.0 + 0.2 * rng.normal(size=4000))
    fold = spread_folds(np.arange(4000), period=1)
    model = fit_band({"x": x[:2000]}, moves[:2000], fold[:2000], [("x",)], penalty=1.0, share=0.95)
    held = moves[2000:] <= np.exp(model.score({"x": x[2000:]}))
    assert held.mean() == pytest.approx(0.95, abs=0.02)


def test_choices_that_a_score_made_are_found_again() -> None:
    """Of four numbers each, one is drawn in proportion to exp(1.2 x); that of y says nothing."""
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, 3000, 4))
    chance = np.exp(1.2 * x)
    chance /= chance.sum(axis=1, keepdims=True)
    drawn = (rng.random(3000)[:, None] > np.cumsum(chance, axis=1)).sum(axis=1)
    columns = {"x": x.ravel(), "y": y.ravel()}
    is_true = (np.arange(4) == drawn[:, None]).ravel()
    model = fit_choice(columns, np.repeat(np.arange(3000), 4), is_true, [("x",), ("y",)], penalty=0.1)
    found = np.array([count_holes(model, {"x": x[run], "y": y[run]}, prior=(), is_telling=True, alone=None) for run in range(200)])
    assert np.abs(found - chance[:200]).mean() < 0.02


def test_points_are_right_after_one_scale_for_all() -> None:
    """One of four points of a square is told 2 too far from each other; all lengths are doubled."""
    exact = np.array([[0, 10, 14, 10], [10, 0, 10, 14], [14, 10, 0, 10], [10, 14, 10, 0]], dtype=float)
    assert judge_points(2.0 * exact, exact).all()
    wrong = exact.copy()
    wrong[0, 1:] += 6.0
    wrong[1:, 0] += 6.0
    assert judge_points(wrong, exact).tolist() == [False, False, False, False]
    wrong[0, 1:] -= 4.5
    wrong[1:, 0] -= 4.5
    assert judge_points(wrong, exact).tolist() == [True, True, True, True]


def test_runs_are_of_all_settings_and_half_of_them_as_they_are() -> None:
    recipe = make_recipe(RecipeConfig())
    missions = [draw_mission(seed, recipe) for seed in range(200)]
    assert {mission.setting.name for mission in missions} == set(SETTINGS)
    assert 0.35 < np.mean([mission.kind == AS_IT_IS for mission in missions]) < 0.65
    assert all(mission.setting == SETTINGS[mission.setting.name] for mission in missions if mission.kind == AS_IT_IS)
    assert draw_mission(7, recipe) == missions[7]


@pytest.mark.campaign
def test_few_short_runs_train_models_that_tell_of_other_runs() -> None:
    recipe = make_recipe(RecipeConfig(n_points=40))
    missions = [
        mission for seed in range(400) if (mission := draw_mission(seed, recipe)).setting.duration_s * mission.setting.biobots < 6_000
    ]
    witnesses = [compute_witness(mission) for mission in missions[:30]]
    assert [WITNESSES.unpack(WITNESSES.pack(one)) for one in witnesses] == witnesses
    models = train(witnesses[:24])
    entry = describe(models, trained_on="", command="")
    assert set(entry) == {"loop", "count", "prior", "band", "point", "trained_on", "command"}
    told = [tell(models, one) for one in witnesses[24:] if one.run]
    assert all(((one.chance >= 0.0) & (one.chance <= 1.0)).all() for one in told)
    assert all(one.count.sum() == pytest.approx(1.0) for one in told)
    lines = report(told)
    assert any(line.startswith("stability band") for line in lines)
    assert isinstance(witnesses[0], Witness)


@pytest.mark.parametrize(("image_format", "head"), [("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_equal_events_draw_equal_pictures(image_format: str, head: bytes) -> None:
    panels = {"holes": (np.linspace(0, 1, 50), np.arange(50) > 25)}
    first, second = (draw_reliability(panels, image_format=image_format) for _ in range(2))
    assert first == second
    assert first.startswith(head)
