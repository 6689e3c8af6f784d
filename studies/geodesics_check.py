"""Check the simulator's geodesics against an independent method in every named arena: ``python -m studies.geodesics_check``.

The method shares no code with ``simulator.arenas.visibility``: every point and every corner, whether it sticks out or not, are joined
wherever GEOS says that the line between them is covered by the arena, and shortest paths are looked for in that graph.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from shapely import affinity

from simulator.arenas.arena import Arena, build_arena
from simulator.arenas.floor_plan import trace
from simulator.arenas.geodesics import Geodesics
from simulator.arenas.scenarios import SCENARIOS

Floats = NDArray[np.float64]

WANTED_ERROR = 1e-9
"""Over the arena's extent."""

_SIDE = 50.0
# GEOS lets lines leave the arena by this share of its extent, so that rounding does not close its walls to lines along them.
_SLACK = 1e-11

# Stands for 0, which a sparse graph takes for no edge.
_NO_LENGTH = 1e-290

_LARGE_ROOMS = 14


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """How two methods agree in one arena.

    Parameters
    ----------
    error
        Largest absolute difference, over the arena's extent; inf if they do not agree on which pairs have a way at all.
    seconds, other_seconds
        Processor time of the simulator, for all ways from the first places of the pairs to the second and the preparation of the arena,
        and of the independent method, for the pairs alone [s].
    """

    name: str
    arena: Arena
    pairs: int
    without_way: int
    error: float
    seconds: float
    other_seconds: float


def named_arenas(*, seed: int, degrees: float = 0.0) -> Iterator[tuple[str, Arena]]:
    """Build every named arena, and what it becomes when it changes, turned about its lower left corner."""
    for name, scenario in SCENARIOS.items():
        yield name, _turn(scenario.build(_SIDE, seed=seed), degrees)
        for share, after in scenario.build_changes(_SIDE, seed=seed):
            yield f"{name}, after {share:.0%}", _turn(after, degrees)


def check(name: str, arena: Arena, *, pairs: int, seed: int) -> Check:
    """Measure random pairs of places in both ways: inside, on walls, in corners, and in line with two corners, in equal shares."""
    rng = np.random.default_rng(seed)
    one, other = draw_places(arena, rng, count=pairs), draw_places(arena, rng, count=pairs)
    began = time.process_time()
    found = Geodesics(arena).distances(one, other).diagonal()
    between = time.process_time()
    wanted = slow_distances(arena, one, other)
    ended = time.process_time()
    both = np.isfinite(found) & np.isfinite(wanted)
    agree = np.array_equal(np.isfinite(found), np.isfinite(wanted))
    error = float(np.abs(found[both] - wanted[both]).max(initial=0.0)) / _extent(arena) if agree else np.inf
    return Check(
        name=name,
        arena=arena,
        pairs=pairs,
        without_way=int(np.sum(~both)),
        error=error,
        seconds=between - began,
        other_seconds=ended - between,
    )


