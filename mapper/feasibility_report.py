"""``biobot-mapper feasibility``: its flags, and the forecast as text for a person and as JSON for programs."""

import argparse
import json
import textwrap
from dataclasses import asdict
from math import isfinite
from pathlib import Path

from mapper import feasibility
from mapper.durations import duration_text
from mapper.encounter_csv import read_encounters
from mapper.errors import TooFewEncountersError
from mapper.feasibility import FURTHEST
from mapper.forecast import Comparison, Forecast, Outlook, compare_recording, forecast
from mapper.plan import Plan, check_obstacle, make_plan
from mapper.report import JsonObject, JsonValue
from mapper.resolution import load_law

_PLAN_FLAGS = ("side", "area", "perimeter", "biobots", "landmarks", "speed", "mean_leg", "detection_radius")
_NS_PER_S = 1e9
_SHOWN_CHANGES = 5
_WIDTH = 96
_MIN_RECORDED = 2  # with fewer there is no span of time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of the command; numbers are checked together, when all are known."""
    size = parser.add_argument_group("arena", "a square of this side, or any shape of this free area")
    size.add_argument("--side", type=float, metavar="M", help="side [m]")
    size.add_argument("--area", type=float, metavar="M2", help="free area [m²]")
    size.add_argument("--perimeter", type=float, metavar="M", help="length of all walls [m] (default: of a square)")
    swarm = parser.add_argument_group("swarm")
    swarm.add_argument("--biobots", type=int, metavar="N", help="how many, landmarks included")
    swarm.add_argument("--landmarks", type=int, metavar="N", help="how many of them stand still (default: 15 %%)")
    swarm.add_argument("--speed", type=float, metavar="V", help="walking speed [m/s]")
    swarm.add_argument("--detection-radius", type=float, metavar="M", help="nearer than this is an encounter [m]")
    swarm.add_argument("--mean-leg", type=float, metavar="M", help="mean straight way between two turns [m]")
    swarm.add_argument("--time", type=float, metavar="S", help="time from the moment the landmarks are set [s]")
    parser.add_argument(
        "--obstacle", type=float, metavar="M", help="side of a square obstacle that must be seen [m] (default: a fifth of the arena's side)"
    )
    parser.add_argument("--encounters", type=Path, metavar="FILE.csv", help="compare the number of encounters of this recording")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the forecast as JSON; - is standard output")


def report(args: argparse.Namespace) -> tuple[str, JsonObject]:
    """Make the forecast that the flags ask for, as text and as a JSON object.

    Raises
    ------
    ConfigurationError
        Numbers are out of range or contradict each other.
    MapError
        The recording cannot be used.
    """
    plan = _make_plan(args)
    law = load_law()
    foretold = forecast(plan, law, obstacle=args.obstacle)
    comparison = None
    if args.encounters is not None:
        table = read_encounters(args.encounters)
        if len(table) < _MIN_RECORDED:
            raise TooFewEncountersError(n_encounters=len(table), minimum=_MIN_RECORDED, where=str(args.encounters))
        span_s = (int(table.t_end_ns.max()) - int(table.t_start_ns.min())) / _NS_PER_S
        comparison = compare_recording(plan, law, encounters=len(table), duration_s=span_s)
    return describe(foretold, comparison), to_json_object(foretold, comparison)


def check_given(args: argparse.Namespace) -> None:
    """Check the plan that flags describe; none at all is no fault.

    Raises
    ------
    ConfigurationError
        Numbers are missing, out of range or contradict each other.
    """
    if any(getattr(args, name) is not None for name in (*_PLAN_FLAGS, "time", "obstacle")):
        _make_plan(args)


