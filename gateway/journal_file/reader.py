"""Reading a journal: what is committed, while the gateway goes on writing or not."""

import contextlib
import sqlite3
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, MissionRecord, ModeRecord, decode_journal_record
from firmware_protocol.errors import RecordError
from firmware_protocol.units import NS_PER_S, BootId, NodeId
from gateway.journal_file.audit_chain import COLUMNS, entry_of
from gateway.journal_file.audit_table import WIRE_COMMAND
from gateway.journal_file.blobs import (
    RECORDS_COMPRESSED,
    REPORTS_COMPRESSED,
    DamagedSegmentError,
    decompress,
    pair_needle,
    read_contents,
    unpack_records,
    unpack_reports,
)
from gateway.journal_file.schema import head_offset, oldest_offset, read_meta
from gateway.journal_file.segments import MISSION, MODE
from gateway.journal_file.writes import AuditEntry, Damage, UplinkReport

_KEPT_SEGMENTS = 16
"""Unpacked segments that a reader keeps: late reports of one moment ask for the same ones."""

_RECENT_TRAINS_NS = 7200 * NS_PER_S
"""Trains count for an hour at most (``stimulation.window_s``), by how long gateways ran."""

_NEWEST_AUDIT = f"""
SELECT {COLUMNS}, chain FROM audit WHERE command_id <> '' AND id IN (
  SELECT id FROM audit WHERE id > (SELECT coalesce(max(id), 0) FROM audit) - ?
  UNION SELECT id FROM audit WHERE train_ms > 0 AND ran_ns > (SELECT ran_ns FROM audit ORDER BY id DESC LIMIT 1) - ?)
ORDER BY id"""  # noqa: S608  # constants of this package

