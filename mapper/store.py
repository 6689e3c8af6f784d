"""The mapper's memory: every journaled record once, in its highest revision, in one SQLite file (CONTRACT.md §3).

A record is applied exactly once, in whatever order and however often it arrives. What has arrived of each gateway's
journal is committed together with the records, so nothing is lost between them when the process is killed. After a
power cut the newest commits may be gone (``synchronous=NORMAL``); they are then missing from the watermark too, and are fetched again.
"""

import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from firmware_protocol.contract.records import (
    EncounterRecord,
    JournalRecord,
    MissionPhase,
    MissionRecord,
    ModeRecord,
    RecordBatch,
    decode_journal_record,
)
from firmware_protocol.errors import RecordError
from firmware_protocol.units import NodeId
from mapper.encounter_pages import EncounterPage, read_page
from mapper.errors import StoreError
from mapper.gateway_clocks import SourceClock
from mapper.offsets import OffsetSet, runs
from mapper.record_columns import EncounterRows, is_fit, wall_interval
from mapper.record_rows import RecordRows
from mapper.replica import StoreDelta
from mapper.row_loader import LoadedEncounters, load_encounters
from mapper.site_view import SiteView
from mapper.store_file import open_store_file, random_name, store_name, translate

_MAX_INTEGER = 2**63 - 1
_T = TypeVar("_T")


class Kind(IntEnum):
    """What kind of record a row holds."""

    ENCOUNTER = 0
    MODE = 1
    MISSION = 2


_KINDS: Final[Mapping[type, Kind]] = {EncounterRecord: Kind.ENCOUNTER, ModeRecord: Kind.MODE, MissionRecord: Kind.MISSION}


@dataclass(frozen=True, slots=True, kw_only=True)
class Applied:
    """What a call of ``apply`` did: how many records were new, corrected, known already, or unfit and left out.

    ``modes`` are the mode records among the new and the corrected.
    """

    n_new: int = 0
    n_revised: int = 0
    n_repeated: int = 0
    n_unfit: int = 0
    modes: tuple[ModeRecord, ...] = ()

    @property
    def has_changed(self) -> bool:
        """Say whether the content is another one now."""
        return bool(self.n_new or self.n_revised)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoreProgress:
    """How far a store has come: encounters that are not void, and records taken in, each revision counted as one."""

    n_encounters: int
    change: int


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptMap:
    """A finished map on its way through a restart: what made it, after which change, and its documents."""

    made_by: str
    change: int
    document: bytes


@dataclass(slots=True)
class _Source:
    id: int
    offsets: OffsetSet
    has_spans: bool = False
    """There are ranges beyond the watermark in the file."""


