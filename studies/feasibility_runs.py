"""Runs to fit and to check what ``biobot-mapper feasibility`` foretells: one square obstacle or none, in a square arena.

A run is made from a scaled plan: how many biobots and landmarks, and the four lengths that matter as shares of the arena's side. Plans
are drawn at random over wide ranges, so that a law fitted to them is not one of a few presets. Finished runs are kept on disk.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache
from math import exp, log
from pathlib import Path

import numpy as np
from shapely.geometry import box

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import MIN_ENCOUNTERS, compute_map
from mapper.types import EncounterTable, FloatArray, MapResult, ModeSpell, Recipe
from mapper.window import make_encounter_table
from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.events import EncounterEnded
from simulator.motion import MotionParameters
from simulator.world import World
from studies.arenas import place_squares
from studies.scores import winding_number

# Lengths are those of an arena of side 50 and the speed is 1 per second, as in `studies.trials`.
SIDE = 50.0
_DISPERSION_S = 10.0
_COMMUNICATION_PER_DETECTION = 8.0  # as in the presets
# Between the obstacle and every wall, as a share of the side.
PASSAGE = 0.1
# Raise it when simulator or mapper change what a run would give; older results are then not used.
_CACHE_VERSION = 1
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


def run_plans(plans: Iterable[tuple[ScaledPlan, int]], *, folder: Path | None) -> Iterator[Outcome]:
    """Simulate and map one run for each plan and seed; take from the folder what is there, and add to it what is not."""
    for scaled, seed in plans:
        path = None if folder is None else folder / f"{_fingerprint(scaled)}-{seed}.json"
        outcome = _load(path)
        if outcome is None:
            outcome = run_plan(scaled, seed)
            _store(outcome, path)
        yield outcome


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
    table, spells, n_together = _walk(world, landmarks=scaled.landmarks, duration_s=scaled.path * SIDE)
    outcome = Outcome(
        scaled=scaled,
        seed=seed,
        n_encounters=len(table),
        n_together=n_together,
        is_connected=False,
        is_found=False,
        n_false=0,
        stretch=None,
    )
    if len(table) < MIN_ENCOUNTERS:
        return outcome
    result = compute_map(table, spells, _recipe())
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


def _walk(world: World, *, landmarks: int, duration_s: float) -> tuple[EncounterTable, tuple[ModeSpell, ...], int]:
    events = world.advance(_DISPERSION_S)
    chosen = select_landmarks(world.adjacency(), count=landmarks)
    for landmark in chosen:
        world.stop(landmark)
    end_s = _DISPERSION_S + duration_s
    events += world.advance(end_s)
    spans = [(event.t_start_s, event.t_end_s, event.id1, event.id2) for event in events if isinstance(event, EncounterEnded)]
    spans += [(began.t_s, end_s, began.id1, began.id2) for began in world.open_encounters()]
    rows = [(max(begin, _DISPERSION_S), end, first, second) for begin, end, first, second in spans if end > _DISPERSION_S]
    begin, end = (np.rint(np.array([row[k] for row in rows]) * NS_PER_S).astype(np.int64) for k in (0, 1))
    table = make_encounter_table(t_start_ns=begin, t_end_ns=end, id1=[row[2] for row in rows], id2=[row[3] for row in rows])
    zero_ns = round(_DISPERSION_S * NS_PER_S)
    spells = tuple(ModeSpell(node=NodeId(one), t_start_ns=zero_ns, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for one in chosen)
    return table, spells, sum(row[0] == _DISPERSION_S for row in rows)


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
    return make_recipe(RecipeConfig())


def _draw_log(rng: np.random.Generator, span: tuple[float, float]) -> float:
    return exp(rng.uniform(log(span[0]), log(span[1])))


def _fingerprint(scaled: ScaledPlan) -> str:
    recipe = {key: value for key, value in asdict(_recipe()).items() if key not in {"epsilon_share", "speed_mps"}}
    content = json.dumps([_CACHE_VERSION, asdict(scaled), recipe], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def _load(path: Path | None) -> Outcome | None:
    if path is None or not path.exists():
        return None
    content = json.loads(path.read_text())
    return Outcome(**content | {"scaled": ScaledPlan(**content["scaled"])})


def _store(outcome: Outcome, path: Path | None) -> None:
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(asdict(outcome)))
    unfinished.replace(path)
