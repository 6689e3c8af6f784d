"""Runs to train and to check how sure a map says it is: of every setting of `studies.trials`, as it is and changed.

Half of the runs are as the setting has it. In a third the mission is shorter or longer, and there are fewer biobots and more or fewer
landmarks. The others are starved: of time, of biobots and of landmarks, down to none of these, so that there are runs of a handful of
encounters, and of many parts.
"""

from dataclasses import dataclass, replace
from math import exp
from typing import Final

import numpy as np
import shapely

from firmware_protocol.units import NS_PER_S
from mapper.bottleneck import bottleneck_distance
from mapper.confidence import Evidence
from mapper.confidence.assess import replica_counts
from mapper.confidence.evidence import reach_of
from mapper.outlines import outline_holes
from mapper.persistence import rips_persistence
from mapper.pipeline import MIN_ENCOUNTERS, compute_evidence
from mapper.types import BoolArray, FloatArray, MapResult, Recipe
from simulator.arenas.arena import Arena
from simulator.arenas.geodesics import geodesic_distances
from simulator.world import World
from studies.cases import PackageFile, Study
from studies.scores import winding_number
from studies.trials import SETTINGS, Setting, make_run
from studies.truth import diagram_of, obstacle_points

AS_IT_IS: Final = "as it is"
KINDS: Final = (AS_IT_IS, "changed", "starved")
_SHARES = (0.5, 0.33, 0.17)
_LONGEST_S = 2000.0  # of the arena's units: longer ones take too long to simulate by the thousand
_FEWEST = 6
# Of what the setting has, for runs that are changed and for those that are starved.
_TIMES = {"changed": (0.2, 2.0), "starved": (0.01, 0.2)}
_BIOBOTS = {"changed": (0.5, 1.0), "starved": (0.1, 1.0)}
_LANDMARKS = {"changed": (0.5, 2.0), "starved": (0.2, 1.5)}
_NO_LANDMARKS_SHARE = {"changed": 0.0, "starved": 0.1}
_MOST_LANDMARKS = 0.5  # of the biobots
_TRUE_WITHIN = 0.1
"""A point is right when its distances to all others are wrong by no more than this share of the true diameter, root mean square."""

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """A run to be made: ``kind`` is one of `KINDS`."""

    setting: Setting
    kind: str
    seed: int
    recipe: Recipe


@dataclass(frozen=True, slots=True, kw_only=True)
class Witness:
    """What one run gave: what its map is judged by, and the truth.

    Parameters
    ----------
    setting, kind, seed, n_encounters
        Which run.
    counted, replica_counts, true_holes
        Holes of the map, of each of its replicas, and of the arena.
    loops, is_hole
        What describes the longest loops of the largest component, by name, and which of them are there: it goes around an obstacle that no
        longer interval goes around.
    other_loops
        The same description of the loops of the other components mapped, in one; whether those are there is not asked.
    is_called
        Which of ``loops`` the map calls holes.
    run
        What describes the largest component, by name; empty where there are too few encounters for a map.
    move
        Bottleneck distance of its loops to those of exact geodesics between the same places, over the map's reach.
    points, is_right
        What describes its points, by name, and which of them have right distances.
    """

    setting: str
    kind: str
    seed: int
    n_encounters: int
    counted: int
    replica_counts: tuple[int, ...]
    true_holes: int
    loops: dict[str, tuple[float, ...]]
    is_hole: tuple[bool, ...]
    is_called: tuple[bool, ...]
    other_loops: dict[str, tuple[float, ...]]
    run: dict[str, float]
    move: float
    points: dict[str, tuple[float, ...]]
    is_right: tuple[bool, ...]


def draw_mission(seed: int, recipe: Recipe) -> Mission:
    """Draw a run: settings come in turn with ascending seeds; the rest follows from the seed."""
    rng = np.random.default_rng([8, seed])
    setting = SETTINGS[list(SETTINGS)[seed % len(SETTINGS)]]
    kind = KINDS[int(rng.choice(len(KINDS), p=_SHARES))]
    if kind == AS_IT_IS:
        return Mission(setting=setting, kind=kind, seed=seed, recipe=recipe)
    times, swarm, landmarks = (exp(rng.uniform(*np.log(span[kind]))) for span in (_TIMES, _BIOBOTS, _LANDMARKS))
    duration_s = min(setting.duration_s * times, max(_LONGEST_S, setting.duration_s))
    biobots = max(_FEWEST, round(setting.biobots * swarm))
    wanted = 0 if rng.random() < _NO_LANDMARKS_SHARE[kind] else max(1, round(setting.landmarks * biobots / setting.biobots * landmarks))
    changed = replace(setting, duration_s=duration_s, biobots=biobots, landmarks=min(wanted, int(_MOST_LANDMARKS * biobots)))
    return Mission(setting=changed, kind=kind, seed=seed, recipe=recipe)


