"""How far a map may be believed whose insects do not walk at random: ``python -m studies.other_walkers``.

Insects that follow walls or are crowded, in arenas without and with obstacles, on seeds that served no training. Of the holes and of the
numbers of holes that the models call sure, it is asked which are so: in runs whose contacts betray the walkers, and in the others.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from shapely import affinity
from shapely.geometry import Point, Polygon

from mapper.confidence import judge_components, load_models
from mapper.confidence.assess import LEAST_PROBABILITY
from mapper.config import RecipeConfig, make_recipe
from mapper.contact_statistics import measure_walkers, walks_at_random
from mapper.pipeline import compute_evidence
from mapper.types import Recipe
from simulator.arenas.arena import Arena, build_arena
from simulator.motion import WallLaw
from simulator.presets import PRESETS, Preset
from simulator.world import World
from studies.arenas import ArenaFamily, draw_arena
from studies.cases import PackageFile, Study, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.confidence_runs import judge_loops, true_places
from studies.errors import StudyError
from studies.exploration import Exploration, explore
from studies.truth import obstacle_points

_FIRST_SEED: Final = 400_000
_SURE: Final = 0.9
_DRAWN_SIDE: Final = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one run gave: how it is judged by its contacts, its loops that are told of, and its number of holes, beside the truth."""

    walkers: str
    seed: int
    is_random: bool
    unevenness: float | None
    at_once: float
    alike_lengths: float | None
    true_holes: int
    chances: tuple[float, ...]
    is_there: tuple[bool, ...]
    value: int
    probability: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Outing:
    """A run to be made; ``walkers`` is one of `WALKERS`."""

    walkers: str
    seed: int
    recipe: Recipe


def _squares(seed: int, side: float) -> Arena:
    return _scaled(ArenaFamily.SQUARES, seed, side)


def _big_square(seed: int, side: float) -> Arena:
    return _scaled(ArenaFamily.BIG_SQUARE, seed, side)


def _scaled(family: ArenaFamily, seed: int, side: float) -> Arena:
    drawn = draw_arena(family, seed=seed)
    return build_arena(affinity.scale(drawn, side / _DRAWN_SIDE, side / _DRAWN_SIDE, origin=(0, 0)))


def _dish(seed: int, side: float) -> Arena:
    """Draw a dish, every other with a disc of 0.3 to 0.5 of its width off the middle."""
    dish = Point(side / 2, side / 2).buffer(side / 2)
    if seed % 2 == 0:
        return build_arena(dish)
    rng = np.random.default_rng([11, seed])
    x, y = side / 2 + side * rng.uniform(-0.1, 0.1, size=2)
    disc = Point(float(x), float(y)).buffer(side * float(rng.uniform(0.15, 0.25)))
    return build_arena(Polygon(dish.exterior, [disc.exterior]))


def _following(preset: Preset, *, exit_hazard: float, persistence: float) -> Preset:
    return replace(preset, motion=replace(preset.motion, wall_law=WallLaw.FOLLOW, exit_hazard=exit_hazard, persistence=persistence))


_UNITS, _LARVA, _HISSER = PRESETS["paper-units"], PRESETS["jeanson-larva"], PRESETS["hisser-field"]

WALKERS: Final[dict[str, tuple[Preset, Callable[[int, float], Arena]]]] = {
    "paper-units, along walls for ever": (_following(_UNITS, exit_hazard=0.0, persistence=0.8), _squares),
    "paper-units, along walls for 20 s": (_following(_UNITS, exit_hazard=0.05, persistence=0.0), _squares),
    "jeanson-larva in its dish": (_LARVA, _dish),
    "hisser-field, along walls for 8 s": (_following(_HISSER, exit_hazard=0.12, persistence=0.0), _big_square),
    "hisser-field as it is": (_HISSER, _big_square),
}
"""Who walks where. All but the last follow walls; in the last they walk at random, but hear each other half a metre away."""


