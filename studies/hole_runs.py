"""Simulated runs around obstacles of several forms, mapped, and each hole of the map beside the obstacle that it goes around."""

from dataclasses import asdict, dataclass
from enum import StrEnum

import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import Point, Polygon, box
from shapely.geometry.base import BaseGeometry

from mapper.hole_shapes import measure_loop
from mapper.hole_sizes import LoopMeasures
from mapper.pipeline import compute_map
from mapper.types import EncounterTable, MapResult, Recipe
from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.world import World
from studies.cases import Study
from studies.errors import NoRoomError
from studies.exploration import Exploration, explore
from studies.scores import winding_number
from studies.truth import Floats

HELD_OUT_SEED = 10_000
"""Training takes seeds from 0 on."""

_SIDE = 50.0
_TRIES = 400
_RESTARTS = 50
_NS_PER_S = 1e9


class ObstacleForm(StrEnum):
    """What stands in the arena."""

    SQUARE = "square"
    BAR = "bar"  # a rectangle, two to four times as long as wide
    DISC = "disc"
    TRIANGLE = "triangle"  # equilateral
    ANGLE = "angle"  # an L of two bars: its hull is larger than it is


@dataclass(frozen=True, slots=True, kw_only=True)
class Swarm:
    """Who walks, and how; obstacles have the square root of their hull's area between ``sizes``, and ``passage`` between them and walls.

    Lengths are those of an arena of side 50; speed is 1 per second.
    """

    name: str
    biobots: int
    landmarks: int
    mean_leg: float
    detection_radius: float
    duration_s: float
    most_obstacles: int
    sizes: tuple[float, float]
    passage: float


_PAPER = {"biobots": 150, "landmarks": 20, "detection_radius": 1.0, "most_obstacles": 3, "sizes": (9.0, 14.0), "passage": 3.0}
SWARMS: dict[str, Swarm] = {
    swarm.name: swarm
    for swarm in (
        Swarm(name="paper-units", mean_leg=10.0, duration_s=200.0, **_PAPER),  # type: ignore[arg-type]  # one dict, several types
        Swarm(name="paper-units, three times as long", mean_leg=10.0, duration_s=600.0, **_PAPER),  # type: ignore[arg-type]  # same
        Swarm(name="paper-50cm", mean_leg=30.0, duration_s=2000.0, **_PAPER),  # type: ignore[arg-type]  # same
        # As `studies.trials` has it: forty hissers at 4 cm/s for half an hour, in units of 10 cm and 2.5 s.
        Swarm(
            name="hisser-field",
            biobots=40,
            landmarks=10,
            mean_leg=5.0,
            detection_radius=2.5,
            duration_s=720.0,
            most_obstacles=1,
            sizes=(16.0, 22.0),
            passage=8.0,
        ),
    )
}


