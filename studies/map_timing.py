"""Time maps of one table in a process of its own: ``python -m studies.map_timing CUT.npz CASE --result OUT.npz``.

Tells times, stages and memory as JSON. Nothing but the mapper is imported, so that memory and start-up are its own.
"""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import compute_map
from mapper.types import MapResult, Method, Recipe
from studies.cut import Cut, load_cut
from studies.peak_memory import peak_memory

CASES: Mapping[str, Recipe] = MappingProxyType(
    {
        "paper": make_recipe(RecipeConfig(method=Method.PAPER)),
        "paper, all kept": make_recipe(RecipeConfig(method=Method.PAPER, outlier_q=1.0)),
        "default, 150 points": make_recipe(RecipeConfig(n_points=150)),
        "default": make_recipe(RecipeConfig()),
    }
)
"""What is timed. Of the paper's method also without its filter: then every encounter can be picked, as in `studies.plain_paths`."""

_WARM_UP_ENCOUNTERS = 2000


def time_map(cut: Cut, recipe: Recipe) -> tuple[dict[str, float], dict[str, float], MapResult]:
    """Make one map; return seconds by stage, by the wall's clock and of all cores, and the map.

    Notes
    -----
    Stages are those that ``progress`` tells; of several components they are summed.
    """
    wall_s: dict[str, float] = {}
    core_s: dict[str, float] = {}
    stage, since = "", (time.perf_counter(), time.process_time())

    def begin(next_stage: str, _share: float) -> None:
        nonlocal stage, since
        now = time.perf_counter(), time.process_time()
        if stage:
            wall_s[stage] = wall_s.get(stage, 0.0) + now[0] - since[0]
            core_s[stage] = core_s.get(stage, 0.0) + now[1] - since[1]
        stage, since = next_stage, now

    result = compute_map(cut.table, cut.spells, recipe, progress=begin)
    begin("", 1.0)
    return wall_s, core_s, result


def store_result(result: MapResult, path: Path) -> None:
    """Write what two maps of one table are compared by; of components the largest."""
    part = result.components[0]
    np.savez(
        path,
        encounter=result.points.encounter,
        distances=part.distances,
        intervals_0=part.intervals[0],
        intervals_1=part.intervals[1],
        betti_numbers=np.array(result.betti_numbers),
        cover_radius=np.array(part.cover_radius),
        coordinates=np.column_stack([result.points.x, result.points.y]),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Make maps of one table; print their times and the peak of memory as JSON."""
    parser = argparse.ArgumentParser(prog="python -m studies.map_timing", description="Time maps of one table.")
    parser.add_argument("cut", type=Path, metavar="CUT.npz", help="a table that studies.bench_map wrote")
    parser.add_argument("case", choices=CASES, help="how the map is made")
    parser.add_argument("--repeats", type=int, default=5, metavar="R", help="maps that are timed (default: %(default)s)")
    parser.add_argument("--cold", action="store_true", help="no small map first: to time the start of a program")
    parser.add_argument("--result", type=Path, metavar="OUT.npz", help="where the last map goes")
    options = parser.parse_args(arguments)
    cut, recipe = load_cut(options.cut), CASES[options.case]
    if not options.cold:
        time_map(cut.first(_WARM_UP_ENCOUNTERS), recipe)
    runs = []
    for _ in range(options.repeats):
        wall_s, core_s, result = time_map(cut, recipe)
        runs.append({"wall_s": wall_s, "core_s": core_s})
    peak = peak_memory()
    if options.result is not None:
        store_result(result, options.result)
    print(json.dumps({"encounters": len(cut.table), "points": len(result.points), "peak_bytes": peak, "runs": runs}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
