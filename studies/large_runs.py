"""What the limit of candidates costs the default method in long runs: ``python -m studies.large_runs``.

Every run is mapped once with each limit in question; 0 is the method without a limit.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.bottleneck import bottleneck_distance
from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import compute_map
from mapper.types import EncounterTable, IntArray, MapResult, ModeSpell
from mapper.window import make_encounter_table
from simulator.arenas.arena import build_arena
from simulator.arenas.geodesics import geodesic_distances
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.world import World
from studies.arenas import ArenaFamily, draw_arena
from studies.cases import PackageFile, Study, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.trials import SETTINGS, Setting
from studies.truth import Floats, diagram_of

# Training takes seeds from 0 on, `studies.hole_count` those from 10,000.
FIRST_SEED = 60_000
LIMITS = (0, 40_000, 20_000, 10_000, 5_000)
# Settings of `paper-units`, longer: about 11 encounters in a second.
RUNS = {
    name: replace(SETTINGS["squares/paper-units"], name=name, family=family, duration_s=duration_s)
    for name, family, duration_s in (
        ("squares/10,000 s", ArenaFamily.SQUARES, 10_000.0),
        ("squares/30,000 s", ArenaFamily.SQUARES, 30_000.0),
        ("squares/90,000 s", ArenaFamily.SQUARES, 90_000.0),
        ("shapes/10,000 s", ArenaFamily.SHAPES, 10_000.0),
        ("small-squares/10,000 s", ArenaFamily.SMALL_SQUARES, 10_000.0),
    )
}
_DISPERSION_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LargeCase:
    """A run, and the limit of candidates that it is mapped with."""

    setting: str
    seed: int
    limit: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one map of one run was worth.

    ``bottleneck``: distance of the diagrams of dimension 1 of the map and of exact geodesics between its points, over the largest of these.
    ``metric_error``: root of the sum of squared errors of the distances between points, over that of the squared distances.
    ``seconds``: from encounters in memory to the map.
    """

    setting: str
    seed: int
    limit: int
    n_encounters: int
    true_holes: int
    holes: int
    bottleneck: float
    metric_error: float
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LongRun:
    """A simulated run: its world at the end, and what a base station would know."""

    world: World
    table: EncounterTable
    spells: tuple[ModeSpell, ...]


