"""The tables of a journal, version 4, and whether a file is one (docs/journal.md).

``segments`` says of each commit, or of several merged ones, what is in it; ``contents`` holds its bytes. ``windows``, ``nodes``, ``states``
and ``audit`` are what a restart wants to know at once. One INSERT into the view ``commits`` is one transaction on all of them: each
statement that Python steps through gives up its lock of the interpreter and has to wait for it again.
"""

import secrets
import sqlite3
from pathlib import Path

from firmware_protocol.own_files import HEAD_BYTES, JOURNAL, JOURNAL_ID, tell_own_file
from gateway.errors import JournalUnfitError
from gateway.journal_file.audit_chain import genesis

SCHEMA_VERSION = 4
FIRST_SCHEMA_VERSION = 1
"""Whose files are brought over."""

_WALL_AGED_SCHEMA_VERSION = 2
"""Whose files lack ``ran_ns``, and get it in place; those of this one and the next lack the chain of the audit log."""

_COLUMNS = (
    "segment, first_offset, n_records, n_reports, wall_ns, ran_ns, min_start, max_end, encoding, crc, pairs, records, reports, "
    "windows, states, nodes, audits, audit_head, blobs"
)
COMMIT = f"INSERT INTO commits ({_COLUMNS}) VALUES ({', '.join('?' * len(_COLUMNS.split(',')))})"  # noqa: S608  # constants of this file
"""Takes ``SealedSegment.row()``."""

_RAN = "ran_ns INTEGER NOT NULL DEFAULT 0"
_RAN_TABLES = ("segments", "windows", "watermarks")

_AUDIT_TABLES = (
    # id: its place in the chain, without gaps. chain: audit_chain.py.
    """CREATE TABLE audit (
  id INTEGER PRIMARY KEY, kind TEXT NOT NULL, wall_ns INTEGER NOT NULL, ran_ns INTEGER NOT NULL, boot INTEGER NOT NULL, mono_ns INTEGER,
  operator TEXT NOT NULL, node INTEGER, command_id TEXT NOT NULL, wire_command INTEGER, stage TEXT NOT NULL, train_ms INTEGER NOT NULL,
  request BLOB NOT NULL, body BLOB NOT NULL, chain BLOB NOT NULL)""",
    "CREATE INDEX audit_of_command ON audit (command_id, id) WHERE command_id <> ''",
    "CREATE INDEX audit_of_trains ON audit (ran_ns) WHERE train_ms > 0",
    "CREATE INDEX audit_of_kind ON audit (kind, node, id) WHERE kind <> 'stage'",
)
_TABLES = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
    # level: how often it was merged, or that it is damaged. wall_ns: when it was committed. min_start, max_end: UTC of its encounters.
    # ran_ns, here and below: how long gateways had run on this journal by then. Ages are told by it: no clock that is set changes it.
    f"""CREATE TABLE segments (
  first_offset INTEGER NOT NULL, segment INTEGER NOT NULL, n_records INTEGER NOT NULL, n_reports INTEGER NOT NULL, level INTEGER NOT NULL,
  wall_ns INTEGER NOT NULL, min_start INTEGER, max_end INTEGER, encoding INTEGER NOT NULL, crc INTEGER NOT NULL, {_RAN},
  PRIMARY KEY (first_offset, segment)) WITHOUT ROWID""",
    "CREATE INDEX segments_of_time ON segments (max_end, min_start) WHERE max_end IS NOT NULL",
    "CREATE TABLE contents (segment INTEGER PRIMARY KEY, pairs BLOB NOT NULL, records BLOB NOT NULL, reports BLOB NOT NULL)",
    f"""CREATE TABLE windows (
  node INTEGER NOT NULL, boot INTEGER NOT NULL, next INTEGER NOT NULL, above INTEGER NOT NULL, wall_ns INTEGER NOT NULL, {_RAN},
  PRIMARY KEY (node, boot)) WITHOUT ROWID""",
    "CREATE TABLE nodes (node INTEGER PRIMARY KEY, body BLOB NOT NULL)",
    "CREATE TABLE states (offset INTEGER PRIMARY KEY, kind INTEGER NOT NULL, body BLOB NOT NULL)",
    "CREATE INDEX states_of_kind ON states (kind, offset)",
    *_AUDIT_TABLES,
    f"CREATE TABLE watermarks (mapper TEXT PRIMARY KEY, offset INTEGER NOT NULL, wall_ns INTEGER NOT NULL, {_RAN}) WITHOUT ROWID",
)
_BLOB = "coalesce(substr(NEW.blobs, value ->> {first}, value ->> {length}), x'')"  # substr of an empty blob is NULL
# Texts of an audit row come from outside, and may hold what JSON in SQLite does not keep: they lie among the blobs.
_AUDIT_TEXTS = ", ".join(f"CAST({_BLOB.format(first=first, length=first + 1)} AS TEXT)" for first in (8, 10, 12, 14))
_AUDIT_BLOBS = ", ".join(_BLOB.format(first=first, length=first + 1) for first in (16, 18, 20))
_COMMITS = (
    f"CREATE VIEW commits AS SELECT {', '.join('NULL AS ' + name for name in _COLUMNS.split(', '))}",
    f"""CREATE TRIGGER commit_segment INSTEAD OF INSERT ON commits BEGIN
  INSERT INTO segments VALUES (
    NEW.first_offset, NEW.segment, NEW.n_records, NEW.n_reports, 0, NEW.wall_ns, NEW.min_start, NEW.max_end, NEW.encoding, NEW.crc,
    NEW.ran_ns);
  INSERT INTO contents VALUES (NEW.segment, NEW.pairs, NEW.records, NEW.reports);
  INSERT OR REPLACE INTO windows
    SELECT value ->> 0, value ->> 1, value ->> 2, value ->> 3, value ->> 4, NEW.ran_ns FROM json_each(NEW.windows);
  INSERT INTO states
    SELECT value ->> 0, value ->> 1, {_BLOB.format(first=2, length=3)} FROM json_each(NEW.states);
  INSERT OR REPLACE INTO nodes
    SELECT value ->> 0, {_BLOB.format(first=1, length=2)} FROM json_each(NEW.nodes);
  INSERT INTO audit (id, wall_ns, ran_ns, boot, mono_ns, node, wire_command, train_ms,
    kind, operator, command_id, stage, request, body, chain)
    SELECT value ->> 0, value ->> 1, value ->> 2, value ->> 3, value ->> 4, value ->> 5, value ->> 6, value ->> 7,
      {_AUDIT_TEXTS}, {_AUDIT_BLOBS} FROM json_each(NEW.audits);
  INSERT OR REPLACE INTO meta SELECT 'audit_head', NEW.audit_head WHERE NEW.audit_head IS NOT NULL;
END""",  # noqa: S608  # constants of this file
)

