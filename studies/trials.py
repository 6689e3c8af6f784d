"""Trials: one simulated run in a random arena, mapped, and what came out beside the truth."""

from dataclasses import asdict, dataclass

import numpy as np

from mapper.pipeline import compute_map
from mapper.types import EncounterTable, FloatArray, ModeSpell, Recipe
from simulator.arenas.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.world import World
from studies.arenas import ArenaFamily, draw_arena
from studies.cases import Study
from studies.exploration import explore

# Training takes seeds from 0 on.
HELD_OUT_SEED = 10_000

# Of a recipe: the rule that judges a trial afterwards, and the scale at which it is drawn.
_WITHOUT_EFFECT = {"betti_rules", "epsilon_share", "speed_mps"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A family of runs: which arenas, how many biobots, how they walk. Lengths are those of an arena of side 50, speed is 1 per second."""

    name: str
    family: ArenaFamily
    biobots: int
    landmarks: int
    mean_leg: float
    detection_radius: float
    duration_s: float


_PAPER_SWARM = {"biobots": 150, "landmarks": 20, "detection_radius": 1.0}
_UNITS = {**_PAPER_SWARM, "mean_leg": 10.0, "duration_s": 200.0}
# The arena of 50 cm with every number of a biobot as printed, in centimetres and tenths of a second: speed is 1 again.
_50CM = {**_PAPER_SWARM, "mean_leg": 30.0, "duration_s": 2000.0}

SETTINGS: dict[str, Setting] = {
    setting.name: setting
    for setting in (
        Setting(name="squares/paper-units", family=ArenaFamily.SQUARES, **_UNITS),  # type: ignore[arg-type]  # one dict, two types
        Setting(name="squares/paper-50cm", family=ArenaFamily.SQUARES, **_50CM),  # type: ignore[arg-type]  # same
        Setting(name="small-squares/paper-50cm", family=ArenaFamily.SMALL_SQUARES, **_50CM),  # type: ignore[arg-type]  # same
        # Forty hissers at 4 cm/s for half an hour in 5 m x 5 m, detection radius 25 cm, in units of 10 cm and 2.5 s.
        Setting(
            name="big-square/hisser-field",
            family=ArenaFamily.BIG_SQUARE,
            biobots=40,
            landmarks=10,
            mean_leg=5.0,
            detection_radius=2.5,
            duration_s=720.0,
        ),
        Setting(
            name="shapes/long",
            family=ArenaFamily.SHAPES,
            biobots=150,
            landmarks=20,
            mean_leg=10.0,
            detection_radius=1.0,
            duration_s=600.0,
        ),
    )
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """What one run gave.

    ``counted`` are the Betti numbers by the rules in force when the run was made. ``loops`` and ``merges`` are the finite intervals
    of the largest component, shape (m, 2), in diameters, longest first.
    """

    setting: str
    seed: int
    true_holes: int
    counted: tuple[int, int]
    n_encounters: int
    n_components: int
    merges: FloatArray
    loops: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialCase:
    """A trial to be made."""

    setting: Setting
    seed: int
    recipe: Recipe


def compute_trial(case: TrialCase) -> Trial:
    """Simulate and map one run."""
    return run_trial(case.setting, case.seed, case.recipe)


def _key(case: TrialCase) -> object:
    """Return what the intervals of a trial depend on."""
    recipe = {name: value for name, value in asdict(case.recipe).items() if name not in _WITHOUT_EFFECT}
    return {"setting": case.setting, "seed": case.seed, "recipe": recipe}


# The trained rules are none of its files: training, which makes them, looks at the intervals alone.
TRIALS = Study(name="trials", compute=compute_trial, result_type=Trial, key=_key)


def run_trial(setting: Setting, seed: int, recipe: Recipe) -> Trial:
    """Simulate and map one run."""
    table, spells, true_holes = simulate(setting, seed)
    result = compute_map(table, spells, recipe)
    part = result.components[0]
    merges, loops = (intervals[np.isfinite(intervals[:, 1])] / (part.diameter or 1.0) for intervals in part.intervals)
    return Trial(
        setting=setting.name,
        seed=seed,
        true_holes=true_holes,
        counted=result.betti_numbers,
        n_encounters=result.n_encounters,
        n_components=result.n_components,
        merges=merges,
        loops=loops,
    )


def simulate(setting: Setting, seed: int) -> tuple[EncounterTable, tuple[ModeSpell, ...], int]:
    """Let biobots walk in a random arena; return their encounters, the landmarks' spells and the true number of holes."""
    run = start_run(setting, seed)
    return run.table, run.spells, run.arena.betti.holes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """What a base station would know of a run, the arena, and the world at the end, which knows where everybody was."""

    table: EncounterTable
    spells: tuple[ModeSpell, ...]
    arena: Arena
    world: World


def start_run(setting: Setting, seed: int) -> Run:
    """Let biobots walk in a random arena."""
    arena = build_arena(draw_arena(setting.family, seed=seed))
    world = World(
        arena,
        motion=MotionParameters(speed=1.0, mean_leg=setting.mean_leg),
        ranges=Ranges(detection=setting.detection_radius, communication=8 * setting.detection_radius),
        ids=range(1, setting.biobots + 1),
        seed=seed,
    )
    explored = explore(world, landmarks=setting.landmarks, duration_s=setting.duration_s)
    return Run(table=explored.table, spells=explored.spells, arena=arena, world=world)