def draw_places(arena: Arena, rng: np.random.Generator, *, count: int) -> Floats:
    """Draw places of the four kinds in random order, shape (count, 2) [length]."""
    shape = arena.polygon
    ids = rng.integers(1, 2**63, size=count).astype(np.uint64)
    inside = arena.draw_places(seed=int(rng.integers(2**32)), ids=ids)
    on_walls = shapely.get_coordinates(shapely.line_interpolate_point(shape.boundary, rng.uniform(0, shape.length, count)))
    corners = shapely.get_coordinates(shape)
    pairs = rng.integers(len(corners), size=(20 * count, 2))
    share = rng.choice([0.1, 0.25, 0.5, -0.5, 1.5, 2.0, -1.0], size=(20 * count, 1))
    in_line = corners[pairs[:, 0]] + share * (corners[pairs[:, 1]] - corners[pairs[:, 0]])
    in_line = in_line[shapely.intersects_xy(shape, in_line[:, 0], in_line[:, 1])]
    kinds = [inside, on_walls, corners[rng.integers(len(corners), size=count)], in_line]
    quarter = -(-count // 4)
    return rng.permutation(np.vstack([kind[:quarter] for kind in kinds]))[:count]


def slow_distances(arena: Arena, one: Floats, other: Floats) -> Floats:
    """Measure from each of some points to its partner by the independent method: shape (n,) [length], inf where there is no way."""
    slack = _SLACK * _extent(arena)
    roomy = arena.polygon.buffer(slack, join_style="mitre", mitre_limit=50.0)
    shapely.prepare(roomy)
    corners = np.unique(shapely.get_coordinates(arena.polygon), axis=0)
    n = len(corners)
    i, j = np.triu_indices(n, 1)
    straight = _straight(roomy, corners[i], corners[j])
    free = np.isfinite(straight)
    between = dijkstra(csr_array((straight[free], (i[free], j[free])), shape=(n, n)), directed=False)
    from_one, from_other = (
        _straight(roomy, np.repeat(points, n, axis=0), np.tile(corners, (len(points), 1))).reshape(-1, n) for points in (one, other)
    )
    lengths = _straight(roomy, one, other)
    for corner in range(n):
        to_corner = (from_one + between[corner]).min(axis=1)
        lengths = np.minimum(lengths, to_corner + from_other[:, corner])
    return np.where(lengths < _NO_LENGTH, 0.0, lengths)


def large_plan(*, seed: int) -> Arena:
    """Trace a floor plan of 14 by 14 rooms of 20 pixels, doors and blocks in them by chance; the largest connected part of it."""
    rng, room, size = np.random.default_rng(seed), 20, 20 * _LARGE_ROOMS + 1
    free = np.ones((size, size), dtype=bool)
    free[::room], free[:, ::room] = False, False
    for row in range(0, size - 1, room):
        for column in range(0, size - 1, room):
            free[row, column + 5 : column + 9] |= row > 0 and rng.random() < 0.7
            free[row + 8 : row + 12, column] |= column > 0 and rng.random() < 0.7
            free[row + 10 : row + 15, column + 11 : column + 16] &= rng.random() < 0.5
    label, _ = ndimage.label(free)
    return build_arena(trace(label == 1 + np.argmax(np.bincount(label.ravel())[1:])))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; the exit status is 1 if some error is larger than wanted."""
    parser = argparse.ArgumentParser(prog="python -m studies.geodesics_check", description=__doc__)
    parser.add_argument("--pairs", type=int, default=1_000, help="random pairs in each arena (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="draws the pairs, and the arenas that are random (default: %(default)s)")
    parser.add_argument(
        "--degrees", type=float, default=0.0, help="turn the arenas, so that no wall lies along an axis (default: %(default)s)"
    )
    parser.add_argument("--points", type=int, default=500, help="points in a large floor plan, 0 for none (default: %(default)s)")
    options = parser.parse_args(arguments)
    if options.pairs < 1 or options.points < 0:
        parser.error(f"--pairs is {options.pairs}, --points {options.points}; wanted at least 1 and 0")
    print(
        "| arena | components, holes | walls | pairs | of those without a way | largest error / extent | seconds | other method, seconds |"
    )
    print("|---|---|---|---|---|---|---|---|")
    worst = 0.0
    for name, arena in named_arenas(seed=options.seed, degrees=options.degrees):
        result = check(name, arena, pairs=options.pairs, seed=options.seed)
        worst = max(worst, result.error)
        print(
            f"| {name} | {arena.betti.components}, {arena.betti.holes} | {len(arena.wall_start)} | {result.pairs} | {result.without_way} "
            f"| {result.error:.1e} | {result.seconds:.2f} | {result.other_seconds:.2f} |",
            flush=True,
        )
    print(f"\nlargest error over extent {worst:.1e}, wanted at most {WANTED_ERROR:g}")
    if options.points:
        plan = large_plan(seed=options.seed)
        points = plan.draw_places(seed=options.seed, ids=np.arange(1, options.points + 1, dtype=np.uint64))
        began = time.process_time()
        Geodesics(plan).distances(points)
        seconds = time.process_time() - began
        print(f"{options.points} points in a floor plan of {len(plan.wall_start)} walls and {plan.betti.holes} holes: {seconds:.1f} s")
    return 0 if worst <= WANTED_ERROR else 1


def _turn(arena: Arena, degrees: float) -> Arena:
    shape = affinity.rotate(arena.polygon, degrees, origin=(0.0, 0.0)) if degrees else arena.polygon
    return build_arena(shape)


def _straight(roomy: shapely.Geometry, begin: Floats, end: Floats) -> Floats:
    """Return the length of each line that the area covers, shape (k,) [length], inf for others; none is 0."""
    lines = shapely.linestrings(np.stack([begin, end], axis=1))
    length = np.maximum(np.sqrt(np.sum((end - begin) ** 2, axis=1)), _NO_LENGTH / 100)
    return np.asarray(np.where(shapely.covers(roomy, lines), length, np.inf))


def _extent(arena: Arena) -> float:
    x_min, y_min, x_max, y_max = arena.bounds
    return max(x_max - x_min, y_max - y_min)


if __name__ == "__main__":
    sys.exit(main())