_MAX_WAL_SIZE = 16 << 20
"""Octets that the write-ahead log keeps when it begins anew."""

AFTER_DAMAGE = (
    "stop the gateway, keep a copy of the file, save what can be read with `biobot-gateway journal export --skip-damaged`, "
    "and begin another one (--journal)"
)
"""What to do with a damaged journal."""

_APPLICATION_ID_AT = 68
"""Where SQLite's header has it."""

_NAME_THE_JOURNAL = "name the file that the gateway writes (--journal)"
_NO_SPACE_ADVICE = "free some space or choose another file with --journal"


def make_tables(connection: sqlite3.Connection, *, journal: str | None = None) -> None:
    """Make the tables of an empty file; its history is called ``journal``, or gets a random name."""
    # Before the first table: a file cannot be made to give its pages back later.
    connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
    set_durable(connection)
    connection.execute("BEGIN IMMEDIATE")
    for statement in (*_TABLES, *_COMMITS):
        connection.execute(statement)
    name = journal or secrets.token_hex(4)
    names = (name, name, genesis(name).text())
    connection.execute("INSERT INTO meta VALUES ('journal', ?), ('boot', '0'), ('audit_genesis', ?), ('audit_head', ?)", names)
    connection.execute(f"PRAGMA application_id = {JOURNAL_ID}")
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    connection.execute("COMMIT")


