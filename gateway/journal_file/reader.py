"""Reading a journal: what is committed, while the gateway goes on writing or not."""

import sqlite3
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, MissionRecord, ModeRecord, decode_journal_record
from firmware_protocol.units import BootId, NodeId
from gateway.journal_file.blobs import decompress, find_pair, pair_needle, unpack_records, unpack_reports
from gateway.journal_file.schema import head_offset, oldest_offset
from gateway.journal_file.segments import MISSION, MODE, RECORDS_COMPRESSED, REPORTS_COMPRESSED
from gateway.journal_file.writes import AuditEntry, UplinkReport

_KEPT_SEGMENTS = 16
"""Unpacked segments that a reader keeps: late reports of one moment ask for the same ones."""

_CONTENT = "s.first_offset, s.segment, s.n_records, s.encoding, s.crc"
_CONTENTS = "segments s JOIN contents c ON c.segment = s.segment"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordPage:
    """Records in the order of their offsets, as MessagePack, and what the journal has: from ``oldest_offset`` to ``head_offset``."""

    first_offset: int
    bodies: tuple[bytes, ...]
    head_offset: int
    oldest_offset: int


class JournalReader:
    """A connection that only reads what is committed."""

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=5.0)
        self._connection.execute("PRAGMA query_only = ON")
        self._unpacked: OrderedDict[tuple[int, int, int], list[bytes]] = OrderedDict()

    def read_page(self, *, from_offset: int, limit: int) -> RecordPage:
        """Return up to ``limit`` records from an offset on, or from the oldest that is left."""
        bodies: list[bytes] = []
        connection = self._connection
        connection.execute("BEGIN")  # one moment of the file: segments are merged and dropped meanwhile
        try:
            head, oldest = head_offset(connection), oldest_offset(connection)
            first_offset = max(from_offset, oldest)
            begin = "SELECT max(first_offset) FROM segments WHERE first_offset <= ? AND n_records > 0"
            (at,) = connection.execute(begin, (first_offset,)).fetchone()
            rows = connection.execute(
                f"SELECT {_CONTENT}, c.records FROM {_CONTENTS} "  # noqa: S608  # constants of this file
                "WHERE s.first_offset >= ? AND s.n_records > 0 ORDER BY s.first_offset",
                (oldest if at is None else at,),
            )
            for first, segment, _n_records, encoding, crc, records in rows:
                members = self._unpack(first, segment, encoding, crc, records)
                bodies += members[max(0, first_offset - first) :][: limit - len(bodies)]
                if len(bodies) >= limit:
                    break
            rows.close()
        finally:
            connection.execute("COMMIT")
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
        rows = self._connection.execute(
            f"SELECT {_CONTENT}, c.pairs, c.records FROM {_CONTENTS} "  # noqa: S608  # constants of this file
            "WHERE s.max_end >= ? AND s.min_start <= ? AND instr(c.pairs, ?) ORDER BY s.first_offset",
            (from_wall_ns, to_wall_ns, needle),
        ).fetchall()
        found: list[EncounterRecord] = []
        for first, segment, _n_records, encoding, crc, pairs, records in rows:
            places = find_pair(pairs, needle)
            bodies = self._unpack(first, segment, encoding, crc, records) if places else []
            for place in places:
                record = decode_journal_record(bodies[place])
                if isinstance(record, EncounterRecord) and (record.node_a, record.node_b) == (node_a, node_b):
                    found.append(record)
        return [record for record in found if _overlaps(record, from_wall_ns, to_wall_ns)]

    def read_encounters(self, *, from_wall_ns: int, to_wall_ns: int) -> Iterator[EncounterRecord]:
        """Yield all revisions of all encounters that overlap a time, in the order of their offsets."""
        rows = self._connection.execute(
            f"SELECT {_CONTENT}, c.records FROM {_CONTENTS} "  # noqa: S608  # constants of this file
            "WHERE s.max_end >= ? AND s.min_start <= ? ORDER BY s.first_offset",
            (from_wall_ns, to_wall_ns),
        )
        for first, segment, _n_records, encoding, crc, records in rows:
            for body in self._unpack(first, segment, encoding, crc, records):
                record = decode_journal_record(body)
                if isinstance(record, EncounterRecord) and _overlaps(record, from_wall_ns, to_wall_ns):
                    yield record

    def read_reports(self) -> Iterator[UplinkReport]:
        """Yield all uplink messages that are left, in the order in which they were committed."""
        rows = self._connection.execute(
            f"SELECT s.encoding, c.reports FROM {_CONTENTS} "  # noqa: S608  # constants of this file
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

    def _unpack(self, first: int, segment: int, encoding: int, crc: int, records: bytes) -> list[bytes]:
        key = (first, segment, crc)
        bodies = self._unpacked.get(key)
        if bodies is None:
            bodies = unpack_records(decompress(records, is_compressed=bool(encoding & RECORDS_COMPRESSED)))
            self._unpacked[key] = bodies
            if len(self._unpacked) > _KEPT_SEGMENTS:
                self._unpacked.popitem(last=False)
        else:
            self._unpacked.move_to_end(key)
        return bodies

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
