"""Alerts: what is wrong or new, since when, and who has seen it. Pure: conditions and instants are arguments.

A *condition* is what a rule finds to hold at one look; an *alert* is a condition that has held long enough to be told, from then until it
has not held for long enough. So nothing that flickers raises alert after alert.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import msgspec

from firmware_protocol.first_use import prepare

MAX_ALERTS: Final = 1000
"""So many are remembered; those that are over go first, the oldest first."""


class Severity(StrEnum):
    """How soon somebody must act: not at all, when there is time, now."""

    INFO = "info"
    WARNING = "warning"
    CRITICAL = "critical"


class AlertKind(StrEnum):
    """What alerts are about."""

    BIOBOT_LOST = "biobot_lost"
    BIOBOT_STUCK = "biobot_stuck"
    BATTERY_LOW = "battery_low"
    SWARM_SPLIT = "swarm_split"
    GATEWAY_AWAY = "gateway_away"
    GATEWAY_FAULT = "gateway_fault"
    GATEWAY_EVENT = "gateway_event"
    DISK_FULL = "disk_full"
    RADIO_DOWN = "radio_down"
    BUS_AWAY = "bus_away"
    MAPPER_FAULT = "mapper_fault"
    LANDMARK_LOST = "landmark_lost"
    NEW_HOLE = "new_hole"
    HOLE_VANISHED = "hole_vanished"
    DATA_NOT_ENOUGH = "data_not_enough"


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """Something that holds now.

    ``subject``: of what, as in "biobot 17"; ``text``: what it means and what to do, without numbers that change by the second.
    """

    kind: AlertKind
    subject: str
    severity: Severity
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """How long a condition must hold before it is an alert, and be gone before that is over [s]."""

    on_after_s: float = 0.0
    off_after_s: float = 0.0


PATIENCE: Final[Mapping[AlertKind, Patience]] = {
    AlertKind.BIOBOT_LOST: Patience(off_after_s=5.0),
    AlertKind.BIOBOT_STUCK: Patience(on_after_s=30.0, off_after_s=30.0),
    AlertKind.BATTERY_LOW: Patience(on_after_s=5.0, off_after_s=30.0),
    AlertKind.SWARM_SPLIT: Patience(on_after_s=60.0, off_after_s=60.0),
    AlertKind.GATEWAY_AWAY: Patience(on_after_s=3.0, off_after_s=3.0),
    AlertKind.GATEWAY_FAULT: Patience(on_after_s=3.0, off_after_s=10.0),
    AlertKind.GATEWAY_EVENT: Patience(),
    AlertKind.DISK_FULL: Patience(off_after_s=10.0),
    AlertKind.RADIO_DOWN: Patience(on_after_s=10.0, off_after_s=5.0),
    AlertKind.BUS_AWAY: Patience(on_after_s=10.0, off_after_s=3.0),
    AlertKind.MAPPER_FAULT: Patience(on_after_s=3.0, off_after_s=10.0),
    AlertKind.LANDMARK_LOST: Patience(),
    AlertKind.NEW_HOLE: Patience(),
    AlertKind.HOLE_VANISHED: Patience(),
    AlertKind.DATA_NOT_ENOUGH: Patience(on_after_s=60.0, off_after_s=30.0),
}
"""What is counted in reports or maps by its own rule needs none here."""

AlertKey = tuple[AlertKind, str]


class Alert(msgspec.Struct, frozen=True, kw_only=True):
    """An alert as it stands; ``ended_wall_ns`` None: it is on."""

    id: int
    kind: AlertKind
    severity: Severity
    subject: str
    text: str
    since_wall_ns: int
    ended_wall_ns: int | None = None
    acknowledged_by: str | None = None
    acknowledged_wall_ns: int | None = None

    @property
    def is_on(self) -> bool:
        """Say whether it holds."""
        return self.ended_wall_ns is None


prepare(Alert)


@dataclass(slots=True)
class AlertBook:
    """All alerts that are remembered, by id."""

    alerts: dict[int, Alert] = field(default_factory=dict)
    _next_id: int = 1
    _on: dict[AlertKey, int] = field(default_factory=dict)
    """Ids of those that are on."""
    _since: dict[AlertKey, tuple[int, int]] = field(default_factory=dict)
    """Of conditions that hold and are no alerts yet: since when, on the monotonic clock and the wall clock [ns]."""
    _gone: dict[AlertKey, int] = field(default_factory=dict)
    """Of alerts whose condition does not hold: since when [ns, monotonic]."""

    def restore(self, alerts: Iterable[Alert]) -> None:
        """Go on from the alerts of before a restart: those that were on are, until their conditions have not held for long enough."""
        for alert in alerts:
            self.alerts[alert.id] = alert
            self._next_id = max(self._next_id, alert.id + 1)
            if alert.is_on:
                self._on[alert.kind, alert.subject] = alert.id

    def is_on(self, kind: AlertKind, subject: str) -> bool:
        """Say whether there is such an alert: rules hold on to what they told, and let go of it later than they began."""
        return (kind, subject) in self._on

    def take(self, conditions: Iterable[Condition], *, now_ns: int, wall_ns: int) -> tuple[list[Alert], list[int]]:
        """Take in all that holds at one look; return the alerts that have changed, and ids of those that are forgotten.

        Parameters
        ----------
        now_ns, wall_ns
            The instant on the monotonic and on the wall clock [ns].
        """
        holding = {(condition.kind, condition.subject): condition for condition in conditions}
        changed = [alert for key, condition in holding.items() if (alert := self._hold(key, condition, now_ns, wall_ns)) is not None]
        for key in [key for key in self._since if key not in holding]:
            del self._since[key]
        for key in [key for key in self._on if key not in holding]:
            gone_ns = self._gone.setdefault(key, now_ns)
            if now_ns - gone_ns >= PATIENCE[key[0]].off_after_s * 1e9:
                del self._gone[key]
                changed.append(self._put(msgspec.structs.replace(self.alerts[self._on.pop(key)], ended_wall_ns=wall_ns)))
        return changed, self._forget()

    def acknowledge(self, alert_id: int, *, person: str, wall_ns: int) -> Alert | None:
        """Note who has seen an alert; the first one stays. None: there is no such alert."""
        alert = self.alerts.get(alert_id)
        if alert is None or alert.acknowledged_by is not None:
            return alert
        return self._put(msgspec.structs.replace(alert, acknowledged_by=person, acknowledged_wall_ns=wall_ns))

    def _hold(self, key: AlertKey, condition: Condition, now_ns: int, wall_ns: int) -> Alert | None:
        self._gone.pop(key, None)
        told = self._on.get(key)
        if told is not None:
            alert = self.alerts[told]
            if (alert.severity, alert.text) == (condition.severity, condition.text):
                return None
            # What has become worse wants to be seen anew.
            is_worse = list(Severity).index(condition.severity) > list(Severity).index(alert.severity)
            seen = {"acknowledged_by": None, "acknowledged_wall_ns": None} if is_worse else {}
            return self._put(msgspec.structs.replace(alert, severity=condition.severity, text=condition.text, **seen))
        since_ns, since_wall_ns = self._since.setdefault(key, (now_ns, wall_ns))
        if now_ns - since_ns < PATIENCE[condition.kind].on_after_s * 1e9:
            return None
        del self._since[key]
        alert = Alert(
            id=self._next_id,
            kind=condition.kind,
            severity=condition.severity,
            subject=condition.subject,
            text=condition.text,
            since_wall_ns=since_wall_ns,
        )
        self._next_id += 1
        self._on[key] = alert.id
        return self._put(alert)

    def _put(self, alert: Alert) -> Alert:
        self.alerts[alert.id] = alert
        return alert

    def _forget(self) -> list[int]:
        n_over = len(self.alerts) - MAX_ALERTS
        if n_over <= 0:
            return []
        forgotten = sorted(self.alerts, key=lambda number: (self.alerts[number].is_on, number))[:n_over]
        for number in forgotten:
            alert = self.alerts.pop(number)
            if alert.is_on:
                del self._on[alert.kind, alert.subject]
        return forgotten
