"""The journal's file as the gateway writes it: opened, locked, and committed to segment by segment.

Synchronous; each object belongs to one thread at a time.
"""

import fcntl
import json
import secrets
import sqlite3
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, TypeVar

from firmware_protocol.units import NS_PER_S, BootId, Nanoseconds
from gateway.errors import JournalUnfitError
from gateway.journal_file.audit_chain import ChainHead
from gateway.journal_file.audit_table import JOURNAL_KIND, Stamp, append_entries, note_of_journal, read_head
from gateway.journal_file.migration import bring_over, renew
from gateway.journal_file.owner import expect_owner, remember_owner
from gateway.journal_file.schema import (
    COMMIT,
    FIRST_SCHEMA_VERSION,
    SCHEMA_VERSION,
    head_offset,
    make_tables,
    oldest_offset,
    read_meta,
    schema_version_of,
    set_durable,
    unfit,
)
from gateway.journal_file.segments import SegmentBuilder, Windows
from gateway.journal_file.upkeep import Dropped, Retention, Upkeep, drop_audit, drop_segments, drop_tables, give_back, merge_neighbours
from gateway.journal_file.writes import JournalIdentity

SESSIONS_PER_START = 16
"""Link session numbers that are a start's own: 4096 starts in a row use different ones."""

PROGRESS = "progress"
"""The step of upkeep that writes down how far mappers have come."""

_MAX_ANCHORS = 64

_RAN_PERIOD_NS = 600 * NS_PER_S
"""How long a gateway has run is written down at least so often, where nothing is committed."""


_ResultT = TypeVar("_ResultT")


