"""The units that [Dir16] prints: how many encounters a run has, by the side of the arena, with every number of a biobot as printed.

``python -m studies.paper.units``. v_m = 0.1 m/s, l* = 0.30 m, r_d = 1 cm, 150 biobots of which 20 stand, 200 s; the arena is 50 m x 50 m.
"""

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from shapely.geometry import box

from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.presets import find_preset
from simulator.world import World
from studies.cases import Study, results_of, run_cases
from studies.encounter_rate import Gas, torus_rate, wall_factor
from studies.exploration import explore
from studies.paper import drawing
from studies.paper.experiment import Experiment, Outcome, Setting, perform_main

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIDES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_PRINTED_SIDE_M = 50.0
_PRINTED = find_preset("paper-50cm")  # every number as printed, but for the side
_RUNS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class SquareCase:
    """A run in an empty square."""

    side_m: float
    seed: int
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SquareRun:
    """How many encounters it had."""

    n_encounters: int


def compute_square(case: SquareCase) -> SquareRun:
    """Simulate a run and count its encounters."""
    arena = build_arena(box(0.0, 0.0, case.side_m, case.side_m))
    ranges = Ranges(detection=_PRINTED.ranges.detection, communication=_PRINTED.ranges.communication)
    world = World(arena, motion=_PRINTED.motion, ranges=ranges, ids=range(1, _PRINTED.biobots + 1), seed=case.seed)
    return SquareRun(n_encounters=len(explore(world, landmarks=_PRINTED.landmarks, duration_s=case.duration_s).table))


SQUARES = Study(name="paper-units", compute=compute_square, result_type=SquareRun)


def expected_encounters(side_m: float, *, duration_s: float) -> float:
    """Return how many encounters the kinetic theory of gases expects (``studies.encounter_rate``)."""
    radius, walkers = _PRINTED.ranges.detection / side_m, _PRINTED.biobots - _PRINTED.landmarks
    gas = Gas(radius=radius, walkers=walkers, landmarks=_PRINTED.landmarks, mean_leg=_PRINTED.motion.mean_leg / side_m)
    return torus_rate(gas) * wall_factor(radius) * _PRINTED.motion.speed / side_m * duration_s


def run_units(setting: Setting) -> Outcome:
    """Count encounters in squares of many sizes."""
    sides = setting.pick(_SIDES_M, (0.5, 50.0))
    duration_s = setting.pick(_PRINTED.duration_s, 20.0)
    seeds = range(setting.first_seed, setting.first_seed + setting.pick(_RUNS, 2))
    cases = [SquareCase(side_m=side, seed=seed, duration_s=duration_s) for side in sides for seed in seeds]
    runs = results_of(run_cases(SQUARES, cases, setting.options("units"), label="units"))
    rows = [{"side_m": case.side_m, "seed": case.seed, "encounters": run.n_encounters} for case, run in zip(cases, runs, strict=True)]
    table = []
    for side in sides:
        counts = np.array([run.n_encounters for case, run in zip(cases, runs, strict=True) if case.side_m == side])
        theory = expected_encounters(side, duration_s=duration_s)
        table.append({"side_m": side, "runs": len(counts), "encounters": float(counts.mean()), "theory": theory})
    return Outcome(summary={"table": table}, rows=rows, figures={"": _draw(table, duration_s=duration_s)})


def _draw(table: list[dict[str, float]], *, duration_s: float) -> "Figure":
    figure, ((axes,),) = drawing.new_figure(1, 1, size=(6.4, 4.2))
    fine = np.geomspace(min(row["side_m"] for row in table), max(row["side_m"] for row in table), 50)
    theory = [expected_encounters(side, duration_s=duration_s) for side in fine.tolist()]
    axes.plot(fine, theory, color=drawing.GREY, label="kinetic theory")
    axes.plot([row["side_m"] for row in table], [row["encounters"] for row in table], "o", color=drawing.BLUE, label="simulated, mean")
    axes.axvline(_PRINTED_SIDE_M, color=drawing.ORANGE, linestyle="--", linewidth=1)
    axes.annotate("as printed: 50 m", (_PRINTED_SIDE_M, max(theory)), color=drawing.ORANGE, ha="right", va="top", rotation=90)
    axes.set(xscale="log", yscale="log", xlabel="side of the square arena [m]", ylabel=f"encounters of 150 biobots in {duration_s:g} s")
    axes.set_title("v = 0.1 m/s, l* = 0.3 m, r_d = 1 cm, 20 of 150 stand")
    axes.legend()
    return figure


EXPERIMENT = Experiment(name="units", about="encounters by the side of the arena, all other numbers as printed", run=run_units)

if __name__ == "__main__":
    sys.exit(perform_main([EXPERIMENT], None, prog="python -m studies.paper.units", about="The units that [Dir16] prints."))
