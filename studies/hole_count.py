"""Judge the count of holes on simulated runs that played no part in training: ``python -m studies.hole_count``."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapper.config import RecipeConfig, make_recipe
from mapper.types import Method, MetricKind, Recipe
from studies.cases import Options, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.trials import HELD_OUT_SEED, SETTINGS, TRIALS, Trial, TrialCase

_DEFAULT_RUNS = {
    "squares/paper-units": 400,
    "squares/paper-50cm": 200,
    "small-squares/paper-50cm": 60,
    "big-square/hisser-field": 200,
    "big-square/hisser-stops": 200,
    "big-square/hisser-lossy": 60,
    "big-square/hisser-lossy-stops": 60,
    "shapes/long": 180,
    "obstacles/long": 100,
    "squares/short": 200,
    "squares/dead-landmarks": 200,
    "squares/few": 200,
    "squares/crowd": 60,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """How a group of runs was counted. ``right_of``: true number of holes to (counted right, runs)."""

    setting: str
    runs: int
    right: int
    components_wrong: int
    right_of: dict[int, tuple[int, int]]
    encounters: int

    def line(self) -> str:
        """Tell it in one line."""
        by_holes = "  ".join(f"{holes}: {right}/{runs}" for holes, (right, runs) in sorted(self.right_of.items()))
        return f"{self.setting:30} {self.right:4d} of {self.runs:4d} = {self.right / self.runs:6.1%}   {self.encounters:6d}   {by_holes}"


def tally(trials: Sequence[Trial], *, setting: str) -> Tally:
    """Count the runs whose number of holes was found exactly.

    Parameters
    ----------
    trials
        At least one.
    """
    right_of = {}
    for holes in sorted({trial.true_holes for trial in trials}):
        group = [trial for trial in trials if trial.true_holes == holes]
        right_of[holes] = (sum(trial.counted[1] == holes for trial in group), len(group))
    return Tally(
        setting=setting,
        runs=len(trials),
        right=sum(right for right, _ in right_of.values()),
        components_wrong=sum(trial.counted[0] != 1 for trial in trials),
        right_of=right_of,
        encounters=int(np.median([trial.n_encounters for trial in trials])),
    )


def judge(setting: str, recipe: Recipe, options: Options, *, runs: int, first_seed: int = HELD_OUT_SEED) -> Tally:
    """Simulate, map and count held-out runs of one setting.

    Raises
    ------
    StudyError
        A run failed, or the runs cannot be computed as asked.
    """
    cases = [TrialCase(setting=SETTINGS[setting], seed=seed, recipe=recipe) for seed in range(first_seed, first_seed + runs)]
    return tally(results_of(run_cases(TRIALS, cases, options, label=setting)), setting=setting)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print how often the number of holes is found exactly; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.hole_count", description=__doc__)
    parser.add_argument("--method", type=Method, choices=list(Method), default=Method.DEFAULT, help="(default: %(default)s)")
    parser.add_argument("--metric", type=MetricKind, choices=list(MetricKind), help="change this one step of the method")
    parser.add_argument("--setting", choices=list(SETTINGS), action="append", help="may be repeated (default: all)")
    parser.add_argument("--runs", type=int, help="runs of each setting (default: 60 to 400)")
    parser.add_argument("--seed", type=int, default=HELD_OUT_SEED, help="first seed; training takes those from 0 on (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs is not None and options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    recipe = make_recipe(RecipeConfig(method=options.method, metric=options.metric))
    print(f"method {recipe.method}, metric {recipe.metric}, seeds from {options.seed}")
    print("setting                        holes right          encounters   right by true number of holes")
    for setting in options.setting or list(SETTINGS):
        runs = options.runs or _DEFAULT_RUNS[setting]
        try:
            # Nothing is kept: the rules may have changed since.
            result = judge(setting, recipe, read_flags(options, journal=None), runs=runs, first_seed=options.seed)
        except StudyError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        print(result.line())
        if result.components_wrong:
            print(f"{'':26} {result.components_wrong} of them with a number of components other than one")
    return 0


if __name__ == "__main__":
    sys.exit(main())
