"""Simulated runs of [Dir16] VI that know where everything was. Lengths are those of an arena of side 50, whatever the preset.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

from dataclasses import dataclass, replace

import numpy as np
from shapely import affinity
from shapely.geometry import box

from mapper.types import EncounterTable, ModeSpell
from simulator.arenas.arena import Arena, build_arena
from simulator.arenas.geodesics import geodesic_distances
from simulator.arenas.scenarios import find_scenario
from simulator.config import Ranges
from simulator.presets import find_preset
from simulator.world import World
from studies.arenas import place_squares
from studies.exploration import explore
from studies.truth import Floats, Indices

SIDE = 50.0
PRESETS = ("paper-units", "paper-50cm")
"""The two readings of the units that [Dir16] printed (docs/simulation.md)."""
SCENARIOS = ("no-obstacle", "one-obstacle", "two-obstacles")
"""[Dir16] VI, scenarios 1 to 3."""

# [Dir16] does not print the size of its obstacles; these are of the size of scenario 3's.
_HOLE_SIDE = 13.0
_ARENA_STREAM = 8016  # keeps these arenas apart from those drawn elsewhere by the same seeds
_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a run takes place: a scenario by name, or square obstacles at random places.

    Parameters
    ----------
    scenario
        Name of a scenario; empty for random obstacles.
    holes
        How many random obstacles, each a square of side 13.
    scale
        Multiplies the arena with its obstacles; the biobots stay as they are.
    """

    scenario: str = ""
    holes: int = 0
    scale: float = 1.0

    def build(self, *, seed: int) -> Arena:
        """Make the arena, of side 50 times ``scale``."""
        if self.scenario:
            return find_scenario(self.scenario).build(SIDE * self.scale)
        rng = np.random.default_rng([_ARENA_STREAM, self.holes, seed])
        shape = place_squares(box(0.0, 0.0, SIDE, SIDE), rng, n_holes=self.holes, sides=(_HOLE_SIDE, _HOLE_SIDE))
        return build_arena(affinity.scale(shape, self.scale, self.scale, origin=(0.0, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class RunCase:
    """A run to be simulated: ``movers`` walk and ``landmarks`` stand, for a share of the preset's time."""

    preset: str
    place: Place
    seed: int
    movers: int = 130
    landmarks: int = 20
    time_share: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwarmRun:
    """A run with its truth.

    Parameters
    ----------
    arena
        Of side 50, unless scaled.
    speed
        How far a biobot walks in a second [length/s].
    reach
        Detection radius r_d [length].
    duration_s
        From when the landmarks are set, which is at ``start_s`` of the encounters' times [s].
    table, spells
        What the mapper is given.
    positions
        Where each encounter was: the middle between its biobots at its centre time, shape (n, 2) [length].
    landmark_ids, landmark_positions
        Shapes (l,) and (l, 2) [length].
    mover_positions
        Where the others were when the landmarks were set, shape (m, 2) [length].
    """

    arena: Arena
    speed: float
    reach: float
    start_s: float
    duration_s: float
    table: EncounterTable
    spells: tuple[ModeSpell, ...]
    positions: Floats
    landmark_ids: Indices
    landmark_positions: Floats
    mover_positions: Floats

    @property
    def centre_s(self) -> Floats:
        """Centre times, shape (n,) [s]."""
        return np.asarray((self.table.t_start_ns + self.table.t_end_ns) / (2.0 * _NS_PER_S))

    def true_distances(self, encounters: Indices) -> Floats:
        """Measure exact geodesics between encounters, given by their rows, shape (p,): shape (p, p) [length]."""
        return geodesic_distances(self.arena, self.positions[encounters])


def simulate_run(case: RunCase) -> SwarmRun:
    """Let biobots disperse, set landmarks, and explore."""
    preset = find_preset(case.preset)
    unit = SIDE / preset.side
    motion = replace(preset.motion, speed=unit * preset.motion.speed, mean_leg=unit * preset.motion.mean_leg)
    ranges = Ranges(detection=unit * preset.ranges.detection, communication=unit * preset.ranges.communication)
    arena = case.place.build(seed=case.seed)
    world = World(arena, motion=motion, ranges=ranges, ids=range(1, case.movers + case.landmarks + 1), seed=case.seed)
    duration_s = preset.duration_s * case.time_share
    explored = explore(world, landmarks=case.landmarks, duration_s=duration_s)
    table = explored.table
    centre_s = np.minimum((table.t_start_ns + table.t_end_ns) / (2.0 * _NS_PER_S), world.now_s)
    start_s = world.now_s - duration_s
    ids = np.array(sorted(spell.node for spell in explored.spells), dtype=np.int64)
    movers = np.setdiff1d(np.array(world.ids, dtype=np.int64), ids)
    return SwarmRun(
        arena=arena,
        speed=motion.speed,
        reach=ranges.detection,
        start_s=start_s,
        duration_s=duration_s,
        table=table,
        spells=explored.spells,
        positions=(world.positions_of(table.id1, centre_s) + world.positions_of(table.id2, centre_s)) / 2.0,
        landmark_ids=ids,
        landmark_positions=world.positions_of(ids, np.full(len(ids), start_s)),
        mover_positions=world.positions_of(movers, np.full(len(movers), start_s)),
    )
