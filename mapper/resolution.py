"""What size of obstacle a map shows, and how often a map shows a hole that is not there: laws fitted to simulated runs.

The runs, the fit and the residuals are in docs/feasibility.md; ``python -m studies.feasibility_check`` repeats them. The constants are in
``data/feasibility.json``. The laws are for one square obstacle in a square arena mapped by the default method.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from math import exp, inf, log, pi, sqrt

from mapper.feasibility import encounter_rate, expected_encounters, time_until
from mapper.plan import Plan

# What a map is said to show.
USUAL_CHANCE = 0.8
EVEN_CHANCE = 0.5
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Law:
    """The fitted constants; lengths are shares of the arena's side L, the square root of its area.

    Parameters
    ----------
    crowd, path_power, floor, steepness
        c, p, c_0 and k of ``even_side`` and ``chance_found``.
    false_hole
        Constant and factors of ``chance_of_false_hole``, by name.
    dispersion, relative_error
        Of the count of encounters: its variance is dispersion times the mean, and the square of relative_error times the mean.
    ranges
        Name of a quantity to the least and the greatest value in the runs.
    fitted_on, command
        Where the constants come from.
    """

    crowd: float
    path_power: float
    floor: float
    steepness: float
    false_hole: Mapping[str, float]
    dispersion: float
    relative_error: float
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fitted_on: str = ""
    command: str = ""


@cache
def load_law() -> Law:
    """Read the constants that the package ships."""
    content = json.loads(resources.files("mapper").joinpath("data", "feasibility.json").read_text(encoding="utf-8"))
    ranges = {name: (float(least), float(greatest)) for name, (least, greatest) in content.pop("ranges").items()}
    return Law(**content, ranges=ranges)


def quantities(plan: Plan) -> dict[str, float]:
    """Return the numbers without unit that decide: those of ``Law.ranges``."""
    return {
        "biobots": plan.biobots,
        "landmarks": plan.landmarks,
        "detection radius over side": plan.detection_radius / plan.side,
        "mean leg over side": plan.mean_leg / plan.side,
        "path over side": plan.path / plan.side,
        "landmarks' discs over area": plan.landmarks * pi * plan.detection_radius**2 / plan.area,
        "encounters": expected_encounters(plan),
    }


def outside_ranges(plan: Plan, law: Law) -> tuple[str, ...]:
    """Name the quantities with which nothing was run: there the laws are a guess."""
    found = quantities(plan)
    return tuple(
        f"{name} {found[name]:.3g} (checked: {least:.3g} to {greatest:.3g})"
        for name, (least, greatest) in law.ranges.items()
        if name in found and not least * (1.0 - _ROUNDING) <= found[name] <= greatest * (1.0 + _ROUNDING)
    )


def even_side(plan: Plan, law: Law) -> float:
    """Return the side of the square obstacle that every other map shows [m]; inf without landmarks.

    Notes
    -----
    s^2 = r^2 + (c_0 L)^2 + (c L)^2 (v T / L)^p / (N N_l), N the encounters expected to begin, N_l the landmarks. Nothing finer than the
    detection radius r is seen, for that is how exactly an encounter is at a place; c_0 is what the method blurs, however much it is
    given; and the last term falls with the number of distances known, one from each encounter to each landmark. Of long times a part of
    that gain is lost.
    """
    if plan.landmarks == 0:
        return inf
    known = encounter_rate(plan) * plan.duration_s * plan.landmarks
    length = plan.side
    noise = (law.crowd * length) ** 2 * (plan.path / length) ** law.path_power / known if known > 0 else inf
    return sqrt(plan.detection_radius**2 + (law.floor * length) ** 2 + noise)


def side_found(plan: Plan, law: Law, *, chance: float) -> float:
    """Return the side of the square obstacle that a map shows with a chance in (0, 1) [m]; inf without landmarks."""
    return even_side(plan, law) * float((chance / (1.0 - chance)) ** (1.0 / law.steepness))


def chance_found(plan: Plan, law: Law, *, obstacle: float) -> float:
    """Say how likely a hole of the map goes around a square obstacle of this side [m]: 1 / (1 + (s_50 / s)^k)."""
    return 1.0 / (1.0 + float((even_side(plan, law) / obstacle) ** law.steepness))


def chance_of_false_hole(plan: Plan, law: Law) -> float:
    """Say how likely the map of an empty arena shows a hole: logistic in the logarithms of what ``Law.false_hole`` names.

    Notes
    -----
    A landmark's disc is crossed in no time, so the more of the arena those discs take, the more the map folds; and where legs are short, a
    straight way and a crooked one take very different times. In single plans the runs had half or twice as many.
    """
    found = quantities(plan)
    if found["encounters"] <= 0 or plan.landmarks == 0:
        return 0.0
    score = sum(factor * (log(found[name]) if name != "constant" else 1.0) for name, factor in law.false_hole.items())
    return 1.0 / (1.0 + exp(-max(-50.0, min(50.0, score))))


def count_deviation(plan: Plan, law: Law) -> float:
    """Return the standard deviation of the number of encounters from run to run."""
    mean = expected_encounters(plan)
    return sqrt(law.dispersion * mean + (law.relative_error * mean) ** 2)


def largest_checked(plan: Plan, law: Law) -> float:
    """Return the side of the largest obstacle in the runs [m], as a share of this arena; no law speaks of larger ones."""
    return law.ranges["obstacle over side"][1] * plan.side


def time_to_find(plan: Plan, law: Law, *, obstacle: float, chance: float = USUAL_CHANCE) -> float | None:
    """Return how long it takes until a square obstacle of this side [m] is found with a chance [s]; None: not in what is looked at."""
    return time_until(plan, lambda later: chance_found(later, law, obstacle=obstacle) >= chance)
