"""Trials: one simulated run in a random arena, mapped, and what came out beside the truth."""

from dataclasses import asdict, dataclass, replace

import numpy as np
from shapely import affinity

from mapper.pipeline import compute_map
from mapper.types import EncounterTable, FloatArray, ModeSpell, Recipe
from simulator.arenas.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.presets import PRESETS
from simulator.radios.paths import Paths
from simulator.radios.radio import RADIO_PRESETS
from simulator.radios.sensing import SensingConfig, sense
from simulator.world import World
from studies.arenas import ArenaFamily, draw_arena
from studies.cases import Study
from studies.exploration import DISPERSION_S, explore, tabulate

# Training takes seeds from 0 on.
HELD_OUT_SEED = 10_000

# Of a recipe: the rule that judges a trial afterwards, and the scale at which it is drawn.
_WITHOUT_EFFECT = {"betti_rules", "epsilon_share", "speed_mps", "replicates"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A family of runs: which arenas, how many biobots, how they walk and how they are heard.

    Lengths are those of an arena of side 50, speed is 1 per second; ``metres`` and ``seconds`` are what one unit of each is in the
    run, whose numbers are metres and seconds then. ``dead_landmarks``: so many fall silent half-way. ``stops``: insects stop by
    themselves, as those of the preset ``hisser-field`` do. ``radio``: a radio preset by whose beacons, one a second, encounters are
    sensed; None: they are exact.
    """

    name: str
    family: ArenaFamily
    biobots: int
    landmarks: int
    mean_leg: float
    detection_radius: float
    duration_s: float
    metres: float = 1.0
    seconds: float = 1.0
    dead_landmarks: int = 0
    stops: bool = False
    radio: str | None = None


_PAPER = Setting(
    name="squares/paper-units", family=ArenaFamily.SQUARES, biobots=150, landmarks=20, mean_leg=10.0, detection_radius=1.0, duration_s=200.0
)
# The arena of 50 cm with every number of a biobot as printed, in centimetres and tenths of a second: speed is 1 again.
_50CM = replace(_PAPER, name="squares/paper-50cm", mean_leg=30.0, duration_s=2000.0)
# Forty hissers at 4 cm/s for half an hour in 5 m x 5 m, detection radius 25 cm, in units of 10 cm and 2.5 s.
_HISSERS = Setting(
    name="big-square/hisser-field",
    family=ArenaFamily.BIG_SQUARE,
    biobots=40,
    landmarks=10,
    mean_leg=5.0,
    detection_radius=2.5,
    duration_s=720.0,
)
_HISSERS_SI = replace(_HISSERS, metres=0.1, seconds=2.5)
# Two beacons open an encounter, and one lost does not end it: "steady" of studies.sensing.
_STEADY_BEACONS, _STEADY_GAP = 2, 2.3

SETTINGS: dict[str, Setting] = {
    setting.name: setting
    for setting in (
        _PAPER,
        _50CM,
        replace(_50CM, name="small-squares/paper-50cm", family=ArenaFamily.SMALL_SQUARES),
        _HISSERS,
        replace(_HISSERS_SI, name="big-square/hisser-stops", stops=True),
        replace(_HISSERS_SI, name="big-square/hisser-lossy", radio="indoor"),
        replace(_HISSERS_SI, name="big-square/hisser-lossy-stops", radio="indoor", stops=True),
        replace(_PAPER, name="shapes/long", family=ArenaFamily.SHAPES, duration_s=600.0),
        replace(_PAPER, name="obstacles/long", family=ArenaFamily.OBSTACLES, duration_s=600.0),
        replace(_PAPER, name="squares/short", duration_s=120.0),
        replace(_PAPER, name="squares/dead-landmarks", dead_landmarks=10),
        replace(_PAPER, name="squares/few", biobots=40, landmarks=10, duration_s=1000.0),
        replace(_PAPER, name="squares/crowd", biobots=500, landmarks=50, duration_s=100.0),
    )
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """What one run gave.

    ``counted`` are the Betti numbers by the rules in force when the run was made. ``loops`` and ``merges`` are the finite intervals
    of the largest component, shape (m, 2), in diameters, longest first; ``n_used`` of its encounters are no outliers.
    """

    setting: str
    seed: int
    true_holes: int
    counted: tuple[int, int]
    n_encounters: int
    n_used: int
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
        n_used=part.n_used,
        n_components=result.n_components,
        merges=merges,
        loops=loops,
    )


def simulate(setting: Setting, seed: int) -> tuple[EncounterTable, tuple[ModeSpell, ...], int]:
    """Let biobots walk in a random arena; return their encounters, the spells of standing, and the true number of holes."""
    run = make_run(setting, seed)
    return run.table, run.spells, run.arena.betti.holes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """What a base station would know of a run, the arena, and the world at the end, which knows where everybody was."""

    table: EncounterTable
    spells: tuple[ModeSpell, ...]
    arena: Arena
    world: World


def make_world(setting: Setting, seed: int) -> World:
    """Put the biobots of a setting into a random arena; time is 0."""
    drawn = draw_arena(setting.family, seed=seed)
    metres, seconds = setting.metres, setting.seconds
    arena = build_arena(drawn if metres == 1 else affinity.scale(drawn, metres, metres, origin=(0, 0)))
    detection = setting.detection_radius * metres
    motion = MotionParameters(speed=metres / seconds, mean_leg=setting.mean_leg * metres)
    if setting.stops:
        own = PRESETS["hisser-field"].motion
        motion = replace(
            motion,
            stop_hazard=own.stop_hazard,
            short_rest_s=own.short_rest_s,
            long_rest_s=own.long_rest_s,
            long_rest_share=own.long_rest_share,
        )
    return World(
        arena,
        motion=motion,
        ranges=Ranges(detection=detection, communication=8 * detection),
        ids=range(1, setting.biobots + 1),
        seed=seed,
    )


def make_run(setting: Setting, seed: int) -> Run:
    """Let biobots walk in a random arena."""
    seconds, detection = setting.seconds, setting.detection_radius * setting.metres
    world = make_world(setting, seed)
    explored = explore(
        world,
        landmarks=setting.landmarks,
        duration_s=setting.duration_s * seconds,
        dispersion_s=DISPERSION_S * seconds,
        n_silenced=setting.dead_landmarks,
    )
    table = explored.table
    if setting.radio is not None:
        config = SensingConfig(
            seed=seed,
            detection=detection,
            communication=8 * detection,
            min_beacons=_STEADY_BEACONS,
            gap_periods=_STEADY_GAP,
            radio=RADIO_PRESETS[setting.radio].config,
        )
        sensed = sense(Paths(world.legs(), n=len(world.ids)), ids=world.ids, arena=world.arena, until_s=world.now_s, config=config)
        table = tabulate(sensed.encounters, from_s=DISPERSION_S * seconds)
    return Run(table=table, spells=explored.spells, arena=world.arena, world=world)
