"""How right routes around obstacles are, on simulated runs: ``python -m studies.routes``.

In each run routes are asked for between some pairs of points of the map. The length of the shortest is held against the exact geodesic
between where those encounters truly were. Of each two routes of different kinds, one way there and the other back, it is seen in the
true places of their corners around which obstacles they go: those that the map says, or not. ``--train`` fits how wrong lengths are, on
seeds that the table does not use.
"""

import argparse
import statistics
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import minimize
from shapely.geometry import Polygon

from mapper.config import RecipeConfig, make_recipe
from mapper.errors import MapError
from mapper.map_sketch import MapSketch, sketch_map
from mapper.pipeline import compute_map
from mapper.places import PointPlace, find_place
from mapper.routes import Route, RouteErrors, find_routes
from mapper.types import Recipe
from simulator.arenas.arena import build_arena
from simulator.arenas.geodesics import geodesic_distances
from studies.cases import Study, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.hole_runs import HELD_OUT_SEED, SWARMS, ObstacleForm, Swarm, match_holes, simulate_walk
from studies.scores import winding_number
from studies.truth import Floats

DEFAULT_RUNS = {"paper-units": 40, "paper-units, three times as long": 30, "paper-50cm": 20, "hisser-field": 60}
_PAIRS = 6
_CLASSES = 4
_LEAST_VARIANCE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class RouteCase:
    """A run to be made, around obstacles of the form that the seed asks for."""

    swarm: Swarm
    seed: int
    recipe: Recipe


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedRoute:
    """Routes between two points: length of the shortest, what it is in truth, and the cover radius of the map.

    Of ``n_pairs`` pairs of routes so many, ``n_right``, go around just those matched obstacles in truth that the map says.
    """

    length: float
    true_length: float
    cover_radius: float
    n_routes: int
    n_pairs: int
    n_right: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutesRun:
    """What one run gave; ``refused`` pairs of points had no route on the map."""

    swarm: str
    seed: int
    refused: int
    asked: tuple[AskedRoute, ...]


def compute_routes_run(case: RouteCase) -> RoutesRun:
    """Simulate and map a run, and ask for routes."""
    form = list(ObstacleForm)[case.seed % len(ObstacleForm)]
    walk = simulate_walk(case.swarm, form, seed=case.seed)
    result = compute_map(walk.exploration.table, walk.exploration.spells, case.recipe)
    sketch = sketch_map(result)
    places = walk.places[result.points.encounter]
    middles = {number + 1: _middle(obstacle) for number, obstacle in match_holes(result, walk)}
    rng = np.random.default_rng(case.seed)
    own = np.flatnonzero(sketch.component == 0)
    arena = build_arena(walk.arena)
    asked, refused = [], 0
    for _ in range(_PAIRS):
        begin, end = (int(index) for index in rng.choice(own, 2, replace=False))
        ends = (find_place(PointPlace(index=index), sketch) for index in (begin, end))
        try:
            routes = find_routes(sketch, *ends, classes=_CLASSES).routes
        except MapError:
            refused += 1
            continue
        corners = [_true_corners(route, sketch, places) for route in routes]
        checks = [_goes_around_the_same(one, other, middles) for one, other in combinations(zip(routes, corners, strict=True), 2)]
        asked.append(
            AskedRoute(
                length=routes[0].length,
                true_length=float(geodesic_distances(arena, places[[begin, end]])[0, 1]),
                cover_radius=sketch.cover_radii[0],
                n_routes=len(routes),
                n_pairs=len(checks),
                n_right=sum(checks),
            )
        )
    return RoutesRun(swarm=case.swarm.name, seed=case.seed, refused=refused, asked=tuple(asked))


ROUTES_RUNS = Study(name="routes beside geodesics", compute=compute_routes_run, result_type=RoutesRun)


def _middle(obstacle: Polygon) -> tuple[float, float]:
    place = obstacle.representative_point()
    return float(place.x), float(place.y)


def _true_corners(route: Route, sketch: MapSketch, places: Floats) -> Floats:
    """Return where the corners of a route between points truly were, shape (n, 2)."""
    number = {tuple(place): index for index, place in enumerate(sketch.xy.tolist())}
    return places[[number[tuple(corner)] for corner in route.xy.tolist()]]