def describe(foretold: Forecast, comparison: Comparison | None = None) -> str:
    """Tell a forecast on one screen."""
    plan, looks = foretold.plan, foretold.outlooks
    lines = [
        f"arena {plan.area:.4g} m², walls {plan.perimeter:.4g} m; {plan.biobots} biobots, {plan.landmarks} of them landmarks",
        f"speed {plan.speed:g} m/s, detection radius {plan.detection_radius:g} m, mean leg {plan.mean_leg:g} m",
        "",
        _row("in a time of", [duration_text(one.plan.duration_s) for one in looks]),
        _row("encounters", [_count(one.encounters) for one in looks]),
        _row("  in 9 of 10 runs", [f"{_count(one.least_encounters)}-{_count(one.most_encounters)}" for one in looks]),
        _row("  for each biobot that walks", [_count(one.encounters_per_mover) for one in looks]),
        _row("obstacle found in 80 % of maps", [_side(one.usual_side, foretold) for one in looks]),
        _row("obstacle found in 50 %", [_side(one.even_side, foretold) for one in looks]),
        _row(f"chance to see one of {foretold.obstacle:.3g} m", [f"{one.chance_found:.0%}" for one in looks]),
        _row("chance of a hole that is not there", [f"{one.chance_of_false_hole:.0%}" for one in looks]),
        "",
        *_wrapped(_when(foretold)),
        *_wrapped(_theory(foretold)),
        *([] if comparison is None else _wrapped(_compared(comparison))),
    ]
    if foretold.changes:
        now = looks[0]
        lines += ["", _row("what helps, the best first", ["found in 80 %", "hole not there"], width=26)]
        for change in foretold.changes[:_SHOWN_CHANGES]:
            sides = f"{_side(now.usual_side, foretold)} -> {_side(change.outlook.usual_side, foretold)}"
            chances = f"{now.chance_of_false_hole:.0%} -> {change.outlook.chance_of_false_hole:.0%}"
            lines.append(_row(change.name, [sides, chances], width=26))
    notes = [f"warning: {warning}" for warning in foretold.warnings]
    if any(foretold.largest_side < side <= plan.side for one in looks for side in (one.usual_side, one.even_side)):
        notes.append(f"in brackets: larger than any obstacle that was run ({foretold.largest_side:.3g} m here)")
    if foretold.extrapolated:
        notes.append(f"a guess, for nothing of the kind was run: {'; '.join(foretold.extrapolated)}")
    return "\n".join([*lines, *([""] if notes else []), *(line for note in notes for line in _wrapped(note))])


def to_json_object(foretold: Forecast, comparison: Comparison | None = None) -> JsonObject:
    """Describe a forecast for programs: keys as in ``Forecast``; null where something never comes or has no bound."""
    plan = foretold.plan
    document = {
        "plan": asdict(plan),
        "outlooks": [_outlook(one) for one in foretold.outlooks],
        "theory": {
            "free_path": feasibility.free_path(plan),
            "path_inflation": feasibility.path_inflation(plan),
            "wall_share": feasibility.wall_share(plan),
            "crossing_s": feasibility.crossing_s(plan),
            "mixing_s": feasibility.mixing_s(plan),
            "encounter_spacing": feasibility.encounter_spacing(plan),
            "landmark_cover_radius": feasibility.landmark_cover_radius(plan),
            "connected_s": foretold.connected_s,
            "landmarks_met_s": foretold.landmarks_met_s,
        },
        "obstacle": {"side": foretold.obstacle, "found_s": foretold.obstacle_s, "biobots": foretold.obstacle_biobots},
        "changes": [{"name": change.name, **_outlook(change.outlook)} for change in foretold.changes],
        "largest_side": foretold.largest_side,
        "extrapolated": list(foretold.extrapolated),
        "warnings": list(foretold.warnings),
        "recording": None if comparison is None else asdict(comparison),
        "law": asdict(load_law()),
    }
    cleaned = _finite(document)
    assert isinstance(cleaned, dict)
    return cleaned


def to_json(document: JsonObject) -> str:
    """Write a forecast as one line of JSON."""
    return json.dumps(document, allow_nan=False) + "\n"


