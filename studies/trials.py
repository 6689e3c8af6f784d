"""Trials: one simulated run in a random arena, mapped, and what came out beside the truth. Finished trials are kept on disk."""

import hashlib
import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.units import NodeId
from mapper.pipeline import compute_map
from mapper.types import EncounterTable, FloatArray, ModeSpell, Recipe
from mapper.window import make_encounter_table
from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.events import EncounterEnded
from simulator.motion import MotionParameters
from simulator.world import World
from studies.arenas import ArenaFamily, draw_arena

_NS_PER_S = 1_000_000_000
# Raise it when simulator or mapper change what a trial would give; older results are then not used.
_CACHE_VERSION = 1
_BAR_WIDTH = 40


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


def run_trials(setting: Setting, seeds: Iterable[int], recipe: Recipe, *, cache: Path | None) -> Iterator[Trial]:
    """Simulate and map one run for each seed; take from the cache what is there, and add to it what is not.

    Notes
    -----
    A trial is stored when it is done, so a study that was stopped goes on where it was.
    """
    for seed in seeds:
        path = None if cache is None else cache / f"{_fingerprint(setting, recipe)}-{seed}.json"
        trial = _load(path)
        if trial is None:
            trial = run_trial(setting, seed, recipe)
            _store(trial, path)
        yield trial


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


@lru_cache(maxsize=4)  # several recipes are tried on one run
def simulate(setting: Setting, seed: int) -> tuple[EncounterTable, tuple[ModeSpell, ...], int]:
    """Let biobots walk in a random arena; return their encounters, the landmarks' spells and the true number of holes."""
    arena = build_arena(draw_arena(setting.family, seed=seed))
    world = World(
        arena,
        motion=MotionParameters(speed=1.0, mean_leg=setting.mean_leg),
        ranges=Ranges(detection=setting.detection_radius, communication=8 * setting.detection_radius),
        ids=range(1, setting.biobots + 1),
        seed=seed,
    )
    zero_s = 10.0
    events = world.advance(zero_s)
    landmarks = select_landmarks(world.adjacency(), count=setting.landmarks)
    for landmark in landmarks:
        world.stop(landmark)
    end_s = zero_s + setting.duration_s
    events += world.advance(end_s)
    spans = [(event.t_start_s, event.t_end_s, event.id1, event.id2) for event in events if isinstance(event, EncounterEnded)]
    spans += [(began.t_s, end_s, began.id1, began.id2) for began in world.open_encounters()]
    rows = [(max(begin, zero_s), end, first, second) for begin, end, first, second in spans if end > zero_s]
    begin, end = (np.rint(np.array([row[k] for row in rows]) * _NS_PER_S).astype(np.int64) for k in (0, 1))
    table = make_encounter_table(t_start_ns=begin, t_end_ns=end, id1=[row[2] for row in rows], id2=[row[3] for row in rows])
    spells = tuple(
        ModeSpell(node=NodeId(landmark), t_start_ns=round(zero_s * _NS_PER_S), t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND)
        for landmark in landmarks
    )
    return table, spells, arena.betti.holes


def show_progress(trials: Iterable[Trial], *, total: int, label: str) -> Iterator[Trial]:
    """Pass trials on, with a bar on standard error where that is a terminal, and a line at the end elsewhere."""
    is_terminal = sys.stderr.isatty()
    done = 0
    for trial in trials:
        yield trial
        done += 1
        if is_terminal:
            filled = _BAR_WIDTH * done // total
            sys.stderr.write(f"\r[{'#' * filled}{' ' * (_BAR_WIDTH - filled)}] {done}/{total}  {label}")
            sys.stderr.flush()
    sys.stderr.write("\n" if is_terminal else f"{label}: {done} runs\n")


def _fingerprint(setting: Setting, recipe: Recipe) -> str:
    """Name what a trial depends on: all but the rule that judges it afterwards and the scale at which it is drawn."""
    parameters = {key: value for key, value in asdict(recipe).items() if key not in {"betti_rules", "epsilon_share", "speed_mps"}}
    content = json.dumps([_CACHE_VERSION, asdict(setting), parameters], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def _load(path: Path | None) -> Trial | None:
    if path is None or not path.exists():
        return None
    content = json.loads(path.read_text())
    merges, loops = (np.array(content.pop(key), dtype=np.float64).reshape(-1, 2) for key in ("merges", "loops"))
    first, second = content.pop("counted")
    return Trial(**content, merges=merges, loops=loops, counted=(first, second))


def _store(trial: Trial, path: Path | None) -> None:
    if path is None:
        return
    content = asdict(trial) | {"merges": trial.merges.tolist(), "loops": trial.loops.tolist()}
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(content))
    unfinished.replace(path)
