"""Training finds the rule that separates holes from noise, and the shipped parameters are its work."""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from mapper.betti import judge_intervals, load_trained_rules, read_rules
from mapper.config import RecipeConfig, make_recipe
from mapper.types import Method, MetricKind, Recipe
from studies import hole_count, train_classifier
from studies.cases import Options, Workers, results_of, run_cases
from studies.hole_count import tally
from studies.train_classifier import runs_of, share_right, train
from studies.trials import SETTINGS, TRIALS, Setting, Trial, TrialCase, run_trial

HISSERS = SETTINGS["big-square/hisser-field"]
SHORT = dataclasses.replace(HISSERS, name="short", duration_s=120.0)
RECIPE = make_recipe(RecipeConfig())


def _trial(seed: int, *, true_holes: int, real: float, noise: float, counted: int = 0, n_used: int = 1000) -> Trial:
    """Make a diagram with ``true_holes`` intervals of length ``real`` among nine of length up to ``noise``."""
    rng = np.random.default_rng(seed)
    lengths = np.sort(np.concatenate([np.full(true_holes, real), noise * rng.uniform(0.2, 1.0, 9)]))[::-1]
    loops = np.column_stack([np.full(len(lengths), 0.1), 0.1 + lengths])
    merges = np.column_stack([np.zeros(9), 0.05 * rng.uniform(0.5, 1.0, 9)])
    return Trial(
        setting="made", seed=seed, true_holes=true_holes, counted=(1, counted), n_encounters=n_used, n_used=n_used, n_components=1,
        merges=merges, loops=loops,
    )  # fmt: skip


def test_training_separates_what_can_be_separated_at_any_level_of_noise() -> None:
    groups = {
        "quiet": [_trial(seed, true_holes=seed % 4, real=0.2, noise=0.02) for seed in range(40)],
        "noisy": [_trial(seed, true_holes=seed % 4, real=0.4, noise=0.05) for seed in range(40)],
    }
    training = train(groups, method=Method.DEFAULT)
    assert training.right == {"quiet": 1.0, "noisy": 1.0}
    unseen = [_trial(seed, true_holes=seed % 4, real=0.3, noise=0.03) for seed in range(1000, 1040)]
    assert share_right(unseen, training.rules[1]) == 1.0


def test_a_threshold_that_falls_with_the_number_of_encounters_is_found_where_none_fits_all() -> None:
    """Noise stands out by up to 5 among 1,000 encounters and by 1.5 among 20,000, where a hole stands out by no more than 4."""
    groups = {
        "few": [_trial(seed, true_holes=seed % 4, real=0.3, noise=0.05) for seed in range(40)],
        "many": [_trial(seed, true_holes=seed % 4, real=0.08, noise=0.03, n_used=20_000) for seed in range(40)],
    }
    training = train(groups, method=Method.DEFAULT)
    assert training.right == {"few": 1.0, "many": 1.0}
    assert train(groups, method=Method.PAPER).rules[1].power == 0.0, "[Dir16] asks the same of all"


def test_in_dimension_zero_nothing_finite_seen_in_training_is_real() -> None:
    trials = [_trial(seed, true_holes=1, real=0.2, noise=0.02) for seed in range(10)]
    for method in Method:
        merges = train({"quiet": trials}, method=method).rules[0]
        assert not any(judge_intervals(trial.merges, merges, diameter=1.0).any() for trial in trials)


def _cases(seeds: Iterable[int], *, setting: Setting = SHORT, recipe: Recipe = RECIPE) -> list[TrialCase]:
    return [TrialCase(setting=setting, seed=seed, recipe=recipe) for seed in seeds]


def test_a_finished_trial_is_taken_from_the_journal_and_is_the_same(tmp_path: Path) -> None:
    options = Options(journal=tmp_path / "trials.jsonl", workers=Workers(jobs=1))
    first = results_of(run_cases(TRIALS, _cases([1, 2]), options, label="short"))
    written = (tmp_path / "trials.jsonl").read_bytes()
    again = results_of(run_cases(TRIALS, _cases([1, 2]), options, label="short"))
    assert (tmp_path / "trials.jsonl").read_bytes() == written
    for one, other, fresh in zip(first, again, [run_trial(SHORT, seed, RECIPE) for seed in (1, 2)], strict=True):
        for trial in (other, fresh):
            assert (one.seed, one.true_holes, one.counted) == (trial.seed, trial.true_holes, trial.counted)
            assert np.array_equal(one.loops, trial.loops)
            assert np.array_equal(one.merges, trial.merges)


