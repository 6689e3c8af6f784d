"""How well chosen landmarks cover a swarm: ``python -m studies.landmark_choice [DOCUMENT]``.

Communication graphs of simulated swarms, after they have walked for a minute: dense ones as the presets have them (r_c = 8 r_d), and sparse
ones in many clusters (r_c = 4.8 r_d). In each, landmarks are chosen by the gateway's rule and by the simulator's, whose first pick is the
lowest id, and drawn at random a thousand times, with the same share of each cluster. Told is the covering radius: the most hops from any
biobot to the nearest landmark, over the clusters that have one. A document gets the table between its markers.
"""

import argparse
import random
import statistics
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from firmware_protocol.landmarks import choose_landmarks, select_landmarks
from simulator.arenas.scenarios import find_scenario
from simulator.presets import find_preset
from simulator.world import World
from studies.errors import StudyError
from studies.tables import put_between_markers

MARKERS = ("<!-- landmark-choice begins -->", "<!-- landmark-choice ends -->")
_PRESET, _SCENARIO = "paper-units", "two-obstacles"
_DISPERSION_S = 60.0
_SHARE = 0.15
MOST_OVER_BEST = 1.5
"""No choice may have more than this many times the radius of the best of the random ones."""

GRAPHS = {"dense": 1.0, "sparse": 0.6}
"""Communication radius, by that of the preset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cover:
    """Covering radii of one graph [hops]."""

    n_clusters: int
    mean_degree: float
    ours: int
    lowest_id: int
    best: int
    median: float


def make_graph(*, seed: int, reach: float) -> dict[int, set[int]]:
    """Return the communication graph of a swarm that has walked for a minute."""
    preset = find_preset(_PRESET)
    ranges = replace(preset.ranges, communication=preset.ranges.communication * reach)
    arena, ids = find_scenario(_SCENARIO).build(preset.side), range(1, preset.biobots + 1)
    world = World(arena, motion=preset.motion, ranges=ranges, ids=ids, seed=seed, keeps_legs=False)
    world.run(_DISPERSION_S)
    return world.adjacency()


def measure_cover(graph: Mapping[int, Collection[int]], *, seed: int, n_draws: int) -> Cover:
    """Compare the choices of one graph."""
    count = round(_SHARE * len(graph))
    chosen = choose_landmarks(graph, count=count, eligible=graph)
    given = [(one.members, len(one.picks)) for one in chosen if one.picks]
    draw = random.Random(f"landmark-choice {seed}")
    ids = sorted(graph)
    at = {node: index for index, node in enumerate(ids)}
    hops = np.full((len(ids), len(ids)), len(ids), dtype=np.int32)
    for node in ids:
        for other, distance in _hops_from(graph, node).items():
            hops[at[node], at[other]] = distance
    covered = np.array([at[node] for members, _ in given for node in members])

    def radius(picks: Collection[int]) -> int:
        chosen_rows = np.array([at[pick] for pick in picks])
        return int(hops[np.ix_(covered, chosen_rows)].min(axis=1).max())

    drawn = [radius([pick for members, share in given for pick in draw.sample(members, share)]) for _ in range(n_draws)]
    return Cover(
        n_clusters=len(chosen),
        mean_degree=statistics.fmean(len(heard) for heard in graph.values()),
        ours=radius([pick for one in chosen for pick in one.picks]),
        lowest_id=radius(select_landmarks(graph, count=count)),
        best=min(drawn),
        median=statistics.median(drawn),
    )


def _hops_from(graph: Mapping[int, Collection[int]], origin: int) -> dict[int, int]:
    """Count hops by widening circles: slow and obvious, and not the rule's own."""
    hops, circle, at = {origin: 0}, {origin}, 0
    while circle:
        at += 1
        circle = {other for node in circle for other in graph[node]} - hops.keys()
        hops |= dict.fromkeys(circle, at)
    return hops


def table_of(covers: Mapping[str, Sequence[Cover]], *, n_draws: int) -> str:
    """Return the table of a document."""
    ratio_name = f"worst ratio to the best of {n_draws:,} random choices"
    names = (
        "graph",
        "mean degree",
        "clusters",
        "first pick",
        "mean radius [hops]",
        ratio_name,
        "above 1.5",
        "not better than their median",
    )
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for name, found in covers.items():
        for rule in ("ours", "lowest_id"):
            radii = [getattr(cover, rule) for cover in found]
            over = [radius / cover.best for radius, cover in zip(radii, found, strict=True)]
            n_not_better = sum(radius >= cover.median for radius, cover in zip(radii, found, strict=True))
            label = "that covers best (gateway)" if rule == "ours" else "lowest id (simulator)"
            degree, clusters = (statistics.fmean(getattr(cover, key) for cover in found) for key in ("mean_degree", "n_clusters"))
            lines.append(
                f"| {name} | {degree:.1f} | {clusters:.1f} | {label} | {statistics.fmean(radii):.2f} | {max(over):.2f} | "
                f"{sum(ratio > MOST_OVER_BEST for ratio in over)} of {len(found)} | {n_not_better} of {len(found)} |"
            )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return the exit status: 0 done, 1 the gateway's rule misses its mark, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.landmark_choice", description="How well chosen landmarks cover a swarm.")
    parser.add_argument("document", nargs="?", type=Path, help="gets the table between its markers")
    parser.add_argument("--seeds", type=int, default=100, metavar="N", help="graphs of each kind (default: %(default)s)")
    parser.add_argument("--draws", type=int, default=1000, metavar="N", help="random choices in each (default: %(default)s)")
    options = parser.parse_args(arguments)
    if options.seeds < 1 or options.draws < 1:
        parser.error(f"--seeds {options.seeds} --draws {options.draws}; wanted at least 1 of each")
    covers = {
        name: [measure_cover(make_graph(seed=seed, reach=reach), seed=seed, n_draws=options.draws) for seed in range(1, options.seeds + 1)]
        for name, reach in GRAPHS.items()
    }
    table = table_of(covers, n_draws=options.draws)
    print(table)
    if options.document is not None:
        try:
            text = put_between_markers(options.document.read_text(), table, path=options.document, markers=MARKERS)
        except (StudyError, OSError) as error:
            print(f"landmark_choice: {error}", file=sys.stderr)
            return 2
        options.document.write_text(text)
    found = [cover for some in covers.values() for cover in some]
    return 0 if all(cover.ours <= MOST_OVER_BEST * cover.best and cover.ours < cover.median for cover in found) else 1


if __name__ == "__main__":
    sys.exit(main())
