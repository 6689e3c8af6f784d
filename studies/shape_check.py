"""How right the distances and the picture of a map are, in the scenarios of [Dir16] VI: ``python -m studies.shape_check``.

Every run is mapped by both methods with its walking speed given, so that the map is in the run's own lengths; nothing but the similarity
that lays the picture on the truth is fitted to it.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from firmware_protocol.units import NS_PER_S
from mapper.bottleneck import bottleneck_distance
from mapper.config import RecipeConfig, make_recipe
from mapper.embedding import embed_in_plane
from mapper.pipeline import compute_map
from mapper.types import MapResult, Method
from simulator.arenas.geodesics import geodesic_distances
from simulator.arenas.scenarios import find_scenario
from simulator.presets import find_preset
from simulator.world import World
from studies.cases import PackageFile, Study, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.comparison import fit_similarity
from studies.errors import StudyError
from studies.exploration import explore
from studies.truth import Floats, diagram_of

PRESETS = ("paper-units", "paper-50cm")
SCENARIOS = ("no-obstacle", "one-obstacle", "two-obstacles")
# Training takes seeds from 0 on, other studies those from 10,000 and from 60,000.
FIRST_SEED = 150_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeCase:
    """A run, and the method that maps it."""

    preset: str
    scenario: str
    method: Method
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """How near the map of one run comes to its truth; exact geodesics are those between the true places of the map's own points.

    Parameters
    ----------
    n_encounters, n_points
        Of the run, and of the largest component's subsample.
    holes, true_holes
        Counted, and of the arena.
    bottleneck
        Bottleneck distances of the diagrams of the map and of exact geodesics in dimensions 0 and 1, over the largest of these; finite
        intervals alone.
    metric_error
        Root of the sum of squared errors of the distances between points, over that of the squared exact ones.
    scale
        The factor that would bring the map's distances nearest to the exact ones: 1 where their scale is right.
    placement, placement_of_exact
        Root mean square distance of the picture's points from their true places after the best similarity, mirror images allowed, over the
        arena's side; and the same for classical scaling of the exact geodesics.
    """

    preset: str
    scenario: str
    method: Method
    seed: int
    n_encounters: int
    n_points: int
    holes: int
    true_holes: int
    bottleneck: tuple[float, float]
    metric_error: float
    scale: float
    placement: float
    placement_of_exact: float


def compute_shape(case: ShapeCase) -> Shape:
    """Simulate and map one run, and compare the map with the truth."""
    preset = find_preset(case.preset)
    arena = find_scenario(case.scenario).build(preset.side)
    world = World(arena, motion=preset.motion, ranges=preset.ranges, ids=range(1, preset.biobots + 1), seed=case.seed)
    explored = explore(world, landmarks=preset.landmarks, duration_s=preset.duration_s)
    result = compute_map(
        explored.table, explored.spells, make_recipe(RecipeConfig(method=case.method, speed_mps=preset.motion.speed, replicates=0))
    )
    places = true_places(world, result)
    exact = geodesic_distances(arena, places)
    part = result.components[0]
    finite = ([loops[np.isfinite(loops[:, 1])] for loops in one] for one in (part.intervals, diagram_of(exact)))
    picture = np.column_stack([result.points.x, result.points.y])[: part.n_points]
    return Shape(
        preset=case.preset,
        scenario=case.scenario,
        method=case.method,
        seed=case.seed,
        n_encounters=result.n_encounters,
        n_points=part.n_points,
        holes=result.betti_numbers[1],
        true_holes=arena.betti.holes,
        bottleneck=_bottlenecks(*finite, largest=float(exact.max())),
        metric_error=float(np.sqrt(((part.distances - exact) ** 2).sum() / (exact**2).sum())),
        scale=float((part.distances * exact).sum() / (part.distances**2).sum()),
        placement=_misplacement(picture, places) / preset.side,
        placement_of_exact=_misplacement(embed_in_plane(exact).coordinates, places) / preset.side,
    )


def true_places(world: World, result: MapResult) -> Floats:
    """Find where the encounters of the largest component's points were: half way between their biobots; shape (p, 2)."""
    points = slice(0, result.components[0].n_points)
    at_s = np.minimum(result.points.t_ns[points] / NS_PER_S, world.now_s)
    one, other = (world.positions_of(ids[points].tolist(), at_s) for ids in (result.points.id1, result.points.id2))
    return np.asarray((one + other) / 2.0)


def _bottlenecks(found: list[Floats], true: list[Floats], *, largest: float) -> tuple[float, float]:
    shares = [bottleneck_distance(one, other) / largest for one, other in zip(found, true, strict=True)]
    return shares[0], shares[1]


def _misplacement(picture: Floats, places: Floats) -> float:
    misses = fit_similarity(picture, places)(picture) - places
    return float(np.sqrt(np.mean(np.sum(misses**2, axis=1))))


SHAPES = Study(
    name="shape-check", compute=compute_shape, result_type=Shape, files=(PackageFile(package="mapper", path="data/classifier.json"),)
)


def describe(shapes: Sequence[Shape]) -> str:
    """Tell the runs of one preset, scenario and method, at least one, in a line: means, and standard errors after the signs."""
    first = shapes[0]
    figures = [
        _mean_and_error([100 * shape.bottleneck[1] for shape in shapes]),
        _mean_and_error([100 * shape.bottleneck[0] for shape in shapes]),
        _mean_and_error([100 * shape.metric_error for shape in shapes]),
        f"{np.mean([shape.scale for shape in shapes]):.3f} +- {np.std([shape.scale for shape in shapes]):.3f}",
        _mean_and_error([100 * shape.placement for shape in shapes]),
        f"{np.mean([100 * shape.placement_of_exact for shape in shapes]):4.1f}",
        f"{sum(shape.holes == shape.true_holes for shape in shapes)}/{len(shapes)}",
    ]
    return f"{first.preset:11} {first.scenario:13} {first.method:8} " + "   ".join(figures)


HEADER = (
    "preset      scenario      method   d_B H1 [%]    d_B H0 [%]    distances [%] scale (+- deviation) placement [%] exact  holes right"
)


def _mean_and_error(values: Sequence[float]) -> str:
    return f"{np.mean(values):4.1f} +- {np.std(values) / np.sqrt(len(values)):3.1f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.shape_check", description=__doc__)
    parser.add_argument("--preset", choices=PRESETS, action="append", help="may be repeated (default: both)")
    parser.add_argument("--scenario", choices=SCENARIOS, action="append", help="may be repeated (default: all)")
    parser.add_argument("--method", type=Method, choices=list(Method), action="append", help="may be repeated (default: both)")
    parser.add_argument("--runs", type=int, default=20, help="runs of each (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="first seed (default: %(default)s)")
    parser.add_argument("--journal", type=Path, default=Path("artifacts/shape_check.jsonl"), help="finished runs (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    groups = [
        [ShapeCase(preset=preset, scenario=scenario, method=method, seed=seed) for seed in range(options.seed, options.seed + options.runs)]
        for preset in options.preset or PRESETS
        for scenario in options.scenario or SCENARIOS
        for method in options.method or list(Method)
    ]
    try:
        cases = [case for group in groups for case in group]
        shapes = results_of(run_cases(SHAPES, cases, read_flags(options, journal=options.journal), label="shapes"))
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(HEADER)
    for index in range(len(groups)):
        print(describe(shapes[index * options.runs : (index + 1) * options.runs]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
