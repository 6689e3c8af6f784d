"""Compare how simulated insects move with theory: ``python -m studies.motion_theory``.

In the open: mean squared displacement and leg lengths, here; how often insects meet, ``studies.encounter_rate``; how they spread
between walls, ``studies.wall_density``; larvae in a dish, ``studies.larva_dish``.
"""

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from shapely.geometry import box

from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.legs import Floats, Legs
from simulator.motion import MotionParameters
from simulator.world import World
from studies import encounter_rate, larva_dish, wall_density
from studies.agreement import Agreement

# So large that no insect comes to a wall, so small a radius that hardly any two meet.
_OPEN_SIDE = 1e6
_NEVER = Ranges(detection=1e-3, communication=1e-3)
_FREE_PATHS = (0.5, 2.0, 10.0)
_FIRST_LEGS = 3


def mean_squared_displacement(*, free_paths: float, mean_leg: float, persistence: float) -> float:
    """Return E[r^2] [length^2] of a walk of exponential legs after some mean legs walked.

    Notes
    -----
    Turns strike at the rate v / l* and each leaves, of the heading's expectation, the mean cosine rho: headings t apart have the mean
    cosine exp(-(1 - rho) v t / l*). That is the correlation of an isotropic walk with the mean leg L = l* / (1 - rho), and E[r^2]
    depends on it alone: its double integral is 2 L^2 (s - 1 + exp(-s)), s = v t / L.
    """
    effective = mean_leg / (1.0 - persistence)
    s = free_paths * mean_leg / effective
    return 2.0 * effective**2 * (s + math.expm1(-s))


def open_world(motion: MotionParameters, *, insects: int, seed: int, keeps_legs: bool) -> World:
    """Put insects far from each other into a square of a million lengths."""
    arena = build_arena(box(0.0, 0.0, _OPEN_SIDE, _OPEN_SIDE))
    return World(arena, motion=motion, ranges=_NEVER, ids=range(1, insects + 1), seed=seed, keeps_legs=keeps_legs)


def compare_displacement(*, insects: int, seed: int, within: float = 0.02) -> list[Agreement]:
    """Compare mean squared displacements after 0.5, 2 and 10 mean legs, for isotropic and for persistent turns."""
    found = []
    for persistence in (0.0, 0.5, 0.9):
        world = open_world(MotionParameters(speed=1.0, mean_leg=1.0, persistence=persistence), insects=insects, seed=seed, keeps_legs=False)
        start = world.positions()
        for free_paths in _FREE_PATHS:
            world.run(free_paths)
            measured = float(np.mean(((world.positions() - start) ** 2).sum(axis=1)))
            theory = mean_squared_displacement(free_paths=free_paths, mean_leg=1.0, persistence=persistence)
            name = f"E[r^2], mean cosine {persistence:g}, {free_paths:g} mean legs walked"
            found.append(Agreement(name=name, measured=measured, theory=theory, within=within))
    return found


def power_law_distribution(length: Floats, *, exponent: float, shortest: float, longest: float) -> Floats:
    """Return the share of legs up to each length, of a power law p(l) ~ l^-mu between two lengths."""
    fall = 1.0 - exponent
    whole: Floats = -np.expm1(fall * np.log(np.clip(length, shortest, longest) / shortest)) / -math.expm1(
        fall * math.log(longest / shortest)
    )
    return whole


def compare_levy(*, insects: int, seed: int) -> list[Agreement]:
    """Compare the lengths of the first three legs of every insect with the truncated power law.

    The mean scatters by the standard deviation over the root of the count, and three times that is allowed. The largest distance between
    the two distributions is compared with what 1 in 1,000 samples of one law would exceed: 1.95 / sqrt(n) (Kolmogorov and Smirnov).
    """
    found = []
    for exponent, longest in ((1.5, 10.0), (2.0, 20.0), (3.0, 20.0)):
        motion = MotionParameters(speed=1.0, mean_leg=1.0, levy_exponent=exponent, longest_leg=longest)
        world = open_world(motion, insects=insects, seed=seed, keeps_legs=True)
        world.run(_FIRST_LEGS * longest + 1.0)
        length = np.sort(_first_legs(world.legs()))
        shares = power_law_distribution(length, exponent=exponent, shortest=motion.shortest_leg, longest=longest)
        steps = np.arange(length.size + 1) / length.size
        apart = max(float(np.max(shares - steps[:-1])), float(np.max(steps[1:] - shares)))
        scatter = 3.0 * float(length.std()) / math.sqrt(length.size)
        name = f"power law, mu = {exponent:g}, cut off at {longest:g} mean legs: "
        found.append(Agreement(name=name + "mean leg", measured=float(length.mean()), theory=1.0, within=scatter))
        limit = 1.95 / math.sqrt(length.size)
        found.append(Agreement(name=name + "1 - largest gap", measured=1.0 - apart, theory=1.0, within=limit))
    return found


def _first_legs(legs: Legs) -> Floats:
    """Lengths of the first few legs of every insect: all of them are over, so none is counted for being long."""
    first = np.searchsorted(legs.biobot, np.unique(legs.biobot))
    chosen = (first[:, None] + np.arange(_FIRST_LEGS)).ravel()
    length: Floats = (legs.t_end_s - legs.t_start_s)[chosen]
    return length


def compare_open(*, is_quick: bool, seed: int) -> list[Agreement]:
    """Compare displacement and leg lengths."""
    insects = 6_000 if is_quick else 200_000
    found = compare_displacement(insects=insects, seed=seed, within=0.06 if is_quick else 0.02)
    return found + compare_levy(insects=2_000 if is_quick else 30_000, seed=seed)


PARTS: Mapping[str, Callable[..., list[Agreement]]] = MappingProxyType(
    {"open": compare_open, "rate": encounter_rate.compare, "walls": wall_density.compare, "larva": larva_dish.compare}
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every figure beside its theory; 1 where one disagrees."""
    parser = argparse.ArgumentParser(prog="python -m studies.motion_theory", description=__doc__)
    parser.add_argument("--part", choices=list(PARTS), action="append", help="may be repeated (default: all)")
    parser.add_argument("--quick", action="store_true", help="fewer insects, wider limits: a minute less")
    parser.add_argument("--seed", type=int, default=1, help="(default: %(default)s)")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="draw the density between walls")
    options = parser.parse_args(arguments)
    disagreeing = 0
    for part in options.part or list(PARTS):
        print(part)
        for one in PARTS[part](is_quick=options.quick, seed=options.seed):
            print("  " + one.line(), flush=True)
            disagreeing += not one.agrees
    if options.figure is not None:
        wall_density.draw(options.figure, seed=options.seed, is_quick=options.quick)
    return 1 if disagreeing else 0


if __name__ == "__main__":
    sys.exit(main())
