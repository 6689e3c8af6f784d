"""The file of the store: whose it is, its schema, and how an older one becomes a newer one."""

import secrets
import sqlite3
from pathlib import Path
from typing import Final

import msgspec

from firmware_protocol.errors import RecordError
from firmware_protocol.own_files import HEAD_BYTES, STORE, STORE_ID, tell_own_file
from mapper.errors import StoreError

SCHEMA_VERSION: Final = 5

# The steps by which a file comes to each version from the one before; an empty file takes all of them.
_STEPS: Final = {
    1: """
CREATE TABLE gateway (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE);
CREATE TABLE source (
  id INTEGER PRIMARY KEY,
  gateway INTEGER NOT NULL REFERENCES gateway (id),
  journal TEXT NOT NULL,
  watermark INTEGER NOT NULL,
  UNIQUE (gateway, journal)
);
CREATE TABLE span (
  source INTEGER NOT NULL REFERENCES source (id),
  first INTEGER NOT NULL,
  last INTEGER NOT NULL,
  PRIMARY KEY (source, first)
) WITHOUT ROWID;
CREATE TABLE record (
  id INTEGER PRIMARY KEY,
  gateway INTEGER NOT NULL REFERENCES gateway (id),
  boot INTEGER NOT NULL,
  sequence INTEGER NOT NULL,
  revision INTEGER NOT NULL,
  kind INTEGER NOT NULL,
  change INTEGER NOT NULL,
  body BLOB NOT NULL,
  UNIQUE (gateway, boot, sequence)
);
CREATE UNIQUE INDEX record_by_change ON record (kind, change);
""",
    # The last finished map, so that a restart has one at once.
    2: """
CREATE TABLE finished_map (
  id INTEGER PRIMARY KEY CHECK (id = 1),
  made_by TEXT NOT NULL,
  change INTEGER NOT NULL,
  document BLOB NOT NULL
);
""",
    # Two journals of one gateway may number their starts and records alike: whose a record is, its body says.
    3: """
INSERT OR IGNORE INTO source (gateway, journal, watermark) SELECT DISTINCT gateway, journal_of(body), 0 FROM record;
CREATE TABLE record_of_source (
  id INTEGER PRIMARY KEY,
  source INTEGER NOT NULL REFERENCES source (id),
  boot INTEGER NOT NULL,
  sequence INTEGER NOT NULL,
  revision INTEGER NOT NULL,
  kind INTEGER NOT NULL,
  change INTEGER NOT NULL,
  body BLOB NOT NULL,
  UNIQUE (source, boot, sequence)
);
INSERT INTO record_of_source
SELECT record.id, source.id, boot, sequence, revision, kind, change, body
FROM record CROSS JOIN source ON source.gateway = record.gateway AND source.journal = journal_of(body)
ORDER BY record.id;
DROP TABLE record;
ALTER TABLE record_of_source RENAME TO record;
CREATE UNIQUE INDEX record_by_change ON record (kind, change);
""",
    # Places that the operator named.
    4: """
CREATE TABLE pin (name TEXT PRIMARY KEY, place TEXT NOT NULL, x REAL, y REAL);
""",
    # Maps of the past, and alerts with who acknowledged them.
    5: """
CREATE TABLE past_map (version INTEGER PRIMARY KEY, facts BLOB NOT NULL, documents BLOB NOT NULL);
CREATE TABLE alert (id INTEGER PRIMARY KEY, body BLOB NOT NULL);
""",
}


class _OfJournal(msgspec.Struct, frozen=True, gc=False):
    """The field of a record that says which journal it is of."""

    journal: str


_of_journal = msgspec.msgpack.Decoder(_OfJournal)


def open_store_file(path: Path | None) -> sqlite3.Connection:
    """Open a store of records in the newest schema; make it if it is not there, and bring an older one up to date.

    Parameters
    ----------
    path
        None keeps everything in memory.

    Raises
    ------
    StoreError
        The file is none of ours, is from a newer version, is in use by another mapper, or cannot be opened.
    """
    if path is not None:
        _refuse_foreign_file(path)
    name = store_name(path)
    try:
        database = sqlite3.connect(":memory:" if path is None else path, isolation_level=None, check_same_thread=False, timeout=1.0)
    except sqlite3.Error as error:
        raise translate(error, path=name) from error
    try:
        _prepare(database, path=name)
    except (sqlite3.Error, StoreError) as error:
        database.close()
        raise translate(error, path=name) from error
    return database


def expect_fit_file(path: Path) -> None:
    """Raise ``StoreError`` where a file could not be opened as a store, as far as its first octets tell; nothing is made or written."""
    _refuse_foreign_file(path)
    try:
        with path.open("rb") as file:
            version = int.from_bytes(file.read(64)[60:64], "big")  # PRAGMA user_version, as the log was last brought in
    except FileNotFoundError:
        return
    if version > SCHEMA_VERSION:
        raise _too_new(str(path), version)


