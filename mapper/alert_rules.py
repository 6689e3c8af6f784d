"""What holds at one look at the site that somebody should know: one function for each kind of alert. Pure.

A rule that compares with a number lets go of what it told later than it begins to tell: ``is_on`` says what it told. Texts are for a
team leader: what it means, and what to do next.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.records import LandmarkChange, MissionPhase, MissionRecord, Mode
from mapper.alert_book import AlertKind, Condition, Severity
from mapper.fleet import BiobotView, GatewayView
from mapper.presence import Presence, gateway_faults, presence_of
from mapper.recent_contacts import Contacts

IsOn = Callable[[AlertKind, str], bool]

_UP: Final = "up"
_BATTERY_BACK_MV: Final = 100
_DISK_LOW_BYTES: Final = 512 * 2**20
_DISK_SCARCE_BYTES: Final = 128 * 2**20  # a gateway calls it a fault itself then
_DISK_BACK: Final = 1.25
# Of a walker that meets the same again and again: so many encounters with so few others, while half of the walkers met more.
_STUCK_ENCOUNTERS: Final = 6
_STUCK_PARTNERS: Final = 2
_FREE_PARTNERS: Final = 4
_LEAST_WALKERS: Final = 5
# The swarm is one while this share of those who met anybody hangs together; it is not said of fewer encounters each.
_SPLIT_SHARE: Final = 0.8
_WHOLE_SHARE: Final = 0.9
_LEAST_EACH: Final = 3
_LISTED: Final = 8
_OVER: Final = frozenset({MissionPhase.IDLE, MissionPhase.DONE})

_EVENTS: Final[Mapping[str, tuple[Severity, str]]] = {
    "journal.damaged": (
        Severity.WARNING,
        "has records on its disk that cannot be read any more. The map lacks them; copy its journal away, and exchange the disk.",
    ),
    "journal.behind": (
        Severity.WARNING,
        "runs on an older copy of its journal. Restart it when nothing is under way: it takes a new name for its journal then.",
    ),
    "journal.undelivered_dropped": (
        Severity.WARNING,
        "dropped records that a mapper did not have yet. The map lacks them; make room on its disk, or give its [retention] more.",
    ),
    "journal.oversized": (Severity.WARNING, "keeps more records than it may, and all are too young to go. Make room on its disk."),
    "node.duplicate": (
        Severity.WARNING,
        "hears two backpacks with one number: the map takes them for one insect. Give one of them another number.",
    ),
    "node.not_configured": (
        Severity.INFO,
        "could not configure a backpack: its encounters may be sensed otherwise than those of the others. Restart that backpack.",
    ),
    "radio.flood": (
        Severity.WARNING,
        "has a radio that says more than its share, and reads it more slowly. Look for a backpack that is stuck.",
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class AlertLimits:
    """From where on something is told."""

    lost_s: float = 60.0
    battery_mv: int = 2400
    battery_critical_mv: int = 2200


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """All that is looked at.

    ``events``, ``recent_changes`` (with their gateways), ``contacts``: of the last minutes; ``remedies``: what would help where the
    data are not enough for the map, None: they are.
    """

    is_connected: bool
    gateways: Sequence[GatewayView]
    biobots: Sequence[BiobotView]
    events: Sequence[GatewayEvent]
    faults: Sequence[str]
    missions: Sequence[MissionRecord]
    recent_changes: Sequence[tuple[str, LandmarkChange]]
    contacts: Contacts
    remedies: Sequence[str] | None


def find_conditions(situation: Situation, *, limits: AlertLimits, is_on: IsOn) -> list[Condition]:
    """Return all that holds."""
    return [
        *_bus(situation),
        *_gateways(situation, is_on),
        *_biobots(situation, limits, is_on),
        *_contacts(situation, is_on),
        *_landmarks(situation),
        *_data(situation),
    ]


def _bus(situation: Situation) -> Iterator[Condition]:
    if not situation.is_connected:
        text = (
            "The mapper is not connected to any gateway or router: nothing arrives, and no command leaves. "
            "Check cables and power; it connects by itself."
        )
        yield Condition(kind=AlertKind.BUS_AWAY, subject="bus", severity=Severity.CRITICAL, text=text)
    if situation.faults:
        text = f"The mapper itself says: {_steady('; '.join(situation.faults))}."
        yield Condition(kind=AlertKind.MAPPER_FAULT, subject="mapper", severity=Severity.WARNING, text=text)


def _gateways(situation: Situation, is_on: IsOn) -> Iterator[Condition]:
    for view in situation.gateways:
        subject = f"gateway {view.name}"
        if not view.is_alive:
            if situation.is_connected:
                text = (
                    f"Gateway {view.name} has fallen silent: nothing arrives from its biobots, and commands do not reach them. "
                    "Check its power and network; what it recorded meanwhile comes when it is back."
                )
                yield Condition(kind=AlertKind.GATEWAY_AWAY, subject=subject, severity=Severity.CRITICAL, text=text)
            continue
        yield from _radios(view)
        yield from _disk(view, is_on)
        faults = gateway_faults(view)
        if faults:
            text = f"Gateway {view.name} says: {_steady('; '.join(faults))}."
            yield Condition(kind=AlertKind.GATEWAY_FAULT, subject=subject, severity=Severity.CRITICAL, text=text)
    for event in situation.events:
        if event.kind in _EVENTS:
            severity, text = _EVENTS[event.kind]
            node = event.facts.get("node")
            about = f"gateway {event.gateway}, {event.kind}" + ("" if node is None else f", biobot {node}")
            whose = "" if node is None else f" (biobot {node})"
            yield Condition(kind=AlertKind.GATEWAY_EVENT, subject=about, severity=severity, text=f"Gateway {event.gateway} {text}{whose}")


def _radios(view: GatewayView) -> Iterator[Condition]:
    if view.status is None:
        return
    is_any_up = _UP in view.status.radios.values()
    for name, state in sorted(view.status.radios.items()):
        if state == _UP:
            continue
        report = view.status.radio_reports.get(name)
        why = f" ({_steady(report.reason)})" if report is not None and report.reason else ""
        rest = (
            "Biobots may still be heard by its other radios."
            if is_any_up
            else "It has no other: no biobot there is heard or can be stopped."
        )
        text = f"Radio {name} of gateway {view.name} is {state}{why}. {rest} Check the dongle and its cable."
        severity = Severity.WARNING if is_any_up else Severity.CRITICAL
        yield Condition(kind=AlertKind.RADIO_DOWN, subject=f"radio {name} of gateway {view.name}", severity=severity, text=text)


def _disk(view: GatewayView, is_on: IsOn) -> Iterator[Condition]:
    free = None if view.status is None else view.status.disk_free_bytes
    subject = f"gateway {view.name}"
    if free is None or free >= _DISK_LOW_BYTES * (_DISK_BACK if is_on(AlertKind.DISK_FULL, subject) else 1.0):
        return
    is_scarce = free < _DISK_SCARCE_BYTES
    state = "all but full" if is_scarce else "filling up"
    text = f"The disk of gateway {view.name} is {state}. When it is full, nothing is recorded. Make room."
    severity = Severity.CRITICAL if is_scarce else Severity.WARNING
    yield Condition(kind=AlertKind.DISK_FULL, subject=subject, severity=severity, text=text)


def _biobots(situation: Situation, limits: AlertLimits, is_on: IsOn) -> Iterator[Condition]:
    gateways = {view.name: view for view in situation.gateways if view.is_alive and view.status is not None}
    for biobot in situation.biobots:
        if biobot.gateway not in gateways:
            continue  # of one whose gateway is away nothing is known
        subject = f"biobot {biobot.node}"
        if presence_of(biobot, gateways=gateways, lost_s=limits.lost_s) is Presence.LOST:
            role = "It was a landmark: the map leans on it no more. " if biobot.is_landmark else ""
            text = (
                f"Biobot {biobot.node} has not been heard for over {limits.lost_s:g} s, though gateway {biobot.gateway} works. {role}"
                "It is out of range, stuck or without power: look where it was last."
            )
            yield Condition(kind=AlertKind.BIOBOT_LOST, subject=subject, severity=Severity.WARNING, text=text)
        yield from _battery(biobot, subject, limits, is_on)


def _battery(biobot: BiobotView, subject: str, limits: AlertLimits, is_on: IsOn) -> Iterator[Condition]:
    battery_mv = biobot.battery_mv or 0  # 0: it does not measure
    back_mv = _BATTERY_BACK_MV if is_on(AlertKind.BATTERY_LOW, subject) else 0
    if battery_mv == 0 or battery_mv >= limits.battery_mv + back_mv:
        return
    is_critical = battery_mv < limits.battery_critical_mv
    text = (
        f"The battery of biobot {biobot.node} is {'all but empty' if is_critical else 'low'} "
        f"(below {limits.battery_critical_mv if is_critical else limits.battery_mv} mV). Fetch it, or have another take its place."
    )
    yield Condition(kind=AlertKind.BATTERY_LOW, subject=subject, severity=Severity.WARNING if is_critical else Severity.INFO, text=text)


def _contacts(situation: Situation, is_on: IsOn) -> Iterator[Condition]:
    contacts = situation.contacts
    walkers = [biobot for biobot in situation.biobots if biobot.mode is Mode.CRW and biobot.node in contacts.partners]
    usual = median(contacts.partners[biobot.node] for biobot in walkers) if len(walkers) >= _LEAST_WALKERS else 0
    for biobot in walkers:
        subject = f"biobot {biobot.node}"
        few = _FREE_PARTNERS - 1 if is_on(AlertKind.BIOBOT_STUCK, subject) else _STUCK_PARTNERS
        is_often = contacts.n_encounters[biobot.node] >= _STUCK_ENCOUNTERS
        if is_often and contacts.partners[biobot.node] <= few and usual >= _FREE_PARTNERS:
            text = (
                f"Biobot {biobot.node} walks, but meets the same neighbours again and again: it may be caught in a corner. "
                "Turn it by a command, or look there."
            )
            yield Condition(kind=AlertKind.BIOBOT_STUCK, subject=subject, severity=Severity.WARNING, text=text)
    n_biobots = sum(map(len, contacts.groups))
    share = _WHOLE_SHARE if is_on(AlertKind.SWARM_SPLIT, "swarm") else _SPLIT_SHARE
    if (
        sum(contacts.n_encounters.values()) < _LEAST_EACH * n_biobots
        or len(contacts.groups) < 2
        or len(contacts.groups[0]) >= share * n_biobots
    ):
        return
    sizes = ", ".join(str(len(group)) for group in contacts.groups[:4])
    listed = "; ".join(_listed(group) for group in contacts.groups[1:3])
    text = (
        f"The swarm has come apart: groups of {sizes} biobots have not met each other lately (apart: {listed}). "
        "How these parts lie to each other is not known; steer a biobot across, or add some between."
    )
    yield Condition(kind=AlertKind.SWARM_SPLIT, subject="swarm", severity=Severity.WARNING, text=text)


def _landmarks(situation: Situation) -> Iterator[Condition]:
    newest: dict[str, MissionRecord] = {}
    for record in situation.missions:  # in the order in which they began
        newest[record.gateway] = record
    lost = [
        (record.gateway, change)
        for record in newest.values()
        if record.phase not in _OVER
        for change in record.changes
        if change.replacement is None and change.node not in record.landmarks
    ]
    replaced = [(gateway, change) for gateway, change in situation.recent_changes if change.replacement is not None]
    for gateway, change in (*lost, *replaced):
        if change.replacement is None:
            fate, severity = (
                "and no other could take its place: that part of the map is less sure. Let another biobot stand there.",
                Severity.WARNING,
            )
        else:
            fate, severity = f"and biobot {change.replacement} took its place. Nothing need be done.", Severity.INFO
        text = f"Biobot {change.node} is no landmark any more ({change.reason}), {fate}"
        subject = f"landmark {change.node} of gateway {gateway}"
        yield Condition(kind=AlertKind.LANDMARK_LOST, subject=subject, severity=severity, text=text)


def _data(situation: Situation) -> Iterator[Condition]:
    if situation.remedies is None:
        return
    help_ = f" It would help to {situation.remedies[0]}." if situation.remedies else ""
    text = f"There are not enough data yet for what the map shows: do not rely on its holes.{_steady(help_)}"
    yield Condition(kind=AlertKind.DATA_NOT_ENOUGH, subject="map", severity=Severity.INFO, text=text)


def _listed(nodes: Sequence[int]) -> str:
    return ", ".join(map(str, nodes[:_LISTED])) + (f" and {len(nodes) - _LISTED} more" if len(nodes) > _LISTED else "")


def _steady(text: str) -> str:
    """Take lengths of time out of a text: what changes by the second is no news."""
    return re.sub(r"\b\d+(\.\d+)? (s|min|h)\b", "a while", text)
