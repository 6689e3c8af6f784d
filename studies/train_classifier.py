"""Train the rules that count holes, by brute force over theta = (q, Delta, tau) ([Dir16] eq. 16-17), on simulated runs.

``python -m studies.train_classifier --out mapper/data/classifier.json`` made the file that the mapper ships.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from mapper.betti import judge_intervals, read_rules, share_of_tau
from mapper.config import RecipeConfig, make_recipe
from mapper.types import BettiRule, BettiRuleKind, FloatArray, Method, MetricKind, Recipe
from studies.cases import Options, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.trials import SETTINGS, TRIALS, Trial, TrialCase

# Higher quantiles reach into the real intervals where holes are many and noise is scarce.
QUANTILES = (0.5, 0.6, 0.7)
# A larger Delta hides small obstacles, which dense runs show well.
DELTAS = (0.0, 0.0025, 0.005)
TAUS = tuple(np.geomspace(1.5, 15.0, 60).tolist())
# How much less is asked of an interval where there are more encounters; [Dir16] asks the same of all.
POWERS = (0.0, 0.1, 0.2, 0.3, 0.4)
_FALSE_HOLE = 0.5  # of an error more, for a hole in an arena without any
_PLATEAU = 2  # steps of tau to either side that must do well too
# Differences below a third of the standard error of the mean share (0.010 with the runs below) mean nothing.
_TOLERANCE = 0.003
_SLACK = 1.5  # in dimension 0, where no finite interval is real, over the largest ratio seen

# Runs of each setting; seeds count from 0. `studies.hole_count` judges on seeds from 10,000.
TRAINING_RUNS = {"squares/paper-units": 200, "squares/paper-50cm": 80, "big-square/hisser-field": 80, "shapes/long": 90}
# The default recipe is trained on the whole zoo, but for `squares/few`, whose few encounters do not show holes of that size: a rule that
# learned from it would guess. The others, kept for comparison, cannot count most of it.
ZOO_RUNS = TRAINING_RUNS | {
    "small-squares/paper-50cm": 60,
    "obstacles/long": 60,
    "squares/short": 60,
    "squares/crowd": 32,
    "squares/dead-landmarks": 60,
    "big-square/hisser-stops": 80,
    "big-square/hisser-lossy": 24,
    "big-square/hisser-lossy-stops": 24,
}
_BEST = f"{Method.DEFAULT}/{MetricKind.LANDMARK_PROFILE}"
RECIPES = tuple(f"{method}/{metric}" for method in Method for metric in MetricKind)
_QUICK_RUNS = 8

TrialsBySetting = dict[str, list[Trial]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """The rules chosen for dimensions 0 and 1, and the share of the training runs that dimension 1 counts right, by setting."""

    rules: tuple[BettiRule, BettiRule]
    right: dict[str, float]


def train(trials: TrialsBySetting, *, method: Method) -> Training:
    """Choose the rules that count components and holes right most often, each setting weighing the same.

    Notes
    -----
    A hole in an arena without any counts as one and a half errors: it is the worst that a map can show. In dimension 1 the mean of
    neighbouring taus is maximised, so that the middle of a plateau is taken and not its edge. Of the rules that are as good as the best,
    the one with the largest Delta is taken: it is the safest on recordings with less noise than any simulated; then the better, then that
    of the lower q and power. In dimension 0 every run is one component, so no finite interval is real: for ``--method paper`` tau is 1.5
    times the largest ratio seen, and the default needs no rule.
    """
    loops = _choose_loop_rule(trials, powers=POWERS if method is Method.DEFAULT else (0.0,))
    every = [trial for group in trials.values() for trial in group]
    ratios = [_lengths(trial.merges).max(initial=0.0) / (_quantile(trial.merges, loops.q) + loops.delta) for trial in every]
    kind = BettiRuleKind.QUANTILE if method is Method.PAPER else BettiRuleKind.CONNECTED
    merges = BettiRule(kind=kind, q=loops.q, delta=loops.delta, tau=_rounded(_SLACK * max(ratios)))
    right = {name: share_right(group, loops) for name, group in trials.items()}
    return Training(rules=(merges, loops), right=right)


def share_right(trials: Sequence[Trial], rule: BettiRule) -> float:
    """Say in what share of the runs a rule for dimension 1 counts exactly the true number of holes."""
    return float(np.mean([count_loops(trial, rule) == trial.true_holes for trial in trials]))


def count_loops(trial: Trial, rule: BettiRule) -> int:
    """Count the intervals of dimension 1 that a rule calls real."""
    return int(judge_intervals(trial.loops, rule, diameter=1.0, n_encounters=trial.n_used).sum())


def _choose_loop_rule(trials: TrialsBySetting, *, powers: Sequence[float]) -> BettiRule:
    scored: list[tuple[float, BettiRule]] = []
    for q, delta, power in product(QUANTILES, DELTAS, powers):
        right = np.mean([_score_by_tau(group, q=q, delta=delta, power=power) for group in trials.values()], axis=0)
        plateau = np.convolve(right, np.ones(2 * _PLATEAU + 1) / (2 * _PLATEAU + 1), mode="valid")
        at = int(plateau.argmax())
        rule = BettiRule(kind=BettiRuleKind.QUANTILE, q=q, delta=delta, tau=_rounded(TAUS[at + _PLATEAU]), power=power)
        scored.append((float(plateau[at]), rule))
    limit = max(score for score, _ in scored) - _TOLERANCE
    good = [entry for entry in scored if entry[0] >= limit]
    return max(good, key=lambda entry: (entry[1].delta, entry[0], -entry[1].q, -entry[1].power))[1]


def _score_by_tau(trials: Sequence[Trial], *, q: float, delta: float, power: float) -> FloatArray:
    right = np.zeros(len(TAUS))
    for trial in trials:
        asked = np.array(TAUS) * share_of_tau(trial.n_used, power=power)
        ratios = _lengths(trial.loops) / (_quantile(trial.loops, q) + delta or 1.0)
        counted = (ratios[:, None] > asked).sum(axis=0)
        right += counted == trial.true_holes
        if trial.true_holes == 0:
            right -= _FALSE_HOLE * (counted > 0)
    return right / len(trials)


def _lengths(intervals: FloatArray) -> FloatArray:
    return np.asarray(intervals[:, 1] - intervals[:, 0])


def _quantile(intervals: FloatArray, q: float) -> float:
    return float(np.quantile(_lengths(intervals), q, method="lower")) if len(intervals) else 0.0


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def runs_of(recipe: str, *, settings: Sequence[str] | None, quick: bool) -> dict[str, int]:
    """Say how many runs of each setting a recipe is trained on; ``settings`` None takes all there are for it."""
    whole = ZOO_RUNS if recipe == _BEST else TRAINING_RUNS
    return {name: _QUICK_RUNS if quick else n for name, n in whole.items() if settings is None or name in settings}


def collect(options: Options, *, runs: dict[str, dict[str, int]]) -> dict[str, TrialsBySetting]:
    """Simulate and map the training runs of each recipe: its name to setting to number of runs.

    Raises
    ------
    StudyError
        A run failed, or the runs cannot be computed as asked.
    """
    places = [(recipe, name, seed) for recipe, own in runs.items() for name, n in own.items() for seed in range(n)]
    cases = [TrialCase(setting=SETTINGS[name], seed=seed, recipe=_recipe(recipe)) for recipe, name, seed in places]
    collected: dict[str, TrialsBySetting] = {}
    trials = results_of(run_cases(TRIALS, cases, options, label="training runs"))
    for (recipe, name, _), trial in zip(places, trials, strict=True):
        collected.setdefault(recipe, {}).setdefault(name, []).append(trial)
    return collected


def _recipe(name: str) -> Recipe:
    method, metric = name.split("/")
    return make_recipe(RecipeConfig(method=Method(method), metric=MetricKind(metric), replicates=0))


def describe(training: Training, *, runs: dict[str, int], command: str) -> dict[str, object]:
    """Make the entry of ``classifier.json``."""
    shares = ", ".join(f"{name} {share:.1%} of {runs[name]}" for name, share in training.right.items())
    entry: dict[str, object] = {
        f"dimension_{dimension}": {"rule": str(rule.kind), "q": rule.q, "delta": rule.delta, "tau": rule.tau, "power": rule.power}
        for dimension, rule in enumerate(training.rules)
    }
    return entry | {"trained_on": f"simulated runs, seeds from 0; holes counted right: {shares}", "command": command}


def main(arguments: Sequence[str] | None = None) -> int:
    """Train recipes and write or print the parameters of all; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.train_classifier", description=__doc__)
    parser.add_argument("--out", type=Path, help="write the parameters here (default: print them)")
    parser.add_argument("--cache", type=Path, default=Path("artifacts/trials"), help="folder of finished runs (default: %(default)s)")
    parser.add_argument("--recipe", choices=RECIPES, action="append", help="train this alone, keep the others as shipped; may be repeated")
    parser.add_argument("--quick", action="store_true", help=f"{_QUICK_RUNS} runs of each setting, to see that it works")
    parser.add_argument("--setting", choices=list(ZOO_RUNS), action="append", help="train on this alone; may be repeated")
    add_flags(parser)
    options = parser.parse_args(arguments)
    runs = {recipe: runs_of(recipe, settings=options.setting, quick=options.quick) for recipe in options.recipe or RECIPES}
    # A recipe's rule is the same whether the others are trained with it or not.
    flags = ["--quick"] * options.quick + [f"--setting {name}" for name in options.setting or ()]
    command = " ".join(["python -m studies.train_classifier", *flags])
    try:
        collected = collect(read_flags(options, journal=options.cache / "trials.jsonl"), runs=runs)
    except StudyError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    entries = read_rules() | {
        recipe: describe(train(trials, method=Method(recipe.split("/")[0])), runs=runs[recipe], command=command)
        for recipe, trials in collected.items()
    }
    text = json.dumps(entries, indent=2) + "\n"
    if options.out is None:
        sys.stdout.write(text)
    else:
        options.out.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
