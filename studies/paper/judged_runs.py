"""Intervals and holes of one run by both methods, for the classifier."""

from dataclasses import dataclass

import numpy as np

from mapper.types import MapResult, Method
from studies.cases import Study
from studies.paper.map_scores import make_map
from studies.paper.swarm_runs import RunCase, SwarmRun, simulate_run
from studies.scores import count_enclosed
from studies.truth import Floats, obstacle_points

METHODS = (Method.PAPER, Method.DEFAULT)
_LOOP_DIGITS = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """What one method made of a run.

    Parameters
    ----------
    loops
        Finite intervals of dimension 1 of the largest component [diameters], shape (m, 2).
    n_holes, n_enclosing
        Holes of the map by the rule that is shipped, and how many of them go around an obstacle, each around one of its own.
    """

    loops: Floats
    n_holes: int
    n_enclosing: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JudgedRun:
    """One run by both methods."""

    n_encounters: int
    paper: Judged
    default: Judged


def compute_judged(case: RunCase) -> JudgedRun:
    """Simulate a run and map it by both methods."""
    run = simulate_run(case)
    paper, default = (_judge(run, make_map(run, method)) for method in METHODS)
    return JudgedRun(n_encounters=len(run.table), paper=paper, default=default)


JUDGED = Study(name="paper-classifier", compute=compute_judged, result_type=JudgedRun)


def _judge(run: SwarmRun, result: MapResult) -> Judged:
    part, places = result.components[0], run.positions[result.points.encounter]
    n_enclosing = count_enclosed([places[hole.outline] for hole in result.holes], obstacle_points(run.arena))
    loops = np.round(part.intervals[1] / (part.diameter or 1.0), _LOOP_DIGITS)
    return Judged(loops=loops, n_holes=len(result.holes), n_enclosing=n_enclosing)
