"""lambda_3 and the bottleneck distances with their bounds over N_l and N_m ([Dir16] VI, "Convergence Analysis"; Theorem 3, Corollary 1).

``python -m studies.paper.bounds``. Scenarios 1 and 2, 20 runs a point. lambda_3 is what d_GEL between landmarks exceeds d_M by, as a share:
its largest value over all pairs goes into the bounds. PD(M) is of a fine sample of the arena, and covering radii are over that sample:
bounds and distances speak of the same finite sets. delta_e is the covering radius of the subsample's places.
"""

import sys
from dataclasses import asdict
from itertools import product

import numpy as np

from studies.cases import results_of, run_cases
from studies.paper.bound_checks import BOUNDS, ROUNDING, BoundsCase, BoundsRun
from studies.paper.bounds_figures import draw_bottlenecks, draw_inflation
from studies.paper.experiment import Experiment, Outcome, Setting, perform_main
from studies.paper.swarm_runs import PRESETS, Place, RunCase

_SCENARIOS = ("no-obstacle", "one-obstacle")
_LANDMARKS = (10, 20, 30, 40)
_MOVERS = (50, 100, 150, 200)
_RUNS = 20
_POINTS, _QUICK_POINTS = 400, 80


def run_bounds(setting: Setting) -> Outcome:
    """Compute all runs of the grid."""
    presets = setting.pick(PRESETS, PRESETS[:1])
    scenarios = setting.pick(_SCENARIOS, _SCENARIOS[1:])
    landmarks, movers = setting.pick(_LANDMARKS, (10, 20)), setting.pick(_MOVERS, (50, 100))
    seeds = range(setting.first_seed, setting.first_seed + setting.pick(_RUNS, 1))
    n_points, share = setting.pick(_POINTS, _QUICK_POINTS), setting.pick(1.0, 0.5)
    cases = [
        BoundsCase(
            run=RunCase(preset=preset, place=Place(scenario=scenario), seed=seed, landmarks=n_landmarks, movers=n_movers, time_share=share),
            n_points=n_points,
        )
        for preset in presets
        for scenario in scenarios
        for n_landmarks in landmarks
        for n_movers in movers
        for seed in seeds
    ]
    runs = results_of(run_cases(BOUNDS, cases, setting.options("bounds"), label="bounds"))
    rows = [
        {
            "preset": case.run.preset,
            "scenario": case.run.place.scenario,
            "landmarks": case.run.landmarks,
            "movers": case.run.movers,
            "seed": case.run.seed,
            **asdict(run),
        }
        for case, run in zip(cases, runs, strict=True)
    ]
    violations, ends, figures = [], [], {}
    for preset in presets:
        for scenario in scenarios:
            own: dict[tuple[int, int], list[BoundsRun]] = {key: [] for key in product(landmarks, movers)}
            for case, run in zip(cases, runs, strict=True):
                if (case.run.preset, case.run.place.scenario) == (preset, scenario):
                    own[case.run.landmarks, case.run.movers].append(run)
            about = {"preset": preset, "scenario": scenario}
            violations.append({**about, **_count_violations([run for group in own.values() for run in group])})
            ends += [{**about, "landmarks": key[0], "movers": key[1], **_means(group)} for key, group in own.items()]
            title = f"preset {preset}, scenario {1 + _SCENARIOS.index(scenario)} ({scenario})"
            figures[f"lambda-{preset}-{scenario}"] = draw_inflation(own, title=title)
            figures[f"bottleneck-{preset}-{scenario}"] = draw_bottlenecks(own, title=title)
    return Outcome(summary={"violations": violations, "grid": ends}, rows=rows, figures=figures)


def _count_violations(runs: list[BoundsRun]) -> dict[str, float]:
    """Count runs whose bottleneck distance, in either dimension, exceeds a bound, and average shares of pairs."""
    counted: dict[str, float] = {"runs": len(runs)}
    for kind in ("published", "corrected", "stable"):
        for of in ("l", "e"):
            bounds = np.array([getattr(run, f"{kind}_{of}") for run in runs])
            for dimension in (0, 1):
                found = np.array([getattr(run, f"bottleneck_{of}_{dimension}") for run in runs])
                counted[f"{kind}_{of}_{dimension}"] = int((found > bounds * (1.0 + ROUNDING)).sum())
            found = np.array([max(getattr(run, f"bottleneck_{of}_0"), getattr(run, f"bottleneck_{of}_1")) for run in runs])
            counted[f"{kind}_{of}_slack"] = float(np.median(bounds / found))
    for name in ("theorem_2_below", "corollary_below", "corollary_published", "corollary_corrected", "corollary_by_landmarks"):
        counted[name] = float(np.mean([getattr(run, name) for run in runs]))
    return counted


def _means(runs: list[BoundsRun]) -> dict[str, float]:
    names = ("n_encounters", "lambda_max", "lambda_median", "next_landmark", "landmark_cover", "bottleneck_l_1", "bottleneck_e_1")
    return {name: float(np.mean([getattr(run, name) for run in runs])) for name in names}


EXPERIMENT = Experiment(name="bounds", about="lambda_3 and bottleneck distances with their bounds, over N_l and N_m", run=run_bounds)

if __name__ == "__main__":
    about_ = "lambda_3 and bottleneck distances with their bounds."
    sys.exit(perform_main([EXPERIMENT], None, prog="python -m studies.paper.bounds", about=about_))
