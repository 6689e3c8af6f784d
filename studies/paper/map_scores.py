"""Maps of one run by both methods, and how they compare with the truth. Lengths are those of the run, and nothing is fitted."""

from dataclasses import dataclass

import numpy as np

from mapper.config import RecipeConfig, make_recipe
from mapper.embedding import embed_in_plane
from mapper.pipeline import compute_map
from mapper.types import MapResult, Method, Recipe
from studies.cases import Study
from studies.comparison import fit_similarity
from studies.paper.classification import PUBLISHED, PUBLISHED_IN_SCENARIOS, count_holes
from studies.paper.encounter_space import bottlenecks
from studies.paper.swarm_runs import SIDE, RunCase, SwarmRun, simulate_run
from studies.truth import Floats, Intervals, diagram_of


@dataclass(frozen=True, slots=True, kw_only=True)
class MapScore:
    """How the map of one method compares with the truth.

    Parameters
    ----------
    betti
        Components and holes of the map.
    bottleneck
        In dimensions 0 and 1, of all components together [length].
    diameter
        Largest true distance between two points of the subsample [length].
    published_holes
        Holes by theta as published, with lengths in units of the arena of side 50, and the same with the threshold of the scenarios.
    picture_error, exact_picture_error
        Root mean square distance between points of the picture and of the truth after a similarity fit of the largest component, and the
        same for classical MDS of exact geodesics [share of the side].
    """

    betti: tuple[int, int]
    bottleneck: tuple[float, float]
    diameter: float
    published_holes: tuple[int, int]
    picture_error: float
    exact_picture_error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioScore:
    """One run, mapped by the paper's method and by the default one."""

    n_encounters: int
    paper: MapScore
    default: MapScore


def compute_scores(case: RunCase) -> ScenarioScore:
    """Simulate a run, map it by both methods, and compare with the truth."""
    run = simulate_run(case)
    return ScenarioScore(n_encounters=len(run.table), paper=_score(run, Method.PAPER), default=_score(run, Method.DEFAULT))


SCORES = Study(name="paper-scenarios", compute=compute_scores, result_type=ScenarioScore)


def recipe_of(method: Method, *, speed: float) -> Recipe:
    """Return a method's recipe whose lengths are those of the run."""
    return make_recipe(RecipeConfig(method=method, speed_mps=speed))


def make_map(run: SwarmRun, method: Method) -> MapResult:
    """Map a run; lengths are those of the run."""
    return compute_map(run.table, run.spells, recipe_of(method, speed=run.speed))


def intervals_of(result: MapResult) -> Intervals:
    """Return the intervals of all components together."""
    zero, one = (np.concatenate([part.intervals[dimension] for part in result.components]) for dimension in (0, 1))
    return zero, one


def _score(run: SwarmRun, method: Method) -> MapScore:
    result = make_map(run, method)
    places = run.positions[result.points.encounter]
    exact = run.true_distances(result.points.encounter)
    loops = intervals_of(result)[1]
    largest = result.points.component == 0
    picture = np.column_stack([result.points.x, result.points.y])[largest]
    return MapScore(
        betti=result.betti_numbers,
        bottleneck=bottlenecks(diagram_of(exact), intervals_of(result)),
        diameter=float(exact.max()),
        published_holes=(count_holes(loops, PUBLISHED), count_holes(loops, PUBLISHED_IN_SCENARIOS)),
        picture_error=_picture_error(picture, places[largest]),
        exact_picture_error=_picture_error(embed_in_plane(exact[np.ix_(largest, largest)]).coordinates, places[largest]),
    )


def _picture_error(picture: Floats, places: Floats) -> float:
    miss = fit_similarity(picture, places)(picture) - places
    return float(np.sqrt((miss**2).sum(axis=1).mean())) / SIDE