def renew_tables(connection: sqlite3.Connection, *, version: int) -> None:
    """Make the tables of a file of version 2 or 3 this version's, within the caller's transaction; ``old_audit`` is left to be copied.

    All that is in a file of version 2 begins to age now.
    """
    connection.execute("DROP VIEW IF EXISTS commits")  # and its trigger
    if version == _WALL_AGED_SCHEMA_VERSION:
        for table in (*_RAN_TABLES, "audit"):
            connection.execute(f"ALTER TABLE {table} ADD COLUMN {_RAN}")
    for index in ("audit_of_command", "audit_of_time"):
        connection.execute(f"DROP INDEX IF EXISTS {index}")
    connection.execute("ALTER TABLE audit RENAME TO old_audit")
    for statement in (*_AUDIT_TABLES, *_COMMITS):
        connection.execute(statement)
    connection.execute("INSERT OR REPLACE INTO meta SELECT 'audit_genesis', value FROM meta WHERE key = 'journal'")
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


def set_durable(connection: sqlite3.Connection) -> None:
    """Have every commit on disk when it returns, a power cut or not."""
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute(f"PRAGMA journal_size_limit = {_MAX_WAL_SIZE}")


def schema_version_of(connection: sqlite3.Connection, *, path: Path) -> int:
    """Return the version of a journal's tables, 0 where there are none yet.

    Raises
    ------
    JournalUnfitError
        The file is another program's, or of a version that is not known here.
    """
    application_id = connection.execute("PRAGMA application_id").fetchone()[0]
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        return 0
    if application_id != JOURNAL_ID:
        raise foreign(path, "is a database of another program")
    if not FIRST_SCHEMA_VERSION <= version <= SCHEMA_VERSION:
        reason = f"has schema version {version}, but this program knows {FIRST_SCHEMA_VERSION} to {SCHEMA_VERSION}"
        raise JournalUnfitError(
            path=str(path), reason=reason, advice="choose another file with --journal, or the program's fitting version"
        )
    return version


def head_offset(connection: sqlite3.Connection) -> int:
    """Return the newest offset of a journal, 0 where it has none."""
    row = connection.execute(
        "SELECT first_offset + n_records - 1 FROM segments ORDER BY first_offset DESC, segment DESC LIMIT 1"
    ).fetchone()
    return 0 if row is None else int(row[0])


def oldest_offset(connection: sqlite3.Connection) -> int:
    """Return the first offset under its name that a journal still has, or will have."""
    (first_offset,) = connection.execute("SELECT coalesce(min(first_offset), 1) FROM segments").fetchone()
    return max(int(first_offset), int(read_meta(connection, "begins") or 1))


def read_meta(connection: sqlite3.Connection, key: str) -> str | None:
    """Return what ``meta`` says, or None."""
    row = connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
    return None if row is None else str(row[0])


def unfit(path: Path, error: sqlite3.DatabaseError) -> JournalUnfitError:
    """Say what is wrong with a file, and what to do."""
    text = str(error)
    if "malformed" in text or ("not a database" in text and _begins_as_journal(path)):
        return JournalUnfitError(path=str(path), reason=f"is damaged ({text})", advice=AFTER_DAMAGE)
    if "not a database" in text:
        return foreign(path, f"is no journal ({text})")
    if "readonly" in text or "unable to open" in text:
        return JournalUnfitError(path=str(path), reason=f"cannot be written ({text})", advice="make it writable or choose another file")
    if "locked" in text:  # readers never wait for a gateway: it is the database of a program that wants it for itself
        if tell_own_file(_head_of(path)) not in {None, JOURNAL}:
            return foreign(path, f"is no journal ({text})")
        return JournalUnfitError(path=str(path), reason=f"is in use ({text})", advice="end the program that has it open, or wait for it")
    return JournalUnfitError(path=str(path), reason=text, advice=_NO_SPACE_ADVICE)


def foreign(path: Path, reason: str) -> JournalUnfitError:
    """Say that a file is no journal, and what it is where it is another one of ours."""
    own = tell_own_file(_head_of(path))
    if own is not None and own is not JOURNAL:
        return JournalUnfitError(path=str(path), reason=f"is no journal but {own.what}: {own.use}", advice=_NAME_THE_JOURNAL)
    return JournalUnfitError(path=str(path), reason=reason, advice=_NAME_THE_JOURNAL)


def _begins_as_journal(path: Path) -> bool:
    # What is overwritten at its front is a journal all the same, by the id that stands behind.
    return _head_of(path)[_APPLICATION_ID_AT : _APPLICATION_ID_AT + 4] == JOURNAL_ID.to_bytes(4, "big")


def _head_of(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(HEAD_BYTES)
    except OSError:
        return b""