def test_another_recipe_or_setting_is_another_case_but_the_rule_that_judges_afterwards_is_not() -> None:
    others = [
        *_cases([1, 2]),
        *_cases([1], setting=dataclasses.replace(SHORT, mean_leg=6.0)),
        *_cases([1], recipe=dataclasses.replace(RECIPE, n_points=120)),
    ]
    assert len({TRIALS.digest(case) for case in others}) == 4
    rules = load_trained_rules(Method.PAPER, MetricKind.ENCOUNTER).rules
    (judged,) = _cases([1], recipe=dataclasses.replace(RECIPE, betti_rules=rules))
    assert TRIALS.digest(judged) == TRIALS.digest(others[0])


def test_a_tally_counts_by_true_number_of_holes() -> None:
    trials = [
        _trial(seed, true_holes=holes, real=0.2, noise=0.02, counted=counted)
        for seed, (holes, counted) in enumerate([(0, 0), (1, 1), (1, 2)])
    ]
    result = tally(trials, setting="made")
    assert (result.right, result.runs, result.right_of) == (2, 3, {0: (1, 1), 1: (1, 2)})
    assert "2 of    3 =  66.7%" in result.line()


def test_the_shipped_rules_count_unseen_arenas_right() -> None:
    """Twelve runs of the coarse `paper-units`: above nine tenths are right in the long run, so two errors in twelve are unlikely enough."""
    setting: Setting = SETTINGS["squares/paper-units"]
    options = Options(workers=Workers(jobs=1))
    trials = results_of(run_cases(TRIALS, _cases(range(20_000, 20_012), setting=setting), options, label="unseen"))
    assert sum(trial.counted == (1, trial.true_holes) for trial in trials) >= 10


def test_the_quick_command_writes_rules_for_every_method_and_metric(tmp_path: Path) -> None:
    out = tmp_path / "classifier.json"
    assert (
        train_classifier.main(["--quick", "--setting", HISSERS.name, "--out", str(out), "--cache", str(tmp_path / "trials"), "--jobs", "2"])
        == 0
    )
    entries = json.loads(out.read_text())
    assert set(entries) == {f"{method}/{metric}" for method in Method for metric in MetricKind}
    assert all(entry["command"].endswith("--quick --setting big-square/hisser-field") for entry in entries.values())


@pytest.mark.parametrize("method", list(Method))
@pytest.mark.parametrize("metric", list(MetricKind))
def test_the_shipped_rules_name_the_command_and_runs_they_come_from(method: Method, metric: MetricKind) -> None:
    trained = load_trained_rules(method, metric)
    assert trained.command == "python -m studies.train_classifier"
    runs_of_setting = runs_of(f"{method}/{metric}", settings=None, quick=False)
    assert all(f"{name} " in trained.trained_on and f"of {runs}" in trained.trained_on for name, runs in runs_of_setting.items())


def test_recipes_that_are_not_trained_keep_their_rules(tmp_path: Path) -> None:
    out = tmp_path / "classifier.json"
    flags = ["--quick", "--setting", HISSERS.name, "--out", str(out), "--cache", str(tmp_path / "trials"), "--jobs", "1"]
    assert train_classifier.main([*flags, "--recipe", "default/landmark_profile"]) == 0
    shipped, entries = read_rules(), json.loads(out.read_text())
    assert {name for name in shipped if entries[name] != shipped[name]} == {"default/landmark_profile"}


def test_judging_prints_a_line_for_each_setting(capsys: pytest.CaptureFixture[str]) -> None:
    assert hole_count.main(["--setting", "big-square/hisser-field", "--runs", "2", "--jobs", "1"]) == 0
    assert "big-square/hisser-field" in capsys.readouterr().out


def test_judging_no_runs_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        hole_count.main(["--runs", "0"])
    assert "at least 1" in capsys.readouterr().err
