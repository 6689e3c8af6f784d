"""The mission report: one printable HTML page of what the map says, how sure it is, what happened, and who did what. Pure.

No script, no picture from elsewhere, no style in it: a style sheet is named, or put in where the page is to be kept as a file.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from html import escape
from typing import Final

import msgspec

from firmware_protocol.contract.commands import StimulationAccount
from firmware_protocol.contract.records import MissionRecord
from firmware_protocol.first_use import prepare
from firmware_protocol.units import EVERYBODY
from mapper.alert_book import Alert, AlertKind
from mapper.certainty import chance_text, sure_text
from mapper.command_log import Command
from mapper.fleet import BiobotView, GatewayView
from mapper.map_archive import PastMap
from mapper.named_pins import NamedPin, PinOnMap
from mapper.record_columns import wall_interval
from mapper.report_pictures import DrawnHole, DrawnMap, TimedCount, TimedSpan, draw_map, draw_timeline

_NS_PER_S: Final = 1e9
_MOST_COMMANDS: Final = 300
_MOST_ALERTS: Final = 200
_LISTED_PROBABILITY: Final = 0.1


class _Count(msgspec.Struct, frozen=True):
    value: int
    probability: float
    probabilities: dict[str, float]
    is_known: bool = True


class _Data(msgspec.Struct, frozen=True):
    is_enough: bool
    reasons: list[str]
    remedies: list[str]


class _Parameters(msgspec.Struct, frozen=True):
    method: str
    metric: str
    length_unit: str


class _Map(DrawnMap, frozen=True):
    version: int
    begun_wall_ns: int
    computed_wall_ns: int
    betti_numbers: tuple[int, int]
    hole_count: _Count | None
    data: _Data | None
    n_encounters: int
    n_used: int
    diameter: float
    lost_spectrum: float
    n_before: int
    n_ahead: int
    warnings: list[str]
    parameters: _Parameters
    frame: dict[str, object] | None = None


prepare(_Map)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFacts:
    """All that a report is made of. ``map_json``, None before the first map: what that waits for is in ``waiting``."""

    site: str
    now_wall_ns: int
    software: str
    kernels: str
    persistence: str | None
    made_by: str | None
    map_json: bytes | None
    waiting: str | None
    history: Sequence[PastMap]
    alerts: Sequence[Alert]
    gateways: Sequence[GatewayView]
    biobots: Sequence[BiobotView]
    accounts: Sequence[StimulationAccount]
    commands: Sequence[Command]
    missions: Sequence[MissionRecord]
    faults: Sequence[str]
    pins: Sequence[tuple[NamedPin, PinOnMap]] = ()


def write_report(facts: ReportFacts, *, style_url: str | None = None, style: str | None = None) -> str:
    """Write the page; ``style_url`` names its style sheet, ``style`` is one that is put into it."""
    map_ = None if facts.map_json is None else msgspec.json.decode(facts.map_json, type=_Map)
    link = "" if style_url is None else f'<link rel="stylesheet" href="{escape(style_url)}">'
    inline = "" if style is None else f"<style>{style}</style>"
    title = f"Mission report: site {facts.site}, {_date(facts.now_wall_ns)}"
    body = [
        f"<h1>Mission report</h1><p class=lead>Site {escape(facts.site)}, {_time(facts.now_wall_ns)}. All times are UTC.</p>",
        *(_no_map(facts) if map_ is None else _of_map(map_, facts.pins)),
        *_pins(facts.pins),
        _lost(facts),
        "<h2>Holes and alerts over time</h2>",
        _timeline(facts),
        "<h2>What cannot be concluded</h2>",
        _list(_doubts(facts, map_)),
        *_phases(facts.missions),
        *_biobots(facts),
        *_commands(facts.commands),
        *_alerts(facts.alerts),
        *_gateways(facts.gateways),
        *_origin(facts, map_),
    ]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>{link}{inline}'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body class="report"><main>{"".join(body)}</main></body></html>\n'


def _no_map(facts: ReportFacts) -> list[str]:
    return [f'<p class="verdict">There is no map yet: {escape(facts.waiting or "the mapper has just started")}.</p>']


def _of_map(map_: _Map, pins: Sequence[tuple[NamedPin, PinOnMap]]) -> list[str]:
    unit = map_.parameters.length_unit
    b0, b1 = map_.betti_numbers
    parts = _counted(b0, "connected part", "connected parts")
    sure = "how sure that is is not known" if map_.hole_count is None else sure_text(map_.hole_count.probability)
    verdict = f"The map shows {_counted(b1, 'hole', 'holes')} ({sure}) in {parts}."
    if map_.hole_count is not None and not map_.hole_count.is_known:
        verdict = f"How many holes there are is not known. The map shows {parts}."
    doubtful = map_.data is not None and not map_.data.is_enough
    lines = [f'<p class="verdict">{"Not enough data yet. " if doubtful else ""}{escape(verdict)}</p>']
    if map_.data is not None and doubtful:
        lines += [
            "<p>Why, and what would help:</p>",
            _list([*map_.data.reasons, *(f"It would help to {one}." for one in map_.data.remedies)]),
        ]
    others = [] if map_.hole_count is None else sorted(map_.hole_count.probabilities.items(), key=lambda item: -item[1])
    if others:
        chances = ", ".join(f"{number}: {chance_text(chance)}" for number, chance in others[:4] if chance >= 0.005)
        lines.append(f"<p>How likely each number of holes is: {escape(chances)}.</p>")
    lines.append(
        f"<p>It is of {map_.n_encounters} encounters ({map_.n_used} used), {map_.diameter:.3g} {escape(unit)} from end to end; "
        f"version {map_.version}, of all that had come by {_time(map_.begun_wall_ns)}.</p>"
    )
    caption = (
        "Numbers are those of the table; dashed, ?: may be a hole; hollow points are badly seen; triangles are landmarks, crosses pins."
    )
    drawn = [(pin.name, (on.x, on.y)) for pin, on in pins if on.x is not None and on.y is not None]
    lines += [f"<figure>{draw_map(map_, unit=unit, pins=drawn)}<figcaption>{caption}</figcaption></figure>", "<h2>Holes</h2>"]
    rows = [_hole_row(str(number), hole) for number, hole in enumerate(map_.holes, start=1)]
    rows += [_hole_row("?", hole) for hole in map_.possible_holes if (hole.probability or 0.0) >= _LISTED_PROBABILITY]
    lines.append(_table(["Hole", "How sure", f"Area [{unit}²]", f"Perimeter [{unit}]", "Part"], rows, empty="The map shows no hole."))
    return lines


def _hole_row(name: str, hole: DrawnHole) -> list[str]:
    area = "not known" if hole.area is None else f"{hole.area:.3g} ± {hole.area_error or 0.0:.2g}"
    around = "not known" if hole.perimeter is None else f"{hole.perimeter:.3g} ± {hole.perimeter_error or 0.0:.2g}"
    return [name, "not known" if hole.probability is None else chance_text(hole.probability), area, around, str(hole.component + 1)]


def _pins(pins: Sequence[tuple[NamedPin, PinOnMap]]) -> list[str]:
    rows = []
    for pin, on in pins:
        known = "" if pin.at is None else f"{pin.at[0]:.6g}, {pin.at[1]:.6g}"
        found = (on.problem or "on no map yet") if on.x is None or on.y is None else f"{on.x:.3g}, {on.y:.3g}"
        rows.append([pin.name, pin.place, known, found, "" if on.residual_m is None else f"{on.residual_m:.2g}"])
    head = ["Pin", "Place", "Known place, x, y [m]", "On the map, x, y", "Off by [m]"]
    return ["<h2>Pins</h2>", _table(head, rows, empty="No place was named.")]


def _lost(facts: ReportFacts) -> str:
    lost = sorted(alert.subject.removeprefix("biobot ") for alert in facts.alerts if _is_lost(alert))
    return f"<p>Lost now: {'biobot' if len(lost) == 1 else 'biobots'} {escape(', '.join(lost))}.</p>" if lost else ""


def _is_lost(alert: Alert) -> bool:
    return alert.is_on and alert.kind is AlertKind.BIOBOT_LOST


def _timeline(facts: ReportFacts) -> str:
    counts = [TimedCount(wall_ns=one.wall_ns, n_holes=one.betti_numbers[1], is_enough=one.is_enough) for one in facts.history]
    worst = sorted(facts.alerts, key=lambda alert: (["critical", "warning", "info"].index(alert.severity.value), -alert.since_wall_ns))
    spans = [
        TimedSpan(begin_ns=alert.since_wall_ns, end_ns=alert.ended_wall_ns, kind=alert.severity.value, text=alert.text) for alert in worst
    ]
    begin = "" if not counts else f"From {_time(min(one.wall_ns for one in counts))} to {_time(facts.now_wall_ns)}. "
    caption = f"{begin}The line: holes on the map, pale while data were not enough. The bars: alerts, the most severe first."
    return f"<figure>{draw_timeline(counts, spans, end_ns=facts.now_wall_ns)}<figcaption>{caption}</figcaption></figure>"


def _doubts(facts: ReportFacts, map_: _Map | None) -> list[str]:
    doubts = []
    if map_ is not None:
        if map_.frame is None:
            doubts.append(
                "Where the map lies, how it is turned, and whether it is the mirror image of the place: no pins fix that. "
                "Three places with known coordinates would."
            )
        if map_.parameters.length_unit == "s":
            doubts.append("Lengths in metres: they are seconds of walking, as no walking speed was given.")
        if map_.betti_numbers[0] > 1:
            doubts.append("How the connected parts lie to each other: no biobot joins them.")
        if map_.hole_count is None:
            doubts.append("How sure the map is: it was made without replicates.")
        if map_.n_before:
            doubts.append(f"Anything of {map_.n_before} earlier encounters: they were over before what counts began.")
        n_badly = sum(point.is_well_seen is False for point in map_.points)
        if n_badly:
            doubts.append(f"Distances around {n_badly} of {len(map_.points)} points, which are badly seen.")
        doubts += [f"{warning[:1].upper()}{warning[1:]}." for warning in map_.warnings]
    doubts.append("What stands in a hole, and what lies where no biobot walked: a hole is only a place that they walk around.")
    doubts += [f"The mapper says: {fault}." for fault in facts.faults]
    return doubts


def _phases(missions: Sequence[MissionRecord]) -> list[str]:
    rows = [
        [_time(wall_interval(one)[0]), one.gateway, one.phase.value.replace("_", " "), str(len(one.landmarks)), one.operator, one.reason]
        for one in missions
    ]
    return ["<h2>Mission</h2>", _table(["From", "Gateway", "Phase", "Landmarks", "Ordered by", "Why"], rows, empty="No mission was run.")]


def _biobots(facts: ReportFacts) -> list[str]:
    stimulated: dict[int, list[StimulationAccount]] = {}
    for account in facts.accounts:
        stimulated.setdefault(account.node, []).append(account)
    lost = {alert.subject for alert in facts.alerts if _is_lost(alert)}
    rows = []
    for one in facts.biobots:
        accounts = stimulated.get(one.node, [])
        state = (
            "lost" if f"biobot {one.node}" in lost else "landmark" if one.is_landmark else "stands" if one.mode.value == "S" else "walks"
        )
        heard = "" if one.last_heard_wall_ns is None else _time(one.last_heard_wall_ns)
        battery = f"{one.battery_mv} mV" if one.battery_mv else "not measured"
        trains = sum(account.n_trains for account in accounts)
        on_s = sum(account.on_ms for account in accounts) / 1000
        rows.append([str(one.node), state, str(one.n_encounters), heard, battery, str(trains), f"{on_s:.1f}"])
    head = ["Biobot", "State", "Encounters", "Last heard", "Battery", "Stimulus trains", "Stimulated [s]"]
    return [f"<h2>Biobots ({len(facts.biobots)})</h2>", _table(head, rows, empty="No biobot was heard.")]


def _commands(commands: Sequence[Command]) -> list[str]:
    rows = [
        [
            _time(one.began_wall_ns),
            one.operator,
            one.action.value.replace("_", " "),
            "all" if one.node == EVERYBODY else str(one.node),
            "under way" if one.outcome is None else one.outcome.value.replace("_", " "),
            one.reason,
        ]
        for one in commands[:_MOST_COMMANDS]
    ]
    note = f"<p>The newest {_MOST_COMMANDS}; all are in the gateways' audit logs.</p>" if len(commands) > _MOST_COMMANDS else ""
    head = ["Given", "By", "Action", "Biobot", "Outcome", "Why"]
    return ["<h2>Commands since the mapper's start</h2>", note, _table(head, rows, empty="None was given.")]


def _alerts(alerts: Sequence[Alert]) -> list[str]:
    rows = [
        [
            _time(one.since_wall_ns),
            "on" if one.ended_wall_ns is None else _time(one.ended_wall_ns),
            one.severity.value,
            one.text,
            one.acknowledged_by or "",
        ]
        for one in alerts[:_MOST_ALERTS]
    ]
    return ["<h2>Alerts</h2>", _table(["Since", "Until", "Severity", "What", "Seen by"], rows, empty="There was none.")]


def _gateways(gateways: Sequence[GatewayView]) -> list[str]:
    rows = []
    for one in gateways:
        status = one.status
        radios = "" if status is None else ", ".join(f"{name} {state}" for name, state in sorted(status.radios.items()))
        head = "not told" if status is None or not status.audit_head else f"{status.audit_rows} rows, {status.audit_head}"
        rows.append([one.name, "there" if one.is_alive else "away", radios, head])
    note = "<p>Whoever notes number and hash of an audit log's last row sees later whether anything in it was changed or cut off.</p>"
    return ["<h2>Gateways</h2>", _table(["Gateway", "State", "Radios", "Audit log"], rows, empty="None was seen."), note]


def _origin(facts: ReportFacts, map_: _Map | None) -> list[str]:
    rows = [["Software", facts.software], ["Kernels", facts.kernels], ["Persistence", facts.persistence or "none"]]
    if map_ is not None and facts.map_json is not None:
        rows += [
            ["Method", f"{map_.parameters.method}, metric {map_.parameters.metric}"],
            ["Map", f"version {map_.version}, made by {facts.made_by or 'not told'}, done at {_time(map_.computed_wall_ns)}"],
            ["SHA-256 of the map (JSON)", sha256(facts.map_json).hexdigest()],
        ]
    return ["<h2>How this was made</h2>", _table(["What", "Which"], rows, empty="")]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], *, empty: str) -> str:
    lines = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    if not lines:
        return f"<p>{escape(empty)}</p>"
    top = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    return f"<table><thead><tr>{top}</tr></thead><tbody>{''.join(f'<tr>{line}</tr>' for line in lines)}</tbody></table>"


def _list(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def _counted(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def _time(wall_ns: int) -> str:
    try:
        return datetime.fromtimestamp(wall_ns / _NS_PER_S, UTC).strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return "at no time that a calendar has"


def _date(wall_ns: int) -> str:
    return _time(wall_ns)[:10]
