"""The journal's file: its tables, and the transactions on it. Synchronous; each object belongs to one thread at a time.

Tables: ``entries`` (journaled records by offset), ``reports`` (every uplink message, once), ``windows`` (which numbers of a backpack's
messages are done), ``nodes`` (what is known of biobots), ``audit`` (stages of commands), ``meta``.
"""

import fcntl
import json
import secrets
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from firmware_protocol.contract.records import (
    EncounterRecord,
    JournalRecord,
    MissionRecord,
    ModeRecord,
    decode_journal_record,
    encode_journal_record,
)
from firmware_protocol.units import NS_PER_S, BootId, Nanoseconds, NodeId
from gateway.errors import JournalUnfitError

_APPLICATION_ID = 0x42494F47  # "BIOG" in SQLite's header: this file is a gateway's journal
_SCHEMA_VERSION = 1
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
"""
_MAX_INTEGER = (1 << 63) - 1  # SQLite's largest; a command may name a larger node, and its request says which

SESSIONS_PER_START = 16
"""Link session numbers that are a start's own: 4096 starts in a row use different ones."""

_MAX_ANCHORS = 64
_NO_SPACE_ADVICE = "free some space or choose another file with --journal"


@dataclass(frozen=True, slots=True, kw_only=True)
class UplinkReport:
    """An uplink message as it came, and its backpack's window after it."""

    node: NodeId
    boot: BootId
    number: int
    """Unwrapped sequence number."""
    next_number: int
    received_wall_ns: int
    radio: str
    address: int
    rssi_dbm: int
    lqi: int
    payload: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditEntry:
    """A stage of a command. ``train_ms`` is the stimulation it admits, 0 for all but the admitting stage."""

    wall_ns: int
    command_id: str
    wire_command: int | None
    stage: str
    node: NodeId
    train_ms: int
    request: bytes
    body: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalWrite:
    """What belongs together: all of it is on disk, or nothing."""

    records: tuple[JournalRecord, ...] = ()
    report: UplinkReport | None = None
    node: tuple[NodeId, bytes] | None = None
    audit: AuditEntry | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalIdentity:
    """Name of the file's history, number of this start, and how far the history goes.

    ``wall_anchor_ns`` is UTC minus monotonic clock, read at this start; ``earlier_anchors`` are those of earlier starts since
    the machine booted, whose monotonic clock was this one. ``first_session`` begins this start's link session numbers.
    """

    journal: str
    boot: BootId
    head_offset: int
    wall_anchor_ns: Nanoseconds
    earlier_anchors: tuple[Nanoseconds, ...]
    first_session: int


class JournalFile:
    """An open journal, locked against other gateways."""

    def __init__(self, *, connection: sqlite3.Connection, lock: IO[bytes], identity: JournalIdentity) -> None:
        self._connection = connection
        self._lock = lock
        self._n_commits = _count_commits(connection)
        self.identity = identity

    def commit(self, writes: Iterable[JournalWrite]) -> None:
        """Put all ``writes`` on disk in one transaction; an error leaves the file as it was, or complete.

        After an error of SQLite the same writes may be given again: where the failed COMMIT did reach the disk, nothing is
        written twice.
        """
        connection = self._connection
        connection.execute("BEGIN IMMEDIATE")
        try:
            if _count_commits(connection) == self._n_commits:
                for write in writes:
                    _insert(connection, write)
                connection.execute("INSERT OR REPLACE INTO meta VALUES ('commits', ?)", (str(self._n_commits + 1),))
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        self._n_commits += 1

    def close(self) -> None:
        """Close the file and let others have it."""
        self._connection.close()
        self._lock.close()


