"""Encounters for those who read the store page by page: each record, and what it is a part of."""

import sqlite3
from dataclasses import dataclass

from firmware_protocol.contract.records import EncounterRecord, RecordIdentity, decode_journal_record
from mapper.record_columns import wall_interval
from mapper.site_view import SiteView


@dataclass(frozen=True, slots=True, kw_only=True)
class JointEncounter:
    """What several records of one encounter amount to: instants on the site's clock [ns], and the identities, the counted one first."""

    t_start_ns: int
    t_end_ns: int
    is_reciprocal: bool
    identities: tuple[RecordIdentity, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterPage:
    """Encounters in the order in which they were last changed; ``cursor`` of the last one asks for what follows.

    Beside each record: what is added to its gateway's wall clock [ns], how wrong that may be [ns], and what it is a part of; None where it
    is alone.
    """

    records: tuple[EncounterRecord, ...]
    shifts_ns: tuple[int, ...]
    bounds_ns: tuple[int, ...]
    joint: tuple[JointEncounter | None, ...]
    cursor: int
    has_more: bool


def read_page(database: sqlite3.Connection, site: SiteView, *, kind: int, after: int, limit: int) -> EncounterPage:
    """Read encounters changed after a cursor, void ones too."""
    found = database.execute(
        "SELECT id, change, body FROM record WHERE kind = ? AND change > ? ORDER BY change LIMIT ?", (kind, after, limit + 1)
    ).fetchall()
    rows = [(row, record) for row, _, body in found[:limit] if isinstance(record := decode_journal_record(body), EncounterRecord)]
    return EncounterPage(
        records=tuple(record for _, record in rows),
        shifts_ns=tuple(_shift_of(site, row, record) for row, record in rows),
        bounds_ns=tuple(site.clock_bound(record.gateway, record.wall_anchor_ns) for _, record in rows),
        joint=tuple(_joint_of(database, site, row) for row, _ in rows),
        cursor=found[:limit][-1][1] if found else after,
        has_more=len(found) > limit,
    )


def _shift_of(site: SiteView, row: int, record: EncounterRecord) -> int:
    place = site.encounters.interval(row) if site.is_joining else None
    return 0 if place is None else place[0] - wall_interval(record)[0]


def _joint_of(database: sqlite3.Connection, site: SiteView, row: int) -> JointEncounter | None:
    members = site.members(row)
    place = site.encounters.interval(members[0])
    if len(members) == 1 or place is None:
        return None
    bodies = [database.execute("SELECT body FROM record WHERE id = ?", (member,)).fetchone()[0] for member in members]
    records = [record for body in bodies if isinstance(record := decode_journal_record(body), EncounterRecord)]
    return JointEncounter(
        t_start_ns=place[0],
        t_end_ns=place[1],
        is_reciprocal=any(record.is_reciprocal for record in records) or len({side.node for one in records for side in one.sides}) > 1,
        identities=tuple(record.identity for record in records),
    )
