"""Train the numbers by which the mapper tells how large a hole is: ``python -m studies.train_hole_sizes``.

Simulated runs around obstacles of several forms are mapped, and the perimeter and area of each hull are compared with what the map
tells of the hole. Every swarm weighs the same, whatever the number of its holes.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from mapper.config import RecipeConfig, make_recipe
from mapper.hole_sizes import LIMITED, SizeModel, correction_features, error_sources
from mapper.types import Method
from studies.cases import Options, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.hole_runs import HELD_OUT_SEED, HOLE_RUNS, SWARMS, HoleCase, HoleRun, MatchedHole
from studies.truth import Floats

TRAINING_RUNS = {"paper-units": 45, "paper-units, three times as long": 25, "paper-50cm": 15, "hisser-field": 75}
_QUICK_RUNS = 5
_RIDGE = 1.0  # holes' worth of belief that a correction is not needed
_SHARE_WITHIN = 0.683  # of a normal distribution within one standard deviation
_LEAST_VARIANCE = 1e-4  # one per cent


def train(runs: Sequence[HoleRun]) -> SizeModel:
    """Fit the numbers to runs in which each swarm has some holes."""
    holes = [(run.swarm, hole) for run in runs for hole in run.matched]
    swarms = [swarm for swarm, _ in holes]
    weights = np.array([1.0 / swarms.count(swarm) for swarm in swarms])
    weights *= len(holes) / weights.sum()
    measured = [hole for _, hole in holes]
    limits = [
        (round(min(values), 4), round(max(values), 4)) for values in ([getattr(hole.loop, name) for hole in measured] for name in LIMITED)
    ]
    features = np.array([correction_features(hole.loop, (limits[0], limits[1])) for hole in measured])
    lengths = np.array([np.log(hole.hull_perimeter / (3.0 * hole.loop.death)) for hole in measured])
    perimeter = _fit(features, lengths, weights)
    own_perimeter = 3.0 * np.array([hole.loop.death for hole in measured]) * np.exp(features @ perimeter)
    forms = np.array([[1.0, np.log(hole.loop.roundness)] for hole in measured])
    area = _fit(forms, np.array([_log_roundness(hole) for hole in measured]), weights)
    own_area = np.minimum(own_perimeter**2 / (4.0 * np.pi) * np.exp(forms @ area), own_perimeter**2 / (4.0 * np.pi))
    sources = np.array([error_sources(hole.loop) for hole in measured])
    misses = [
        np.log(own_perimeter / [hole.hull_perimeter for hole in measured]),
        np.log(own_area / [hole.hull_area for hole in measured]),
    ]
    variances = [_fit_variance(sources, miss, weights) for miss in misses]
    return SizeModel(
        perimeter=(_rounded(perimeter[0]), _rounded(perimeter[1]), _rounded(perimeter[2])),
        area=(_rounded(area[0]), _rounded(area[1])),
        limits=(limits[0], limits[1]),
        perimeter_variance=_rounded_three(variances[0]),
        area_variance=_rounded_three(variances[1]),
    )


def _log_roundness(hole: MatchedHole) -> float:
    return float(np.log(4.0 * np.pi * hole.hull_area / hole.hull_perimeter**2))


def _fit(features: Floats, wanted: Floats, weights: Floats) -> Floats:
    """Fit by least squares with a ridge on all but the intercept, about the features' means."""
    means = np.average(features, axis=0, weights=weights)
    means[0] = 0.0
    centred = features - means
    ridge = np.diag([0.0, *([_RIDGE] * (features.shape[1] - 1))])
    found = np.linalg.solve(centred.T @ (centred * weights[:, None]) + ridge, centred.T @ (weights * wanted))
    found[0] -= means[1:] @ found[1:]
    return np.asarray(found)


def _fit_variance(sources: Floats, misses: Floats, weights: Floats) -> Floats:
    """Fit a variance that is a sum of sources with weights that are not negative, then widen or narrow it to hold two of three misses.

    By maximum likelihood of a normal distribution; what is fitted to is spread by more than that where it has heavy tails, and the second
    step takes that out.
    """

    def cost(weight: Floats) -> float:
        variance = sources @ weight + _LEAST_VARIANCE
        return float((weights * (np.log(variance) + misses**2 / variance)).sum())

    found = minimize(cost, x0=np.full(3, 0.01), bounds=[(0.0, 10.0)] * 3, method="L-BFGS-B").x
    found[0] += _LEAST_VARIANCE
    order = np.argsort(misses**2 / (sources @ found))
    reached = np.cumsum(weights[order]) / weights.sum()
    middle = order[int(np.searchsorted(reached, _SHARE_WITHIN))]
    return np.asarray(found * (misses[middle] ** 2 / (sources[middle] @ found)))


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _rounded_three(values: Floats) -> tuple[float, float, float]:
    first, second, third = (_rounded(value) for value in values.tolist())
    return first, second, third


def collect(method: Method, options: Options, *, runs: dict[str, int], first_seed: int = 0) -> list[HoleRun]:
    """Simulate and map runs of each swarm.

    Raises
    ------
    StudyError
        A run failed, or the runs cannot be computed as asked.
    """
    recipe = make_recipe(RecipeConfig(method=method))
    cases = [
        HoleCase(swarm=SWARMS[name], seed=seed, recipe=recipe) for name, n in runs.items() for seed in range(first_seed, first_seed + n)
    ]
    return list(results_of(run_cases(HOLE_RUNS, cases, options, label=f"holes, method {method}")))


def main(arguments: Sequence[str] | None = None) -> int:
    """Train the methods and write or print the numbers; entries of methods that are not trained stay. Progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.train_hole_sizes", description=__doc__)
    parser.add_argument("--out", type=Path, help="write the numbers here (default: print them)")
    parser.add_argument("--method", type=Method, choices=list(Method), action="append", help="train this alone; may be repeated")
    parser.add_argument("--cache", type=Path, default=Path("artifacts/hole_sizes"), help="folder of finished runs (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help=f"{_QUICK_RUNS} runs of each swarm, to see that it works")
    add_flags(parser)
    options = parser.parse_args(arguments)
    runs = {name: _QUICK_RUNS if options.quick else n for name, n in TRAINING_RUNS.items()}
    command = "python -m studies.train_hole_sizes" + " --quick" * options.quick
    entries = json.loads(options.out.read_bytes()) if options.out is not None and options.out.exists() else {}
    try:
        for method in options.method or Method:
            found = collect(method, read_flags(options, journal=options.cache / "holes.jsonl"), runs=runs)
            counted = ", ".join(
                f"{name} {sum(len(run.matched) for run in found if run.swarm == name)} of {n} runs" for name, n in runs.items()
            )
            trained_on = f"holes of simulated runs, seeds from 0 to below {HELD_OUT_SEED}: {counted}"
            name = f"{method}/{make_recipe(RecipeConfig(method=method)).metric}"
            entries[name] = {**asdict(train(found)), "trained_on": trained_on, "command": command}
    except StudyError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    text = json.dumps(entries, indent=2) + "\n"
    if options.out is None:
        sys.stdout.write(text)
    else:
        options.out.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
