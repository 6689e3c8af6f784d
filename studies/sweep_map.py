"""An arena ten times as large as the swarm covers at once, swept by a herded swarm: ``python -m studies.sweep_map``.

Two shapes with 10 obstacles: a strip, 500 x 50, swept from end to end; and a field, 250 x 100, swept in two lanes that lie side by side,
where landmarks along the seam are left standing for the way back. 150 biobots as in ``paper-units``, of which 20 stand around the beacon
at a time. Of every run there are the map of all encounters as one; the maps of windows of 400 s, each half over the one before; and the
one map that those are joined to. Beside them the maps of a swarm ten times larger that stays for 200 s, and of the same swarm let loose in
the whole arena for as long as the sweep took.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from shapely.geometry import box

from mapper.config import RecipeConfig, make_recipe
from mapper.map_file import MapFile, merging_facts, take_map
from mapper.pipeline import compute_map, join_finished_maps
from mapper.report import to_json_object
from mapper.types import EncounterTable, FloatArray, MapResult, ModeSpell, Points
from mapper.window import clip_table
from simulator.arenas.arena import Arena, build_arena
from simulator.arenas.geodesics import geodesic_distances
from simulator.config import Ranges
from simulator.herding import BeaconPath
from simulator.motion import MotionParameters
from simulator.world import World
from studies.arenas import place_squares
from studies.cases import Study, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.exploration import explore
from studies.herded import HerdedExploration, explore_herded, positions_of_encounters
from studies.scores import count_enclosed
from studies.truth import obstacle_points

HELD_OUT_SEED = 10_000

_OBSTACLES = 10
_SIDES = (9.0, 14.0)
_LANE = 50.0
_BEACON_SPEED = 0.15
_RADIUS = 35.0
# To either side of the seam between two lanes.
_SEAM = 8.0
_WINDOW_S, _WINDOWS_EVERY_S = 400.0, 200.0
_SWARM, _LANDMARKS = 150, 20
_SPREAD_S, _LONG_S = 200.0, 3_000.0
# Points whose true distances are computed.
_MEASURED_POINTS = 150


class Shape(StrEnum):
    """What is swept."""

    STRIP = "strip"
    FIELD = "field"


class Way(StrEnum):
    """How the encounters come about."""

    HERDED = "herded"
    TEN_SWARMS = "ten swarms"
    AS_LONG = "let loose"


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepCase:
    """One run."""

    shape: Shape
    way: Way
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What a map shows. ``metric_error``: median of the relative errors of distances; None where it is not measured."""

    found: int
    false: int
    metric_error: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepResult:
    """Maps of one run beside the truth.

    ``joined`` is one map of the finished maps of windows. ``alone`` are those maps by themselves: obstacles that any of them shows, and
    their false holes together; ``repeated`` obstacles are in more than one. All three are None but for a herded swarm.
    """

    true_holes: int
    n_encounters: int
    n_stands: int
    whole: Found
    joined: Found | None
    alone: Found | None
    repeated: int | None


def compute_case(case: SweepCase) -> SweepResult:
    """Simulate and map one run."""
    arena = _draw(case)
    world = World(
        arena,
        motion=MotionParameters(speed=1.0, mean_leg=10.0),
        ranges=Ranges(detection=1.0, communication=8.0),
        ids=range(1, 1 + _SWARM * (10 if case.way is Way.TEN_SWARMS else 1)),
        seed=case.seed,
    )
    obstacles = obstacle_points(arena)
    if case.way is Way.HERDED:
        run = _sweep(world, case.shape)
    else:
        run = _spread(world, landmarks=_LANDMARKS * (10 if case.way is Way.TEN_SWARMS else 1), is_long=case.way is Way.AS_LONG)
    one_map = _map(run.table, run.spells)
    whole = _score(one_map, run.positions[one_map.points.encounter], arena, obstacles)
    joined = alone = repeated = None
    if case.way is Way.HERDED:
        windows = [(table, _map(table, run.spells)) for table in _cut(run)]
        files = [_to_file(result, name=str(number)) for number, (_, result) in enumerate(windows)]
        union = join_finished_maps(files, make_recipe(RecipeConfig()))
        joined = _score(union, _positions(world, union.points), arena, obstacles)
        alone, repeated = _score_windows(run, windows, obstacles)
    return SweepResult(
        true_holes=len(obstacles),
        n_encounters=len(run.table),
        n_stands=run.n_stands,
        whole=whole,
        joined=joined,
        alone=alone,
        repeated=repeated,
    )


SWEEPS = Study(name="sweep-map", compute=compute_case, result_type=SweepResult)


def _draw(case: SweepCase) -> Arena:
    rng = np.random.default_rng([len(Shape), list(Shape).index(case.shape), case.seed])
    size = (10 * _LANE, _LANE) if case.shape is Shape.STRIP else (5 * _LANE, 2 * _LANE)
    return build_arena(place_squares(box(0.0, 0.0, *size), rng, n_holes=_OBSTACLES, sides=_SIDES))


def _sweep(world: World, shape: Shape) -> HerdedExploration:
    begin, lane, back = _LANE / 2, _LANE / 2, 1.5 * _LANE
    far = world.arena.bounds[2] - _LANE / 2
    if shape is Shape.STRIP:
        return explore_herded(world, BeaconPath([(begin, lane), (far, lane)], speed=_BEACON_SPEED), radius=_RADIUS, landmarks=_LANDMARKS)
    path = BeaconPath([(begin, lane), (far, lane), (far, back), (begin, back)], speed=_BEACON_SPEED)
    return explore_herded(
        world, path, radius=_RADIUS, landmarks=_LANDMARKS, stays=lambda place: abs(place[1] - _LANE) < _SEAM and place[0] < far
    )


