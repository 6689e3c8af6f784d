"""Train what says how sure a map is, on simulated runs with known holes.

``python -m studies.train_confidence --out mapper/data/confidence.json`` made the file that the mapper ships. Runs that are done are kept:
what was stopped goes on.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapper.confidence.counting import COUNT_FEATURES, describe_numbers
from mapper.confidence.evidence import LOOP_FEATURES, POINT_FEATURES, RUN_FEATURES
from mapper.confidence.model import Model, Models
from mapper.config import RecipeConfig, make_recipe
from mapper.types import BoolArray, FloatArray, IntArray
from studies.cases import Options, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.confidence_fit import Term, choose_penalty, fit_band, fit_choice, fit_logistic, foretell, spread_folds
from studies.confidence_runs import WITNESSES, Witness, draw_mission
from studies.errors import StudyError
from studies.trials import SETTINGS

TRAINING_RUNS = 650
_QUICK_RUNS = 60
_PENALTIES = (1.0, 3.0, 10.0, 30.0)
_BAND_SHARE = 0.95
_COUNT_PENALTIES = (3.0, 10.0, 30.0, 100.0)
_BAND_PENALTY, _POINT_PENALTY = 1.0, 10.0
_LEAST_MOVE = 0.002  # of the diameter: a diagram without loops does not move
_POINTS_A_RUN = 40  # points of one map err together, so more would add little

_STRONG = (
    "death over birth",
    "length",
    "length over noise",
    "death over spacing",
    "called real",
    "length at its place in replicas",
)
_CIRCUMSTANCES = ("encounters a biobot", "landmarks", "encounters", "encounter's length", "doubt")
LOOP_TERMS: tuple[Term, ...] = (
    *((name,) for name in (*LOOP_FEATURES, *RUN_FEATURES)),
    *((one, other) for one in _STRONG for other in _CIRCUMSTANCES),
    *((name, name) for name in _STRONG if name != "called real"),
)
_OF_NUMBERS = ("as counted", "more than counted", "fewer than counted", "number", "none")
COUNT_TERMS: tuple[Term, ...] = (
    *((name,) for name in COUNT_FEATURES),
    *((one, other) for one in _OF_NUMBERS for other in RUN_FEATURES),
    *((one, other) for one in ("sum of loops", "drop of chances") for other in _CIRCUMSTANCES),
    ("more than counted", "more than counted"),
)
RUN_TERMS: tuple[Term, ...] = tuple((name,) for name in RUN_FEATURES)
POINT_TERMS: tuple[Term, ...] = (
    *((name,) for name in (*POINT_FEATURES, *RUN_FEATURES)),
    *((one, other) for one in POINT_FEATURES for other in ("encounters a biobot", "landmarks", "doubt")),
    *((name, name) for name in POINT_FEATURES),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopTable:
    """The longest loops of many runs, one under the other: what describes them, which are holes, and whose they are, shape (n,) each."""

    columns: dict[str, FloatArray]
    is_hole: BoolArray
    run: IntArray


def stack_loops(witnesses: Sequence[Witness]) -> LoopTable:
    """Put the loops of runs one under the other; ``run`` counts the witnesses."""
    names = (*LOOP_FEATURES, *RUN_FEATURES)
    return LoopTable(
        columns={name: np.concatenate([np.array(one.loops[name]) for one in witnesses]) for name in names},
        is_hole=np.concatenate([np.array(one.is_hole, dtype=bool) for one in witnesses]),
        run=np.repeat(np.arange(len(witnesses)), [len(one.is_hole) for one in witnesses]),
    )


def run_columns(witnesses: Sequence[Witness]) -> dict[str, FloatArray]:
    """Put what describes runs one under the other."""
    return {name: np.array([one.run[name] for one in witnesses]) for name in RUN_FEATURES}


def train(witnesses: Sequence[Witness]) -> Models:
    """Fit all models to runs; those without a map teach nothing.

    Notes
    -----
    The count is fitted to probabilities that models fitted to other runs gave, as it will be used on runs that no model was fitted to.
    """
    mapped = [one for one in witnesses if one.run]
    folds = spread_folds(np.array([one.seed for one in mapped]), period=len(SETTINGS))
    table = stack_loops(mapped)
    penalty = choose_penalty(table.columns, table.is_hole, folds[table.run], LOOP_TERMS, penalties=_PENALTIES)
    loop = fit_logistic(table.columns, table.is_hole, LOOP_TERMS, penalty=penalty)
    unseen = foretell(table.columns, table.is_hole, folds[table.run], LOOP_TERMS, penalty=penalty)
    others = [other_loop_probabilities(loop, one) for one in mapped]
    found = [np.concatenate([unseen[table.run == index], others[index]]) for index in range(len(mapped))]
    runs = run_columns(mapped)
    moves = np.array([max(one.move, _LEAST_MOVE) for one in mapped])
    return Models(
        loop=loop,
        count=_fit_count(mapped, found, folds),
        prior=tuple((np.bincount([one.true_holes for one in mapped]) / len(mapped)).tolist()),
        band=fit_band(runs, moves, folds, RUN_TERMS, penalty=_BAND_PENALTY, share=_BAND_SHARE),
        point=_fit_points(mapped),
    )


def number_columns(witness: Witness, found: FloatArray) -> dict[str, FloatArray]:
    """Describe the numbers of holes that a run may have, by the probabilities of its loops."""
    run = {name: np.array(value) for name, value in witness.run.items()}
    return describe_numbers(found, counted=witness.counted, replicas=np.array(witness.replica_counts), run=run)


def _fit_count(mapped: Sequence[Witness], found: Sequence[FloatArray], folds: IntArray) -> Model:
    """Fit the choice among numbers, with the penalty under which the true numbers of folds left out are foretold best."""
    tables = [number_columns(one, chances) for one, chances in zip(mapped, found, strict=True)]
    lengths = [len(table["number"]) for table in tables]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    is_true = np.concatenate([np.arange(length) == one.true_holes for one, length in zip(mapped, lengths, strict=True)])
    run = np.repeat(np.arange(len(tables)), lengths)

    def fit(is_in: BoolArray, penalty: float) -> Model:
        own = {name: column[is_in] for name, column in columns.items()}
        return fit_choice(own, np.unique(run[is_in], return_inverse=True)[1], is_true[is_in], COUNT_TERMS, penalty=penalty)

    def loss(penalty: float) -> float:
        total = 0.0
        for out in np.unique(folds):
            is_out = folds[run] == out
            model = fit(~is_out, penalty)
            for index in np.flatnonzero(folds == out).tolist():
                score = model.score(tables[index])
                total += float(np.logaddexp.reduce(score) - score[mapped[index].true_holes])
        return total

    return fit(np.ones(len(run), dtype=bool), min(_COUNT_PENALTIES, key=loss))


def other_loop_probabilities(model: Model, witness: Witness) -> FloatArray:
    """Say how likely the loops of the smaller components are holes."""
    columns = {name: np.array(values) for name, values in witness.other_loops.items()}
    return model.probability(columns) if columns else np.zeros(0)


def _fit_points(mapped: Sequence[Witness]) -> Model:
    chosen = [np.unique(np.linspace(0, len(one.is_right) - 1, _POINTS_A_RUN).astype(int)) for one in mapped]
    columns = {
        name: np.concatenate([np.array(one.points[name])[rows] for one, rows in zip(mapped, chosen, strict=True)])
        for name in (*POINT_FEATURES, *RUN_FEATURES)
    }
    is_right = np.concatenate([np.array(one.is_right, dtype=bool)[rows] for one, rows in zip(mapped, chosen, strict=True)])
    return fit_logistic(columns, is_right, POINT_TERMS, penalty=_POINT_PENALTY)


def describe(models: Models, *, trained_on: str, command: str) -> dict[str, object]:
    """Write models as a JSON object."""
    return {
        "loop": _plain(models.loop),
        "count": _plain(models.count),
        "prior": [_rounded(share) for share in models.prior],
        "band": _plain(models.band),
        "point": _plain(models.point),
        "trained_on": trained_on,
        "command": command,
    }


def _plain(model: Model) -> dict[str, object]:
    return {
        "features": {name: [_rounded(value) for value in four] for name, four in model.features.items()},
        "constant": _rounded(model.constant),
        "weights": {" * ".join(term): _rounded(weight) for term, weight in model.weights.items()},
    }


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")


def collect(options: Options, *, first_seed: int, runs: int, label: str) -> list[Witness]:
    """Simulate and map runs with the default recipe.

    Raises
    ------
    StudyError
        A run failed, or the runs cannot be computed as asked.
    """
    recipe = make_recipe(RecipeConfig())
    missions = [draw_mission(seed, recipe) for seed in range(first_seed, first_seed + runs)]
    return results_of(run_cases(WITNESSES, missions, options, label=label))


def main(arguments: Sequence[str] | None = None) -> int:
    """Train and write or print the models; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.train_confidence", description=__doc__)
    parser.add_argument("--out", type=Path, help="write the models here (default: print them)")
    parser.add_argument("--cache", type=Path, default=Path("artifacts/confidence"), help="folder of finished runs (default: %(default)s)")
    parser.add_argument("--runs", type=int, default=TRAINING_RUNS, help="seeds from 0 on (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help=f"{_QUICK_RUNS} runs, to see that it works")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs < _QUICK_RUNS:
        parser.error(f"--runs is {options.runs}; wanted at least {_QUICK_RUNS}")
    runs = _QUICK_RUNS if options.quick else options.runs
    try:
        witnesses = collect(read_flags(options, journal=options.cache / "training.jsonl"), first_seed=0, runs=runs, label="confidence")
    except StudyError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    flag = "" if runs == TRAINING_RUNS else " --quick" if options.quick else f" --runs {runs}"
    trained_on = f"{runs} simulated runs, seeds 0 to {runs - 1}, of the settings of studies.trials, as they are, changed and starved"
    entry = describe(train(witnesses), trained_on=trained_on, command=f"python -m studies.train_confidence{flag}")
    text = json.dumps({"default/landmark_profile": entry}, indent=1) + "\n"
    if options.out is None:
        sys.stdout.write(text)
    else:
        options.out.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