class JournalReader:
    """A second connection that only reads what is committed."""

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=5.0)
        self._connection.execute("PRAGMA query_only = ON")

    def read_records(self, *, from_offset: int, limit: int) -> tuple[list[JournalRecord], int]:
        """Return up to ``limit`` records from an offset on, and the newest offset."""
        bodies = self._connection.execute(
            "SELECT body FROM entries WHERE offset >= ? ORDER BY offset LIMIT ?", (from_offset, limit)
        ).fetchall()
        return [decode_journal_record(body) for (body,) in bodies], _head_offset(self._connection)

    def read_recent_encounters(self, *, limit: int) -> list[EncounterRecord]:
        """Return the newest ``limit`` encounter records, in the order of their offsets."""
        records = self._newest("kind = 'encounter'", limit)
        return [record for record in records if isinstance(record, EncounterRecord)]

    def read_recent_modes(self, *, limit: int) -> list[ModeRecord]:
        """Return the newest ``limit`` mode records, in the order of their offsets."""
        records = self._newest("kind = 'mode' AND node_a IS NULL", limit)
        return [record for record in records if isinstance(record, ModeRecord)]

    def read_last_mission(self) -> MissionRecord | None:
        """Return the phase that began last, or None where no mission has run."""
        for record in self._newest("kind = 'mission' AND node_a IS NULL", 1):
            if isinstance(record, MissionRecord):
                return record
        return None

    def read_pair(self, *, node_a: NodeId, node_b: NodeId, from_wall_ns: int, to_wall_ns: int) -> list[EncounterRecord]:
        """Return all revisions of a pair's encounters that overlap a time, in the order of their offsets.

        An encounter's interval never shrinks, so where an earlier revision overlaps the newest one does.
        """
        bodies = self._connection.execute(
            "SELECT body FROM entries WHERE node_a = ? AND node_b = ? AND end_wall_ns >= ? AND start_wall_ns <= ? ORDER BY offset",
            (node_a, node_b, from_wall_ns, to_wall_ns),
        )
        records = [decode_journal_record(body) for (body,) in bodies]
        return [record for record in records if isinstance(record, EncounterRecord)]

    def read_windows(self) -> list[tuple[NodeId, BootId, int, list[int]]]:
        """Return the newest boots of each node, the number below which all is done, and the numbers above that."""
        rows = self._connection.execute("SELECT node, boot, next FROM windows ORDER BY wall_ns").fetchall()
        above = "SELECT sequence FROM reports WHERE node = ? AND boot = ? AND sequence >= ?"
        return [
            (NodeId(node), BootId(boot), at, [number for (number,) in self._connection.execute(above, (node, boot, at))])
            for node, boot, at in rows
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

    def _newest(self, where: str, limit: int) -> list[JournalRecord]:
        query = f"SELECT body FROM entries WHERE {where} ORDER BY offset DESC LIMIT ?"  # noqa: S608  # constants of this file
        return [decode_journal_record(body) for (body,) in reversed(self._connection.execute(query, (limit,)).fetchall())]

    def _audit(self, where: str, values: Sequence[object]) -> list[AuditEntry]:
        columns = "wall_ns, command_id, wire_command, stage, node, train_ms, request, body"
        rows = self._connection.execute(f"SELECT {columns} FROM audit {where}", values)  # noqa: S608  # both parts are constants of this file
        names = columns.split(", ")
        return [AuditEntry(**dict(zip(names, row, strict=True))) for row in rows]


def open_journal_file(path: Path, *, now_wall_ns: int, now_ns: int, machine_boot: str) -> JournalFile:
    """Open the journal, or make it where there is none, and begin a new boot.

    ``machine_boot`` names what the monotonic clock counts from; it is empty where that is not known.

    Raises
    ------
    JournalUnfitError
        The file is something else, cannot be written, or is in use by another gateway.
    """
    lock = _take_lock(path)
    try:
        connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=5.0)
        try:
            _prepare(connection, path=path)
            identity = _begin_boot(connection, now_wall_ns=now_wall_ns, now_ns=now_ns, machine_boot=machine_boot)
        except BaseException:
            connection.close()
            raise
    except sqlite3.DatabaseError as error:
        lock.close()
        raise _unfit(path, error) from error
    except BaseException:
        lock.close()
        raise
    return JournalFile(connection=connection, lock=lock, identity=identity)


def _take_lock(path: Path) -> IO[bytes]:
    # A lock on the database file itself would be dropped by SQLite's own opening and closing of it: POSIX locks are a process's.
    if path.is_dir():
        raise JournalUnfitError(path=str(path), reason="is a directory", advice="give the name of a file")
    lock_path = path.with_name(path.name + ".lock")
    try:
        lock = lock_path.open("ab")
    except OSError as error:
        reason = f"{lock_path.parent} cannot be written: {error.strerror}"
        raise JournalUnfitError(path=str(path), reason=reason, advice="make the directory or choose another file with --journal") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        raise JournalUnfitError(
            path=str(path), reason="another gateway has it open", advice="stop that one or choose another file with --journal"
        ) from error
    return lock