def walk(walkers: str, seed: int) -> tuple[Exploration, Arena, World]:
    """Simulate one run of `WALKERS`."""
    preset, draw = WALKERS[walkers]
    arena = draw(seed, preset.side)
    world = World(arena, motion=preset.motion, ranges=preset.ranges, ids=range(1, preset.biobots + 1), seed=seed)
    run = explore(world, landmarks=preset.landmarks, duration_s=preset.duration_s, dispersion_s=preset.dispersion_s)
    return run, arena, world


def compute_outcome(outing: Outing) -> Outcome:
    """Simulate and map one run, and compare what it would tell, were it not for the contacts, with the truth."""
    run, arena, world = walk(outing.walkers, outing.seed)
    models = load_models(outing.recipe.method, outing.recipe.metric)
    if models is None:
        raise StudyError(f"nothing tells how sure a map of method {outing.recipe.method}, metric {outing.recipe.metric} is")
    statistics = measure_walkers(run.table, run.spells)
    result, gathered = compute_evidence(run.table, run.spells, outing.recipe)
    verdict = judge_components(models, gathered, run.table, n_components=result.n_components)
    is_there = judge_loops(gathered[0], true_places(result, world), obstacle_points(arena))
    is_told = verdict.chances[0] >= LEAST_PROBABILITY
    return Outcome(
        walkers=outing.walkers,
        seed=outing.seed,
        is_random=walks_at_random(statistics),
        unevenness=statistics.unevenness,
        at_once=statistics.at_once,
        alike_lengths=statistics.alike_lengths,
        true_holes=arena.betti.holes,
        chances=tuple(verdict.chances[0][is_told].tolist()),
        is_there=tuple(is_there[is_told].tolist()),
        value=verdict.count.value,
        probability=verdict.count.probability,
    )


OUTINGS = Study(
    name="other-walkers",
    compute=compute_outcome,
    result_type=Outcome,
    files=(PackageFile(package="mapper", path="data/classifier.json"), PackageFile(package="mapper", path="data/confidence.json")),
)


def tell(name: str, outcomes: Sequence[Outcome]) -> str:
    """Tell in one row what is so of what is told: holes of 90 % or more, all loops told of, and numbers of holes of 90 % or more."""
    sure = [is_there for one in outcomes for chance, is_there in zip(one.chances, one.is_there, strict=True) if chance >= _SURE]
    loops = [is_there for one in outcomes for is_there in one.is_there]
    counts = [one.value == one.true_holes for one in outcomes if one.probability >= _SURE]
    right = [one.value == one.true_holes for one in outcomes]
    return f"{name:44}{len(outcomes):5}{_share(sure):>20}{_share(loops):>20}{_share(counts):>20}{_share(right):>20}"


def _share(is_so: Sequence[bool]) -> str:
    return f"{sum(is_so)} of {len(is_so)}" + (f" = {sum(is_so) / len(is_so):.0%}" if is_so else "")


def main(given: Sequence[str] | None = None) -> int:
    """Print the table; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.other_walkers", description=__doc__)
    parser.add_argument("--walkers", choices=list(WALKERS), action="append", help="may be repeated (default: all)")
    parser.add_argument("--runs", type=int, default=20, help="runs of each (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=_FIRST_SEED, help="first seed (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(given)
    if options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    recipe = make_recipe(RecipeConfig())
    everything: list[Outcome] = []
    head = f"{'walkers':44}{'runs':>5}{'holes of 90 %: so':>20}{'loops told of: so':>20}{'numbers of 90 %':>20}{'numbers right':>20}"
    print(f"seeds from {options.seed}\n{head}")
    try:
        for name in options.walkers or list(WALKERS):
            cases = [Outing(walkers=name, seed=seed, recipe=recipe) for seed in range(options.seed, options.seed + options.runs)]
            outcomes = results_of(run_cases(OUTINGS, cases, read_flags(options, journal=None), label=name))
            betrayed = [one for one in outcomes if not one.is_random]
            print(tell(name, outcomes) + f"   betrayed: {len(betrayed)}", flush=True)
            everything += outcomes
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(tell("all whose contacts betray it", [one for one in everything if not one.is_random]))
    print(tell("all others", [one for one in everything if one.is_random]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