class JournalFile:
    """An open journal, locked against other gateways.

    ``windows`` is what the disk knows of backpacks' messages, and what segments that are under way will tell it.
    """

    def __init__(
        self,
        *,
        connection: sqlite3.Connection,
        lock: IO[bytes],
        identity: JournalIdentity,
        wall_clock: Callable[[], int] = time.time_ns,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._connection = connection
        self._lock = lock
        self._wall_clock = wall_clock
        self._clock = clock
        self._ran_until_now_ns = self._told_ran_ns = _ran_ns(connection)
        self._opened_ns = clock()
        self._newest_segment = _newest_segment(connection)
        self._has_failed = False
        self._audit_head = read_head(connection)
        self.identity = identity
        self.windows = Windows(connection.execute("SELECT node, boot, next, above, wall_ns FROM windows"))

    def commit(self, gathered: SegmentBuilder) -> None:
        """Put a segment on disk in one transaction; an error leaves the file as it was, or complete.

        After an error of SQLite the same segment may be given again: where the failed commit did reach the disk, nothing is
        written twice.
        """
        number = self._newest_segment + 1
        if self._has_failed and _newest_segment(self._connection) >= number:
            self._audit_head = read_head(self._connection)
        else:
            self._has_failed = True  # until it is known not to have
            stamp = self._stamp()
            sealed = gathered.seal(
                segment=number, now_wall_ns=stamp.wall_ns, ran_ns=stamp.ran_ns, boot=stamp.boot, audit_head=self._audit_head
            )
            try:
                self._connection.execute(COMMIT, sealed.row())
            except sqlite3.IntegrityError:
                self._audit_head = read_head(self._connection)  # another hand has put a row where this one's was to be
                raise
            self._audit_head = sealed.audit_head or self._audit_head
        self._has_failed = False
        self._newest_segment = number

    def tidy(self, retention: Retention, watermarks: Mapping[str, int], *, is_behind: bool = False) -> Upkeep:
        """Take one short step of upkeep, and write down how far mappers have come.

        ``is_behind``: a mapper has more of this journal than it has itself; from the next start on it has another name.
        What makes room comes first, and what the disk refuses keeps nothing else from being done.
        """
        connection, stamp = self._connection, self._stamp()
        ran_ns = stamp.ran_ns
        refused: dict[str, str] = {}

        def attempt(step: str, work: Callable[[], _ResultT], otherwise: _ResultT) -> _ResultT:
            try:
                return work()
            except sqlite3.Error as error:
                refused[step] = str(error)
                return otherwise

        dropped = attempt("drop", lambda: drop_segments(connection, retention, ran_ns=ran_ns), Dropped())
        has_given = attempt("give back", lambda: give_back(connection), otherwise=False)
        self._audit_head = attempt("drop audit", lambda: drop_audit(connection, retention, stamp=stamp), None) or self._audit_head
        attempt("drop the rest", lambda: drop_tables(connection, retention, ran_ns=ran_ns), None)
        attempt(PROGRESS, lambda: self._write_progress(watermarks, ran_ns=ran_ns, is_behind=is_behind), None)
        damage = attempt("merge", lambda: merge_neighbours(connection), None)
        return Upkeep(
            n_dropped=dropped.n_records,
            n_undelivered=dropped.n_undelivered,
            is_oversized=dropped.is_oversized,
            has_more=dropped.has_more or has_given or damage is not None,
            oldest_offset=attempt("look", lambda: oldest_offset(connection), None),
            damage=damage or (),
            refused=refused,
        )

    @property
    def audit_head(self) -> ChainHead:
        """Where the audit log's chain ends."""
        return self._audit_head

    def watermarks(self) -> dict[str, int]:
        """Return how far each known mapper has said to have everything."""
        return {mapper: int(offset) for mapper, offset in self._connection.execute("SELECT mapper, offset FROM watermarks")}

    def oldest_offset(self) -> int:
        """Return the first offset that the file still has, or will have."""
        return oldest_offset(self._connection)

    def ran_ns(self) -> int:
        """Return how long gateways have run on this journal [ns]."""
        return self._ran_until_now_ns + max(0, self._clock() - self._opened_ns)

    def _write_progress(self, watermarks: Mapping[str, int], *, ran_ns: int, is_behind: bool) -> None:
        for mapper, offset in watermarks.items():
            values = (mapper, offset, self._wall_clock(), ran_ns)
            self._connection.execute("INSERT OR REPLACE INTO watermarks VALUES (?, ?, ?, ?)", values)
        if is_behind:
            self._connection.execute("INSERT OR REPLACE INTO meta VALUES ('is_behind', '1')")
        if ran_ns - self._told_ran_ns >= _RAN_PERIOD_NS:
            self._connection.execute("INSERT OR REPLACE INTO meta VALUES ('ran_ns', ?)", (str(ran_ns),))
            self._told_ran_ns = ran_ns

    def _stamp(self) -> Stamp:
        return Stamp(ran_ns=self.ran_ns(), boot=self.identity.boot, wall_ns=self._wall_clock())

    def close(self) -> None:
        """Close the file and let others have it."""
        self._connection.close()
        self._lock.close()


def open_journal_file(
    path: Path,
    *,
    now_wall_ns: int,
    now_ns: int,
    machine_boot: str,
    gateway: str | None = None,
    wall_clock: Callable[[], int] = time.time_ns,
    clock: Callable[[], int] = time.monotonic_ns,
) -> JournalFile:
    """Open the journal, or make it where there is none, and begin a new boot. One of an earlier version is brought over first.

    ``machine_boot`` names what the monotonic clock counts from; it is empty where that is not known. ``gateway`` is the name of the gateway
    whose journal it is, and stays; None: whichever.

    Raises
    ------
    JournalUnfitError
        The file is something else, cannot be written, is in use by another gateway, or was written by one of another name.
    """
    lock = _take_lock(path)
    try:
        connection = _connect(path)
        try:
            version = schema_version_of(connection, path=path)
            if gateway is not None and version:
                expect_owner(connection, path=path, gateway=gateway, schema_version=version)
            if version == FIRST_SCHEMA_VERSION:
                connection.close()
                bring_over(path, stamp=Stamp(ran_ns=0, boot=0, wall_ns=now_wall_ns))
                connection = _connect(path)
            if version == 0:
                make_tables(connection)
            set_durable(connection)
            if FIRST_SCHEMA_VERSION < version < SCHEMA_VERSION:
                renew(connection, version=version, stamp=Stamp(ran_ns=0, boot=0, wall_ns=now_wall_ns))
            if gateway is not None:
                remember_owner(connection, gateway)
            _forget_old_lives(connection)
            identity = _begin_boot(connection, now_wall_ns=now_wall_ns, now_ns=now_ns, machine_boot=machine_boot)
            return JournalFile(connection=connection, lock=lock, identity=identity, wall_clock=wall_clock, clock=clock)
        except BaseException:
            connection.close()
            raise
    except sqlite3.DatabaseError as error:
        lock.close()
        raise unfit(path, error) from error
    except BaseException:
        lock.close()
        raise


def is_in_use(path: Path) -> bool:
    """Return whether a gateway has a journal open now; nothing is made. Where that cannot be seen, it is not known to be."""
    try:
        with _lock_of(path).open("rb") as lock:
            # Shared, for a moment: two who look at once are not in each other's way.
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _lock_of(path: Path) -> Path:
    return path.with_name(path.name + ".lock")


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=5.0)
    connection.execute("PRAGMA locking_mode = NORMAL")
    return connection


