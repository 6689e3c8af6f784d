"""The mapper's memory: every journaled record once, in its highest revision, in one SQLite file (CONTRACT.md §3).

A record is applied exactly once, in whatever order and however often it arrives. What has arrived of each gateway's
journal is committed together with the records, so nothing is lost between them when the process is killed. After a
power cut the newest commits may be gone (``synchronous=NORMAL``); they are then missing from the watermark too, and are fetched again.
"""

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final

from firmware_protocol.contract.records import (
    EncounterRecord,
    JournalRecord,
    MissionPhase,
    MissionRecord,
    ModeRecord,
    RecordBatch,
    decode_journal_record,
    encode_journal_record,
)
from firmware_protocol.errors import RecordError
from mapper.errors import StoreError
from mapper.offsets import OffsetSet
from mapper.record_columns import EncounterColumns, ModeSpells, StoreSnapshot, is_fit, wall_interval

APPLICATION_ID: Final = 0x42494F42
"""In the header of every file of ours: "BIOB"."""
SCHEMA_VERSION: Final = 1

_MAX_INTEGER = 2**63 - 1

_SCHEMA = """
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
"""

# A record of another kind under a known identity is refused by the last condition.
_UPSERT = """
INSERT INTO record (gateway, boot, sequence, revision, kind, change, body) VALUES (?, ?, ?, ?, ?, ?, ?)
ON CONFLICT (gateway, boot, sequence) DO UPDATE SET revision = excluded.revision, change = excluded.change, body = excluded.body
WHERE excluded.revision > record.revision AND excluded.kind = record.kind
RETURNING id
"""


class Kind(IntEnum):
    """What kind of record a row holds."""

    ENCOUNTER = 0
    MODE = 1
    MISSION = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Applied:
    """What a call of ``apply`` did: how many records were new, corrected, known already, or unfit and left out."""

    n_new: int = 0
    n_revised: int = 0
    n_repeated: int = 0
    n_unfit: int = 0

    @property
    def has_changed(self) -> bool:
        """Say whether the content is another one now."""
        return bool(self.n_new or self.n_revised)


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterPage:
    """Encounters in the order in which they were last changed; ``cursor`` of the last one asks for what follows."""

    records: tuple[EncounterRecord, ...]
    cursor: int
    has_more: bool


@dataclass(slots=True)
class _Source:
    id: int
    gateway_id: int
    offsets: OffsetSet