def store_name(path: Path | None) -> str:
    """Name a store for people."""
    return "the store in memory" if path is None else str(path)


def random_name(database: sqlite3.Connection) -> str:
    """Return the name that a file was given when it was first opened: gateways know it by this, whatever the file is called."""
    # A table that other versions leave alone: no step of the schema.
    database.execute("CREATE TABLE IF NOT EXISTS own_name (id INTEGER PRIMARY KEY CHECK (id = 1), name TEXT NOT NULL)")
    database.execute("INSERT OR IGNORE INTO own_name VALUES (1, ?)", (f"mapper-{secrets.token_hex(4)}",))
    return str(database.execute("SELECT name FROM own_name").fetchone()[0])


def translate(error: sqlite3.Error | RecordError | StoreError, *, path: str) -> StoreError:
    """Say what is wrong with the file at ``path``, and what to do."""
    if isinstance(error, StoreError):
        return error
    text = str(error)
    if isinstance(error, RecordError):
        return StoreError(path=path, reason=f"is damaged: {text}", next_step="name another file; gateways fill it again")
    if "locked" in text:
        return StoreError(path=path, reason="is in use by another mapper", next_step="stop that one, or name another file")
    if "full" in text:
        return StoreError(path=path, reason=f"cannot be written: {text}", next_step="make room on the disk")
    return StoreError(path=path, reason=f"cannot be used: {text}", next_step="check path and permissions, or name another file")


def _prepare(database: sqlite3.Connection, *, path: str) -> None:
    # Only one mapper may write a file: its memory is in step with the file, and with no other process.
    database.execute("PRAGMA locking_mode = EXCLUSIVE")
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA synchronous = NORMAL")
    database.execute("BEGIN IMMEDIATE")
    (application_id,) = database.execute("PRAGMA application_id").fetchone()
    (version,) = database.execute("PRAGMA user_version").fetchone()
    (n_tables,) = database.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    if n_tables == 0 and application_id in {0, STORE_ID}:
        database.execute(f"PRAGMA application_id = {STORE_ID}")
        version = 0
    elif application_id != STORE_ID:
        raise _foreign(path)
    elif not 1 <= version <= SCHEMA_VERSION:
        raise _too_new(path, version)
    database.create_function("journal_of", 1, _journal_of, deterministic=True)
    for step in range(version + 1, SCHEMA_VERSION + 1):
        for statement in _STEPS[step].split(";"):
            database.execute(statement)
        database.execute(f"PRAGMA user_version = {step}")
    database.execute("COMMIT")


def _journal_of(body: bytes) -> str:
    try:
        return _of_journal.decode(body).journal
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return ""  # whoever reads the record says that it is damaged


def _refuse_foreign_file(path: Path) -> None:
    other = "name another file"
    if path.is_dir():
        raise StoreError(path=str(path), reason="is a directory", next_step="name a file in it")
    if not path.parent.is_dir():
        raise StoreError(path=str(path), reason=f"there is no directory {path.parent}", next_step="make it, or name another file")
    try:
        with path.open("rb") as file:
            header = file.read(HEAD_BYTES)
    except FileNotFoundError:
        return
    except OSError as error:
        raise StoreError(path=str(path), reason=f"cannot be read: {error.strerror}", next_step=other) from error
    own = tell_own_file(header)
    if own is not None and own is not STORE:
        raise StoreError(path=str(path), reason=f"is no store but {own.what}: {own.use}", next_step=other)
    if header and not header.startswith(b"SQLite format 3\0"):
        raise StoreError(path=str(path), reason="is not a store of records (no SQLite file)", next_step=other)
    # https://www.sqlite.org/fileformat.html: page size in bytes 16 and 17 (1 means 65,536), application id in bytes 68 to 71. A
    # file of ours has id 0 and one page until its first checkpoint.
    page_size = int.from_bytes(header[16:18], "big")
    application_id = int.from_bytes(header[68:72], "big")
    is_young = application_id == 0 and path.stat().st_size <= (page_size if page_size > 1 else 65_536)
    if header and application_id != STORE_ID and not is_young:
        raise _foreign(str(path))


def _foreign(path: str) -> StoreError:
    return StoreError(path=path, reason="is the SQLite file of another program", next_step="name another file")


def _too_new(path: str, version: int) -> StoreError:
    return StoreError(
        path=path,
        reason=f"has schema version {version}, but this program knows {SCHEMA_VERSION}",
        next_step="use the version of the program that made it, or name another file",
    )