def _take_lock(path: Path) -> IO[bytes]:
    # A lock on the database file itself would be dropped by SQLite's own opening and closing of it: POSIX locks are a process's.
    if path.is_dir():
        raise JournalUnfitError(path=str(path), reason="is a directory", advice="give the name of a file")
    lock_path = _lock_of(path)
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


def _forget_old_lives(connection: sqlite3.Connection) -> None:
    newest = "SELECT node, boot, row_number() OVER (PARTITION BY node ORDER BY ran_ns DESC, wall_ns DESC) AS place FROM windows"
    connection.execute(
        f"DELETE FROM windows WHERE (node, boot) IN (SELECT node, boot FROM ({newest}) WHERE place > ?)",  # noqa: S608  # constants
        (Windows.MAX_LIVES,),
    )


def _begin_boot(connection: sqlite3.Connection, *, now_wall_ns: int, now_ns: int, machine_boot: str) -> JournalIdentity:
    if read_meta(connection, "is_behind") is not None:
        _begin_history(connection, now_wall_ns=now_wall_ns)
    meta = dict(connection.execute("SELECT key, value FROM meta"))
    boot = BootId(max(int(meta["boot"]) + 1, now_wall_ns // NS_PER_S))
    anchor_ns = Nanoseconds(now_wall_ns - now_ns)
    is_same_clock = bool(machine_boot) and meta.get("machine_boot") == machine_boot
    earlier = tuple(Nanoseconds(anchor) for anchor in json.loads(meta["anchors"])) if is_same_clock else ()
    clock_boot = BootId(int(meta.get("clock_boot", boot))) if is_same_clock else boot
    first_session = int(meta.get("next_session") or secrets.randbelow(1 << 16))
    # Before the first session is opened: a process that is killed leaves its numbers used.
    connection.execute(
        "INSERT OR REPLACE INTO meta VALUES ('boot', ?), ('machine_boot', ?), ('clock_boot', ?), ('anchors', ?), ('next_session', ?)",
        (
            str(boot),
            machine_boot,
            str(clock_boot),
            json.dumps([*earlier, anchor_ns][-_MAX_ANCHORS:]),
            str((first_session + SESSIONS_PER_START) % (1 << 16)),
        ),
    )
    return JournalIdentity(
        journal=meta["journal"],
        boot=boot,
        head_offset=head_offset(connection),
        wall_anchor_ns=anchor_ns,
        earlier_anchors=earlier,
        first_session=first_session,
        opened_ns=now_ns,
        ran_ns=_ran_ns(connection),
        clock_boot=clock_boot,
    )


def _begin_history(connection: sqlite3.Connection, *, now_wall_ns: int) -> None:
    """Give the journal another name: its next offsets are known, with other records, to those who read it."""
    connection.execute("BEGIN IMMEDIATE")
    was, name = read_meta(connection, "journal"), secrets.token_hex(4)
    connection.execute("INSERT OR REPLACE INTO meta VALUES ('journal', ?), ('begins', ?)", (name, str(head_offset(connection) + 1)))
    stamp = Stamp(ran_ns=_ran_ns(connection), boot=int(read_meta(connection, "boot") or 0), wall_ns=now_wall_ns)
    renamed = note_of_journal(JOURNAL_KIND, {"event": "renamed: an older copy of itself", "was": was, "is": name}, stamp=stamp)
    append_entries(connection, [renamed], stamp=stamp)
    connection.execute("DELETE FROM watermarks")
    connection.execute("DELETE FROM meta WHERE key = 'is_behind'")
    connection.execute("COMMIT")


def _ran_ns(connection: sqlite3.Connection) -> int:
    """Return how long gateways have run on a journal, as far as was written down [ns]."""
    newest = "SELECT ran_ns FROM segments ORDER BY first_offset DESC, segment DESC LIMIT 1"
    audited = "SELECT ran_ns FROM audit ORDER BY id DESC LIMIT 1"
    query = f"SELECT max(coalesce(({newest}), 0), coalesce(({audited}), 0), (SELECT coalesce(max(ran_ns), 0) FROM watermarks))"  # noqa: S608  # constants
    return max(int(connection.execute(query).fetchone()[0]), int(read_meta(connection, "ran_ns") or 0))


def _newest_segment(connection: sqlite3.Connection) -> int:
    row = connection.execute("SELECT segment FROM segments ORDER BY first_offset DESC, segment DESC LIMIT 1").fetchone()
    return 0 if row is None else int(row[0])