def _spread(world: World, *, landmarks: int, is_long: bool) -> HerdedExploration:
    """Let a swarm loose in the whole arena, its landmarks where they are."""
    explored = explore(world, landmarks=landmarks, duration_s=_LONG_S if is_long else _SPREAD_S)
    return HerdedExploration(
        table=explored.table,
        spells=explored.spells,
        positions=positions_of_encounters(world, explored.table),
        begin_s=0.0,
        end_s=world.now_s,
        n_stands=len(explored.spells),
    )


def _positions(world: World, points: Points) -> FloatArray:
    t_s = np.minimum(points.t_ns / 1e9, world.now_s)
    return (world.positions_of(points.id1, t_s) + world.positions_of(points.id2, t_s)) / 2.0


def _cut(run: HerdedExploration) -> list[EncounterTable]:
    """Cut windows out of a run, each half over the one before."""
    begins = np.arange(run.begin_s, run.end_s - _WINDOWS_EVERY_S, _WINDOWS_EVERY_S).tolist()
    return [clip_table(run.table, since_ns=round(at * 1e9), until_ns=round((at + _WINDOW_S) * 1e9)) for at in begins]


def _to_file(result: MapResult, *, name: str) -> MapFile:
    """Hand a map over as a file would."""
    return take_map({**to_json_object(result), **merging_facts(result)}, name=name)


def _map(table: EncounterTable, spells: Sequence[ModeSpell]) -> MapResult:
    return compute_map(table, spells, make_recipe(RecipeConfig()))


def _score(result: MapResult, places: FloatArray, arena: Arena, obstacles: FloatArray) -> Found:
    n_found = count_enclosed([places[hole.outline] for hole in result.holes], obstacles)
    rows = np.arange(0, result.components[0].n_points, max(1, result.components[0].n_points // _MEASURED_POINTS))
    true = geodesic_distances(arena, places[rows], places[rows])
    above = np.triu_indices(len(rows), 1)
    measured = result.components[0].distances[np.ix_(rows, rows)][above]
    usable = true[above] > 0
    error = float(np.median(np.abs(measured - true[above])[usable] / true[above][usable]))
    return Found(found=n_found, false=len(result.holes) - n_found, metric_error=error)


def _score_windows(run: HerdedExploration, windows: Sequence[tuple[EncounterTable, MapResult]], obstacles: FloatArray) -> tuple[Found, int]:
    shown = np.zeros(len(obstacles), dtype=np.int64)
    false = 0
    for table, result in windows:
        places = run.positions[table.source_row[result.points.encounter]]
        outlines = [places[hole.outline] for hole in result.holes]
        false += len(outlines) - count_enclosed(outlines, obstacles)
        shown += [count_enclosed(outlines, obstacles[[row]]) for row in range(len(obstacles))]
    return Found(found=int((shown > 0).sum()), false=false, metric_error=None), int((shown > 1).sum())


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.sweep_map", description="Maps of an arena ten times larger than the swarm.")
    parser.add_argument("--shape", type=Shape, choices=list(Shape), action="append", help="may be repeated (default: both)")
    parser.add_argument("--way", type=Way, choices=list(Way), action="append", help="may be repeated (default: all)")
    parser.add_argument("--runs", type=int, default=20, help="of each kind (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=HELD_OUT_SEED, help="first seed (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    print(f"{options.runs} runs each, seeds from {options.seed}, {_OBSTACLES} obstacles in each arena")
    print("| arena | swarm | map | encounters | obstacles found | false holes a map | metric error |\n|---|---|---|---|---|---|---|")
    for shape in options.shape or list(Shape):
        for way in options.way or list(Way):
            cases = [SweepCase(shape=shape, way=way, seed=seed) for seed in range(options.seed, options.seed + options.runs)]
            try:
                results = results_of(run_cases(SWEEPS, cases, read_flags(options, journal=None), label=f"{shape} {way}"))
            except StudyError as error:
                print(f"error: {error}", file=sys.stderr)
                return 1
            print(*_lines(shape, way, results), sep="\n")
    return 0


def _lines(shape: Shape, way: Way, results: Sequence[SweepResult]) -> list[str]:
    lines = [_line(shape, way, "one", results, [one.whole for one in results])]
    if way is Way.HERDED:
        lines.append(_line(shape, way, "windows' maps, joined", results, [one.joined for one in results if one.joined]))
        lines.append(_line(shape, way, "windows alone, together", results, [one.alone for one in results if one.alone]))
        repeated = sum(one.repeated or 0 for one in results) / len(results)
        lines[-1] += f" {repeated:.1f} obstacles are in more than one window |"
    return lines


def _line(shape: Shape, way: Way, what: str, results: Sequence[SweepResult], maps: Sequence[Found]) -> str:
    true = sum(one.true_holes for one in results)
    found = sum(one.found for one in maps)
    errors = [one.metric_error for one in maps if one.metric_error is not None]
    error = f"{np.mean(errors):.1%}" if errors else ""
    encounters = int(np.median([one.n_encounters for one in results]))
    cells = (
        shape,
        way,
        what,
        f"{encounters:,}",
        f"{found} of {true} = {found / true:.0%}",
        f"{sum(m.false for m in maps) / len(maps):.2f}",
    )
    return "| " + " | ".join([*cells, error]) + " |"


if __name__ == "__main__":
    sys.exit(main())
