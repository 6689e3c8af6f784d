"""Whether outlines go around one obstacle each: ``python -m studies.outlines``.

In random arenas, as many of the longest intervals as there are obstacles are outlined, from exact geodesics between points spread over
the arena, or from those with an error on each. An arena counts as right when every outline goes around just one obstacle, and around
each obstacle goes one. Beside the mapper's outlines stands the plain way: the edge that gave birth to the loop, and the shortest path
back through older edges.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from mapper.errors import MapError
from mapper.outlines import outline_holes
from mapper.persistence import Diagram, rips_persistence
from mapper.types import IntArray
from simulator.arenas.arena import build_arena
from simulator.arenas.geodesics import geodesic_distances
from studies.arenas import ArenaFamily, draw_arena
from studies.samples import sample_arena
from studies.scores import winding_number
from studies.truth import Floats, obstacle_points

# Every fourth arena of the family of squares has 2 obstacles, and every fourth 3; small squares are 4 to 6.
_CASES = (
    ("2 squares", ArenaFamily.SQUARES, 4, 2),
    ("3 squares", ArenaFamily.SQUARES, 4, 3),
    ("4-6 squares", ArenaFamily.SMALL_SQUARES, 1, 0),
)
_HELD_OUT_SEED = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """How one way of drawing did in one arena: whether all outlines were right, time of the core [s] and corners of each outline."""

    is_right: bool
    seconds: float
    n_corners: float


def close_birth_edge(distances: Floats, diagram: Diagram, row: int) -> IntArray:
    """Close the birth edge of a loop by a shortest path through older edges: points in order, not closed."""
    edge = diagram.birth_edges[row]
    ends = diagram.filtration.ends(np.arange(1, diagram.filtration.between(edge[:1], edge[1:])[0]))
    older = csr_array((distances[tuple(ends.T)], tuple(ends.T)), shape=distances.shape)
    _, before = dijkstra(older, directed=False, indices=edge[:1], return_predecessors=True)
    path = [int(edge[1])]
    while path[-1] != edge[0]:
        path.append(int(before[0, path[-1]]))
    return np.array(path)


def draw_both(distances: Floats, places: Floats, obstacles: Floats) -> tuple[Drawn, Drawn]:
    """Outline as many of the longest intervals as there are obstacles: as the mapper does, and by birth edges."""
    diagram = rips_persistence(distances)
    rows = np.arange(min(len(obstacles), len(diagram.birth_edges)))
    begin = time.process_time()
    ours = outline_holes(distances, diagram, rows)
    middle = time.process_time()
    plain = [close_birth_edge(distances, diagram, row) for row in rows.tolist()]
    end = time.process_time()
    return (
        _judge([places[outline] for outline in ours], obstacles, seconds=middle - begin),
        _judge([places[outline] for outline in plain], obstacles, seconds=end - middle),
    )


def _judge(outlines: Sequence[Floats], obstacles: Floats, *, seconds: float) -> Drawn:
    encloses = np.array([[winding_number(outline, obstacle) != 0 for obstacle in obstacles] for outline in outlines])
    is_right = len(outlines) == len(obstacles) and bool((encloses.sum(axis=0) == 1).all() and (encloses.sum(axis=1) == 1).all())
    n_outlines = max(1, len(outlines))
    return Drawn(is_right=is_right, seconds=seconds / n_outlines, n_corners=sum(map(len, outlines)) / n_outlines)


def run_case(family: ArenaFamily, *, step: int, first: int, arenas: int, n_points: int, error: float) -> Iterator[tuple[Drawn, Drawn]]:
    """Draw the outlines in one arena after the other.

    Parameters
    ----------
    step, first
        Which seeds of the family are taken.
    error
        Standard deviation of the logarithm of each distance's error.
    """
    for seed in range(_HELD_OUT_SEED + first, _HELD_OUT_SEED + first + step * arenas, step):
        arena = build_arena(draw_arena(family, seed=seed))
        places, distances = sample_arena(arena, geodesic_distances, n_points=n_points, seed=seed)
        errors = np.triu(np.random.default_rng(seed).normal(0.0, error, distances.shape), 1)
        yield draw_both(distances * np.exp(errors + errors.T), places, obstacle_points(arena))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; return the exit status: 0 done, 1 no engine for persistence, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.outlines", description="Whether outlines go around one obstacle each.")
    parser.add_argument("--arenas", type=int, default=100, metavar="N", help="arenas of each kind (default: %(default)s)")
    parser.add_argument("--points", type=int, default=150, metavar="N", help="points in each (default: %(default)s)")
    options = parser.parse_args(arguments)
    if options.arenas < 1 or options.points < 20:
        parser.error(f"--arenas {options.arenas} --points {options.points}; wanted at least 1 and 20")
    print(f"{options.arenas} arenas each, {options.points} points; right / ms per outline / corners\n")
    print(f"{'arenas':14}{'error':>7}   {'mapper':24}{'birth edge and shortest path':24}")
    try:
        for name, family, step, first in _CASES:
            for error in (0.0, 0.1):
                case = run_case(family, step=step, first=first, arenas=options.arenas, n_points=options.points, error=error)
                ours, plain = zip(*case, strict=True)
                print(f"{name:14}{error:7.0%}   {_summary(ours):24}{_summary(plain):24}", flush=True)
    except MapError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    return 0


def _summary(drawn: Sequence[Drawn]) -> str:
    right = statistics.fmean(one.is_right for one in drawn)
    milliseconds = 1e3 * statistics.median(one.seconds for one in drawn)
    return f"{right:6.1%} {milliseconds:6.2f} {statistics.fmean(one.n_corners for one in drawn):6.1f}"


if __name__ == "__main__":
    sys.exit(main())
