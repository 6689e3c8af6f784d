"""How fast Rips persistence is beside other programs: ``python -m studies.bench_rips``.

Two kinds of distances: straight ones in a square with two obstacles, and those of the encounter metric in a simulated run. They are
rounded to single precision first, because some programs count in it, so that all diagrams must be equal and are compared. Programs take
turns, all but giotto-ph in one process; medians are told, and how many times faster ours is. Ours includes numbering the edges and
naming the births. What is not installed is left out, with the reason (``pip install -r requirements/peers.txt``).
"""

import argparse
import statistics
import sys
from collections.abc import Mapping, Sequence

import numpy as np

from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import compute_map
from mapper.types import Method
from simulator.arenas.scenarios import find_scenario
from studies.errors import OtherDiagramError, StudyError
from studies.giotto_peer import GiottoProgram
from studies.rips_peers import Missing, Peer, find_dionysus, find_peers
from studies.samples import measure_straight, sample_arena, spread
from studies.trials import SETTINGS, simulate
from studies.truth import Floats, Intervals

_SIZES = (150, 500, 1000)
_SEED = 1
# Dionysus makes every triangle: with more points than this it needs minutes.
_MOST_FOR_DIONYSUS = 150


def make_matrices(sizes: Sequence[int]) -> dict[str, tuple[Floats, ...]]:
    """Make distances of both kinds, shape (n, n) for each size n."""
    largest = max(sizes)
    _, straight = sample_arena(find_scenario("two-obstacles").build(50.0), measure_straight, n_points=largest, seed=_SEED)
    table, spells, _ = simulate(SETTINGS["shapes/long"], _SEED)
    recipe = make_recipe(RecipeConfig(method=Method.PAPER, n_points=largest))
    met = compute_map(table, spells, recipe).components[0].distances
    if len(met) < largest:
        raise StudyError(f"the simulated run gave {len(met)} points, fewer than {largest}; ask for smaller sizes")
    kinds = {"square, two obstacles": straight, "encounter metric": met}
    chosen = {name: spread(distances, n_points=largest) for name, distances in kinds.items()}
    return {
        name: tuple(distances[np.ix_(chosen[name][:n], chosen[name][:n])].astype(np.float32).astype(np.float64) for n in sizes)
        for name, distances in kinds.items()
    }


def time_in_turns(distances: Floats, peers: Mapping[str, Peer], *, rounds: int) -> tuple[dict[str, float], dict[str, Intervals]]:
    """Call every program once a round, after one call that does not count; return median wall times [s] and the intervals of each."""
    found = {name: peer(distances)[1] for name, peer in peers.items()}
    taken: dict[str, list[float]] = {name: [] for name in peers}
    for _ in range(rounds):
        for name, peer in peers.items():
            taken[name].append(peer(distances)[0])
    return {name: statistics.median(times) for name, times in taken.items()}, found


def check_equal(found: Mapping[str, Intervals], *, matrix: str) -> None:
    """Compare all diagrams with the first, bar by bar; those without length do not count.

    Raises
    ------
    OtherDiagramError
        One has other bars.
    """
    (_, first), *others = found.items()
    for name, intervals in others:
        for dimension in (0, 1):
            if _lasting(intervals[dimension]) != _lasting(first[dimension]):
                raise OtherDiagramError(peer=name, matrix=matrix, dimension=dimension)


def _lasting(bars: Floats) -> list[list[float]]:
    return sorted(bars[bars[:, 1] > bars[:, 0]].tolist())


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; return the exit status: 0 done, 1 a diagram differs or nothing of ours is installed, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.bench_rips", description="How fast Rips persistence is beside other programs.")
    parser.add_argument("--rounds", type=int, default=7, metavar="N", help="calls of each that count (default: %(default)s)")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(_SIZES), metavar="N", help="numbers of points (default: 150 500 1000)")
    parser.add_argument("--dionysus", action="store_true", help="time Dionysus too, up to 150 points, in one round")
    options = parser.parse_args(arguments)
    if options.rounds < 1 or not all(4 <= size <= 1000 for size in options.sizes):
        parser.error(f"--rounds {options.rounds} --sizes {options.sizes}; wanted at least 1 round, and 4 to 1000 points")
    peers = _installed(find_peers())
    dionysus = _installed(find_dionysus()) if options.dionysus else {}
    if not any(name.startswith("ours") for name in peers):
        print("error: neither redzed-tda nor holos-tda is installed; pip install holos-tda", file=sys.stderr)
        return 1
    print("making the matrices", file=sys.stderr)
    try:
        for kind, matrices in make_matrices(options.sizes).items():
            for distances in matrices:
                slow = dionysus if len(distances) <= _MOST_FOR_DIONYSUS else {}
                _compare(f"{kind}, {len(distances)} points", distances, peers, slow, rounds=options.rounds)
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    finally:
        for peer in peers.values():
            if isinstance(peer, GiottoProgram):
                peer.close()
    return 0


def _compare(matrix: str, distances: Floats, peers: Mapping[str, Peer], slow: Mapping[str, Peer], *, rounds: int) -> None:
    times, found = time_in_turns(distances, peers, rounds=rounds)
    slow_times, slow_found = time_in_turns(distances, slow, rounds=1)
    check_equal(found | slow_found, matrix=matrix)
    ours = next(iter(times.values()))
    print(f"\n{matrix}; diagrams equal")
    for name, seconds in (times | slow_times).items():
        print(f"  {name:28} {1e3 * seconds:10.2f} ms  {seconds / ours:8.2f} x", flush=True)


def _installed(peers: Mapping[str, Peer | Missing]) -> dict[str, Peer]:
    for name, peer in peers.items():
        if isinstance(peer, Missing):
            print(f"left out: {name}: {peer.reason}", file=sys.stderr)
    return {name: peer for name, peer in peers.items() if not isinstance(peer, Missing)}


if __name__ == "__main__":
    sys.exit(main())
