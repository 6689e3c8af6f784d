"""A journal as versions before the audit log had a chain left it."""

import contextlib
import sqlite3
from pathlib import Path

_AUDIT = """
DROP VIEW commits;
ALTER TABLE audit RENAME TO chained;
DROP INDEX audit_of_command; DROP INDEX audit_of_trains; DROP INDEX audit_of_kind;
CREATE TABLE audit (
  id INTEGER PRIMARY KEY, wall_ns INTEGER NOT NULL, command_id TEXT NOT NULL, wire_command INTEGER, stage TEXT NOT NULL,
  node INTEGER NOT NULL, train_ms INTEGER NOT NULL, request BLOB NOT NULL, body BLOB NOT NULL, ran_ns INTEGER NOT NULL DEFAULT 0);
CREATE INDEX audit_of_command ON audit (command_id, id);
CREATE INDEX audit_of_time ON audit (wall_ns);
INSERT INTO audit SELECT id, wall_ns, command_id, wire_command, stage, node, train_ms, request, body, ran_ns FROM chained
  WHERE command_id <> '' AND id <> 2;
DROP TABLE chained;
DELETE FROM meta WHERE key IN ('audit_head', 'audit_genesis', 'audit_pruned', 'clock_boot');
PRAGMA user_version = 3;
"""


def make_schema_3(path: Path) -> None:
    """Make a closed journal one of version 3; the second row of its audit log is gone, as where the older ones went by age."""
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.executescript(_AUDIT)


def make_schema_2(path: Path) -> None:
    """Make a closed journal one of version 2, whose ages the wall clock told."""
    make_schema_3(path)
    with contextlib.closing(sqlite3.connect(path)) as database:
        for table in ("segments", "windows", "audit", "watermarks"):
            database.execute(f"ALTER TABLE {table} DROP COLUMN ran_ns")
        database.execute("PRAGMA user_version = 2")