@dataclass(frozen=True, slots=True, kw_only=True)
class HoleCase:
    """A run to be made: the obstacles are all of the form that the seed asks for, 1 to the most the swarm's arena takes."""

    swarm: Swarm
    seed: int
    recipe: Recipe

    @property
    def form(self) -> ObstacleForm:
        """The forms come in turn with ascending seeds."""
        return list(ObstacleForm)[self.seed % len(ObstacleForm)]


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchedHole:
    """A hole that goes around just one obstacle: what the map tells of it, and the area and perimeter of the obstacle and of its hull."""

    loop: LoopMeasures
    obstacle_area: float
    obstacle_perimeter: float
    hull_area: float
    hull_perimeter: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HoleRun:
    """What one run gave: ``unmatched`` holes go around no obstacle or around several."""

    swarm: str
    form: ObstacleForm
    seed: int
    obstacles: int
    unmatched: int
    matched: tuple[MatchedHole, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Walk:
    """A simulated exploration, and where it happened: ``places`` of the encounters, shape (n, 2) [length]."""

    arena: Polygon
    exploration: Exploration
    places: Floats

    @property
    def obstacles(self) -> list[Polygon]:
        """What stands in the arena."""
        return [Polygon(ring) for ring in self.arena.interiors]


def compute_hole_run(case: HoleCase) -> HoleRun:
    """Simulate and map one run, and compare its holes with the obstacles."""
    walk = simulate_walk(case.swarm, case.form, seed=case.seed)
    result = compute_map(walk.exploration.table, walk.exploration.spells, case.recipe)
    pairs = match_holes(result, walk)
    matched = [
        MatchedHole(
            loop=measure_hole(result, hole),
            obstacle_area=float(obstacle.area),
            obstacle_perimeter=float(obstacle.length),
            hull_area=float(obstacle.convex_hull.area),
            hull_perimeter=float(obstacle.convex_hull.length),
        )
        for hole, obstacle in pairs
    ]
    return HoleRun(
        swarm=case.swarm.name,
        form=case.form,
        seed=case.seed,
        obstacles=len(walk.obstacles),
        unmatched=len(result.holes) - len(matched),
        matched=tuple(matched),
    )


def _key(case: HoleCase) -> object:
    return {"swarm": asdict(case.swarm), "seed": case.seed, "recipe": asdict(case.recipe)}


HOLE_RUNS = Study(name="holes beside obstacles", compute=compute_hole_run, result_type=HoleRun, key=_key)


def simulate_walk(swarm: Swarm, form: ObstacleForm, *, seed: int) -> Walk:
    """Let a swarm walk around obstacles of one form."""
    polygon = draw_obstacles(swarm, form, seed=seed)
    world = World(
        build_arena(polygon),
        motion=MotionParameters(speed=1.0, mean_leg=swarm.mean_leg),
        ranges=Ranges(detection=swarm.detection_radius, communication=8 * swarm.detection_radius),
        ids=range(1, swarm.biobots + 1),
        seed=seed,
    )
    exploration = explore(world, landmarks=swarm.landmarks, duration_s=swarm.duration_s)
    table = exploration.table
    times_s = centre_times_s(table)
    places = (world.positions_of(table.id1, times_s) + world.positions_of(table.id2, times_s)) / 2.0
    return Walk(arena=polygon, exploration=exploration, places=places)


def centre_times_s(table: EncounterTable) -> Floats:
    """Return the middle of every encounter [s], shape (n,)."""
    return np.asarray((table.t_start_ns + table.t_end_ns) / (2.0 * _NS_PER_S))


def match_holes(result: MapResult, walk: Walk) -> list[tuple[int, Polygon]]:
    """Pair each hole of a map that goes around just one obstacle with that obstacle: number of the hole, and the obstacle."""
    places = walk.places[result.points.encounter]
    pairs = []
    for number, hole in enumerate(result.holes):
        inner = [obstacle.representative_point() for obstacle in walk.obstacles]
        around = [winding_number(places[hole.outline], np.array([place.x, place.y])) != 0 for place in inner]
        if sum(around) == 1:
            pairs.append((number, walk.obstacles[around.index(True)]))
    return pairs


def measure_hole(result: MapResult, number: int) -> LoopMeasures:
    """Measure a hole of a finished map as the mapper does when it makes one."""
    hole = result.holes[number]
    part = result.components[hole.component]
    rows = np.flatnonzero(result.points.component == hole.component)
    coordinates = np.column_stack([result.points.x, result.points.y])[rows]
    return measure_loop(hole.outline - rows[0], coordinates, part.distances, birth=hole.birth, death=hole.death, n_used=part.n_used)


def draw_obstacles(swarm: Swarm, form: ObstacleForm, *, seed: int) -> Polygon:
    """Put obstacles of one form at random into a square of side 50, with room to pass on every side of each.

    Raises
    ------
    NoRoomError
        They do not fit, however they are placed.
    """
    rng = np.random.default_rng([list(ObstacleForm).index(form), list(SWARMS).index(swarm.name), seed])
    wanted = 1 + seed // len(ObstacleForm) % swarm.most_obstacles
    square = box(0.0, 0.0, _SIDE, _SIDE)
    room = square.buffer(-swarm.passage)
    for _ in range(_RESTARTS):
        obstacles: list[Polygon] = []
        for _ in range(_TRIES):
            obstacle = _draw_form(form, rng, size=float(rng.uniform(*swarm.sizes)))
            obstacle = affinity.translate(obstacle, *rng.uniform(0.0, _SIDE, 2))
            if room.contains(obstacle) and all(obstacle.distance(other) >= swarm.passage for other in obstacles):
                obstacles.append(obstacle)
            if len(obstacles) == wanted:
                return Polygon(square.exterior, [obstacle.exterior for obstacle in obstacles])
    raise NoRoomError(n_holes=wanted, sides=swarm.sizes, area=float(square.area))


def _draw_form(form: ObstacleForm, rng: np.random.Generator, *, size: float) -> Polygon:
    """Make a form about the origin, turned at random, whose hull has the area ``size`` squared."""
    plain: BaseGeometry
    match form:
        case ObstacleForm.SQUARE:
            plain = box(-1.0, -1.0, 1.0, 1.0)
        case ObstacleForm.BAR:
            plain = box(0.0, 0.0, float(rng.uniform(2.0, 4.0)), 1.0)
        case ObstacleForm.DISC:
            plain = Point(0.0, 0.0).buffer(1.0)
        case ObstacleForm.TRIANGLE:
            plain = Polygon([(0.0, 0.0), (2.0, 0.0), (1.0, np.sqrt(3.0))])
        case ObstacleForm.ANGLE:
            plain = shapely.union(box(0.0, 0.0, 3.0, 1.0), box(0.0, 0.0, 1.0, 3.0))
    factor = size / float(np.sqrt(plain.convex_hull.area))
    scaled = affinity.scale(plain, factor, factor, origin=(0.0, 0.0))
    turned = affinity.rotate(scaled, float(rng.uniform(0.0, 360.0)), origin=scaled.centroid)
    return Polygon(shapely.get_coordinates(affinity.translate(turned, -turned.centroid.x, -turned.centroid.y)))
