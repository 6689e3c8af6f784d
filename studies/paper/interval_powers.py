"""Lengths of signal and noise of one run's diagrams, with and without the filter before the subsample."""

from dataclasses import dataclass, replace

import numpy as np

from mapper.pipeline import compute_map
from mapper.types import MapResult, Method, Recipe
from studies.cases import Study
from studies.paper.map_scores import recipe_of
from studies.paper.swarm_runs import RunCase, SwarmRun, simulate_run
from studies.truth import Floats

SUBSAMPLES = ("maxmin", "KNN-maxmin", "default")


@dataclass(frozen=True, slots=True, kw_only=True)
class Powers:
    """Mean squared lengths of signal and noise intervals of dimension 1 [length^2], None where there are none.

    Parameters
    ----------
    called_signal, called_noise
        Signal are those that the map calls holes, as in [Dir16].
    true_signal, true_noise
        Signal is the longest one: there is one obstacle.
    n_called
        How many holes the map has.
    """

    called_signal: float | None
    called_noise: float | None
    true_signal: float | None
    true_noise: float | None
    n_called: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SubsamplingRun:
    """One run, subsampled in three ways, in the order of ``SUBSAMPLES``."""

    powers: tuple[Powers, Powers, Powers]


def compute_powers(case: RunCase) -> SubsamplingRun:
    """Simulate a run, and map it with each subsample."""
    run = simulate_run(case)
    maxmin, knn, default = (measure_powers(compute_map(run.table, run.spells, recipe)) for recipe in recipes_of(run))
    return SubsamplingRun(powers=(maxmin, knn, default))


POWERS = Study(name="paper-subsampling", compute=compute_powers, result_type=SubsamplingRun)


def measure_powers(result: MapResult) -> Powers:
    """Sum up the intervals of dimension 1 of a map's largest component."""
    part = result.components[0]
    loops = part.intervals[1]
    called = {(hole.birth, hole.death) for hole in result.holes if hole.component == 0}
    is_called = np.array([tuple(loop) in called for loop in loops.tolist()], dtype=bool)
    lengths = loops[:, 1] - loops[:, 0]  # longest first
    return Powers(
        called_signal=_power(lengths[is_called]),
        called_noise=_power(lengths[~is_called]),
        true_signal=_power(lengths[:1]),
        true_noise=_power(lengths[1:]),
        n_called=int(is_called.sum()),
    )


def recipes_of(run: SwarmRun) -> tuple[Recipe, Recipe, Recipe]:
    """Return the recipes of ``SUBSAMPLES``: the paper's without its filter, the paper's, and the default."""
    paper = recipe_of(Method.PAPER, speed=run.speed)
    return replace(paper, outlier_q=1.0), paper, recipe_of(Method.DEFAULT, speed=run.speed)


def _power(lengths: Floats) -> float | None:
    return float(np.mean(lengths**2)) if len(lengths) else None