class Store:
    """All records of all gateways. Not safe for use by several threads at a time.

    Parameters
    ----------
    path
        The file; it is made if it is not there. None keeps everything in memory.

    Raises
    ------
    StoreError
        The file is none of ours, is from a newer version, is in use by another mapper, or cannot be opened.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = "the store in memory" if path is None else str(path)
        if path is not None:
            _refuse_foreign_file(path)
        self._next_change = 1
        try:
            self._db = sqlite3.connect(":memory:" if path is None else path, isolation_level=None, check_same_thread=False, timeout=1.0)
        except sqlite3.Error as error:
            raise self._translate(error) from error
        try:
            self._prepare()
            self._load()
        except (sqlite3.Error, RecordError, StoreError) as error:
            self._db.close()
            raise self._translate(error) from error

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @property
    def n_encounters(self) -> int:
        """Count the encounters that are not void."""
        return self._encounters.n_counting

    def apply(self, batches: Iterable[RecordBatch]) -> Applied:
        """Take in records; those already known, in this revision or a higher one, change nothing.

        Raises
        ------
        StoreError
            The file cannot be written; nothing of the batches was taken in.
        """
        fresh: list[tuple[int, JournalRecord]] = []
        next_change, last_id = self._next_change, self._last_id
        n_repeated = n_unfit = 0
        touched: dict[tuple[str, str], _Source] = {}
        with self._transaction():
            for batch in batches:
                key = (batch.gateway, batch.journal)
                for record in batch.records:
                    if (record.gateway, record.journal) != key or record.offset > _MAX_INTEGER:
                        n_unfit += 1
                        continue
                    source = touched.get(key) or touched.setdefault(key, self._copy_source(*key))
                    # An unfit record counts as arrived, or the gap would be asked for again for ever.
                    source.offsets.add(record.offset)
                    if not is_fit(record):
                        n_unfit += 1
                        continue
                    row = (source.gateway_id, record.boot, record.sequence, record.revision, _kind(record), next_change)
                    found = self._db.execute(_UPSERT, (*row, encode_journal_record(record))).fetchone()
                    if found is None:
                        n_repeated += 1
                    else:
                        fresh.append((found[0], record))
                        next_change += 1
            for source in touched.values():
                self._save_source(source)
        self._sources.update(touched)
        self._next_change = next_change
        n_new = len({row_id for row_id, _ in fresh if row_id > last_id})
        for row_id, record in fresh:
            self._remember(row_id, record)
        return Applied(n_new=n_new, n_revised=len(fresh) - n_new, n_repeated=n_repeated, n_unfit=n_unfit)

    def watermark(self, *, gateway: str, journal: str) -> int:
        """Return the highest offset of a journal up to which nothing is missing, 0 where nothing has come."""
        source = self._sources.get((gateway, journal))
        return source.offsets.watermark if source else 0

    def first_hole(self, *, gateway: str, journal: str, head_offset: int) -> tuple[int, int] | None:
        """Name the first run of offsets that a journal has (up to ``head_offset`` at least) and this store lacks."""
        source = self._sources.get((gateway, journal))
        offsets = source.offsets if source else OffsetSet()
        return offsets.first_hole(up_to=max(head_offset, offsets.last))

    def give_up(self, *, gateway: str, journal: str, first: int, last: int) -> None:
        """Count offsets as arrived that the gateway itself does not have any more."""
        with self._transaction():
            source = self._copy_source(gateway, journal)
            source.offsets.add(first, last)
            self._save_source(source)
        self._sources[gateway, journal] = source

    def snapshot(self) -> StoreSnapshot:
        """Take what a map is made of: encounters that are not void and mode spells, on the wall clock.

        Where a mission set landmarks, encounters count from the newest exploration on: between earlier ones and the landmarks lies
        time in which nobody stood still ([Dir16] IV: time 0 is the moment the landmarks are set).
        """
        begun = [wall_interval(record)[0] for record in self._missions.values() if record.phase is MissionPhase.EXPLORATION]
        since_ns = max(begun, default=None)
        table = self._encounters.table(since_ns=since_ns)
        return StoreSnapshot(
            table=table,
            spells=self._modes.spells(),
            since_ns=since_ns,
            n_before=self.n_encounters - len(table),
            n_encounters_of=self._encounters.count_by_node(),
        )

    def encounters(self, *, after: int, limit: int) -> EncounterPage:
        """Return encounters changed after a cursor, void ones too; a corrected one comes again, at the end."""
        rows = self._db.execute(
            "SELECT change, body FROM record WHERE kind = ? AND change > ? ORDER BY change LIMIT ?", (Kind.ENCOUNTER, after, limit + 1)
        ).fetchall()
        records = [record for _, body in rows[:limit] if isinstance(record := decode_journal_record(body), EncounterRecord)]
        return EncounterPage(records=tuple(records), cursor=rows[:limit][-1][0] if rows else after, has_more=len(rows) > limit)

    def missions(self) -> tuple[MissionRecord, ...]:
        """Return all mission phases in the order in which they began."""
        return tuple(sorted(self._missions.values(), key=lambda record: (wall_interval(record)[0], record.gateway, record.offset)))

    def latest_modes(self) -> tuple[ModeRecord, ...]:
        """Return the newest mode of every biobot."""
        return self._modes.latest()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        try:
            self._db.execute("BEGIN IMMEDIATE")
            yield
            self._db.execute("COMMIT")
        except sqlite3.Error as error:
            raise self._translate(error) from error
        finally:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")

    def _prepare(self) -> None:
        # Only one mapper may write a file: its memory is in step with the file, and with no other process.
        self._db.execute("PRAGMA locking_mode = EXCLUSIVE")
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = NORMAL")
        self._db.execute("BEGIN IMMEDIATE")
        (application_id,) = self._db.execute("PRAGMA application_id").fetchone()
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        (n_tables,) = self._db.execute("SELECT count(*) FROM sqlite_schema").fetchone()
        if n_tables == 0 and application_id in {0, APPLICATION_ID}:
            for statement in _SCHEMA.split(";"):
                self._db.execute(statement)
            self._db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            self._db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
            version = SCHEMA_VERSION
        elif application_id != APPLICATION_ID:
            raise _foreign(self._path)
        self._db.execute("COMMIT")
        if version != SCHEMA_VERSION:
            raise StoreError(
                path=self._path,
                reason=f"has schema version {version}, but this program knows {SCHEMA_VERSION}",
                next_step="use the version of the program that made it, or name another file",
            )

    def _load(self) -> None:
        self._encounters = EncounterColumns()
        self._modes = ModeSpells()
        self._missions: dict[int, MissionRecord] = {}
        self._sources: dict[tuple[str, str], _Source] = {}
        self._last_id = 0
        for row_id, body in self._db.execute("SELECT id, body FROM record ORDER BY id"):
            self._remember(row_id, decode_journal_record(body))
        (self._next_change,) = self._db.execute("SELECT coalesce(max(change), 0) + 1 FROM record").fetchone()
        query = "SELECT source.id, gateway.id, name, journal, watermark FROM source JOIN gateway ON gateway.id = source.gateway"
        for source_id, gateway_id, name, journal, watermark in self._db.execute(query).fetchall():
            spans = self._db.execute("SELECT first, last FROM span WHERE source = ?", (source_id,)).fetchall()
            offsets = OffsetSet(watermark=watermark, spans=spans)
            self._sources[name, journal] = _Source(id=source_id, gateway_id=gateway_id, offsets=offsets)

    def _remember(self, row_id: int, record: JournalRecord) -> None:
        self._last_id = max(self._last_id, row_id)
        match record:
            case EncounterRecord():
                self._encounters.put(row_id, record)
            case ModeRecord():
                self._modes.put(row_id, record)
            case MissionRecord():
                self._missions[row_id] = record

    def _copy_source(self, gateway: str, journal: str) -> _Source:
        known = self._sources.get((gateway, journal))
        if known:
            return _Source(
                id=known.id, gateway_id=known.gateway_id, offsets=OffsetSet(watermark=known.offsets.watermark, spans=known.offsets.spans)
            )
        self._db.execute("INSERT INTO gateway (name) VALUES (?) ON CONFLICT DO NOTHING", (gateway,))
        (gateway_id,) = self._db.execute("SELECT id FROM gateway WHERE name = ?", (gateway,)).fetchone()
        (source_id,) = self._db.execute(
            "INSERT INTO source (gateway, journal, watermark) VALUES (?, ?, 0) RETURNING id", (gateway_id, journal)
        ).fetchone()
        return _Source(id=source_id, gateway_id=gateway_id, offsets=OffsetSet())

    def _save_source(self, source: _Source) -> None:
        self._db.execute("UPDATE source SET watermark = ? WHERE id = ?", (source.offsets.watermark, source.id))
        self._db.execute("DELETE FROM span WHERE source = ?", (source.id,))
        rows: Sequence[tuple[int, int, int]] = [(source.id, first, last) for first, last in source.offsets.spans]
        self._db.executemany("INSERT INTO span (source, first, last) VALUES (?, ?, ?)", rows)

    def _translate(self, error: sqlite3.Error | RecordError | StoreError) -> StoreError:
        if isinstance(error, StoreError):
            return error
        text = str(error)
        if isinstance(error, RecordError):
            return StoreError(path=self._path, reason=f"is damaged: {text}", next_step="name another file; gateways fill it again")
        if "locked" in text:
            return StoreError(path=self._path, reason="is in use by another mapper", next_step="stop that one, or name another file")
        if "full" in text:
            return StoreError(path=self._path, reason=f"cannot be written: {text}", next_step="make room on the disk")
        return StoreError(path=self._path, reason=f"cannot be used: {text}", next_step="check path and permissions, or name another file")


def _refuse_foreign_file(path: Path) -> None:
    other = "name another file"
    if path.is_dir():
        raise StoreError(path=str(path), reason="is a directory", next_step="name a file in it")
    if not path.parent.is_dir():
        raise StoreError(path=str(path), reason=f"there is no directory {path.parent}", next_step="make it, or name another file")
    try:
        with path.open("rb") as file:
            header = file.read(100)
    except FileNotFoundError:
        return
    except OSError as error:
        raise StoreError(path=str(path), reason=f"cannot be read: {error.strerror}", next_step=other) from error
    if header and not header.startswith(b"SQLite format 3\0"):
        raise StoreError(path=str(path), reason="is not a store of records (no SQLite file)", next_step=other)
    # https://www.sqlite.org/fileformat.html: page size in bytes 16 and 17 (1 means 65,536), application id in bytes 68 to 71. A
    # file of ours has id 0 and one page until its first checkpoint.
    page_size = int.from_bytes(header[16:18], "big")
    application_id = int.from_bytes(header[68:72], "big")
    is_young = application_id == 0 and path.stat().st_size <= (page_size if page_size > 1 else 65_536)
    if header and application_id != APPLICATION_ID and not is_young:
        raise _foreign(str(path))


def _foreign(path: str) -> StoreError:
    return StoreError(path=path, reason="is the SQLite file of another program", next_step="name another file")


def _kind(record: JournalRecord) -> Kind:
    match record:
        case EncounterRecord():
            return Kind.ENCOUNTER
        case ModeRecord():
            return Kind.MODE
        case MissionRecord():
            return Kind.MISSION