def _prepare(connection: sqlite3.Connection, *, path: Path) -> None:
    connection.execute("PRAGMA locking_mode = NORMAL")
    application_id = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    n_tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    if n_tables and application_id != _APPLICATION_ID:
        raise JournalUnfitError(path=str(path), reason="is a database of another program", advice="choose another file with --journal")
    if n_tables and version != _SCHEMA_VERSION:
        reason = f"has schema version {version}, but this program writes version {_SCHEMA_VERSION}"
        raise JournalUnfitError(
            path=str(path), reason=reason, advice="choose another file with --journal, or the program's fitting version"
        )
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    if not n_tables:
        # executescript would commit before it begins; one statement after the other stays in the transaction.
        connection.execute("BEGIN IMMEDIATE")
        for statement in _SCHEMA.split(";"):
            if statement.strip():
                connection.execute(statement)
        connection.execute("INSERT INTO meta VALUES ('journal', ?), ('boot', '0')", (secrets.token_hex(4),))
        connection.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {_SCHEMA_VERSION}")
        connection.execute("COMMIT")


def _begin_boot(connection: sqlite3.Connection, *, now_wall_ns: int, now_ns: int, machine_boot: str) -> JournalIdentity:
    meta = dict(connection.execute("SELECT key, value FROM meta"))
    boot = BootId(max(int(meta["boot"]) + 1, now_wall_ns // NS_PER_S))
    anchor_ns = Nanoseconds(now_wall_ns - now_ns)
    is_same_clock = bool(machine_boot) and meta.get("machine_boot") == machine_boot
    earlier = tuple(Nanoseconds(anchor) for anchor in json.loads(meta["anchors"])) if is_same_clock else ()
    first_session = int(meta.get("next_session") or secrets.randbelow(1 << 16))
    # Before the first session is opened: a process that is killed leaves its numbers used.
    connection.execute(
        "INSERT OR REPLACE INTO meta VALUES ('boot', ?), ('machine_boot', ?), ('anchors', ?), ('next_session', ?)",
        (
            str(boot),
            machine_boot,
            json.dumps([*earlier, anchor_ns][-_MAX_ANCHORS:]),
            str((first_session + SESSIONS_PER_START) % (1 << 16)),
        ),
    )
    return JournalIdentity(
        journal=meta["journal"],
        boot=boot,
        head_offset=_head_offset(connection),
        wall_anchor_ns=anchor_ns,
        earlier_anchors=earlier,
        first_session=first_session,
    )


def _count_commits(connection: sqlite3.Connection) -> int:
    row = connection.execute("SELECT value FROM meta WHERE key = 'commits'").fetchone()
    return 0 if row is None else int(row[0])


def _head_offset(connection: sqlite3.Connection) -> int:
    return int(connection.execute("SELECT coalesce(max(offset), 0) FROM entries").fetchone()[0])


def _unfit(path: Path, error: sqlite3.DatabaseError) -> JournalUnfitError:
    text = str(error)
    if "not a database" in text or "malformed" in text:
        return JournalUnfitError(path=str(path), reason=f"is no journal ({text})", advice="choose another file with --journal")
    if "readonly" in text or "unable to open" in text:
        return JournalUnfitError(path=str(path), reason=f"cannot be written ({text})", advice="make it writable or choose another file")
    return JournalUnfitError(path=str(path), reason=text, advice=_NO_SPACE_ADVICE)


def _insert(connection: sqlite3.Connection, write: JournalWrite) -> None:
    for record in write.records:
        body = encode_journal_record(record)
        head = (record.offset, record.boot, record.sequence, record.revision)
        if isinstance(record, EncounterRecord):
            anchor_ns = record.wall_anchor_ns
            pair: tuple[int | None, ...] = (record.node_a, record.node_b, record.t_start_ns + anchor_ns, record.t_end_ns + anchor_ns)
            kind = "encounter"
        else:
            pair, kind = (None, None, None, None), "mission" if isinstance(record, MissionRecord) else "mode"
        connection.execute("INSERT INTO entries VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", (head[0], kind, *head[1:], *pair, body))
    report = write.report
    if report is not None:
        connection.execute(
            "INSERT OR IGNORE INTO reports VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                report.node,
                report.boot,
                report.number,
                report.received_wall_ns,
                report.radio,
                report.address,
                report.rssi_dbm,
                report.lqi,
                report.payload,
            ),
        )
        connection.execute(
            "INSERT OR REPLACE INTO windows VALUES (?, ?, ?, ?)", (report.node, report.boot, report.next_number, report.received_wall_ns)
        )
    if write.node is not None:
        connection.execute("INSERT OR REPLACE INTO nodes VALUES (?, ?)", write.node)
    audit = write.audit
    if audit is not None:
        connection.execute(
            "INSERT INTO audit (wall_ns, command_id, wire_command, stage, node, train_ms, request, body) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (
                audit.wall_ns,
                audit.command_id,
                audit.wire_command,
                audit.stage,
                min(audit.node, _MAX_INTEGER),
                audit.train_ms,
                audit.request,
                audit.body,
            ),
        )