def compute_witness(mission: Mission) -> Witness:
    """Simulate and map one run, and compare what it shows with the truth."""
    run = make_run(mission.setting, mission.seed)
    arena, table = run.arena, run.table
    witness = Witness(
        setting=mission.setting.name,
        kind=mission.kind,
        seed=mission.seed,
        n_encounters=len(table),
        counted=0,
        replica_counts=(),
        true_holes=arena.betti.holes,
        loops={},
        is_hole=(),
        is_called=(),
        other_loops={},
        run={},
        move=0.0,
        points={},
        is_right=(),
    )
    if len(table) < MIN_ENCOUNTERS:
        return witness
    result, gathered = compute_evidence(table, run.spells, mission.recipe)
    largest = gathered[0]
    places = true_places(result, run.world)
    seconds_per_length = mission.setting.seconds / mission.setting.metres  # that of a map without a speed
    exact = seconds_per_length * geodesic_distances(arena, free_places(arena, places))
    return replace(
        witness,
        counted=result.betti_numbers[1],
        replica_counts=tuple(replica_counts(gathered).tolist()),
        loops=_plain(largest.loop_columns()),
        is_hole=tuple(judge_loops(largest, places, obstacle_points(arena)).tolist()),
        is_called=tuple(_is_called(result, largest).tolist()),
        other_loops=_joined([one.loop_columns() for one in gathered[1:]]),
        run={name: float(value) for name, value in largest.run_columns().items()},
        move=_move(largest, exact),
        points=_plain(largest.point_columns()),
        is_right=tuple(judge_points(largest.part.distances, exact).tolist()),
    )


def judge_loops(evidence: Evidence, places: FloatArray, obstacles: FloatArray) -> BoolArray:
    """Say which of the longest loops are there.

    Parameters
    ----------
    places
        Where the points were in truth, shape (n_points, 2).
    obstacles
        A point in each obstacle that one can walk around, shape (h, 2).

    Notes
    -----
    Each loop is outlined, and the outline drawn through the true places. Longest first, a loop is there if the loops that are there so far
    and it can each have an obstacle of their own that they go around.
    """
    n = evidence.n_judged
    if n == 0:
        return np.zeros(0, dtype=bool)
    outlines = outline_holes(evidence.part.distances, rips_persistence(evidence.part.distances), np.arange(n))
    encloses = [[winding_number(places[outline], obstacle) != 0 for obstacle in obstacles] for outline in outlines]
    owner: dict[int, int] = {}

    def claim(loop: int, asked: set[int]) -> bool:
        for obstacle, is_around in enumerate(encloses[loop]):
            if is_around and obstacle not in asked:
                asked.add(obstacle)
                if obstacle not in owner or claim(owner[obstacle], asked):
                    owner[obstacle] = loop
                    return True
        return False

    return np.array([claim(loop, set()) for loop in range(n)])


def judge_points(distances: FloatArray, exact: FloatArray) -> BoolArray:
    """Say which points have right distances, after one scale for all: the error of all their distances is small, root mean square."""
    is_known = np.isfinite(exact)
    true = np.where(is_known, exact, 0.0)
    found = np.where(is_known, distances, 0.0)
    scale = float((found * true).sum() / ((found**2).sum() or 1.0))
    error = np.sqrt(((scale * found - true) ** 2).sum(axis=1) / is_known.sum(axis=1))
    return np.asarray(error <= _TRUE_WITHIN * true.max(initial=0.0))


def _is_called(result: MapResult, evidence: Evidence) -> BoolArray:
    called = {(hole.birth, hole.death) for hole in result.holes if hole.component == 0}
    return np.array([tuple(one) in called for one in evidence.part.intervals[1][: evidence.n_judged].tolist()], dtype=bool)


def _move(evidence: Evidence, exact: FloatArray) -> float:
    loops = diagram_of(exact)[1]
    return bottleneck_distance(evidence.part.intervals[1], loops) / reach_of(evidence.part)


def true_places(result: MapResult, world: World) -> FloatArray:
    """Say where the points of the largest component were: the middle between the two biobots, shape (n_points, 2)."""
    own = result.points.component == 0
    t_s = np.minimum(result.points.t_ns[own] / NS_PER_S, world.now_s)
    first, second = (world.positions_of(ids[own].tolist(), t_s) for ids in (result.points.id1, result.points.id2))
    return (first + second) / 2.0


def free_places(arena: Arena, places: FloatArray) -> FloatArray:
    """Move places that lie in an obstacle, half-way between two biobots that were heard around its corner, to where it is free."""
    return np.asarray(shapely.get_coordinates(shapely.shortest_line(arena.polygon, shapely.points(places)))[::2])


def _plain(columns: dict[str, FloatArray]) -> dict[str, tuple[float, ...]]:
    return {name: tuple(values.tolist()) for name, values in columns.items()}


def _joined(tables: list[dict[str, FloatArray]]) -> dict[str, tuple[float, ...]]:
    if not tables:
        return {}
    return {name: tuple(np.concatenate([table[name] for table in tables]).tolist()) for name in tables[0]}


WITNESSES = Study(
    name="confidence",
    compute=compute_witness,
    result_type=Witness,
    files=(PackageFile(package="mapper", path="data/classifier.json"),),
)
