"""Runs to fit and to check what ``biobot-mapper feasibility`` foretells: one square obstacle or none, in a square arena.

A run is made from a scaled plan: how many biobots and landmarks, and the four lengths that matter as shares of the arena's side. Plans
are drawn at random over wide ranges, so that a law fitted to them is not one of a few presets.
"""

from dataclasses import dataclass, replace
from functools import cache
from math import exp, log

import numpy as np
from shapely.geometry import box

from firmware_protocol.units import NS_PER_S
from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import MIN_ENCOUNTERS, compute_map
from mapper.types import FloatArray, MapResult, Recipe
from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.world import World
from studies.arenas import place_squares
from studies.cases import PackageFile, Study
from studies.exploration import explore
from studies.scores import winding_number

# Lengths are those of an arena of side 50 and the speed is 1 per second, as in `studies.trials`.
SIDE = 50.0
_COMMUNICATION_PER_DETECTION = 8.0  # as in the presets
# Between the obstacle and every wall, as a share of the side.
PASSAGE = 0.1
_EMPTY_SHARE = 0.2
_FAR = 0.25  # pairs further apart than this share of the side tell the map's scale

BIOBOTS = (8, 300)
LANDMARK_SHARE = (0.05, 0.5)
DETECTION = (0.008, 0.1)
LEG = (0.02, 1.0)
PATH = (2.0, 100.0)
OBSTACLE = (0.06, 0.7)
# Fewer encounters make no map, and more take too long to simulate by the thousand runs.
_ENCOUNTERS = (20.0, 25_000.0)
_MAX_LEGS = 60_000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaledPlan:
    """What a run is made from; lengths are shares of the arena's side.

    Parameters
    ----------
    biobots, landmarks
        How many there are, landmarks included; and how many of them stand still.
    detection, leg
        Detection radius r_d and mean leg l*.
    path
        What each biobot walks in the time that counts: v T over the side.
    obstacle
        Side of the square obstacle; 0 for an empty arena.
    """

    biobots: int
    landmarks: int
    detection: float
    leg: float
    path: float
    obstacle: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one run gave.

    Parameters
    ----------
    n_encounters
        All that count, and ``n_together`` of them already under way when the time that counts began.
    is_connected
        Every biobot has met another, and the encounter graph is in one piece.
    is_found
        A hole of the map goes around the obstacle, judged by the true places of its encounters. False in an empty arena.
    n_false
        Holes of the map that do not.
    stretch
        Median of the map's distance, in lengths walked, over the true one, of far pairs of points; None with an obstacle or without a map.
    """

    scaled: ScaledPlan
    seed: int
    n_encounters: int
    n_together: int
    is_connected: bool
    is_found: bool
    n_false: int
    stretch: float | None


def draw_plan(seed: int) -> ScaledPlan:
    """Draw a plan over the ranges above, uniform in the logarithm of every number but the landmarks' share; one in five is empty."""
    rng = np.random.default_rng([6, seed])
    while True:
        biobots = round(_draw_log(rng, BIOBOTS))
        landmarks = max(2, round(biobots * rng.uniform(*LANDMARK_SHARE)))
        detection, leg, path, obstacle = (_draw_log(rng, span) for span in (DETECTION, LEG, PATH, OBSTACLE))
        movers = biobots - landmarks
        # The kinetic gas, as in mapper.feasibility, without its corrections.
        expected = path * detection * (4.0 * movers * (movers - 1) / np.pi + 2.0 * movers * landmarks)
        if _ENCOUNTERS[0] <= expected <= _ENCOUNTERS[1] and movers * path * (1.0 / leg + 1.0) <= _MAX_LEGS:
            is_empty = rng.random() < _EMPTY_SHARE
            return ScaledPlan(
                biobots=biobots, landmarks=landmarks, detection=detection, leg=leg, path=path, obstacle=0.0 if is_empty else obstacle
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanCase:
    """A run to be made of a plan."""

    scaled: ScaledPlan
    seed: int


def compute_plan(case: PlanCase) -> Outcome:
    """Simulate one run and map it by the default method."""
    return run_plan(case.scaled, case.seed)


def run_plan(scaled: ScaledPlan, seed: int) -> Outcome:
    """Simulate one run and map it by the default method."""
    rng = np.random.default_rng([7, seed])
    square = box(0.0, 0.0, SIDE, SIDE)
    side = scaled.obstacle * SIDE
    polygon = place_squares(square, rng, n_holes=int(side > 0), sides=(side, side), passage=PASSAGE * SIDE)
    world = World(
        build_arena(polygon),
        motion=MotionParameters(speed=1.0, mean_leg=scaled.leg * SIDE),
        ranges=Ranges(detection=scaled.detection * SIDE, communication=_COMMUNICATION_PER_DETECTION * scaled.detection * SIDE),
        ids=range(1, scaled.biobots + 1),
        seed=seed,
    )
    explored = explore(world, landmarks=scaled.landmarks, duration_s=scaled.path * SIDE)
    table = explored.table
    outcome = Outcome(
        scaled=scaled,
        seed=seed,
        n_encounters=len(table),
        n_together=explored.n_together,
        is_connected=False,
        is_found=False,
        n_false=0,
        stretch=None,
    )
    if len(table) < MIN_ENCOUNTERS:
        return outcome
    result = compute_map(table, explored.spells, _recipe())
    n_met = np.unique(np.concatenate([table.id1, table.id2])).size
    places = _places(world, result)
    centre = np.array(polygon.interiors[0].centroid.coords[0]) if polygon.interiors else None
    enclosing = [centre is not None and winding_number(places[hole.outline], centre) != 0 for hole in result.holes]
    return replace(
        outcome,
        is_connected=result.n_components == 1 and n_met == scaled.biobots,
        is_found=any(enclosing),
        n_false=len(enclosing) - any(enclosing),
        stretch=_stretch(result, places) if centre is None else None,
    )


def _places(world: World, result: MapResult) -> FloatArray:
    """Say where the encounters of the map's points were: the middle between the two biobots, shape (p, 2)."""
    t_s = np.minimum(result.points.t_ns / NS_PER_S, world.now_s)
    first, second = (world.positions_of(ids.tolist(), t_s) for ids in (result.points.id1, result.points.id2))
    return (first + second) / 2.0


def _stretch(result: MapResult, places: FloatArray) -> float | None:
    part = result.components[0]
    own = places[result.points.component == 0]
    true = np.sqrt(((own[:, None] - own[None]) ** 2).sum(axis=2))
    far = true > _FAR * SIDE
    return float(np.median(part.distances[far] / true[far])) if far.any() else None


@cache
def _recipe() -> Recipe:
    return make_recipe(RecipeConfig(replicates=0))


def _draw_log(rng: np.random.Generator, span: tuple[float, float]) -> float:
    return exp(rng.uniform(log(span[0]), log(span[1])))


PLANS = Study(
    name="feasibility", compute=compute_plan, result_type=Outcome, files=(PackageFile(package="mapper", path="data/classifier.json"),)
)
