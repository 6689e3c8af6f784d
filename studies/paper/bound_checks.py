"""One run held against Theorem 3 and Corollary 1 of [Dir16], as published and as corrected (``studies.paper.theorems``)."""

from dataclasses import dataclass

import numpy as np

from studies.cases import Study
from studies.paper import theorems
from studies.paper.encounter_space import EncounterSpace, bottlenecks, measure_space, sample_scenario
from studies.paper.swarm_runs import RunCase, SwarmRun, simulate_run
from studies.truth import diagram_of

ROUNDING = 1e-9
"""Of a length: two ways to the same one may differ by so much."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundsCase:
    """A run, and how many points stand for the arena."""

    run: RunCase
    n_points: int


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundsRun:
    """What was measured in one run, and the bounds on it. Lengths are those of an arena of side 50.

    Parameters
    ----------
    lambda_max, lambda_median, lambda_min
        Of all pairs of landmarks.
    theorem_2_below
        Share of the pairs of landmarks whose d_GEL is less than d_M, which Theorem 2 rules out.
    next_landmark, landmark_cover, encounter_cover
        The largest distance from a landmark to the next one; covering radii of landmarks and of the subsample.
    bottleneck_l_0, bottleneck_l_1, bottleneck_e_0, bottleneck_e_1
        d_B(PD(M), PD(L)) and d_B(PD(M), PD(E)) in dimensions 0 and 1.
    published_l, published_e
        Theorem 3 as published.
    corrected_l, corrected_e
        With the metric's error growing with the diameter, delta_l twice the covering radius, and sampling counted twice.
    stable_l, stable_e
        With the metric's error as measured: stability of persistence alone.
    corollary_below
        Share of the pairs of the subsample whose d_GEL is less than d_M.
    corollary_published, corollary_corrected, corollary_by_landmarks
        Share of the pairs above Corollary 1: as published, with delta_l twice the covering radius, and by the way over the landmarks.
    """

    n_encounters: int
    lambda_max: float
    lambda_median: float
    lambda_min: float
    theorem_2_below: float
    next_landmark: float
    landmark_cover: float
    encounter_cover: float
    bottleneck_l_0: float
    bottleneck_l_1: float
    bottleneck_e_0: float
    bottleneck_e_1: float
    published_l: float
    published_e: float
    corrected_l: float
    corrected_e: float
    stable_l: float
    stable_e: float
    corollary_below: float
    corollary_published: float
    corollary_corrected: float
    corollary_by_landmarks: float


def compute_bounds(case: BoundsCase) -> BoundsRun:
    """Simulate a run, and hold it against the bounds."""
    run = simulate_run(case.run)
    return hold_against_bounds(run, measure_space(run), scenario=case.run.place.scenario, n_points=case.n_points)


BOUNDS = Study(name="paper-bounds", compute=compute_bounds, result_type=BoundsRun)


def hold_against_bounds(run: SwarmRun, space: EncounterSpace, *, scenario: str, n_points: int) -> BoundsRun:
    """Measure bottleneck distances and shares of pairs, and compute their bounds; ``n_points`` of a fine sample stand for the arena."""
    fine = sample_scenario(scenario, n_points=n_points)
    stands, places = run.landmark_positions[space.landmarks], run.positions[space.encounters]
    inflation, largest = space.inflation, float(space.inflation.max())
    delta_l, cover = 2.0 * fine.covering_radius(stands), fine.covering_radius(places)
    apart_l, apart_e = fine.hausdorff(stands), fine.hausdorff(places)
    diameter_l, diameter_e = float(space.true_between_landmarks.max()), float(space.true_between_encounters.max())
    bottleneck_l = bottlenecks(fine.intervals, diagram_of(space.between_landmarks))
    bottleneck_e = bottlenecks(fine.intervals, diagram_of(space.between_encounters))
    error_l = float(np.abs(space.between_landmarks - space.true_between_landmarks).max())
    error_e = float(np.abs(space.between_encounters - space.true_between_encounters).max())
    above = np.triu_indices(len(space.encounters), 1)
    found, true, slack = space.between_encounters[above], space.true_between_encounters[above], ROUNDING * diameter_e
    published = theorems.corollary_1(true, inflation=largest, delta_l=space.next_landmark)
    corrected = theorems.corollary_1(true, inflation=largest, delta_l=delta_l)
    by_landmarks = theorems.corollary_1_by_landmarks(true, inflation=largest, delta_l=delta_l, wait=space.wait)
    return BoundsRun(
        n_encounters=len(run.table),
        lambda_max=largest,
        lambda_median=float(np.median(inflation)),
        lambda_min=float(inflation.min()),
        theorem_2_below=float(np.mean(inflation < -ROUNDING)),
        next_landmark=space.next_landmark,
        landmark_cover=delta_l / 2.0,
        encounter_cover=cover,
        bottleneck_l_0=bottleneck_l[0],
        bottleneck_l_1=bottleneck_l[1],
        bottleneck_e_0=bottleneck_e[0],
        bottleneck_e_1=bottleneck_e[1],
        published_l=theorems.theorem_3_landmarks(inflation=largest, delta_l=space.next_landmark),
        published_e=theorems.theorem_3_encounters(inflation=largest, delta_l=space.next_landmark, delta_e=cover),
        corrected_l=theorems.stability(metric_error=float(np.abs(inflation).max()) * diameter_l, hausdorff=apart_l),
        corrected_e=theorems.stability(
            metric_error=theorems.encounters_metric_error(inflation=largest, delta_l=delta_l, diameter=diameter_e), hausdorff=apart_e
        ),
        stable_l=theorems.stability(metric_error=error_l, hausdorff=apart_l),
        stable_e=theorems.stability(metric_error=error_e, hausdorff=apart_e),
        corollary_below=float(np.mean(found < true - slack)),
        corollary_published=float(np.mean(found > published + slack)),
        corollary_corrected=float(np.mean(found > corrected + slack)),
        corollary_by_landmarks=float(np.mean(found > by_landmarks + slack)),
    )
