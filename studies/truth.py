"""The truth of a simulated run: where its encounters were, how far they are apart, and what shape they sample."""

import json
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from shapely.ops import polylabel

from mapper.encounter_csv import read_encounters
from mapper.persistence import rips_persistence
from mapper.types import EncounterTable
from simulator.arenas.arena import Arena, ArenaChange, BettiNumbers
from simulator.arenas.geodesics import geodesic_distances
from simulator.arenas.geojson import load_arena
from studies.errors import OtherRunError, RunDirectoryError

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

Intervals = tuple[Floats, Floats]
"""Births and deaths in dimensions 0 and 1, shape (m, 2) each."""

_NS_PER_S = 1_000_000_000

# How far outside an encounter its centre, as told over the air, may lie [s]: clocks are fitted, and beacons are far between.
_SAME_ENCOUNTER_S = 2.0

# Precision of the point deepest inside an obstacle, over the square root of its area.
_DEPTH_PRECISION = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunTruth:
    """What ``biobot-sim run`` or ``serve`` wrote.

    Parameters
    ----------
    directory
        Where it was read from.
    arena
        The arena at first, and its true Betti numbers.
    unit
        Name of the unit of every length.
    speed
        How far a biobot walks in a second of the files' time [length/s].
    zero_wall_ns
        Wall-clock time of the files' time 0 [ns]; 0 for a run that no clock paced.
    encounters
        The encounters of the file, in canonical order, which is the file's.
    encounter_position
        Where each was: the middle between its biobots at its centre time, shape (n, 2) [length].
    t_s, ids, position
        Instants [s], shape (n_t,), identities, shape (b,), and where each biobot was then [length], shape (n_t, b, 2).
    arena_changes
        What the arena became meanwhile, in order of time.
    """

    directory: Path
    arena: Arena
    unit: str
    speed: float
    zero_wall_ns: int
    encounters: EncounterTable
    encounter_position: Floats
    t_s: Floats
    ids: Indices
    position: Floats
    arena_changes: tuple[ArenaChange, ...] = ()

    @property
    def betti(self) -> BettiNumbers:
        """True numbers of components and holes at first; ``arena_at`` has those after a change."""
        return self.arena.betti

    def arena_at(self, t_s: float) -> Arena:
        """Return the arena as it is at an instant of the files' time [s]; at that of a change, the one after it."""
        return next((change.arena for change in reversed(self.arena_changes) if change.at_s <= t_s), self.arena)

    @property
    def side(self) -> float:
        """Square root of the area of the arena's bounding box [length]."""
        x_min, y_min, x_max, y_max = self.arena.bounds
        return float(np.sqrt((x_max - x_min) * (y_max - y_min)))


def load_run(directory: Path) -> RunTruth:
    """Read the truth of a run.

    Raises
    ------
    RunDirectoryError
        ``run.json`` or ``truth.npz`` is missing, unreadable, or does not fit the encounters.
    InputFileError
        ``encounters.csv`` is missing or faulty.
    ArenaError
        ``arena.geojson``, or that of an arena after a change, is missing or faulty.
    """
    run = _read_run(directory / "run.json")
    arrays = _read_arrays(directory / "truth.npz")
    encounters = read_encounters(directory / "encounters.csv")
    position = arrays["encounter_position"]
    if position.shape != (len(encounters), 2):
        problem = f"encounter_position has shape {position.shape}, but encounters.csv has {len(encounters)} rows; are the files of one run?"
        raise RunDirectoryError(path=directory / "truth.npz", problem=problem)
    return RunTruth(
        directory=directory,
        arena=load_arena(directory / "arena.geojson"),
        unit=str(run.get("unit_of_length", "")),
        speed=float(run["parameters"]["speed"]) * float(run.get("speed_factor", 1.0)),
        zero_wall_ns=int(run.get("t0_wall_ns", 0)),
        encounters=encounters,
        encounter_position=position[encounters.source_row],
        t_s=arrays["t_s"],
        ids=arrays["ids"].astype(np.int64),
        position=arrays["position"],
        arena_changes=tuple(
            ArenaChange(at_s=float(change["at_s"]), arena=load_arena(directory / Path(change["file"]).name))
            for change in run.get("arena_changes", [])
        ),
    )


