"""Fit the laws of `mapper.resolution` to simulated runs, by maximum likelihood."""

from collections.abc import Callable, Sequence
from math import exp, log

import numpy as np
from scipy.optimize import minimize

from mapper.feasibility import encounter_rate
from mapper.plan import Plan
from mapper.resolution import Law, chance_found, quantities
from mapper.types import FloatArray
from studies.feasibility_runs import OBSTACLE, Outcome, ScaledPlan

# Larger obstacles leave the insects little more than a corridor.
LARGEST_OBSTACLE = 0.5
_FALSE_HOLE_TERMS = ("landmarks' discs over area", "mean leg over side")
_LEAST_CHANCE = 1e-9

Vector = np.ndarray[tuple[int], np.dtype[np.float64]]


def as_plan(scaled: ScaledPlan, *, knows_obstacle: bool = False) -> Plan:
    """Make the plan of a run, the arena's side and the speed being 1; who plans does not know of the obstacle."""
    blocked = scaled.obstacle if knows_obstacle else 0.0
    return Plan(
        area=1.0 - blocked**2,
        perimeter=4.0 + 4.0 * blocked,
        biobots=scaled.biobots,
        landmarks=scaled.landmarks,
        speed=1.0,
        mean_leg=scaled.leg,
        detection_radius=scaled.detection,
        duration_s=scaled.path,
    )


def with_obstacle(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Pick the runs with an obstacle of the sizes that the law is for."""
    return [outcome for outcome in outcomes if 0 < outcome.scaled.obstacle <= LARGEST_OBSTACLE]


def without_obstacle(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Pick the runs in an empty arena."""
    return [outcome for outcome in outcomes if outcome.scaled.obstacle == 0]


def fit_law(outcomes: Sequence[Outcome], *, command: str) -> Law:
    """Fit all constants.

    Notes
    -----
    Nelder-Mead from fixed beginnings: equal runs give equal constants, which are rounded to three digits.
    """
    crowd, path_power, floor, steepness = _fit_resolution(with_obstacle(outcomes))
    dispersion, relative_error = _fit_spread(outcomes)
    seeds = [outcome.seed for outcome in outcomes]
    found = [quantities(as_plan(outcome.scaled)) for outcome in outcomes]
    ranges = {name: (_rounded(min(one[name] for one in found)), _rounded(max(one[name] for one in found))) for name in found[0]}
    return Law(
        crowd=crowd,
        path_power=path_power,
        floor=floor,
        steepness=steepness,
        false_hole=_fit_false_holes(without_obstacle(outcomes)),
        dispersion=dispersion,
        relative_error=relative_error,
        ranges=ranges | {"obstacle over side": (OBSTACLE[0], LARGEST_OBSTACLE)},
        fitted_on=f"{len(outcomes)} simulated runs, seeds {min(seeds)} to {max(seeds)}",
        command=command,
    )


def loss(law: Law, outcomes: Sequence[Outcome]) -> float:
    """Return minus the logarithm of the likelihood of what was found and what was not."""
    chances = [chance_found(as_plan(one.scaled), law, obstacle=one.scaled.obstacle) for one in outcomes]
    return _binary_loss(np.array(chances), np.array([one.is_found for one in outcomes]))


def _fit_resolution(outcomes: Sequence[Outcome]) -> tuple[float, float, float, float]:
    """Fit ``mapper.resolution.even_side``; written once more for arrays, and a test keeps the two together."""
    plans = [as_plan(outcome.scaled) for outcome in outcomes]
    side, radius, path = (np.array([getattr(one.scaled, name) for one in outcomes]) for name in ("obstacle", "detection", "path"))
    known = np.array([encounter_rate(plan) * plan.duration_s * plan.landmarks for plan in plans])
    is_found = np.array([outcome.is_found for outcome in outcomes])

    def misfit(x: Vector) -> float:
        even = np.sqrt(radius**2 + np.exp(2 * x[2]) + np.exp(2 * x[0]) * path ** x[1] / known)
        return _binary_loss(1.0 / (1.0 + (even / side) ** np.exp(x[3])), is_found)

    best = minimise(misfit, [log(25.0), 0.2, log(0.08), log(2.5)])
    return _rounded(exp(best[0])), _rounded(best[1]), _rounded(exp(best[2])), _rounded(exp(best[3]))


def _fit_false_holes(outcomes: Sequence[Outcome]) -> dict[str, float]:
    found = [quantities(as_plan(outcome.scaled)) for outcome in outcomes]
    terms = np.array([[1.0, *(log(one[name]) for name in _FALSE_HOLE_TERMS)] for one in found])
    is_false = np.array([outcome.n_false > 0 for outcome in outcomes])

    def misfit(x: Vector) -> float:
        return _binary_loss(1.0 / (1.0 + np.exp(-np.clip(terms @ x, -50, 50))), is_false)

    best = minimise(misfit, [-1.0, *(0.0 for _ in _FALSE_HOLE_TERMS)])
    return dict(zip(("constant", *_FALSE_HOLE_TERMS), map(_rounded, best), strict=True))


def _fit_spread(outcomes: Sequence[Outcome]) -> tuple[float, float]:
    """Fit the variance of the count about the kinetic gas in the true free area, as if it were normal."""
    plans = [as_plan(outcome.scaled, knows_obstacle=True) for outcome in outcomes]
    mean = np.array([encounter_rate(plan) * plan.duration_s for plan in plans])
    miss = np.array([outcome.n_encounters - outcome.n_together for outcome in outcomes]) - mean

    def misfit(x: Vector) -> float:
        variance = np.exp(x[0]) * mean + np.exp(2 * x[1]) * mean**2
        return float(np.sum(np.log(variance) + miss**2 / variance))

    best = minimise(misfit, [0.3, log(0.02)])
    return _rounded(exp(best[0])), _rounded(exp(best[1]))


def minimise(misfit: Callable[[Vector], float], begin: Sequence[float]) -> list[float]:
    """Find the arguments that make a function least, by Nelder-Mead."""
    at: Vector = np.array(begin)
    best = minimize(misfit, at, method="Nelder-Mead", options={"maxiter": 4000, "maxfev": 4000, "xatol": 1e-5, "fatol": 1e-5})
    return [float(value) for value in best.x]


def _binary_loss(chance: FloatArray, happened: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> float:
    chance = np.clip(chance, _LEAST_CHANCE, 1.0 - _LEAST_CHANCE)
    return float(-np.sum(np.where(happened, np.log(chance), np.log1p(-chance))))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
