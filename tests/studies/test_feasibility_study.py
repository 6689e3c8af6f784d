"""The study behind ``biobot-mapper feasibility`` finds the law that runs obey, and its runs are what they say."""

import json
from dataclasses import asdict, replace
from importlib import resources
from math import inf
from pathlib import Path

import numpy as np
import pytest

from mapper.feasibility import encounter_rate
from mapper.resolution import chance_found, chance_of_false_hole, count_deviation, load_law, outside_ranges
from studies import feasibility_check
from studies.cases import Options, Workers, results_of, run_cases
from studies.feasibility_fit import as_plan, fit_law, loss, with_obstacle
from studies.feasibility_runs import OBSTACLE, PLANS, Outcome, PlanCase, ScaledPlan, draw_plan, run_plan

pytestmark = pytest.mark.xdist_group("feasibility study")
"""What they share is made once, by one worker."""

SHORT = ScaledPlan(biobots=20, landmarks=5, detection=0.05, leg=0.3, path=4.0, obstacle=0.3)
LAW = load_law()


def _made(seed: int) -> Outcome:
    """Draw what a run would give if the shipped law were the truth."""
    scaled = draw_plan(seed)
    rng = np.random.default_rng(seed)
    plan, free = as_plan(scaled), as_plan(scaled, knows_obstacle=True)
    is_found = scaled.obstacle > 0 and rng.random() < chance_found(plan, LAW, obstacle=scaled.obstacle)
    return Outcome(
        scaled=scaled,
        seed=seed,
        n_encounters=round(encounter_rate(free) * free.duration_s + count_deviation(free, LAW) * rng.normal()),
        n_together=0,
        is_connected=True,
        is_found=bool(is_found),
        n_false=int(rng.random() < chance_of_false_hole(plan, LAW)),
        stretch=None,
    )


@pytest.fixture(scope="module")
def made() -> list[Outcome]:
    return [_made(seed) for seed in range(1500)]


def test_the_fit_finds_the_law_that_made_the_runs(made: list[Outcome]) -> None:
    """Of 1,500 runs; the chances, not the constants, are what can be known well."""
    fitted = fit_law(made, command="none")
    assert fitted.floor == pytest.approx(LAW.floor, rel=0.25)
    assert fitted.steepness == pytest.approx(LAW.steepness, rel=0.2)
    assert fitted.dispersion == pytest.approx(LAW.dispersion, rel=0.2)
    misses = [
        chance_found(as_plan(one.scaled), fitted, obstacle=one.scaled.obstacle)
        - chance_found(as_plan(one.scaled), LAW, obstacle=one.scaled.obstacle)
        for one in with_obstacle(made)
    ]
    assert np.abs(misses).mean() < 0.03
    wrong = [chance_of_false_hole(as_plan(one.scaled), fitted) - chance_of_false_hole(as_plan(one.scaled), LAW) for one in made]
    assert np.abs(wrong).mean() < 0.05


def test_no_other_constants_fit_the_runs_better(made: list[Outcome]) -> None:
    """What is fitted with arrays is the law that the mapper uses, number by number."""
    seen = with_obstacle(made)
    fitted = fit_law(made, command="none")
    for name in ("crowd", "floor", "steepness", "path_power"):
        for factor in (0.9, 1.1):
            assert loss(replace(fitted, **{name: factor * getattr(fitted, name)}), seen) > loss(fitted, seen) - 0.05


def test_the_shipped_constants_are_a_whole_law() -> None:
    document = json.loads(resources.files("mapper").joinpath("data", "feasibility.json").read_text(encoding="utf-8"))
    assert document == json.loads(json.dumps(asdict(LAW)))
    assert LAW.command == "python -m studies.feasibility_check"
    assert "seeds 0 to 2499" in LAW.fitted_on
    assert all(-inf < least < greatest < inf for least, greatest in LAW.ranges.values())
    assert outside_ranges(as_plan(SHORT), LAW) == ()


def test_drawn_plans_keep_to_their_ranges_and_one_in_five_is_empty() -> None:
    drawn = [draw_plan(seed) for seed in range(300)]
    assert drawn == [draw_plan(seed) for seed in range(300)]
    empty = [scaled for scaled in drawn if scaled.obstacle == 0]
    assert 0.12 < len(empty) / len(drawn) < 0.28
    assert all(scaled in empty or OBSTACLE[0] <= scaled.obstacle <= OBSTACLE[1] for scaled in drawn)
    assert all(2 <= scaled.landmarks <= 0.55 * scaled.biobots + 2 for scaled in drawn)


def test_runs_have_as_many_encounters_as_the_gas() -> None:
    """Ten runs of about 150 encounters: the mean is known to 3.5 %, and walls and obstacle lower it by 9 % here."""
    plan = as_plan(SHORT, knows_obstacle=True)
    outcomes = [run_plan(SHORT, seed) for seed in range(10)]
    counted = np.mean([one.n_encounters - one.n_together for one in outcomes])
    assert counted == pytest.approx(encounter_rate(plan) * plan.duration_s, rel=0.1)


def test_a_finished_run_is_taken_from_the_journal_as_it_was(tmp_path: Path) -> None:
    options = Options(journal=tmp_path / "runs.jsonl", workers=Workers(jobs=1))
    cases = [PlanCase(scaled=SHORT, seed=3), PlanCase(scaled=replace(SHORT, obstacle=0.0), seed=3)]
    first = results_of(run_cases(PLANS, cases, options, label="short"))
    assert first == [run_plan(case.scaled, 3) for case in cases]
    written = (tmp_path / "runs.jsonl").read_bytes()
    assert results_of(run_cases(PLANS, cases, options, label="short")) == first
    assert (tmp_path / "runs.jsonl").read_bytes() == written


def test_a_large_obstacle_among_many_is_found_and_an_empty_arena_has_none() -> None:
    crowd = ScaledPlan(biobots=120, landmarks=30, detection=0.02, leg=0.5, path=4.0, obstacle=0.4)
    assert run_plan(crowd, 1).is_found
    empty = run_plan(replace(crowd, obstacle=0.0), 1)
    assert not empty.is_found
    assert empty.stretch == pytest.approx(0.95, abs=0.15)


def test_the_check_tells_its_tables(made: list[Outcome]) -> None:
    text = "\n".join(feasibility_check.check(LAW, made[:1000], made[1000:]))
    assert "counted over foretold" in text
    assert "| 90% to 100% |" in text


@pytest.mark.parametrize("flags", [["--fit-runs", "5"], ["--named-runs", "-1"]])
def test_too_few_runs_are_refused(flags: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        feasibility_check.main(flags)
    assert left.value.code == 2
    assert "wanted at least" in capsys.readouterr().err
