"""The setting of a run: the arena and every parameter, chosen by a configuration and completed by its preset."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from simulator.arenas.arena import Arena, ArenaChange
from simulator.arenas.arena_file import ArenaFile, load_arena_file
from simulator.arenas.scenarios import find_scenario
from simulator.config import Ranges, WorldConfig, parse_arena_then
from simulator.errors import ArenaError, ParameterError
from simulator.log import EventLog
from simulator.motion import MotionParameters, WallLaw
from simulator.presets import Preset, find_preset

log = EventLog(__name__)

# Guards against a slip of units, which would run for days or fill the memory.
_MAX_LEGS = 20_000_000
_MAX_ENCOUNTERS = 5_000_000
# Of one insect at another: 90 to 640 ns each (2026-11-27, two busy cores), so a crowd is through in some ten minutes.
_MAX_LOOKS = 1_000_000_000
# About one insect in two of the engine's cells (make_cells of engine.c), where these are not as wide as insects reach.
_PER_CELL = 0.5
_CELLS_LOOKED_AT = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Everything a world is made from.

    Parameters
    ----------
    arena_name
        The scenario, or the file the arena came from.
    preset, unit
        Name of the preset, and of its unit of length.
    arena_changes
        What the arena becomes while insects explore, in order of time.
    arena_counts
        What the arena's file held beside it, by kind.
    biobots, landmarks
        How many; ids are 1 to ``biobots``.
    dispersion_s, duration_s
        Time before and after the landmarks are set [s].
    """

    arena_name: str
    arena: Arena
    preset: str
    unit: str
    motion: MotionParameters
    ranges: Ranges
    biobots: int
    landmarks: int
    dispersion_s: float
    duration_s: float
    seed: int
    arena_changes: tuple[ArenaChange, ...] = ()
    arena_counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def ids(self) -> range:
        """Identities of the biobots."""
        return range(1, self.biobots + 1)

    @property
    def expected_encounters(self) -> float:
        """Kinetic-gas estimate of the encounters after the landmarks are set.

        ``v T r_d (4 N_m^2 / pi + 2 N_l N_m) / A`` for movers N_m and landmarks N_l: two movers approach each other at 4 v / pi on
        average over all headings, a mover approaches a landmark or one that rests at v, and 2 r_d is the width in which they meet. Of
        that goes the time at rest, and what walls cut off the disc of detection: a share ``r_d P / (pi A)`` for the perimeter P, as in a
        large box. Insects that gather at walls or in company meet more or less than that.
        """
        motion, radius = self.motion, self.ranges.detection
        movers, walking = self.biobots - self.landmarks, 1.0 / (1.0 + motion.stop_hazard * motion.mean_rest_s)
        among_movers = movers**2 * (4.0 / math.pi * walking**2 + 2.0 * walking * (1.0 - walking))
        pairs = among_movers + 2.0 * self.landmarks * movers * walking
        in_sight = max(0.0, 1.0 - radius * float(self.arena.polygon.length) / (math.pi * self.arena.area))
        return motion.speed * self.duration_s * radius * pairs * in_sight / self.arena.area

    @property
    def extent(self) -> float:
        """Diagonal of the arena's bounds [length]."""
        x_min, y_min, x_max, y_max = self.arena.bounds
        return math.hypot(x_max - x_min, y_max - y_min)

    @property
    def expected_legs(self) -> float:
        """Estimate of the legs that end by themselves or at walls, dispersion included; the mean distance between walls is pi A / P."""
        walls = max(
            float(one.polygon.length) / (math.pi * one.area) for one in (self.arena, *(change.arena for change in self.arena_changes))
        )
        return (1.0 / self.motion.mean_leg + walls) * self.motion.speed * self._total_s * self.biobots

    @property
    def expected_looks(self) -> float:
        """Estimate of the engine's work: how often it looks what a new leg means for one of those around.

        A leg ends by itself, at a wall, or for two at once where they touch and turn (kinetic gas, as in ``expected_encounters``, all
        walking). At its end all are looked at who are in the nine cells around: in a crowd, everybody.
        """
        motion, area = self.motion, self.arena.area
        touches = (
            4.0 / math.pi * motion.speed * self._total_s * motion.contact_radius * self.biobots**2 / area if motion.contact_turns else 0.0
        )
        cell_area = max(self.ranges.detection**2, motion.contact_radius**2, _PER_CELL * area / self.biobots)
        around = self.biobots * min(1.0, _CELLS_LOOKED_AT * cell_area / area)
        placed = 2.0 * self.biobots * (1 + len(self.arena_changes))  # once for who is near, once for what is to come
        return (self.expected_legs + 2.0 * touches + placed) * around

    @property
    def _total_s(self) -> float:
        return self.dispersion_s + self.duration_s

    def describe(self) -> dict[str, object]:
        """List the setting for a file of parameters; lengths are in ``unit_of_length``."""
        return {
            "arena": self.arena_name,
            "preset": self.preset,
            "seed": self.seed,
            "unit_of_length": self.unit,
            "parameters": {
                "biobots": self.biobots,
                "landmarks": self.landmarks,
                "speed": self.motion.speed,
                "mean_leg": self.motion.mean_leg,
                "detection_radius": self.ranges.detection,
                "communication_radius": self.ranges.communication,
                "dispersion_s": self.dispersion_s,
                "duration_s": self.duration_s,
            },
            "motion": asdict(self.motion),
            "arena_area": self.arena.area,
            "betti_numbers": [self.arena.betti.components, self.arena.betti.holes],
            "arena_changes": self.describe_changes(),
            "arena_counts": dict(self.arena_counts),
            "expected_encounters": round(self.expected_encounters, 1),
        }

    def describe_changes(self) -> list[dict[str, object]]:
        """List for a file of parameters when the arena changes, its Betti numbers after that, and the file that holds it."""
        return [
            {
                "at_s": change.at_s,
                "betti_numbers_after": [change.arena.betti.components, change.arena.betti.holes],
                "file": change_file(number),
            }
            for number, change in enumerate(self.arena_changes, start=1)
        ]