def find_encounters(truth: RunTruth, *, t_s: Floats, id1: Indices, id2: Indices) -> tuple[Indices, Floats]:
    """Find encounters by their biobots and centre times.

    Parameters
    ----------
    t_s
        Centre times, shape (p,) [s, the clock of the map]: the files' time, or the wall clock for a run that was served.
    id1, id2
        The two biobots, shape (p,), in either order.

    Returns
    -------
    rows, error_s
        Row of the encounter of that pair going on at the time, or else the nearest, shape (p,), and how far its centre is from the
        time given [s].

    Raises
    ------
    OtherRunError
        Some pair has no encounter within two seconds of its time.
    """
    table = truth.encounters
    start_s, end_s = table.t_start_ns / _NS_PER_S, table.t_end_ns / _NS_PER_S
    rows_of: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
    for row, pair in enumerate(zip(table.id1.tolist(), table.id2.tolist(), strict=True)):
        rows_of[pair].append(row)
    own_s = t_s - truth.zero_wall_ns / _NS_PER_S
    rows, errors_s, absent = np.zeros(len(t_s), dtype=np.int64), np.zeros(len(t_s)), []
    for point, (one, other) in enumerate(zip(id1.tolist(), id2.tolist(), strict=True)):
        own = np.array(rows_of.get((min(one, other), max(one, other)), []), dtype=np.int64)
        outside_s = np.maximum(np.maximum(start_s[own] - own_s[point], own_s[point] - end_s[own]), 0.0)
        centre_error_s = np.abs(0.5 * (start_s[own] + end_s[own]) - own_s[point])
        if not outside_s.min(initial=np.inf) <= _SAME_ENCOUNTER_S:
            absent.append(point)
            continue
        best = np.lexsort((centre_error_s, outside_s))[0]
        rows[point], errors_s[point] = own[best], centre_error_s[best]
    if absent:
        raise OtherRunError(
            path=truth.directory,
            n_points=len(t_s),
            n_absent=len(absent),
            example=f"{int(id1[absent[0]])} with {int(id2[absent[0]])} at {float(own_s[absent[0]]):.3f} s of the run's time",
            within_s=_SAME_ENCOUNTER_S,
        )
    return rows, errors_s


def true_distances(truth: RunTruth, rows: Indices, *, at_s: float = 0.0) -> Floats:
    """Measure exact geodesics between encounters.

    Parameters
    ----------
    rows
        The encounters, shape (p,).
    at_s
        The instant whose arena counts [s, the files' time]. Where walls that came later stand in an encounter's place, the nearest place
        that is free then stands for it.

    Returns
    -------
    Floats
        Shape (p, p) [length], inf between components of the arena.
    """
    arena, places = truth.arena_at(at_s), truth.encounter_position[rows]
    if arena is not truth.arena:
        nearest = shapely.shortest_line(arena.polygon, shapely.points(places))
        places = shapely.get_coordinates(nearest)[::2]
    return geodesic_distances(arena, places)


def diagram_of(distances: Floats) -> Intervals:
    """Compute the persistence diagram of points in a space of one or more components.

    Parameters
    ----------
    distances
        Shape (p, p), symmetric, zero diagonal, inf between components, at least one point.

    Returns
    -------
    Intervals
        Births and deaths of all components together, longest first in each dimension, none of zero length; one death in dimension 0 is
        inf for each component.
    """
    n_parts, label = connected_components(csr_array(np.isfinite(distances)), directed=False)
    parts = [rips_persistence(distances[np.ix_(label == part, label == part)]).intervals for part in range(n_parts)]
    pooled = [np.concatenate([part[dimension] for part in parts]) for dimension in (0, 1)]
    lasting = [intervals[intervals[:, 1] > intervals[:, 0]] for intervals in pooled]
    ordered = [intervals[np.argsort(intervals[:, 0] - intervals[:, 1], kind="stable")] for intervals in lasting]
    return ordered[0], ordered[1]


def obstacle_points(arena: Arena) -> Floats:
    """Pick a point deep inside each obstacle: shape (number of holes, 2) [length].

    Obstacles that touch are one, and what touches the outside is none: as the arena's Betti numbers count.
    """
    x_min, y_min, x_max, y_max = arena.bounds
    extent = max(x_max - x_min, y_max - y_min)
    around = shapely.box(x_min - extent, y_min - extent, x_max + extent, y_max + extent)
    gaps = shapely.get_parts(around.difference(arena.polygon))
    one, other = shapely.STRtree(gaps).query(gaps, predicate="intersects")
    touching = csr_array((np.ones(one.size, dtype=bool), (one, other)), shape=(gaps.size, gaps.size))
    _, group = connected_components(touching, directed=False)
    outside = group[int(shapely.intersects_xy(gaps, x_min - extent / 2, y_min - extent / 2).argmax())]
    points = []
    for obstacle in np.unique(group[group != outside]):
        largest = max(gaps[group == obstacle], key=lambda gap: float(gap.area))
        deepest = polylabel(largest, tolerance=_DEPTH_PRECISION * float(np.sqrt(largest.area)))
        points.append((deepest.x, deepest.y))
    return np.array(points, dtype=np.float64).reshape(-1, 2)


def _read_run(path: Path) -> dict[str, Any]:
    try:
        run = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}; give a directory that biobot-sim wrote"
        raise RunDirectoryError(path=path, problem=problem) from error
    except ValueError as error:
        raise RunDirectoryError(path=path, problem=f"not JSON: {error}; run it again") from error
    try:
        float(run["parameters"]["speed"]), float(run.get("speed_factor", 1.0)), int(run.get("t0_wall_ns", 0))
        [(float(change["at_s"]), str(change["file"])) for change in run.get("arena_changes", [])]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        problem = "lacks a number: parameters.speed, speed_factor, t0_wall_ns or at_s of an arena change; was it written by biobot-sim?"
        raise RunDirectoryError(path=path, problem=problem) from error
    found: dict[str, Any] = run
    return found


def _read_arrays(path: Path) -> dict[str, Any]:
    names = ("encounter_position", "t_s", "ids", "position")
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in names}
    except OSError as error:
        raise RunDirectoryError(path=path, problem=f"cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, EOFError) as error:
        raise RunDirectoryError(path=path, problem=f"not an archive with {', '.join(names)}: {error}; run it again") from error