@lru_cache(maxsize=1)  # several limits are tried on one run
def simulate_long(setting: Setting, seed: int) -> LongRun:
    """Let biobots disperse, set landmarks, and take the encounters that begin and end while these stand."""
    world = World(
        build_arena(draw_arena(setting.family, seed=seed)),
        motion=MotionParameters(speed=1.0, mean_leg=setting.mean_leg),
        ranges=Ranges(detection=setting.detection_radius, communication=8 * setting.detection_radius),
        ids=range(1, setting.biobots + 1),
        seed=seed,
    )
    world.run(_DISPERSION_S)
    landmarks = select_landmarks(world.adjacency(), count=setting.landmarks)
    for landmark in landmarks:
        world.stop(landmark)
    ended = world.run(_DISPERSION_S + setting.duration_s).ended
    is_inside = ended.t_start_s >= _DISPERSION_S
    zero_ns = round(_DISPERSION_S * NS_PER_S)
    return LongRun(
        world=world,
        table=make_encounter_table(
            t_start_ns=_to_ns(ended.t_start_s[is_inside]),
            t_end_ns=_to_ns(ended.t_end_s[is_inside]),
            id1=ended.id1[is_inside].astype(np.int64),
            id2=ended.id2[is_inside].astype(np.int64),
        ),
        spells=tuple(
            ModeSpell(node=NodeId(landmark), t_start_ns=zero_ns, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for landmark in landmarks
        ),
    )


def compute_case(case: LargeCase) -> Outcome:
    """Simulate and map one run, and compare the map with the truth."""
    return judge_map(simulate_long(RUNS[case.setting], case.seed), case)


def judge_map(run: LongRun, case: LargeCase) -> Outcome:
    """Map a run that has been simulated, and compare the map with the truth."""
    recipe = replace(make_recipe(RecipeConfig()), max_candidates=case.limit)
    began = time.perf_counter()
    result = compute_map(run.table, run.spells, replace(recipe, replicates=0))
    seconds = time.perf_counter() - began
    exact = geodesic_distances(run.world.arena, _true_places(run, result))
    part = result.components[0]
    found, true = (loops[np.isfinite(loops[:, 1])] for loops in (part.intervals[1], diagram_of(exact)[1]))
    return Outcome(
        setting=case.setting,
        seed=case.seed,
        limit=case.limit,
        n_encounters=result.n_encounters,
        true_holes=run.world.arena.betti.holes,
        holes=result.betti_numbers[1],
        bottleneck=float(bottleneck_distance(found, true) / exact.max()),
        metric_error=float(np.sqrt(((part.distances - exact) ** 2).sum() / (exact**2).sum())),
        seconds=seconds,
    )


LARGE_RUNS = Study(
    name="large-runs", compute=compute_case, result_type=Outcome, files=(PackageFile(package="mapper", path="data/classifier.json"),)
)


def _true_places(run: LongRun, result: MapResult) -> Floats:
    """Find where the encounters of the largest component's points were: half way between their biobots; shape (p, 2)."""
    points = slice(0, result.components[0].n_points)
    at_s = result.points.t_ns[points] / NS_PER_S
    one, other = (run.world.positions_of(ids[points], at_s) for ids in (result.points.id1, result.points.id2))
    return (one + other) / 2


def _to_ns(times_s: Floats) -> IntArray:
    return np.rint(times_s * NS_PER_S).astype(np.int64)


def describe(outcomes: Sequence[Outcome]) -> str:
    """Tell the outcomes of one setting and limit, at least one, in a line; standard errors after the signs."""
    right = np.array([outcome.holes == outcome.true_holes for outcome in outcomes])
    figures = [
        f"{100 * mean:5.1f} +- {100 * error:3.1f} %"
        for mean, error in (
            (right.mean(), np.sqrt(right.mean() * (1 - right.mean()) / len(right))),
            _mean_and_error([outcome.bottleneck for outcome in outcomes]),
            _mean_and_error([outcome.metric_error for outcome in outcomes]),
        )
    ]
    first = outcomes[0]
    n_encounters = int(np.median([outcome.n_encounters for outcome in outcomes]))
    seconds = np.median([outcome.seconds for outcome in outcomes])
    limit = f"{first.limit:,}" if first.limit else "none"
    return f"{first.setting:22} {len(outcomes):4d} {n_encounters:9,} {limit:>8}   " + "   ".join(figures) + f"   {seconds:7.2f}"


def _mean_and_error(values: Sequence[float]) -> tuple[float, float]:
    return float(np.mean(values)), float(np.std(values) / np.sqrt(len(values)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.large_runs", description=__doc__)
    parser.add_argument("--setting", choices=list(RUNS), action="append", help="may be repeated (default: the first two)")
    parser.add_argument("--limit", type=int, action="append", help=f"max_candidates, 0 for none; may be repeated (default: {LIMITS})")
    parser.add_argument("--runs", type=int, default=60, help="runs of each setting (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="first seed (default: %(default)s)")
    parser.add_argument("--journal", type=Path, default=Path("artifacts/large_runs.jsonl"), help="finished maps (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    limits = options.limit or list(LIMITS)
    if min(limits) < 0:
        parser.error(f"--limit is {min(limits)}; wanted 0 for none, or a number of candidates")
    settings = options.setting or list(RUNS)[:2]
    seeds = range(options.seed, options.seed + options.runs)
    cases = [LargeCase(setting=name, seed=seed, limit=limit) for name in settings for seed in seeds for limit in limits]
    try:
        outcomes = results_of(run_cases(LARGE_RUNS, cases, read_flags(options, journal=options.journal), label="large runs"))
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print("setting                runs encounters candidates  holes right    bottleneck H1   metric error   seconds (median)")
    for name in settings:
        for limit in limits:
            print(describe([outcome for outcome in outcomes if (outcome.setting, outcome.limit) == (name, limit)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