def change_file(number: int) -> str:
    """Name the file of the arena after its change of this number, counted from 1."""
    return f"arena_{number}.geojson"


def choose_setting(config: WorldConfig) -> Setting:
    """Complete a configuration from its preset, and load its arena.

    Raises
    ------
    ConfigurationError
        Neither scenario nor arena, or no seed, is given.
    ScenarioError
        No scenario or preset has the name given.
    ArenaError
        The arena file is faulty.
    ParameterError
        The parameters contradict each other, or would make a run without end.
    """
    preset = find_preset(config.preset)
    name = config.arena or config.scenario or preset.scenario
    if name is None or config.seed is None:
        given = {"give --scenario NAME or --arena FILE": name, "give --seed N: the same seed makes the same run": config.seed}
        raise ConfigurationError([what for what, value in given.items() if value is None])
    duration_s = config.duration_s or preset.duration_s
    file, changes = _load_arena(config, name=name, preset=preset, duration_s=duration_s)
    biobots = preset.biobots if config.biobots is None else config.biobots
    landmarks = round(biobots * preset.landmarks / preset.biobots) if config.landmarks is None else config.landmarks
    if landmarks > biobots:
        raise ParameterError(name="landmarks", got=landmarks, wanted=f"at most the number of biobots, {biobots}")
    detection = config.detection_radius or preset.ranges.detection
    communication = config.communication_radius or preset.ranges.communication * detection / preset.ranges.detection
    setting = Setting(
        arena_name=name,
        arena=file.arena,
        preset=preset.name,
        unit=preset.unit,
        motion=config.motion.over(
            replace(preset.motion, speed=config.speed or preset.motion.speed, mean_leg=config.mean_leg or preset.motion.mean_leg)
        ),
        ranges=Ranges(detection=detection, communication=communication),
        biobots=biobots,
        landmarks=landmarks,
        dispersion_s=preset.dispersion_s if config.dispersion_s is None else config.dispersion_s,
        duration_s=duration_s,
        seed=config.seed,
        arena_changes=changes,
        arena_counts=file.counts,
    )
    _check_extent(setting)
    idle = [name for name in setting.motion.idle() if getattr(config.motion, name) is not None]
    if idle:
        log.warning("motion.without_effect", keys=", ".join(idle), hint="docs/simulator.md says what each needs")
    if setting.motion.wall_law is WallLaw.FOLLOW and not setting.motion.exit_hazard:
        log.warning("walls.never_left", hint="insects that have met a wall follow it for ever; give motion.exit_hazard, 0.12 /s for larvae")
    return setting