def _goes_around_the_same(one: tuple[Route, Floats], other: tuple[Route, Floats], middles: dict[int, tuple[float, float]]) -> bool:
    """Say whether the way by one route and back by the other goes around just those obstacles in truth that it does on the map."""
    (first, there), (second, back) = one, other
    loop = np.concatenate([there, back[-2:0:-1]])
    turned = {number: round(turns - dict(second.passes)[number]) != 0 for number, turns in first.passes}
    return all((winding_number(loop, np.array(middle)) != 0) is turned[number] for number, middle in middles.items() if number in turned)


def fit_errors(asked: Sequence[AskedRoute]) -> RouteErrors:
    """Fit how wrong lengths are, by maximum likelihood of a normal distribution of the difference to the truth."""
    length, true, radius = np.array([(one.length, one.true_length, one.cover_radius) for one in asked]).T
    sources = np.column_stack([length**2, radius**2])

    def cost(weight: Floats) -> float:
        variance = sources @ weight + _LEAST_VARIANCE
        return float((np.log(variance) + (length - true) ** 2 / variance).sum())

    share, per_cover = np.sqrt(minimize(cost, x0=np.array([0.02, 1.0]), bounds=[(0.0, 1.0), (0.0, 100.0)], method="L-BFGS-B").x).tolist()
    return RouteErrors(share=float(f"{share:.3g}"), per_cover=float(f"{per_cover:.3g}"))


def describe(asked: Sequence[AskedRoute], *, name: str, refused: int) -> str:
    """Make the line of one swarm."""
    ratio = [one.length / one.true_length for one in asked]
    errors = RouteErrors()
    told = [np.hypot(errors.share * one.length, errors.per_cover * one.cover_radius) for one in asked]
    off = np.array([abs(one.length - one.true_length) for one in asked]) / np.array(told)
    rms = float(np.sqrt(np.mean([(one.length - one.true_length) ** 2 for one in asked]) / np.mean([one.true_length**2 for one in asked])))
    n_pairs = sum(one.n_pairs for one in asked)
    right = sum(one.n_right for one in asked) / n_pairs if n_pairs else float("nan")
    kinds = statistics.fmean(one.n_routes for one in asked)
    within = [float((off <= errors_apart).mean()) for errors_apart in (1, 2)]
    return (
        f"{name:34}{len(asked):5d}{refused:8d}{statistics.median(ratio) - 1.0:+8.1%}{rms:7.1%}{within[0]:7.0%}{within[1]:6.0%}"
        f"{kinds:7.1f}{n_pairs:7d}{right:8.1%}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, or what is fitted; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.routes", description=__doc__)
    parser.add_argument("--swarm", choices=list(SWARMS), action="append", help="may be repeated (default: all)")
    parser.add_argument("--runs", type=int, help="runs of each swarm (default: 20 to 60)")
    parser.add_argument("--train", action="store_true", help="fit how wrong lengths are, on seeds from 0 on")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs is not None and options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    recipe = make_recipe(RecipeConfig())
    first = 0 if options.train else HELD_OUT_SEED
    runs = {name: options.runs or DEFAULT_RUNS[name] for name in options.swarm or DEFAULT_RUNS}
    cases = [RouteCase(swarm=SWARMS[name], seed=seed, recipe=recipe) for name, n in runs.items() for seed in range(first, first + n)]
    try:
        found = results_of(run_cases(ROUTES_RUNS, cases, read_flags(options, journal=None), label="routes"))
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.train:
        print(asdict(fit_errors([one for run in found for one in run.asked])))
        return 0
    print(f"seeds from {first}; lengths of the shortest routes, and kinds of routes")
    print(f"{'swarm':34}{'asked':>5}{'refused':>8}{'bias':>8}{'rms':>7}{'1 err':>7}{'2 err':>6}{'kinds':>7}{'pairs':>7}{'right':>8}")
    for name in runs:
        own = [run for run in found if run.swarm == name]
        print(describe([one for run in own for one in run.asked], name=name, refused=sum(run.refused for run in own)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
