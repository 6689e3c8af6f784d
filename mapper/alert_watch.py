"""Looks at the site every few seconds, and keeps the alerts: in memory for who asks, in the store over a restart."""

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Final

import msgspec

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.records import LandmarkChange, MissionRecord
from mapper.alert_archive import change_alerts, read_alerts
from mapper.alert_book import Alert, AlertBook
from mapper.alert_rules import AlertLimits, Situation, find_conditions
from mapper.changes import Changes, Topic
from mapper.current_map import CurrentMap
from mapper.errors import MapDocumentError, StoreError
from mapper.fleet import Fleet
from mapper.hole_watch import HoleWatch
from mapper.log import EventLog
from mapper.recent_contacts import RecentContacts
from mapper.request_errors import AlertNotFoundError
from mapper.store_thread import StoreThread

_log = EventLog(__name__)

PERIOD_S: Final = 2.0
_SPAN_NS: Final = 600 * 1_000_000_000
"""Contacts, and what gateways tell once, count for so long."""
_MAX_EVENTS: Final = 1000


class _Data(msgspec.Struct, frozen=True):
    is_enough: bool
    remedies: tuple[str, ...]


class _Map(msgspec.Struct, frozen=True):
    data: _Data | None


_decoder = msgspec.json.Decoder(_Map)


class AlertWatch:
    """Finds what holds, and remembers alerts.

    Parameters
    ----------
    sure
        A new hole at least so likely is told.
    is_connected, faults
        Of this mapper; asked at each look.
    """

    def __init__(
        self,
        *,
        records: StoreThread,
        fleet: Fleet,
        changes: Changes,
        current_map: CurrentMap,
        limits: AlertLimits,
        sure: float,
        is_connected: Callable[[], bool],
        faults: Callable[[], list[str]],
    ) -> None:
        self.lost_s = limits.lost_s
        self._records = records
        self._fleet = fleet
        self._changes = changes
        self._current_map = current_map
        self._limits = limits
        self._is_connected = is_connected
        self._faults = faults
        self._book = AlertBook()
        self._contacts = RecentContacts()
        self._change = 0
        self._holes = HoleWatch(sure=sure)
        self._seen_version = 0
        self._remedies: tuple[str, ...] | None = None
        self._events: dict[bytes, tuple[int, GatewayEvent]] = {}
        """What gateways told once, and when it was first seen here [ns, monotonic]."""
        self._unwritten: set[int] = set()
        self._is_writing = asyncio.Lock()

    @property
    def alerts(self) -> Sequence[Alert]:
        """All that are remembered, the newest first."""
        return sorted(self._book.alerts.values(), key=lambda alert: -alert.id)

    async def restore(self) -> None:
        """Go on from the alerts in the store; without those, where it cannot be read."""
        try:
            self._book.restore(await self._records.call(read_alerts))
        except StoreError as error:
            _log.error("alerts.unreadable", reason=str(error))

    async def run(self) -> None:
        """Look again and again, until cancelled."""
        while True:
            await self.look()
            await asyncio.sleep(PERIOD_S)

    async def look(self) -> None:
        """Look at all once."""
        now_ns, wall_ns = time.monotonic_ns(), time.time_ns()
        await self._look_at_map(now_ns=now_ns)
        situation = await self._situation(now_ns=now_ns, wall_ns=wall_ns)
        conditions = find_conditions(situation, limits=self._limits, is_on=self._book.is_on)
        changed, forgotten = self._book.take([*conditions, *self._holes.conditions(now_ns=now_ns)], now_ns=now_ns, wall_ns=wall_ns)
        for alert in changed:
            _log.info(
                f"alert.{'on' if alert.is_on else 'off'}", kind=alert.kind.value, subject=alert.subject, severity=alert.severity.value
            )
        if changed or forgotten or self._unwritten:
            await self._write([alert.id for alert in changed], forgotten)

    async def acknowledge(self, alert_id: int, *, person: str) -> Alert:
        """Note who has seen an alert; the first one stays.

        Raises
        ------
        AlertNotFoundError
            There is no such alert.
        """
        alert = self._book.acknowledge(alert_id, person=person, wall_ns=time.time_ns())
        if alert is None:
            raise AlertNotFoundError(alert_id=alert_id)
        await self._write([alert_id], [])
        return alert

    async def _look_at_map(self, *, now_ns: int) -> None:
        latest = self._current_map.latest
        if latest is None or latest.version == self._seen_version:
            return
        self._seen_version = latest.version
        data = _decoder.decode(latest.map_json).data
        self._remedies = None if data is None or data.is_enough else data.remedies
        try:
            await asyncio.to_thread(self._holes.take, latest.map_json, now_ns=now_ns)
        except MapDocumentError as error:
            _log.error("alerts.map_unread", version=latest.version, reason=str(error))

    async def _situation(self, *, now_ns: int, wall_ns: int) -> Situation:
        change = self._change
        rows, missions, self._change = await self._records.call(
            lambda store: (store.encounters_after(change), store.missions(), store.progress.change)
        )
        self._contacts.take(rows, since_ns=wall_ns - _SPAN_NS)
        return Situation(
            is_connected=self._is_connected(),
            gateways=self._fleet.gateways(now_ns=now_ns),
            biobots=self._fleet.biobots(now_ns=now_ns),
            events=self._recent_events(now_ns=now_ns),
            faults=self._faults(),
            missions=missions,
            recent_changes=_recent_changes(missions, since_ns=wall_ns - _SPAN_NS),
            contacts=self._contacts.contacts(),
            remedies=self._remedies,
        )

    def _recent_events(self, *, now_ns: int) -> list[GatewayEvent]:
        """Return what gateways told of lately, by when it came here: their clocks may be wrong."""
        for event in self._fleet.events:
            self._events.setdefault(msgspec.msgpack.encode(event), (now_ns, event))
        self._events = dict(list(self._events.items())[-_MAX_EVENTS:])
        return [event for seen_ns, event in self._events.values() if now_ns - seen_ns < _SPAN_NS]

    async def _write(self, changed: list[int], forgotten: list[int]) -> None:
        self._changes.bump(Topic.ALERTS)
        async with self._is_writing:
            self._unwritten = self._unwritten | set(changed) | set(forgotten)
            unwritten = self._unwritten
            put = [alert for number in sorted(unwritten) if (alert := self._book.alerts.get(number)) is not None]
            drop = [number for number in unwritten if number not in self._book.alerts]
            try:
                await self._records.call(change_alerts, put=put, drop=drop)
            except StoreError as error:
                _log.debug("alerts.not_kept", reason=str(error))  # the store's own fault is told by who writes records
                return
            self._unwritten = self._unwritten - unwritten


def _recent_changes(missions: Sequence[MissionRecord], *, since_ns: int) -> list[tuple[str, LandmarkChange]]:
    newest = {record.gateway: record for record in missions}
    return [(record.gateway, change) for record in newest.values() for change in record.changes if change.wall_ns >= since_ns]