def _make_plan(args: argparse.Namespace) -> Plan:
    plan = make_plan(**{name: getattr(args, name) for name in _PLAN_FLAGS}, duration_s=args.time)
    check_obstacle(args.obstacle, plan)
    return plan


def _outlook(outlook: Outlook) -> dict[str, object]:
    return {"duration_s": outlook.plan.duration_s, **{name: value for name, value in asdict(outlook).items() if name != "plan"}}


def _finite(value: object) -> JsonValue:
    match value:
        case dict():
            return {str(key): _finite(one) for key, one in value.items()}
        case list() | tuple():
            return [_finite(one) for one in value]
        case float():
            return value if isfinite(value) else None
        case None | bool() | int() | str():
            return value
    raise TypeError(f"{type(value).__name__} has no place in JSON")


def _row(name: str, values: list[str], *, width: int = 18) -> str:
    return f"{name:<40}" + "".join(f"{value:>{width}}" for value in values)


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, width=_WIDTH, subsequent_indent="  ")


def _when(foretold: Forecast) -> str:
    size = f"an obstacle of {foretold.obstacle:.3g} m"
    if foretold.obstacle_s is None:
        told = f"{size} is not found in 80 % of maps even in {duration_text(FURTHEST * foretold.plan.duration_s)}"
    else:
        told = f"{size} is found in 80 % of maps after {duration_text(foretold.obstacle_s)}"
    if foretold.obstacle_biobots is None:
        return f"{told}; no number of biobots does it in {duration_text(foretold.plan.duration_s)}"
    swarm = f"{foretold.obstacle_biobots} biobots, with landmarks in the same proportion"
    return f"{told}; in {duration_text(foretold.plan.duration_s)} it takes {swarm}"


def _theory(foretold: Forecast) -> str:
    plan = foretold.plan
    joined = f"All are joined by encounters after {duration_text(foretold.connected_s)}"
    if plan.landmarks:
        joined += f", and each landmark has met three after {duration_text(foretold.landmarks_met_s)}"
    crossing, mixing = duration_text(feasibility.crossing_s(plan)), duration_text(feasibility.mixing_s(plan))
    spacing, cover = feasibility.encounter_spacing(plan), feasibility.landmark_cover_radius(plan)
    landmarks = f"; some place is {cover:.3g} m or more from every landmark" if plan.landmarks else ""
    return (
        f"{joined} (9 of 10 runs, if all mix well). A biobot crosses the arena in {crossing} and gets about it in {mixing}; between "
        f"encounters it walks {feasibility.free_path(plan):.3g} m, {feasibility.path_inflation(plan):.2f} times the beeline. "
        f"Each encounter has {spacing:.3g} m square for itself{landmarks}."
    )


def _compared(comparison: Comparison) -> str:
    told = (
        f"the recording has {comparison.encounters:,} encounters in {duration_text(comparison.duration_s)}; expected "
        f"{_count(comparison.expected)} ({_count(comparison.least)}-{_count(comparison.most)})"
    )
    if comparison.least <= comparison.encounters <= comparison.most:
        return f"{told}: as foretold"
    radius = (
        "no detection radius explains it"
        if comparison.radius is None
        else f"a detection radius of {comparison.radius:.3g} m would give as many"
    )
    if comparison.encounters < comparison.least:
        return f"{told}: fewer; radios miss some, insects rest, or the radius is smaller ({radius})"
    return f"{told}: more; one meeting is told as several, insects crowd together, or the radius is larger ({radius})"


def _side(side: float, foretold: Forecast) -> str:
    if not isfinite(side) or side > foretold.plan.side:
        return "none"
    return f"{side:.3g} m" if side <= foretold.largest_side else f"({side:.3g} m)"


def _arrow(now: Outlook, then: Outlook, foretold: Forecast) -> str:
    return f"{_side(now.usual_side, foretold)} -> {_side(then.usual_side, foretold)}"


def _count(value: float) -> str:
    return f"{value:,.0f}" if value >= 10 else f"{value:.2g}"
