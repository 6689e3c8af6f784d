"""Reading a journal: what is committed, while the gateway goes on writing or not."""

import contextlib
import sqlite3
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, MissionRecord, ModeRecord, decode_journal_record
from firmware_protocol.units import BootId, NodeId
from gateway.journal_file.blobs import decompress, pair_needle, unpack_records, unpack_reports
from gateway.journal_file.schema import head_offset, oldest_offset
from gateway.journal_file.segments import MISSION, MODE, RECORDS_COMPRESSED, REPORTS_COMPRESSED
from gateway.journal_file.writes import AuditEntry, UplinkReport

_KEPT_SEGMENTS = 16
"""Unpacked segments that a reader keeps: late reports of one moment ask for the same ones."""

_HEAD = "first_offset, segment, encoding, crc"
_Head = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordPage:
    """Records in the order of their offsets, as MessagePack, and what the journal has: from ``oldest_offset`` to ``head_offset``."""

    first_offset: int
    bodies: tuple[bytes, ...]
    head_offset: int
    oldest_offset: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Unpacked:
    """The records of a segment, and the places of each pair's."""

    bodies: list[bytes]
    places: dict[bytes, list[int]]


class JournalReader:
    """A connection that only reads what is committed."""

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=5.0)
        self._connection.execute("PRAGMA query_only = ON")
        self._unpacked: OrderedDict[_Head, _Unpacked] = OrderedDict()

    def read_page(self, *, from_offset: int, limit: int) -> RecordPage:
        """Return up to ``limit`` records from an offset on, or from the oldest that is left."""
        bodies: list[bytes] = []
        connection = self._connection
        with self._one_moment():
            head, oldest = head_offset(connection), oldest_offset(connection)
            first_offset = max(from_offset, oldest)
            begin = "SELECT max(first_offset) FROM segments WHERE first_offset <= ? AND n_records > 0"
            (at,) = connection.execute(begin, (first_offset,)).fetchone()
            rows = connection.execute(
                f"SELECT {_HEAD} FROM segments WHERE first_offset >= ? AND n_records > 0 ORDER BY first_offset",  # noqa: S608  # a constant
                (oldest if at is None else at,),
            )
            for head_of_one in rows:
                members = self._unpack(head_of_one).bodies
                bodies += members[max(0, first_offset - head_of_one[0]) :][: limit - len(bodies)]
                if len(bodies) >= limit:
                    break
            rows.close()
        return RecordPage(first_offset=first_offset, bodies=tuple(bodies), head_offset=head, oldest_offset=oldest)

    def read_records(self, *, from_offset: int, limit: int) -> tuple[list[JournalRecord], int]:
        """Return up to ``limit`` records from an offset on, and the newest offset."""
        page = self.read_page(from_offset=from_offset, limit=limit)
        return [decode_journal_record(body) for body in page.bodies], page.head_offset

    def read_recent_modes(self, *, limit: int) -> list[ModeRecord]:
        """Return the newest ``limit`` mode records, in the order of their offsets."""
        return [record for record in self._states(MODE, limit) if isinstance(record, ModeRecord)]

    def read_last_mission(self) -> MissionRecord | None:
        """Return the phase that began last, or None where no mission has run."""
        for record in self._states(MISSION, 1):
            if isinstance(record, MissionRecord):
                return record
        return None

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
        encounters = [record for record in found if isinstance(record, EncounterRecord)]
        return [
            record
            for record in encounters
            if (record.node_a, record.node_b) == (node_a, node_b) and _overlaps(record, from_wall_ns, to_wall_ns)
        ]

    def read_encounters(self, *, from_wall_ns: int, to_wall_ns: int) -> Iterator[EncounterRecord]:
        """Yield all revisions of all encounters that overlap a time, in the order of their offsets."""
        with self._one_moment():
            rows = self._connection.execute(
                f"SELECT {_HEAD} FROM segments WHERE max_end >= ? AND min_start <= ? ORDER BY first_offset",  # noqa: S608  # a constant
                (from_wall_ns, to_wall_ns),
            )
            for head in rows:
                for body in self._unpack(head).bodies:
                    record = decode_journal_record(body)
                    if isinstance(record, EncounterRecord) and _overlaps(record, from_wall_ns, to_wall_ns):
                        yield record

    def read_latest_end(self) -> int | None:
        """Return the UTC before which all encounters of the journal ended [ns], or None where there are none."""
        (end_ns,) = self._connection.execute("SELECT max(max_end) FROM segments WHERE max_end IS NOT NULL").fetchone()
        return None if end_ns is None else int(end_ns)

    def read_reports(self) -> Iterator[UplinkReport]:
        """Yield all uplink messages that are left, in the order in which they were committed."""
        rows = self._connection.execute(
            "SELECT s.encoding, c.reports FROM segments s JOIN contents c ON c.segment = s.segment "
            "WHERE s.n_reports > 0 ORDER BY s.first_offset, s.segment"
        )
        for encoding, reports in rows:
            yield from unpack_reports(decompress(reports, is_compressed=bool(encoding & REPORTS_COMPRESSED)))

    def read_windows(self) -> list[tuple[NodeId, BootId, int, list[int]]]:
        """Return the newest boots of each node, the number below which all is done, and the numbers above that."""
        rows = self._connection.execute("SELECT node, boot, next, above FROM windows ORDER BY wall_ns").fetchall()
        return [
            (NodeId(node), BootId(boot), at, [at + bit for bit in range(above.bit_length()) if above >> bit & 1])
            for node, boot, at, above in rows
        ]

    def read_nodes(self) -> list[bytes]:
        """Return what is known of biobots, each as the bytes it was written with."""
        return [body for (body,) in self._connection.execute("SELECT body FROM nodes ORDER BY node")]

    def read_audit(self, *, command_id: str) -> list[AuditEntry]:
        """Return all stages of a command, in order."""
        return self._audit("WHERE command_id = ? ORDER BY id", (command_id,))

    def read_audit_since(self, wall_ns: int) -> list[AuditEntry]:
        """Return the stages of all commands from an instant on, in order."""
        return self._audit("WHERE wall_ns >= ? ORDER BY id", (wall_ns,))

    def read_last_wire_command(self) -> int | None:
        """Return the number that the last admitted command had on the wire."""
        row = self._connection.execute("SELECT wire_command FROM audit WHERE wire_command IS NOT NULL ORDER BY id DESC LIMIT 1").fetchone()
        return None if row is None else int(row[0])

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

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
        query = "SELECT pairs, records FROM contents WHERE segment = ?"
        pairs, records = self._connection.execute(query, (head[1],)).fetchone() or (b"", b"")
        bodies = unpack_records(decompress(records, is_compressed=bool(head[2] & RECORDS_COMPRESSED)))
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
        columns = "wall_ns, command_id, wire_command, stage, node, train_ms, request, body"
        rows = self._connection.execute(f"SELECT {columns} FROM audit {where}", values)  # noqa: S608  # both parts are constants of this file
        names = columns.split(", ")
        return [AuditEntry(**dict(zip(names, row, strict=True))) for row in rows]


def _overlaps(record: EncounterRecord, from_wall_ns: int, to_wall_ns: int) -> bool:
    anchor_ns = record.wall_anchor_ns
    return record.t_end_ns + anchor_ns >= from_wall_ns and record.t_start_ns + anchor_ns <= to_wall_ns
