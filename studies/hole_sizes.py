"""How right the sizes of holes are, on simulated runs that played no part in training: ``python -m studies.hole_sizes``.

For each swarm and form of obstacle: the median of what is told over the truth, the root mean square of the relative error, and in how
many holes the truth is within one and within two of the errors told. Truth is the hull of the obstacle, that is the shortest way around
it and what that encloses; only of an angle is the obstacle itself smaller.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mapper.config import RecipeConfig, make_recipe
from mapper.hole_sizes import HoleSize, SizeModel, estimate_size, load_size_model
from mapper.types import Method
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.hole_runs import HELD_OUT_SEED, SWARMS, HoleRun, MatchedHole, ObstacleForm
from studies.train_hole_sizes import collect

DEFAULT_RUNS = {"paper-units": 60, "paper-units, three times as long": 30, "paper-50cm": 15, "hisser-field": 120}
_HEAD = "swarm                             form       holes     perimeter               area"
_COLUMNS = "                                                    bias   rms  1 err 2 err    bias   rms  1 err 2 err"


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How a quantity agrees with the truth: median ratio less 1, rms relative error, and shares within one and two errors told."""

    bias: float
    rms: float
    within_one: float
    within_two: float

    def cell(self) -> str:
        """Tell it in a part of a line."""
        return f"{self.bias:+7.1%}{self.rms:6.1%}{self.within_one:7.0%}{self.within_two:6.0%}"


def compare(told: Sequence[float], errors: Sequence[float], true: Sequence[float]) -> Agreement:
    """Compare what is told, with its errors, with the truth; at least one of each."""
    values, bars, truth = (np.asarray(column, dtype=np.float64) for column in (told, errors, true))
    off = np.abs(values - truth) / bars
    return Agreement(
        bias=float(np.median(values / truth)) - 1.0,
        rms=float(np.sqrt(np.mean((values / truth - 1.0) ** 2))),
        within_one=float((off <= 1.0).mean()),
        within_two=float((off <= 2.0).mean()),
    )


def describe(holes: Sequence[MatchedHole], model: SizeModel, *, head: str) -> str:
    """Make the line of some holes."""
    sizes = [estimate_size(hole.loop, model) for hole in holes]

    def of(quantity: Callable[[HoleSize], float], error: Callable[[HoleSize], float], true: Callable[[MatchedHole], float]) -> str:
        return compare([quantity(size) for size in sizes], [error(size) for size in sizes], [true(hole) for hole in holes]).cell()

    perimeter = of(lambda size: size.perimeter, lambda size: size.perimeter_error, lambda hole: hole.hull_perimeter)
    area = of(lambda size: size.area, lambda size: size.area_error, lambda hole: hole.hull_area)
    return f"{head:44}{len(holes):5d} {perimeter} {area}"


def tell(runs: Sequence[HoleRun], model: SizeModel) -> list[str]:
    """Make the lines of all swarms and forms."""
    lines = []
    for swarm in dict.fromkeys(run.swarm for run in runs):
        own = [run for run in runs if run.swarm == swarm]
        groups: list[tuple[str, list[HoleRun]]] = [(form, [run for run in own if run.form is form]) for form in ObstacleForm]
        for form, group in [*groups, ("all", own)]:
            holes = [hole for run in group for hole in run.matched]
            if holes:
                lines.append(describe(holes, model, head=f"{swarm:34}{form}"))
        obstacles, unmatched = sum(run.obstacles for run in own), sum(run.unmatched for run in own)
        found = sum(len(run.matched) for run in own)
        lines.append(f"{'':34}{found} holes for {obstacles} obstacles; {unmatched} more go around none or several, and are not compared")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.hole_sizes", description=__doc__)
    parser.add_argument("--method", type=Method, choices=list(Method), default=Method.DEFAULT, help="(default: %(default)s)")
    parser.add_argument("--swarm", choices=list(SWARMS), action="append", help="may be repeated (default: all)")
    parser.add_argument("--runs", type=int, help="runs of each swarm (default: 15 to 120)")
    parser.add_argument("--seed", type=int, default=HELD_OUT_SEED, help="first seed; training takes those from 0 on (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs is not None and options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    metric = make_recipe(RecipeConfig(method=options.method)).metric
    model = load_size_model(options.method, metric)
    if model is None:
        print(f"error: no numbers are shipped for method {options.method}, metric {metric}; train them", file=sys.stderr)
        return 1
    runs = {name: options.runs or DEFAULT_RUNS[name] for name in options.swarm or DEFAULT_RUNS}
    try:
        found = collect(options.method, read_flags(options, journal=None), runs=runs, first_seed=options.seed)
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"method {options.method}, metric {metric}, seeds from {options.seed}")
    print("\n".join([_HEAD, _COLUMNS, *tell(found, model)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
