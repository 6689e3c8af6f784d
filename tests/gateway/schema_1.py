"""A journal as versions before segments wrote it."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, MissionRecord, encode_journal_record
from gateway.journal_file import UplinkReport

_SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE entries (
  offset INTEGER PRIMARY KEY, kind TEXT NOT NULL, boot INTEGER NOT NULL, sequence INTEGER NOT NULL, revision INTEGER NOT NULL,
  node_a INTEGER, node_b INTEGER, start_wall_ns INTEGER, end_wall_ns INTEGER, body BLOB NOT NULL);
CREATE INDEX entries_of_pair ON entries (node_a, node_b, end_wall_ns, start_wall_ns) WHERE node_a IS NOT NULL;
CREATE INDEX entries_of_kind ON entries (kind, offset) WHERE node_a IS NULL;
CREATE TABLE reports (
  node INTEGER NOT NULL, boot INTEGER NOT NULL, sequence INTEGER NOT NULL, received_wall_ns INTEGER NOT NULL,
  radio TEXT NOT NULL, address INTEGER NOT NULL, rssi_dbm INTEGER NOT NULL, lqi INTEGER NOT NULL, payload BLOB NOT NULL,
  PRIMARY KEY (node, boot, sequence)) WITHOUT ROWID;
CREATE TABLE windows (
  node INTEGER NOT NULL, boot INTEGER NOT NULL, next INTEGER NOT NULL, wall_ns INTEGER NOT NULL,
  PRIMARY KEY (node, boot)) WITHOUT ROWID;
CREATE TABLE nodes (node INTEGER PRIMARY KEY, body BLOB NOT NULL);
CREATE TABLE audit (
  id INTEGER PRIMARY KEY, wall_ns INTEGER NOT NULL, command_id TEXT NOT NULL, wire_command INTEGER, stage TEXT NOT NULL,
  node INTEGER NOT NULL, train_ms INTEGER NOT NULL, request BLOB NOT NULL, body BLOB NOT NULL);
CREATE INDEX audit_of_command ON audit (command_id, id);
CREATE INDEX audit_of_time ON audit (wall_ns);
INSERT INTO meta VALUES ('journal', '5f0c9a31'), ('boot', '41'), ('machine_boot', 'm'), ('anchors', '[7]'), ('next_session', '320');
INSERT INTO nodes VALUES (1, x'00ff');
INSERT INTO audit VALUES (5, 9, 'c', 77, 'accepted', 1, 500, x'', x'01');
"""


def write_schema_1(path: Path, *, records: Sequence[JournalRecord], reports: Sequence[UplinkReport]) -> None:
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.executescript(_SCHEMA)
        database.execute(f"PRAGMA application_id = {0x42494F47}")
        database.execute("PRAGMA user_version = 1")
        for offset, record in enumerate(records, start=1):
            span: tuple[int | None, ...] = (None,) * 4
            if isinstance(record, EncounterRecord):
                span = (record.node_a, record.node_b, record.t_start_ns, record.t_end_ns)
            kind = "encounter" if span[0] is not None else "mission" if isinstance(record, MissionRecord) else "mode"
            head = (offset, kind, record.boot, record.sequence, record.revision)
            database.execute(f"INSERT INTO entries VALUES ({', '.join('?' * 10)})", (*head, *span, encode_journal_record(record)))
        for one in reports:
            row = (one.node, one.boot, one.number, one.received_wall_ns, one.radio, one.address, one.rssi_dbm, one.lqi, one.payload)
            database.execute(f"INSERT INTO reports VALUES ({', '.join('?' * 9)})", row)
            window = (one.node, one.boot, one.next_number, one.received_wall_ns)
            database.execute("INSERT OR REPLACE INTO windows VALUES (?, ?, ?, ?)", window)
    database.close()
