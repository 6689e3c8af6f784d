"""Check how sure a map says it is on runs that played no part in training: ``python -m studies.confidence_check``.

A loop is there if it goes around an obstacle one can walk around, and no longer interval goes around the same, judged by the true places
of its encounters. A count is right if the map has as many holes as the arena. Told of are the holes of the map and the loops that it calls
possible; ``--figures docs/confidence`` draws reliability diagrams as SVG and PNG.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapper.confidence import Models, load_models
from mapper.confidence.assess import LEAST_PROBABILITY, WELL_SEEN, choose_holes, is_beyond_training, tell_count
from mapper.confidence.counting import count_holes, is_telling
from mapper.confidence.sufficiency import Facts, judge_data
from mapper.types import BoolArray, FloatArray, Method, MetricKind
from studies.cases.flags import add_flags, read_flags
from studies.confidence_fit import area_under_roc, brier_skill, expected_calibration_error
from studies.confidence_runs import AS_IT_IS, KINDS, Witness
from studies.errors import StudyError
from studies.reliability import draw_reliability
from studies.train_confidence import collect, number_columns, other_loop_probabilities
from studies.trials import HELD_OUT_SEED, SETTINGS

_RUNS = 1000
_MOST_HOLES = 6
_SURE = 0.9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """What the map of one run tells, beside the truth.

    ``chance``, ``is_hole`` and ``is_called`` are of its holes and possible holes, shape (k,); ``value`` is its number of holes, and
    ``count``, from 0 on, the distribution of that; ``well_seen`` and ``is_right`` are of its points; ``band`` is over the reach.
    """

    witness: Witness
    chance: FloatArray
    is_hole: BoolArray
    is_called: BoolArray
    value: int
    count: FloatArray
    is_enough: bool
    well_seen: BoolArray
    is_right: BoolArray
    band: float

    @property
    def count_chance(self) -> float:
        """That the map's number of holes is right."""
        return float(self.count[self.value])

    @property
    def count_is_right(self) -> bool:
        """Whether it is."""
        return self.value == self.witness.true_holes


def tell(models: Models, witness: Witness) -> Told:
    """Say what the mapper says of a run that has a map."""
    loops = {name: np.array(values) for name, values in witness.loops.items()}
    run = {name: np.array(value) for name, value in witness.run.items()}
    chance = models.loop.probability(loops)
    every = np.concatenate([chance, other_loop_probabilities(models.loop, witness)])
    n_landmarks = round(float(np.expm1(run["landmarks"])))
    n_walkers = round(float(np.exp(run["encounters"] - run["encounters a biobot"]))) - n_landmarks
    tells = is_telling(n_points=len(witness.is_right), n_landmarks=n_landmarks, n_walkers=n_walkers)
    alone = every if is_beyond_training(models, witness.counted, has_moved_on=False) else None
    count = count_holes(models.count, number_columns(witness, every), prior=models.prior, is_telling=tells, alone=alone)
    chosen = choose_holes(every, count, is_telling=tells)
    is_called = chosen[: len(chance)]
    is_told = tells & (is_called | (chance >= LEAST_PROBABILITY))
    well_seen = models.point.probability({name: np.array(values) for name, values in witness.points.items()}) >= WELL_SEEN
    facts = Facts(
        encounters_each=2.0 * float(np.exp(run["encounters a biobot"])),
        n_landmarks=n_landmarks,
        n_walkers=n_walkers,
        n_components=1,
        apart=1.0 - float(np.exp(run["encounters"])) / witness.n_encounters,
        count=tell_count(int(chosen.sum()), count, is_known=tells),
        well_seen=float(well_seen.mean()),
        span_s=0.0,
        has_moved_on=False,
        doubts=(),
    )
    return Told(
        witness=witness,
        chance=chance[is_told],
        is_hole=np.array(witness.is_hole, dtype=bool)[is_told],
        is_called=is_called[is_told],
        value=int(chosen.sum()),
        count=count,
        is_enough=judge_data(facts).is_enough,
        well_seen=well_seen,
        is_right=np.array(witness.is_right, dtype=bool),
        band=min(float(np.exp(models.band.score(run))), 0.5),
    )


def hole_events(told: Sequence[Told], *, wanted: Callable[[Told], BoolArray]) -> tuple[FloatArray, BoolArray]:
    """Pool the loops of maps: their probabilities and whether they are there."""
    chosen = [(one, wanted(one)) for one in told]
    chance = np.concatenate([np.zeros(0), *(one.chance[rows] for one, rows in chosen)])
    return chance, np.concatenate([np.zeros(0, dtype=bool), *(one.is_hole[rows] for one, rows in chosen)])


def number_events(told: Sequence[Told], number: int) -> tuple[FloatArray, BoolArray]:
    """Pool the event that there are just so many holes."""
    chance = [float(one.count[number]) if number < len(one.count) else 0.0 for one in told]
    return np.array(chance), np.array([one.witness.true_holes == number for one in told])


def count_events(told: Sequence[Told]) -> tuple[FloatArray, BoolArray]:
    """Pool the event that the map's number of holes is right."""
    return np.array([one.count_chance for one in told]), np.array([one.count_is_right for one in told])


def line(name: str, chance: FloatArray, is_so: BoolArray) -> str:
    """Tell how good some probabilities are in one line."""
    if not len(chance):
        return f"{name:40}      0"
    figures = expected_calibration_error(chance, is_so), brier_skill(chance, is_so), area_under_roc(chance, is_so)
    shown = (f"{figure:8.3f}" if np.isfinite(figure) else "       -" for figure in figures)
    return f"{name:40} {len(chance):6d} {is_so.mean():7.1%} {chance.mean():7.1%} {' '.join(shown)}"