class Store:
    """All records of all gateways. Not safe for use by several threads at a time, but for `progress`.

    Parameters
    ----------
    path
        The file; it is made if it is not there. None keeps everything in memory.

    Raises
    ------
    StoreError
        The file is none of ours, is from a newer version, is in use by another mapper, is damaged, or cannot be opened.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = store_name(path)
        self._progress = StoreProgress(n_encounters=0, change=0)
        self.arrived_ns = time.monotonic_ns()  # when an encounter was last new; at first, when it was opened
        self._db = open_store_file(path)
        try:
            self._name = None if path is None else random_name(self._db)
            self._load()
        except (sqlite3.Error, RecordError, StoreError) as error:
            self._db.close()
            raise translate(error, path=self._path) from error

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @property
    def n_encounters(self) -> int:
        """Count the encounters that are not void."""
        return self._site.encounters.n_counting

    @property
    def progress(self) -> StoreProgress:
        """How far it has come; any thread may ask."""
        return self._progress

    def apply(self, batches: Iterable[RecordBatch]) -> Applied:
        """Take in records; those already known, in this revision or a higher one, change nothing.

        Raises
        ------
        StoreError
            The file cannot be written; nothing of the batches was taken in.
        """
        arrived: list[tuple[int, int, JournalRecord]] = []
        n_unfit = 0
        touched: dict[tuple[str, str], _Source] = {}
        with self.transaction():
            for batch in batches:
                n_unfit += self._arrive(batch, into=arrived, touched=touched)
            fresh = self._rows.write(arrived, change=self._progress.change)
            for source in touched.values():
                self._save_source(source)
        self._sources.update(touched)
        n_new = len({row for row, _, _ in fresh if row > self._rows.last})
        self._rows.settle(fresh, arrived)
        self._remember(fresh)
        if self.n_encounters > self._progress.n_encounters:
            self.arrived_ns = time.monotonic_ns()
        self._progress = StoreProgress(n_encounters=self.n_encounters, change=self._progress.change + len(fresh))
        return Applied(
            n_new=n_new,
            n_revised=len(fresh) - n_new,
            n_repeated=len(arrived) - len(fresh),
            n_unfit=n_unfit,
            modes=tuple(record for _, _, record in fresh if isinstance(record, ModeRecord)),
        )

    @property
    def clocks(self) -> tuple[SourceClock, ...]:
        """How each start of each gateway stood to the site's clock when the last map was begun; any thread may ask."""
        return self._clocks

    def watermark(self, *, gateway: str, journal: str) -> int:
        """Return the highest offset of a journal up to which nothing is missing, 0 where nothing has come."""
        source = self._sources.get((gateway, journal))
        return source.offsets.watermark if source else 0

    @property
    def name(self) -> str | None:
        """The random name of its file; None where it is in memory."""
        return self._name

    def durable_watermarks(self) -> dict[tuple[str, str], int]:
        """Return each journal's watermark as a power cut would leave it, nothing where the store is in memory; raises ``StoreError``."""
        if self._name is None:
            return {}
        marks = {key: source.offsets.watermark for key, source in self._sources.items()}
        try:
            # Syncs the log before it copies it: what was committed until now is on the disk, whatever ``synchronous`` says.
            is_busy, n_frames, n_copied = self._db.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        except sqlite3.Error as error:
            raise translate(error, path=self._path) from error
        return marks if not is_busy and n_frames == n_copied else {}

    def first_hole(self, *, gateway: str, journal: str, head_offset: int) -> tuple[int, int] | None:
        """Name the first run of offsets that a journal has (up to ``head_offset`` at least) and this store lacks."""
        source = self._sources.get((gateway, journal))
        offsets = source.offsets if source else OffsetSet()
        return offsets.first_hole(up_to=max(head_offset, offsets.last))

    def give_up(self, *, gateway: str, journal: str, first: int, last: int) -> int:
        """Count offsets as arrived that the gateway itself does not have any more; return the watermark.

        Raises
        ------
        StoreError
            The file cannot be written; they are missing as before.
        """
        with self.transaction():
            source = self._copy_source(gateway, journal)
            source.offsets.add(first, last)
            self._save_source(source)
        self._sources[gateway, journal] = source
        return source.offsets.watermark

    def delta(self, *, after: int) -> StoreDelta:
        """Return what has changed after a change, for a `Replica`; after 0, everything.

        Where a mission set landmarks, encounters count from the newest exploration on: between earlier ones and the landmarks lies
        time in which nobody stood still ([Dir16] IV: time 0 is the moment the landmarks are set).
        """
        self._settle_clocks()
        begun = [
            wall_interval(record)[0]
            for record in self._site.missions.values()
            if record.phase is MissionPhase.EXPLORATION and not record.is_continued  # the landmarks stood during a pause
        ]
        return StoreDelta(
            base=after,
            change=self._progress.change,
            encounters=self._site.encounters.changed_after(after),
            modes=self._site.modes.changed_after(after),
            since_ns=max(begun, default=None),
        )

    def encounters_after(self, change: int) -> EncounterRows:
        """Return the encounters that were set after a change, void ones too."""
        return self._site.encounters.changed_after(change)

    def count_by_node(self) -> Mapping[NodeId, int]:
        """Count the encounters of each biobot, those before any mission too (unsigned ids)."""
        return self._site.encounters.count_by_node()

    def encounters(self, *, after: int, limit: int) -> EncounterPage:
        """Return encounters changed after a cursor, void ones too; a corrected one comes again, at the end."""
        return read_page(self._db, self._site, kind=Kind.ENCOUNTER, after=after, limit=limit)

    def rows(self, *, first: int, limit: int) -> tuple[EncounterRows, int | None]:
        """Return the encounters that count among so many rows from ``first`` on, and the row to go on with; None: that is all."""
        return self._site.encounters.page(first=first, limit=limit)

    def missions(self) -> tuple[MissionRecord, ...]:
        """Return all mission phases in the order in which they began."""
        return tuple(sorted(self._site.missions.values(), key=lambda record: (wall_interval(record)[0], record.gateway, record.offset)))

    def latest_modes(self) -> tuple[ModeRecord, ...]:
        """Return the newest mode of every biobot."""
        return self._site.modes.latest()

    def keep_map(self, kept: KeptMap) -> None:
        """Keep a finished map in the place of the one before.

        Raises
        ------
        StoreError
            The file cannot be written; the one before is still there.
        """
        with self.transaction():
            values = (kept.made_by, kept.change, kept.document)
            self._db.execute("INSERT OR REPLACE INTO finished_map (id, made_by, change, document) VALUES (1, ?, ?, ?)", values)

    def kept_map(self, *, made_by: str) -> KeptMap | None:
        """Return the map that was kept; None where there is none, or another recipe or program made it.

        Raises
        ------
        StoreError
            The file cannot be read.
        """
        query = "SELECT change, document FROM finished_map WHERE made_by = ?"
        row = self.read(lambda database: database.execute(query, (made_by,)).fetchone())
        return None if row is None else KeptMap(made_by=made_by, change=row[0], document=row[1])

    def read(self, query: Callable[[sqlite3.Connection], _T]) -> _T:
        """Ask the file for what other modules keep in it.

        Raises
        ------
        StoreError
            The file cannot be read.
        """
        try:
            return query(self._db)
        except sqlite3.Error as error:
            raise translate(error, path=self._path) from error

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Change the file, all of it or nothing; raises ``StoreError`` where it cannot be written."""
        try:
            self._db.execute("BEGIN IMMEDIATE")
            yield self._db
            self._db.execute("COMMIT")
        except sqlite3.Error as error:
            raise translate(error, path=self._path) from error
        finally:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")

    def _arrive(self, batch: RecordBatch, *, into: list[tuple[int, int, JournalRecord]], touched: dict[tuple[str, str], _Source]) -> int:
        """Note the offsets of a batch, and collect its records that are fit; return how many are not."""
        name, journal = key = (batch.gateway, batch.journal)
        records = [
            record for record in batch.records if record.gateway == name and record.journal == journal and record.offset <= _MAX_INTEGER
        ]
        if not records:
            return len(batch.records)
        source = touched.get(key) or touched.setdefault(key, self._copy_source(name, journal))
        # An unfit record counts as arrived, or the gap would be asked for again for ever.
        for first, last in runs(record.offset for record in records):
            source.offsets.add(first, last)
        fit = [(source.id, _KINDS[type(record)], record) for record in records if is_fit(record)]
        into += fit
        return len(batch.records) - len(fit)

    def _load(self) -> None:
        self._site = SiteView(self._read_encounters)
        self._clocks: tuple[SourceClock, ...] = ()
        self._sources: dict[tuple[str, str], _Source] = {}
        others = self._db.execute("SELECT id, change, body FROM record WHERE kind <> ? ORDER BY change", (Kind.ENCOUNTER,))
        self._remember([(row, change, decode_journal_record(body)) for row, change, body in others])
        self._rows = RecordRows(self._db)
        newest = [self._db.execute("SELECT max(change) FROM record WHERE kind = ?", (kind,)).fetchone()[0] or 0 for kind in Kind]
        gateways = [name for (name,) in self._db.execute("SELECT name FROM gateway")]
        self._site.open(gateways=gateways, change=max(newest))
        self._progress = StoreProgress(n_encounters=self.n_encounters, change=max(newest))
        self._settle_clocks()
        query = "SELECT source.id, name, journal, watermark FROM source JOIN gateway ON gateway.id = source.gateway"
        for source_id, name, journal, watermark in self._db.execute(query).fetchall():
            spans = self._db.execute("SELECT first, last FROM span WHERE source = ?", (source_id,)).fetchall()
            offsets = OffsetSet(watermark=watermark, spans=spans)
            self._sources[name, journal] = _Source(id=source_id, offsets=offsets, has_spans=bool(spans))

    def _read_encounters(self) -> Iterator[LoadedEncounters]:
        try:
            yield from load_encounters(self._db, kind=Kind.ENCOUNTER)
        except (sqlite3.Error, RecordError) as error:
            raise translate(error, path=self._path) from error

    def _remember(self, fresh: Sequence[tuple[int, int, JournalRecord]]) -> None:
        """Put records into memory; of several of one row, the last."""
        encounters: dict[int, tuple[int, EncounterRecord]] = {}
        for row, change, record in fresh:
            match record:
                case EncounterRecord():
                    encounters[row] = (change, record)
                case ModeRecord() | MissionRecord():
                    self._site.take_other(row, record, change=change)
        if encounters:
            changes = np.array([change for change, _ in encounters.values()], dtype=np.int64)
            self._site.take_encounters(list(encounters), [record for _, record in encounters.values()], changes=changes)

    def _settle_clocks(self) -> None:
        """Put all gateways on one clock, by all that is known now."""
        change = self._progress.change
        self._site.settle(change=change)
        self._clocks = self._site.clocks()
        self._progress = StoreProgress(n_encounters=self.n_encounters, change=change)

    def _copy_source(self, gateway: str, journal: str) -> _Source:
        known = self._sources.get((gateway, journal))
        if known:
            offsets = OffsetSet(watermark=known.offsets.watermark, spans=known.offsets.spans)
            return _Source(id=known.id, offsets=offsets, has_spans=known.has_spans)
        self._db.execute("INSERT INTO gateway (name) VALUES (?) ON CONFLICT DO NOTHING", (gateway,))
        (gateway_id,) = self._db.execute("SELECT id FROM gateway WHERE name = ?", (gateway,)).fetchone()
        (source_id,) = self._db.execute(
            "INSERT INTO source (gateway, journal, watermark) VALUES (?, ?, 0) RETURNING id", (gateway_id, journal)
        ).fetchone()
        return _Source(id=source_id, offsets=OffsetSet())

    def _save_source(self, source: _Source) -> None:
        self._db.execute("UPDATE source SET watermark = ? WHERE id = ?", (source.offsets.watermark, source.id))
        if source.has_spans:
            self._db.execute("DELETE FROM span WHERE source = ?", (source.id,))
        rows: Sequence[tuple[int, int, int]] = [(source.id, first, last) for first, last in source.offsets.spans]
        if rows:
            self._db.executemany("INSERT INTO span (source, first, last) VALUES (?, ?, ?)", rows)
        source.has_spans = bool(rows)