def _load_arena(config: WorldConfig, *, name: str, preset: Preset, duration_s: float) -> tuple[ArenaFile, tuple[ArenaChange, ...]]:
    if config.arena is None:
        scenario, seed = find_scenario(name), config.seed or 0
        changes = scenario.build_changes(preset.side, seed=seed)
        file = ArenaFile(arena=scenario.build(preset.side, seed=seed), counts={})
        return file, tuple(ArenaChange(at_s=share * duration_s, arena=arena) for share, arena in changes)
    times_s, later = [], []
    for at_s, path in map(parse_arena_then, config.arena_then):
        if at_s >= duration_s:
            raise ParameterError(
                name=f"time at which the arena becomes {path} [s]", got=at_s, wanted=f"less than the duration, {duration_s:g}"
            )
        times_s.append(at_s)
        later.append(path)
    files = [_read_arena(path, config) for path in (name, *later)]
    x_min, y_min, x_max, y_max = files[0].arena.bounds
    for path, file in zip(later, files[1:], strict=True):
        left, low, right, high = file.arena.bounds
        if left < x_min or low < y_min or right > x_max or high > y_max:
            raise ArenaError(
                source=path, problem=f"it reaches beyond the bounds {files[0].arena.bounds} of {name}; wanted an arena within them"
            )
    return files[0], tuple(ArenaChange(at_s=at_s, arena=file.arena) for at_s, file in zip(times_s, files[1:], strict=True))


def _read_arena(path: str, config: WorldConfig) -> ArenaFile:
    file = load_arena_file(Path(path), scale=config.arena_scale, simplify=config.arena_simplify)
    betti = file.arena.betti
    if file.counts.get("shapes_ignored"):
        hint = "lines have no width: turn strokes into paths (Stroke to Path) for walls to stand"
        log.warning("arena.shapes_ignored", file=path, count=file.counts["shapes_ignored"], hint=hint)
    log.info("arena.read", file=path, components=betti.components, holes=betti.holes, walls=len(file.arena.wall_start), **file.counts)
    return file


def _check_extent(setting: Setting) -> None:
    arena, unit = setting.arena, setting.unit
    if arena.margin > 1e-3 * setting.ranges.detection:
        raise ParameterError(
            name="detection radius",
            got=setting.ranges.detection,
            wanted=f"at least {1e3 * arena.margin:g} {unit} in an arena of this extent; are arena and preset in the same unit of length?",
        )
    if setting.ranges.detection >= setting.extent:
        raise ParameterError(
            name="detection radius",
            got=setting.ranges.detection,
            wanted=f"less than {setting.extent:g} {unit}, the arena from corner to corner, or all meet all the time; are "
            "arena and preset in the same unit of length? Give --arena-scale, another --preset, or a smaller detection_radius",
        )
    legs = setting.expected_legs
    if legs > _MAX_LEGS:
        raise ParameterError(
            name="number of legs to walk",
            got=round(legs),
            wanted=f"at most {_MAX_LEGS}: take fewer biobots or less time, or check that arena and preset ({unit}) share a unit of length",
        )
    if setting.expected_encounters > _MAX_ENCOUNTERS:
        raise ParameterError(
            name="number of encounters to expect",
            got=round(setting.expected_encounters),
            wanted=f"at most {_MAX_ENCOUNTERS}: take fewer biobots, less time, a smaller radius or a larger arena",
        )
    if setting.expected_looks > _MAX_LOOKS:
        raise ParameterError(
            name="number of looks of biobots at each other",
            got=round(setting.expected_looks),
            wanted=f"at most {_MAX_LOOKS}, which take minutes, and here on {arena.area:g} square {unit} each is near many; "
            "take fewer biobots, less time, a smaller radius or a larger arena",
        )
