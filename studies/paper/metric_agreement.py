"""How d_GEL compares with d_M in one run, between landmarks and between encounters, and their diagrams with that of the arena."""

from dataclasses import dataclass

import numpy as np

from studies.cases import Study
from studies.paper.encounter_space import bottlenecks, measure_space, sample_scenario
from studies.paper.swarm_runs import RunCase, simulate_run
from studies.truth import Floats, Intervals, diagram_of


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceCase:
    """A run, and how many points stand for the arena."""

    run: RunCase
    n_points: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How d_GEL compares with d_M on one set of points.

    Parameters
    ----------
    rms_error
        Root of the sum of squared differences over that of squared distances.
    median_ratio
        Of d_GEL to d_M.
    share_below
        Share of the pairs whose d_GEL is smaller.
    bottleneck_1
        Of dimension 1, from a fine sample of the arena [length].
    same_points_bottleneck_1
        From exact geodesics between the same points [length].
    cover_radius
        No place of the fine sample is further than this from the set [length].
    """

    rms_error: float
    median_ratio: float
    share_below: float
    bottleneck_1: float
    same_points_bottleneck_1: float
    cover_radius: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceRun:
    """One run: agreement between landmarks and between encounters, and the largest distance from a landmark to the next [length]."""

    n_encounters: int
    landmarks: Agreement
    encounters: Agreement
    next_landmark: float


def compute_distances(case: DistanceCase) -> DistanceRun:
    """Simulate a run, and compare its metric with the truth."""
    run = simulate_run(case.run)
    space, fine = measure_space(run), sample_scenario(case.run.place.scenario, n_points=case.n_points)
    stands = run.landmark_positions[space.landmarks]
    return DistanceRun(
        n_encounters=len(run.table),
        landmarks=_compare(
            space.between_landmarks, space.true_between_landmarks, fine.intervals, cover_radius=fine.covering_radius(stands)
        ),
        encounters=_compare(
            space.between_encounters,
            space.true_between_encounters,
            fine.intervals,
            cover_radius=fine.covering_radius(run.positions[space.encounters]),
        ),
        next_landmark=space.next_landmark,
    )


DISTANCES = Study(name="paper-distances", compute=compute_distances, result_type=DistanceRun)


def _compare(found: Floats, true: Floats, intervals: Intervals, *, cover_radius: float) -> Agreement:
    above = np.triu_indices(len(true), 1)
    measured, wanted = found[above], true[above]
    own = diagram_of(found)
    return Agreement(
        rms_error=float(np.sqrt(((measured - wanted) ** 2).sum() / (wanted**2).sum())),
        median_ratio=float(np.median(measured / wanted)),
        share_below=float(np.mean(measured < wanted)),
        bottleneck_1=bottlenecks(intervals, own)[1],
        same_points_bottleneck_1=bottlenecks(diagram_of(true), own)[1],
        cover_radius=cover_radius,
    )
