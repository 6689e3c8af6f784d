"""Fit what ``biobot-mapper feasibility`` foretells to simulated runs and check it on others: ``python -m studies.feasibility_check``.

``--out mapper/data/feasibility.json`` made the file that the mapper ships; the tables printed are those of docs/feasibility.md.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from math import exp, log
from pathlib import Path

import numpy as np

from mapper.feasibility import chance_connected, encounter_rate, path_inflation
from mapper.resolution import Law, chance_found, chance_of_false_hole, count_deviation, even_side, quantities, side_found
from studies.cases import Options, results_of, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.feasibility_fit import Vector, as_plan, fit_law, loss, minimise, with_obstacle, without_obstacle
from studies.feasibility_runs import PLANS, Outcome, PlanCase, ScaledPlan, draw_plan
from studies.trials import HELD_OUT_SEED

_COMMAND = "python -m studies.feasibility_check"
_NAMED_SEED = 20_000
_SIDES = (0.0, 0.12, 0.16, 0.2, 0.26, 0.32, 0.4, 0.5)
_HISSERS = ScaledPlan(biobots=40, landmarks=10, detection=0.05, leg=0.1, path=14.4, obstacle=0.0)
# Plans that people will ask about; the hissers walk 4 cm/s for half an hour in 5 m x 5 m.
NAMED = {
    "paper-units": ScaledPlan(biobots=150, landmarks=20, detection=0.02, leg=0.2, path=4.0, obstacle=0.0),
    "paper-50cm": ScaledPlan(biobots=150, landmarks=20, detection=0.02, leg=0.6, path=40.0, obstacle=0.0),
    "40 hissers, 10 landmarks, 30 min": _HISSERS,
    "40 hissers, 20 landmarks, 30 min": replace(_HISSERS, landmarks=20),
    "20 hissers, 6 landmarks, 60 min": replace(_HISSERS, biobots=20, landmarks=6, path=28.8),
}
_FEWER_RUNS = {"paper-50cm": 4}  # a run takes long there
_INTERVAL = 1.645  # deviations of a normal distribution to either side, with 9 in 10 between


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit, check and print; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog=_COMMAND, description=__doc__)
    parser.add_argument("--out", type=Path, help="write the constants here")
    parser.add_argument("--cache", type=Path, default=Path("artifacts/feasibility"), help="folder of finished runs (default: %(default)s)")
    parser.add_argument("--fit-runs", type=int, default=2500, help="runs to fit to, seeds from 0 (default: %(default)s)")
    parser.add_argument("--check-runs", type=int, default=1000, help=f"runs to check on, seeds from {HELD_OUT_SEED} (default: %(default)s)")
    parser.add_argument("--named-runs", type=int, default=40, help="runs of each named plan and obstacle (default: %(default)s)")
    add_flags(parser)
    options = parser.parse_args(arguments)
    for name, least in (("fit_runs", 100), ("check_runs", 100), ("named_runs", 0)):
        if getattr(options, name) < least:
            parser.error(f"--{name.replace('_', '-')} is {getattr(options, name)}; wanted at least {least}")
    try:
        _fit_and_check(options, read_flags(options, journal=options.cache / "runs.jsonl"))
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _fit_and_check(asked: argparse.Namespace, options: Options) -> None:
    fitted = _run([(draw_plan(seed), seed) for seed in range(asked.fit_runs)], options, label="to fit to")
    law = fit_law(fitted, command=_COMMAND)
    document = json.dumps(asdict(law), indent=2) + "\n"
    print(document)
    if asked.out is not None:
        asked.out.write_text(document, encoding="utf-8")
    seeds = range(HELD_OUT_SEED, HELD_OUT_SEED + asked.check_runs)
    print("\n".join(check(law, fitted, _run([(draw_plan(seed), seed) for seed in seeds], options, label="to check on"))))
    if asked.named_runs:
        print("\n".join(_compare_named(law, options, runs=asked.named_runs)))


def check(law: Law, fitted: Sequence[Outcome], held_out: Sequence[Outcome]) -> list[str]:
    """Compare the laws with runs that played no part in fitting, in tables of Markdown."""
    seen = with_obstacle(held_out)
    own = with_obstacle(fitted)
    chances = [chance_found(as_plan(one.scaled), law, obstacle=one.scaled.obstacle) for one in seen]
    empty = without_obstacle(held_out)
    false = [chance_of_false_hole(as_plan(one.scaled), law) for one in empty]
    connected = [chance_connected(as_plan(one.scaled, knows_obstacle=True)) for one in held_out]
    return [
        *_check_counts(law, held_out),
        f"minus log likelihood a run: {loss(law, own) / len(own):.3f} fitted ({len(own)}), {loss(law, seen) / len(seen):.3f} held out",
        *_calibration("chance that the obstacle is found", chances, [one.is_found for one in seen]),
        *_calibration("chance of a hole in an empty arena", false, [one.n_false > 0 for one in empty]),
        *_calibration("chance that all are joined", connected, [one.is_connected for one in held_out]),
        *_residuals("obstacle found", seen, chances, [one.is_found for one in seen]),
        *_check_stretch([*without_obstacle(fitted), *empty]),
    ]


def _run(plans: Sequence[tuple[ScaledPlan, int]], options: Options, *, label: str) -> list[Outcome]:
    cases = [PlanCase(scaled=scaled, seed=seed) for scaled, seed in plans]
    return results_of(run_cases(PLANS, cases, options, label=label))


def _check_counts(law: Law, outcomes: Sequence[Outcome]) -> list[str]:
    lines = ["", "| r_d / L | runs | counted over foretold | within the interval of 9 in 10 |", "|---|---|---|---|"]
    for least, most in ((0.0, 0.015), (0.015, 0.03), (0.03, 0.06), (0.06, 1.0)):
        ratios, inside = [], []
        for one in outcomes:
            if least <= one.scaled.detection < most:
                plan = as_plan(one.scaled, knows_obstacle=True)
                mean = encounter_rate(plan) * plan.duration_s
                ratios.append((one.n_encounters - one.n_together) / mean)
                inside.append(abs(one.n_encounters - one.n_together - mean) <= _INTERVAL * count_deviation(plan, law))
        lines.append(f"| {least:g} to {most:g} | {len(ratios)} | {_mean(ratios):.3f} | {_mean(inside):.0%} |")
    return lines


def _calibration(title: str, chances: Sequence[float], happened: Sequence[bool]) -> list[str]:
    lines = ["", f"| {title}, foretold | runs | foretold on average | happened |", "|---|---|---|---|"]
    chance, is_so = np.array(chances), np.array(happened)
    for least, most in ((0.0, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 1.01)):
        rows = (chance >= least) & (chance < most)
        if rows.any():
            lines.append(f"| {least:.0%} to {min(most, 1):.0%} | {rows.sum()} | {chance[rows].mean():.1%} | {is_so[rows].mean():.1%} |")
    return lines


def _residuals(title: str, outcomes: Sequence[Outcome], chances: Sequence[float], happened: Sequence[bool]) -> list[str]:
    """Show in quarters of each quantity where a law is wrong."""
    lines = ["", f"| {title}: happened less foretold, by quarters of | lowest | | | highest |", "|---|---|---|---|---|"]
    found = [quantities(as_plan(one.scaled)) for one in outcomes]
    miss = np.array(happened, dtype=float) - np.array(chances)
    for name in found[0]:
        parts = np.array_split(np.argsort([one[name] for one in found], kind="stable"), 4)
        lines.append(f"| {name} | " + " | ".join(f"{miss[part].mean():+.1%}" for part in parts) + " |")
    return lines


def _check_stretch(outcomes: Sequence[Outcome]) -> list[str]:
    lines = [
        "",
        "| encounters a mover | way over beeline (Fürth) | runs | the map's distance over the true one: median, middle half |",
        "|---|---|---|---|",
    ]
    for least, most in ((0.0, 8.0), (8.0, 15.0), (15.0, 40.0), (40.0, 1e9)):
        for low, high in ((1.0, 1.2), (1.2, 2.0), (2.0, 1e9)):
            told = [
                one.stretch
                for one in outcomes
                if one.stretch is not None
                and least <= 2.0 * one.n_encounters / one.scaled.biobots < most
                and low <= path_inflation(as_plan(one.scaled)) < high
            ]
            if len(told) >= 8:
                quarter, half, three = np.quantile(told, (0.25, 0.5, 0.75))
                lines.append(f"| {least:g} to {most:g} | {low:g} to {high:g} | {len(told)} | {half:.2f}, {quarter:.2f} to {three:.2f} |")
    return lines


def _compare_named(law: Law, options: Options, *, runs: int) -> list[str]:
    lines = [
        "",
        "| plan | encounters | even chance: run, law | 80 %: run, law | hole in an empty arena: run, law |",
        "|---|---|---|---|---|",
    ]
    for name, scaled in NAMED.items():
        seeds = range(_NAMED_SEED, _NAMED_SEED + runs // _FEWER_RUNS.get(name, 1))
        outcomes = _run([(replace(scaled, obstacle=side), seed) for side in _SIDES for seed in seeds], options, label=name)
        seen, empty, plan = with_obstacle(outcomes), without_obstacle(outcomes), as_plan(scaled)
        even, usual = _measure_sides(seen)
        false = _mean([one.n_false > 0 for one in empty])
        lines.append(
            f"| {name} | {_mean([one.n_encounters for one in empty]):.0f} | {even:.3f}, {even_side(plan, law):.3f} | "
            f"{usual:.3f}, {side_found(plan, law, chance=0.8):.3f} | {false:.0%}, {chance_of_false_hole(plan, law):.0%} |"
        )
    return lines


def _measure_sides(outcomes: Sequence[Outcome]) -> tuple[float, float]:
    """Fit a logistic curve in the logarithm of the side to runs of one plan; return the sides found in 50 % and in 80 %."""
    side = np.log([one.scaled.obstacle for one in outcomes])
    sign = np.where([one.is_found for one in outcomes], -1.0, 1.0)

    def misfit(x: Vector) -> float:
        return float(np.logaddexp(0.0, sign * np.exp(x[1]) * (side - x[0])).sum())

    even, steepness = minimise(misfit, [log(0.2), log(3.0)])
    return exp(even), exp(even + log(4.0) / exp(steepness))


def _mean(values: Sequence[float] | Sequence[bool] | Sequence[int]) -> float:
    return float(np.mean(values)) if values else float("nan")


if __name__ == "__main__":
    sys.exit(main())