_HEAD = "first_offset, segment, encoding, crc, n_records"
_Head = tuple[int, int, int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordPage:
    """Records in the order of their offsets, as MessagePack, and what the journal has: from ``oldest_offset`` to ``head_offset``.

    It covers the offsets from ``first_offset`` up to the one before ``next_offset``; those of ``damage`` are not among the bodies.
    """

    first_offset: int
    next_offset: int
    bodies: tuple[bytes, ...]
    damage: tuple[Damage, ...]
    head_offset: int
    oldest_offset: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Unpacked:
    """The records of a segment, and the places of each pair's."""

    bodies: list[bytes]
    places: dict[bytes, list[int]]


class JournalReader:
    """A connection that only reads what is committed; what is damaged is passed over by ``read_page`` alone, which says so."""

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=5.0)
        self._connection.execute("PRAGMA query_only = ON")
        self._unpacked: OrderedDict[_Head, _Unpacked] = OrderedDict()

    def read_page(self, *, from_offset: int, limit: int) -> RecordPage:
        """Return up to ``limit`` records from an offset on, or from the oldest that is left."""
        bodies: list[bytes] = []
        damage: list[Damage] = []
        connection = self._connection
        with self._one_moment():
            head, oldest = head_offset(connection), oldest_offset(connection)
            first_offset = next_offset = max(from_offset, oldest)
            begin = "SELECT max(first_offset) FROM segments WHERE first_offset <= ? AND n_records > 0"
            (at,) = connection.execute(begin, (first_offset,)).fetchone()
            rows = connection.execute(
                f"SELECT {_HEAD} FROM segments WHERE first_offset >= ? AND n_records > 0 ORDER BY first_offset",  # noqa: S608  # a constant
                (oldest if at is None else at,),
            )
            for head_of_one in rows:
                end = head_of_one[0] + head_of_one[-1]
                try:
                    members = self._unpack(head_of_one).bodies[max(0, next_offset - head_of_one[0]) :][: limit - len(bodies)]
                    _expect_records(members, first_offset=max(next_offset, head_of_one[0]))
                except (DamagedSegmentError, RecordError) as error:
                    if end > next_offset:
                        damage.append(Damage(first=max(next_offset, head_of_one[0]), last=end - 1, reason=str(error)))
                    next_offset = max(next_offset, end)
                    continue
                bodies += members
                next_offset = max(next_offset, head_of_one[0]) + len(members)
                if len(bodies) >= limit:
                    break
            rows.close()
        return RecordPage(
            first_offset=first_offset,
            next_offset=next_offset,
            bodies=tuple(bodies),
            damage=tuple(damage),
            head_offset=head,
            oldest_offset=oldest,
        )

    def read_records(self, *, from_offset: int, limit: int) -> tuple[list[JournalRecord], int]:
        """Return up to ``limit`` records from an offset on, and the newest offset."""
        page = self.read_page(from_offset=from_offset, limit=limit)
        return [decode_journal_record(body) for body in page.bodies], page.head_offset

    def read_recent_modes(self, *, limit: int) -> list[ModeRecord]:
        """Return those of the newest ``limit`` mode records that are of the journal's name, in the order of their offsets."""
        begins = self._begins()
        return [record for record in self._states(MODE, limit) if isinstance(record, ModeRecord) and record.offset >= begins]

    def read_recent_missions(self, *, limit: int) -> list[MissionRecord]:
        """Return the newest ``limit`` records of the mission, in the order of their offsets: phases, and their revisions."""
        return [record for record in self._states(MISSION, limit) if isinstance(record, MissionRecord)]

    def read_pair(self, *, node_a: NodeId, node_b: NodeId, from_wall_ns: int, to_wall_ns: int) -> list[EncounterRecord]:
        """Return all revisions of a pair's encounters that overlap a time, in the order of their offsets.

        A revision may be shorter than an earlier one by what its ends are known better: who wants the newest ones looks that much further.
        """
        needle = pair_needle(node_a, node_b)
        found: list[JournalRecord] = []
        with self._one_moment():
            rows = self._connection.execute(
                f"SELECT {_HEAD} FROM segments WHERE max_end >= ? AND min_start <= ? ORDER BY first_offset",  # noqa: S608  # a constant
                (from_wall_ns, to_wall_ns),
            )
            for head in rows:
                if head in self._unpacked or self._may_hold(head, needle):
                    unpacked = self._unpack(head)
                    found += [decode_journal_record(unpacked.bodies[place]) for place in unpacked.places.get(needle, ())]
        begins = self._begins()
        encounters = [record for record in found if isinstance(record, EncounterRecord)]
        return [
            record
            for record in encounters
            if (record.node_a, record.node_b) == (node_a, node_b)
            and record.offset >= begins
            and _overlaps(record, from_wall_ns, to_wall_ns)
        ]

    def read_encounters(self, *, from_wall_ns: int, to_wall_ns: int) -> Iterator[EncounterRecord]:
        """Yield all revisions of all encounters that overlap a time, in the order of their offsets."""
        begins = self._begins()
        with self._one_moment():
            rows = self._connection.execute(
                f"SELECT {_HEAD} FROM segments WHERE max_end >= ? AND min_start <= ? ORDER BY first_offset",  # noqa: S608  # a constant
                (from_wall_ns, to_wall_ns),
            )
            for head in rows:
                for body in self._unpack(head).bodies:
                    record = decode_journal_record(body)
                    if isinstance(record, EncounterRecord) and record.offset >= begins and _overlaps(record, from_wall_ns, to_wall_ns):
                        yield record

    def read_latest_end(self) -> int | None:
        """Return the UTC before which all encounters of the journal ended [ns], or None where there are none."""
        (end_ns,) = self._connection.execute("SELECT max(max_end) FROM segments WHERE max_end IS NOT NULL").fetchone()
        return None if end_ns is None else int(end_ns)

    def read_reports(self) -> Iterator[UplinkReport]:
        """Yield all uplink messages that are left, in the order in which they were committed."""
        rows = self._connection.execute("SELECT segment, encoding, crc FROM segments WHERE n_reports > 0 ORDER BY first_offset, segment")
        for segment, encoding, crc in rows:
            _, _, reports = read_contents(self._connection, segment, crc=crc)
            yield from unpack_reports(decompress(reports, is_compressed=bool(encoding & REPORTS_COMPRESSED)))

    def read_windows(self) -> list[tuple[NodeId, BootId, int, list[int]]]:
        """Return the newest boots of each node, the number below which all is done, and the numbers above that."""
        rows = self._connection.execute("SELECT node, boot, next, above FROM windows ORDER BY ran_ns, wall_ns").fetchall()
        return [
            (NodeId(node), BootId(boot), at, [at + bit for bit in range(above.bit_length()) if above >> bit & 1])
            for node, boot, at, above in rows
        ]

    def read_last_heard(self) -> dict[NodeId, int]:
        """Return when each biobot was last heard, by how long gateways had run on the journal by then [ns]."""
        return {NodeId(node): ran_ns for node, ran_ns in self._connection.execute("SELECT node, max(ran_ns) FROM windows GROUP BY node")}

    def read_nodes(self) -> list[bytes]:
        """Return what is known of biobots, each as the bytes it was written with."""
        return [body for (body,) in self._connection.execute("SELECT body FROM nodes ORDER BY node")]

    def read_audit(self, *, command_id: str) -> list[AuditEntry]:
        """Return all rows of a command, in order."""
        # The second condition is the index's own: without it all rows are looked through.
        return self._audit("WHERE command_id = ? AND command_id <> '' ORDER BY id", (command_id,))

    def read_newest_audit(self, *, limit: int) -> Iterator[AuditEntry]:
        """Yield the rows of commands among the newest ``limit`` rows of the audit log, and older ones with recent trains, in order.

        However many commands were refused since, no train that may still count is missing. ``JournalIdentity.instant_of`` says when each
        was written.
        """
        rows = self._connection.execute(_NEWEST_AUDIT, (limit, _RECENT_TRAINS_NS))
        return map(entry_of, rows)

    def read_last_audit(self, *, kind: str, node: NodeId | None = None) -> AuditEntry | None:
        """Return the newest entry of a kind, of a biobot where one is named; not for stages of commands, which are many."""
        found = self._audit("WHERE kind = ? AND node IS ? AND kind <> 'stage' ORDER BY id DESC LIMIT 1", (kind, node))
        return found[0] if found else None

    def read_last_wire_command(self) -> int | None:
        """Return the number that the last admitted command had on the wire."""
        row = self._connection.execute("SELECT wire_command FROM audit WHERE wire_command IS NOT NULL ORDER BY id DESC LIMIT 1").fetchone()
        last = read_meta(self._connection, WIRE_COMMAND) if row is None else row[0]
        return None if last is None else int(last)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _begins(self) -> int:
        """Return the first offset of the journal's name; what is before it is of another history."""
        return int(read_meta(self._connection, "begins") or 1)

    @contextlib.contextmanager
    def _one_moment(self) -> Iterator[None]:
        """Read one moment of the file: segments are merged and dropped meanwhile."""
        self._connection.execute("BEGIN")
        try:
            yield
        finally:
            self._connection.execute("COMMIT")

    def _may_hold(self, head: _Head, needle: bytes) -> bool:
        query = "SELECT instr(pairs, ?) FROM contents WHERE segment = ?"
        return bool(self._connection.execute(query, (needle, head[1])).fetchone()[0])

    def _unpack(self, head: _Head) -> _Unpacked:
        unpacked = self._unpacked.get(head)
        if unpacked is not None:
            self._unpacked.move_to_end(head)
            return unpacked
        _, segment, encoding, crc, n_records = head
        pairs, records, _ = read_contents(self._connection, segment, crc=crc)
        bodies = unpack_records(decompress(records, is_compressed=bool(encoding & RECORDS_COMPRESSED)))
        if len(bodies) != n_records:
            raise DamagedSegmentError(f"it has {len(bodies)} records, but should have {n_records}")
        places: dict[bytes, list[int]] = {}
        for place in range(len(bodies)):
            places.setdefault(pairs[4 * place : 4 * place + 4], []).append(place)
        unpacked = self._unpacked[head] = _Unpacked(bodies=bodies, places=places)
        if len(self._unpacked) > _KEPT_SEGMENTS:
            self._unpacked.popitem(last=False)
        return unpacked

    def _states(self, kind: int, limit: int) -> list[JournalRecord]:
        rows = self._connection.execute("SELECT body FROM states WHERE kind = ? ORDER BY offset DESC LIMIT ?", (kind, limit)).fetchall()
        return [decode_journal_record(body) for (body,) in reversed(rows)]

    def _audit(self, where: str, values: Sequence[object]) -> list[AuditEntry]:
        rows = self._connection.execute(f"SELECT {COLUMNS}, chain FROM audit {where}", values)  # noqa: S608  # constants of this package
        return [entry_of(row) for row in rows]


def _expect_records(bodies: Sequence[bytes], *, first_offset: int) -> None:
    """Raise ``DamagedSegmentError`` or ``RecordError`` where bodies are not the records of these offsets."""
    for offset, body in enumerate(bodies, start=first_offset):
        said = decode_journal_record(body).offset
        if said != offset:
            raise DamagedSegmentError(f"the record at offset {offset} says that its offset is {said}")


def _overlaps(record: EncounterRecord, from_wall_ns: int, to_wall_ns: int) -> bool:
    anchor_ns = record.wall_anchor_ns
    return record.t_end_ns + anchor_ns >= from_wall_ns and record.t_start_ns + anchor_ns <= to_wall_ns
