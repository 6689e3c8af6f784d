"""What each step of the default method brings to the count of holes: ``python -m studies.ablation``.

Every variant leaves one step out, or changes it. Each gets a rule trained on its own runs (seeds from 0), so that no variant is judged by
a rule made for another, and is judged on runs that played no part (seeds from 10,000). The table stands in docs/method.md.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mapper.config import RecipeConfig, make_recipe
from mapper.types import Method, MetricKind
from studies.cases import Options, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.train_classifier import count_loops, train
from studies.trials import HELD_OUT_SEED, SETTINGS, TRIALS, Trial, TrialCase

VARIANTS: dict[str, RecipeConfig] = {
    "default": RecipeConfig(),
    "averaged once": RecipeConfig(smoothing_passes=1),
    "averaged four times": RecipeConfig(smoothing_passes=4),
    "not placed in the plane": RecipeConfig(placed=False),
    "not placed, averaged once": RecipeConfig(placed=False, smoothing_passes=1),
    "not bracketed": RecipeConfig(bracketed=False),
    "no outliers dropped": RecipeConfig(outlier_q=1.0),
    "all time counts": RecipeConfig(moving_time=False),
    "150 points": RecipeConfig(n_points=150),
    "five encounters a point": RecipeConfig(encounters_per_point=5),
    "encounter metric": RecipeConfig(metric=MetricKind.ENCOUNTER),
    "paper": RecipeConfig(method=Method.PAPER),
}
"""Name of each variant, and how it differs from the default."""

_SETTINGS = ("squares/paper-units", "small-squares/paper-50cm", "big-square/hisser-field", "big-square/hisser-stops", "shapes/long")
_RUNS = 60


def judge_variant(recipe: RecipeConfig, settings: Sequence[str], options: Options, *, runs: int) -> dict[str, tuple[float, float]]:
    """Train a variant's rule, and judge it on unseen runs.

    Returns
    -------
    dict
        Setting to the shares of runs whose count is exactly right, and of runs without a hole that show one (nan where there are none).

    Raises
    ------
    StudyError
        A run failed, or the runs cannot be computed as asked.
    """
    made = replace(make_recipe(recipe), replicates=0)
    seen, unseen = (_trials(settings, recipe, options, seeds=range(first, first + runs)) for first in (0, HELD_OUT_SEED))
    rule = train(seen, method=made.method).rules[1]
    shares = {}
    for name, trials in unseen.items():
        counted = np.array([count_loops(trial, rule) for trial in trials])
        true = np.array([trial.true_holes for trial in trials])
        empty = counted[true == 0]
        shares[name] = (float((counted == true).mean()), float((empty > 0).mean()) if len(empty) else float("nan"))
    return shares


def _trials(settings: Sequence[str], recipe: RecipeConfig, options: Options, *, seeds: range) -> dict[str, list[Trial]]:
    made = replace(make_recipe(recipe), replicates=0)
    cases = [TrialCase(setting=SETTINGS[name], seed=seed, recipe=made) for name in settings for seed in seeds]
    trials = results_of(run_cases(TRIALS, cases, options, label="runs"))
    return {name: trials[k * len(seeds) : (k + 1) * len(seeds)] for k, name in enumerate(settings)}


def to_line(name: str, shares: dict[str, tuple[float, float]]) -> str:
    """Make a row of the table: right, and in brackets a hole where there is none."""
    cells = [f"{right:.0%}" if np.isnan(false) else f"{right:.0%} ({false:.0%})" for right, false in shares.values()]
    return f"| {name} | {' | '.join(cells)} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table as each line is ready; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.ablation", description=__doc__)
    parser.add_argument("--variant", choices=list(VARIANTS), action="append", help="may be repeated (default: all)")
    parser.add_argument("--setting", choices=list(SETTINGS), action="append", help="may be repeated (default: five)")
    parser.add_argument("--runs", type=int, default=_RUNS, help="runs of each setting, to train and to judge on (default: %(default)s)")
    parser.add_argument("--cache", type=Path, default=Path("artifacts/ablation"), help="folder of finished runs (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    settings = options.setting or _SETTINGS
    print(f"| variant | {' | '.join(settings)} |\n|---|{'---|' * len(settings)}")
    for name in options.variant or VARIANTS:
        try:
            shares = judge_variant(VARIANTS[name], settings, read_flags(options, journal=options.cache / "trials.jsonl"), runs=options.runs)
        except StudyError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        print(to_line(name, shares), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