def report(told: Sequence[Told]) -> list[str]:
    """Tell of all probabilities in lines."""
    groups: list[tuple[str, list[Told]]] = [("all", list(told))]
    groups += [("  settings " + kind, [one for one in told if one.witness.kind == kind]) for kind in KINDS]
    groups += [
        (f"  {name}, {kind}", [one for one in told if (one.witness.setting, one.witness.kind) == (name, kind)])
        for name in SETTINGS
        for kind in KINDS
    ]
    lines = [f"{'':40} {'events':>6} {'so':>7} {'told':>7} {'ECE':>8} {'skill':>8} {'AUC':>8}"]
    lines += ["each hole and possible hole is there"]
    lines += [line(name, *hole_events(group, wanted=lambda one: np.ones(len(one.chance), dtype=bool))) for name, group in groups]
    lines += ["of these, holes of the map", line("all", *hole_events(told, wanted=lambda one: one.is_called))]
    lines += ["of these, possible holes", line("all", *hole_events(told, wanted=lambda one: ~one.is_called))]
    lines += ["the map's number of holes is right"]
    lines += [line(name, *count_events(group)) for name, group in groups if group]
    lines += ["number of holes right: the map's, and the rule's"]
    lines += [
        f"{name:40} {len(group):6d} {_share([one.count_is_right for one in group]):>8} {_share([_rule_is_right(one) for one in group]):>8}"
        for name, group in groups
        if group
    ]
    lines += ["there are just so many holes"]
    pooled = [number_events(told, number) for number in range(_MOST_HOLES + 1)]
    lines += [line(f"{number}", *events) for number, events in enumerate(pooled)]
    lines += [line("0 to 6, each an event", *(np.concatenate(parts) for parts in zip(*pooled, strict=True)))]
    return lines + _report_rest(told)


def _report_rest(told: Sequence[Told]) -> list[str]:
    lines = []
    for name, group in (("all", told), ("settings as they are", [one for one in told if one.witness.kind == AS_IT_IS])):
        band = f"holds in {_share([one.witness.move <= one.band for one in group])} of maps"
        lines.append(f"stability band, {name}: {band}; median {_share([np.median([one.band for one in group] or [0.0])])} of the diameter")
        seen = np.concatenate([np.zeros(0, dtype=bool), *(one.well_seen for one in group)])
        right = np.concatenate([np.zeros(0, dtype=bool), *(one.is_right for one in group)])
        shares = f"{_share(right[seen])} are right; of the others {_share(right[~seen])}"
        lines.append(f"points, {name}: {_share(seen)} well seen, of which {shares}")
    for name, wanted in (("enough", True), ("not enough", False)):
        group = [one for one in told if one.is_enough is wanted]
        right_share = _share([one.count_is_right for one in group])
        false = _share([bool((one.is_called & ~one.is_hole).any()) for one in group])
        lines.append(f"data said to be {name}: {len(group)} maps; count right in {right_share}; a hole that is not there in {false}")
    sure = sum(int((one.is_called & ~one.is_hole & (one.chance >= _SURE)).sum()) for one in told)
    lines.append(f"holes that are not there and are told of with {_SURE:.0%} or more: {sure} in {len(told)} maps")
    return lines


def _rule_is_right(told: Told) -> bool:
    return told.witness.counted == told.witness.true_holes


def _share(values: Sequence[float] | FloatArray | BoolArray) -> str:
    return f"{np.mean(values):.1%}" if len(values) else "-"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures, and draw them where asked; progress goes to standard error."""
    parser = argparse.ArgumentParser(prog="python -m studies.confidence_check", description="Whether probabilities of holes hold.")
    parser.add_argument("--runs", type=int, default=_RUNS, help="(default: %(default)s)")
    parser.add_argument("--seed", type=int, default=HELD_OUT_SEED, help="first seed; training takes those from 0 on (default: %(default)s)")
    parser.add_argument("--cache", type=Path, default=Path("artifacts/confidence"), help="folder of finished runs (default: %(default)s)")
    parser.add_argument("--figures", type=Path, metavar="NAME", help="draw reliability diagrams as NAME.svg and NAME.png")
    add_flags(parser)
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs is {options.runs}; wanted at least 1")
    models = load_models(Method.DEFAULT, MetricKind.LANDMARK_PROFILE)
    if models is None:
        print(
            "error: mapper/data/confidence.json has no models of the default method; train them: studies.train_confidence", file=sys.stderr
        )
        return 1
    try:
        flags = read_flags(options, journal=options.cache / "held-out.jsonl")
        witnesses = collect(flags, first_seed=options.seed, runs=options.runs, label="confidence, held out")
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    told = [tell(models, one) for one in witnesses if one.run]
    print(f"{len(witnesses)} runs, seeds from {options.seed}; {len(witnesses) - len(told)} of them with too few encounters for a map")
    print("\n".join(report(told)))
    if options.figures is not None:
        panels = {
            "each hole and possible hole is there": hole_events(told, wanted=lambda one: np.ones(len(one.chance), dtype=bool)),
            "the map's number of holes is right": count_events(told),
        }
        for suffix in ("svg", "png"):
            options.figures.with_suffix(f".{suffix}").write_bytes(draw_reliability(panels, image_format=suffix))
    return 0


if __name__ == "__main__":
    sys.exit(main())
