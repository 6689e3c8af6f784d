"""Fit and check how long the map's lengths really are: ``python -m studies.scale_fit``.

Random swarms walk in squares with none to three square obstacles; each is mapped by the default method. Compared are the map's distances
without its scale and exact geodesics between the true places of its points. ``--write`` puts the law into the mapper's data.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log, pi
from pathlib import Path

import numpy as np

from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import compute_map
from mapper.scale import ScaleLaw, estimate_scale, load_scale_law
from mapper.types import Evidence, FloatArray
from simulator.arenas.arena import build_arena
from simulator.arenas.geodesics import geodesic_distances
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.world import World
from studies.arenas import ArenaFamily, draw_arena
from studies.cases import Study, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.exploration import explore
from studies.shape_check import true_places

# Lengths are those of an arena of side 50 and the speed is 1, as in `studies.trials`; all but the share are uniform in the logarithm.
BIOBOTS = (30, 250)
LANDMARK_SHARE = (0.1, 0.25)
LEG = (4.0, 50.0)
DETECTION = (0.5, 2.0)
ENCOUNTERS = (800.0, 12_000.0)
# One seed in eight has many.
MANY = (12_000.0, 25_000.0)
_FEW_OF = 8
_AREA = 2500.0
_LONGEST_S = 4000.0
_LEAST_LANDMARKS = 6
HELD_OUT_SEED = 10_000
# What a path over a disc saves is more than the disc's own width, because shortest paths seek discs; the best of a few values tried.
_PER_DISC = 1.35
# More encounters straighten the shortest ways no further; the best of a few values tried, by cross-validation.
_ENOUGH = 5000.0
_REWEIGHTED = 50
_EXACT = 1e-3
_TWO_THIRDS = 2 / 3
_DATA = Path(__file__).parent.parent / "mapper" / "data" / "scale.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleCase:
    """A run to be drawn, made and mapped."""

    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleRun:
    """What one map says of its scale, and by what its lengths, without any factor, were to be multiplied: ``factor``, by least squares."""

    seed: int
    evidence: Evidence
    factor: float


def compute_scale_run(case: ScaleCase) -> ScaleRun:
    """Draw a swarm, let it walk, map it, and compare the map with the truth."""
    rng = np.random.default_rng([9, case.seed])
    while True:
        biobots = round(_draw(rng, BIOBOTS))
        landmarks = max(_LEAST_LANDMARKS, round(biobots * rng.uniform(*LANDMARK_SHARE)))
        span_of_encounters = MANY if case.seed % _FEW_OF == _FEW_OF - 1 else ENCOUNTERS
        leg, radius, encounters = (_draw(rng, span) for span in (LEG, DETECTION, span_of_encounters))
        movers = biobots - landmarks
        # The kinetic gas, as in mapper.feasibility, without its corrections.
        duration_s = encounters * _AREA / (radius * (4.0 * movers**2 / pi + 2.0 * landmarks * movers))
        if duration_s <= _LONGEST_S:
            break
    arena = build_arena(draw_arena(ArenaFamily.SQUARES, seed=case.seed))
    ranges = Ranges(detection=radius, communication=8 * radius)
    world = World(arena, motion=MotionParameters(speed=1.0, mean_leg=leg), ranges=ranges, ids=range(1, biobots + 1), seed=case.seed)
    explored = explore(world, landmarks=landmarks, duration_s=duration_s)
    result = compute_map(explored.table, explored.spells, make_recipe(RecipeConfig()))
    part = result.components[0]
    assert part.scale is not None  # the default method places, and there are landmarks enough
    found, exact = part.distances / part.scale.factor, geodesic_distances(arena, true_places(world, result))
    return ScaleRun(seed=case.seed, evidence=part.scale.evidence, factor=float((found * exact).sum() / (found**2).sum()))


# The law in force does not matter: its factor is taken out again.
SCALE_RUNS = Study(name="scale-fit", compute=compute_scale_run, result_type=ScaleRun)


def fit_scale(runs: Sequence[ScaleRun]) -> ScaleLaw:
    """Fit the law: least absolute error of the logarithm, as the map of a run in a hundred is folded; two thirds lie within ``error``."""
    given = np.array([[log(run.evidence.straightness), log(run.evidence.n_encounters), run.evidence.disc_share] for run in runs])
    terms = np.column_stack(
        [np.ones(len(runs)), given[:, 0], np.minimum(given[:, 1], log(_ENOUGH)), -np.log(1.0 - _PER_DISC * given[:, 2])]
    )
    wanted = np.log([run.factor for run in runs])
    weights = np.ones(len(runs))
    for _ in range(_REWEIGHTED):
        constants, *_ = np.linalg.lstsq(terms * weights[:, None], wanted * weights, rcond=None)
        weights = 1.0 / np.sqrt(np.maximum(np.abs(terms @ constants - wanted), _EXACT))
    error = float(np.quantile(np.abs(terms @ constants - wanted), _TWO_THIRDS))
    low, high = given.min(axis=0), given.max(axis=0)
    spans = [(_rounded(least), _rounded(greatest)) for least, greatest in zip(low.tolist(), high.tolist(), strict=True)]
    constant, straightness, encounters, discs = map(_rounded, constants.tolist())
    return ScaleLaw(
        constant=constant,
        straightness=straightness,
        encounters=encounters,
        discs=discs,
        enough=_ENOUGH,
        per_disc=_PER_DISC,
        error=_rounded(error),
        ranges=(spans[0], spans[1], spans[2]),
    )


def misses(law: ScaleLaw, runs: Sequence[ScaleRun]) -> FloatArray:
    """Return by what the lengths of each run are wrong after the law, as a share: shape (runs,)."""
    return np.array([estimate_scale(run.evidence, law).factor / run.factor - 1.0 for run in runs])


def describe(law: ScaleLaw, runs: Sequence[ScaleRun]) -> str:
    """Tell in a line how right the lengths of some runs are, without and with the law."""
    without, with_law = np.array([1.0 / run.factor - 1.0 for run in runs]), misses(law, runs)
    told = [f"mean {100 * one.mean():+.1f} %, rms {100 * np.sqrt((one**2).mean()):.1f} %" for one in (without, with_law)]
    within = np.mean(np.abs(np.log1p(with_law)) <= law.error)
    return f"{len(runs)} runs: lengths off without the law {told[0]}; with it {told[1]}, {within:.0%} within the stated {law.error:.1%}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit, check on other runs, and print or write the law; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.scale_fit", description=__doc__)
    parser.add_argument("--runs", type=int, default=160, help="runs to fit to, seeds from 0 (default: %(default)s)")
    parser.add_argument("--check-runs", type=int, default=60, help="other runs to check on (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=HELD_OUT_SEED, help="first seed of those (default: %(default)s)")
    parser.add_argument("--write", action="store_true", help="fit anew and write mapper/data/scale.json; else the shipped law is checked")
    parser.add_argument("--journal", type=Path, default=Path("artifacts/scale_fit.jsonl"), help="finished runs (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs < 10 or options.check_runs < 1:
        parser.error(f"--runs is {options.runs} and --check-runs {options.check_runs}; wanted at least 10 and 1")
    spans = {
        "fitted to": range(options.runs) if options.write else range(0),
        "checked on": range(options.seed, options.seed + options.check_runs),
    }
    law = load_scale_law()
    try:
        for name, seeds in spans.items():
            cases = [ScaleCase(seed=seed) for seed in seeds]
            if not cases:
                continue
            runs = results_of(run_cases(SCALE_RUNS, cases, read_flags(options, journal=options.journal), label=name))
            if name == "fitted to":
                law = fit_scale(runs)
                _write(law, n_runs=len(runs))
            print(f"{name} {describe(law, runs)}")
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _write(law: ScaleLaw, *, n_runs: int) -> None:
    names = ("constant", "straightness", "encounters", "discs", "enough", "per_disc", "error", "ranges")
    entry: dict[str, object] = {name: getattr(law, name) for name in names}
    entry |= {"fitted_on": f"{n_runs} simulated runs, seeds 0 to {n_runs - 1}", "command": "python -m studies.scale_fit --write"}
    _DATA.write_text(json.dumps(entry, indent=2) + "\n", encoding="utf-8")


def _draw(rng: np.random.Generator, span: tuple[float, float]) -> float:
    return exp(rng.uniform(log(span[0]), log(span[1])))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


if __name__ == "__main__":
    sys.exit(main())
