"""Keeping the file small and quick: small segments are merged, old ones go, free pages are given back. Each call is one short step.

Ages are told by how long gateways have run on the journal: a wall clock that is set makes nothing older, and nothing younger.

The oldest segments go first, and whole. What is younger than ``keep_ns`` stays whatever it takes. What a known mapper has not said to
have yet outlives its age, and goes only where the size demands it; that is told.
"""

import itertools
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gateway.journal_file.audit_chain import ChainHead
from gateway.journal_file.audit_table import Stamp, prune
from gateway.journal_file.blobs import RECORDS_COMPRESSED, REPORTS_COMPRESSED, DamagedSegmentError, decompress, read_contents
from gateway.journal_file.segments import MODE, Contents, join_contents
from gateway.journal_file.writes import Damage

_SMALL = (512, 2560)
"""Records and reports of a segment of level 0, and of level 1, that is worth merging."""

_MERGED_TOGETHER = (64, 16)
"""Neighbours of level 0, and of level 1, that become one: from a few records each to some thousand."""

_DAMAGED_LEVEL = 255
"""Level of a segment that was found damaged: it stays as it is, for `journal check` to name, and its neighbours end at it."""

_LARGE = 1 << 20
"""Stored octets up to which neighbours are merged: whole segments go where room is wanted."""

_STORED = "length(c.pairs) + length(c.records) + length(c.reports)"

_MERGE_SPAN = 256
"""Newest segments among which neighbours are looked for."""

_KEPT_MODES = 10_000
"""As many as a gateway reads when it starts."""

_DROPPED_TOGETHER = 32
_SPARE_SHARE = 0.05
_SPARE_PAGES = 1024
_PAGES_A_STEP = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class Retention:
    """What may be kept. None: no limit."""

    max_age_ns: int | None = None
    max_size: int | None = None
    """Octets of the file without what is free in it."""
    keep_ns: int = 0
    audit_age_ns: int | None = None
    node_age_ns: int | None = None
    mapper_age_ns: int | None = None
    """A mapper that was not heard of for longer is not waited for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dropped:
    """What was dropped. ``n_undelivered``: records that a known mapper did not have; ``is_oversized``: nothing more may go."""

    n_records: int = 0
    n_undelivered: int = 0
    is_oversized: bool = False
    has_more: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Upkeep:
    """What a step has done; as of ``Dropped``. ``oldest_offset``: where it has changed; ``refused``: steps, and what the disk said."""

    n_dropped: int = 0
    n_undelivered: int = 0
    is_oversized: bool = False
    has_more: bool = False
    oldest_offset: int | None = None
    damage: tuple[Damage, ...] = ()
    refused: Mapping[str, str] = field(default_factory=dict)


def merge_neighbours(connection: sqlite3.Connection) -> tuple[Damage, ...] | None:
    """Merge a run of small neighbours among the newest segments, if one is long enough; None: there is none.

    Damaged ones are not merged, which would hide it, but marked and returned.
    """
    rows = connection.execute(
        f"SELECT s.first_offset, s.segment, s.n_records + s.n_reports, {_STORED}, s.level "  # noqa: S608  # constants of this file
        "FROM segments s JOIN contents c ON c.segment = s.segment ORDER BY s.first_offset DESC, s.segment DESC LIMIT ?",
        (_MERGE_SPAN,),
    )
    for level, run in itertools.groupby(rows.fetchall(), key=_mergeable_level):
        members = list(run)
        if level is None or len(members) < _MERGED_TOGETHER[level]:
            continue
        sizes = itertools.accumulate(size for _, _, _, size, _ in reversed(members))
        n_merged = sum(size <= _LARGE for size in sizes)
        return _merge(connection, oldest=members[-1][:2], newest=members[-n_merged][:2], level=level + 1)
    return None


def drop_segments(connection: sqlite3.Connection, retention: Retention, *, ran_ns: int) -> Dropped:
    """Drop the oldest segments that are over age, or that the size has no room for; a few at a time."""
    if retention.max_age_ns is None and retention.max_size is None:
        return Dropped()
    excess = 0 if retention.max_size is None else used_size(connection) - retention.max_size
    delivered = _delivered(connection, retention, ran_ns=ran_ns)
    # The newest one says how far the journal has come: it stays.
    rows = connection.execute(
        f"SELECT s.segment, s.first_offset, s.n_records, s.ran_ns, {_STORED} "  # noqa: S608  # constants of this file
        "FROM segments s JOIN contents c ON c.segment = s.segment "
        "WHERE s.segment < (SELECT segment FROM segments ORDER BY first_offset DESC, segment DESC LIMIT 1) "
        "ORDER BY s.first_offset, s.segment LIMIT ?",
        (_DROPPED_TOGETHER,),
    ).fetchall()
    last, n_dropped, n_undelivered = None, 0, 0
    is_kept_by_age = False
    for segment, first, n_records, then_ran_ns, size in rows:
        if ran_ns - then_ran_ns < retention.keep_ns:
            is_kept_by_age = True
            break
        n_missing = 0 if delivered is None else max(0, first + n_records - 1 - max(delivered, first - 1))
        is_old = retention.max_age_ns is not None and ran_ns - then_ran_ns > retention.max_age_ns
        if not (excess > 0 or (is_old and not n_missing)):
            break
        last, excess = (first, segment), excess - size
        n_dropped, n_undelivered = n_dropped + n_records, n_undelivered + n_missing
    if last is not None:
        connection.execute("BEGIN IMMEDIATE")
        try:
            _delete_until(connection, *last)
            _delete_states(connection)
            connection.execute("COMMIT")
        finally:
            _roll_back(connection)
    is_oversized = excess > 0 and (is_kept_by_age or not rows)
    return Dropped(n_records=n_dropped, n_undelivered=n_undelivered, is_oversized=is_oversized, has_more=last is not None)


def drop_tables(connection: sqlite3.Connection, retention: Retention, *, ran_ns: int) -> None:
    """Drop what is over age of the rest: silent biobots, silent mappers."""
    if retention.node_age_ns is not None:
        before = ran_ns - retention.node_age_ns
        silent = "SELECT node FROM windows GROUP BY node HAVING max(ran_ns) < ?"
        connection.execute(f"DELETE FROM nodes WHERE node IN ({silent})", (before,))  # noqa: S608  # a constant of this file
        connection.execute(f"DELETE FROM windows WHERE node IN ({silent})", (before,))  # noqa: S608  # same
    if retention.mapper_age_ns is not None:
        connection.execute("DELETE FROM watermarks WHERE ran_ns < ?", (ran_ns - retention.mapper_age_ns,))


def drop_audit(connection: sqlite3.Connection, retention: Retention, *, stamp: Stamp) -> ChainHead | None:
    """Drop the audit log's rows that are over age; return the head of its chain where it has changed."""
    if retention.audit_age_ns is None:
        return None
    connection.execute("BEGIN IMMEDIATE")
    try:
        head = prune(connection, age_ns=retention.audit_age_ns, stamp=stamp)
        connection.execute("COMMIT")
    finally:
        _roll_back(connection)
    return head


def give_back(connection: sqlite3.Connection) -> bool:
    """Return a few free pages to the file system, where there are more than new segments will soon take; return whether there were."""
    n_pages = connection.execute("PRAGMA page_count").fetchone()[0]
    n_free = connection.execute("PRAGMA freelist_count").fetchone()[0]
    n_spare = n_free - max(_SPARE_PAGES, int(n_pages * _SPARE_SHARE))
    if n_spare <= 0:
        return False
    # Gives back one page a step of the statement; execute() takes a single step of what returns no columns.
    connection.executescript(f"PRAGMA incremental_vacuum({min(n_spare, _PAGES_A_STEP)})")
    return True


def used_size(connection: sqlite3.Connection) -> int:
    """Return the octets of the file that hold something."""
    n_pages = connection.execute("PRAGMA page_count").fetchone()[0] - connection.execute("PRAGMA freelist_count").fetchone()[0]
    return int(n_pages * connection.execute("PRAGMA page_size").fetchone()[0])


def _mergeable_level(row: tuple[int, int, int, int, int]) -> int | None:
    _, _, n_members, size, level = row
    return level if level < len(_SMALL) and n_members < _SMALL[level] and size < _LARGE // 4 else None


def _delivered(connection: sqlite3.Connection, retention: Retention, *, ran_ns: int) -> int | None:
    """Return the offset up to which every known mapper has everything; None where no mapper is known."""
    since = 0 if retention.mapper_age_ns is None else ran_ns - retention.mapper_age_ns
    (offset,) = connection.execute("SELECT min(offset) FROM watermarks WHERE ran_ns >= ?", (since,)).fetchone()
    return None if offset is None else int(offset)


def _merge(connection: sqlite3.Connection, *, oldest: tuple[int, int], newest: tuple[int, int], level: int) -> tuple[Damage, ...]:
    connection.execute("BEGIN IMMEDIATE")
    try:
        rows = connection.execute(
            "SELECT first_offset, segment, n_records, n_reports, wall_ns, ran_ns, min_start, max_end, encoding, crc FROM segments "
            "WHERE (first_offset, segment) BETWEEN (?, ?) AND (?, ?) ORDER BY first_offset, segment",
            (*oldest, *newest),
        ).fetchall()
        parts, damage = [], []
        for first, segment, n_records, *_, encoding, crc in rows:
            try:
                pairs, records, reports = read_contents(connection, segment, crc=crc)
                unpacked = decompress(records, is_compressed=bool(encoding & RECORDS_COMPRESSED))
                parts.append((pairs, unpacked, decompress(reports, is_compressed=bool(encoding & REPORTS_COMPRESSED))))
            except DamagedSegmentError as error:
                damage.append(Damage(first=first, last=first + n_records - 1, reason=str(error)))
                key = (_DAMAGED_LEVEL, first, segment)
                connection.execute("UPDATE segments SET level = ? WHERE (first_offset, segment) = (?, ?)", key)
        if not damage:
            _replace(connection, rows, join_contents(parts), level=level)
        connection.execute("COMMIT")
    finally:
        _roll_back(connection)
    return tuple(damage)


def _replace(connection: sqlite3.Connection, rows: Sequence[tuple[int, ...]], contents: Contents, *, level: int) -> None:
    """Put one segment in the place of neighbours."""
    firsts, segments, n_records, n_reports, wall_ns, ran_ns, min_starts, max_ends, *_ = zip(*rows, strict=True)
    last = segments[-1]
    connection.execute(
        "DELETE FROM segments WHERE (first_offset, segment) BETWEEN (?, ?) AND (?, ?)", (firsts[0], segments[0], firsts[-1], last)
    )
    connection.execute("DELETE FROM contents WHERE segment BETWEEN ? AND ?", (segments[0], last))
    connection.execute(
        "INSERT INTO segments VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (
            firsts[0],
            last,
            sum(n_records),
            sum(n_reports),
            level,
            max(wall_ns),
            min((start for start in min_starts if start is not None), default=None),
            max((end for end in max_ends if end is not None), default=None),
            contents.encoding,
            contents.crc,
            max(ran_ns),
        ),
    )
    connection.execute("INSERT INTO contents VALUES (?, ?, ?, ?)", (last, contents.pairs, contents.records, contents.reports))


def _delete_until(connection: sqlite3.Connection, first_offset: int, segment: int) -> None:
    connection.execute("DELETE FROM segments WHERE (first_offset, segment) <= (?, ?)", (first_offset, segment))
    connection.execute("DELETE FROM contents WHERE segment <= ?", (segment,))


def _delete_states(connection: sqlite3.Connection) -> None:
    """Drop the modes of segments that are gone, but for those that a restart reads."""
    connection.execute(
        "DELETE FROM states WHERE kind = :mode AND offset < (SELECT min(first_offset) FROM segments) "
        "AND offset < (SELECT offset FROM states WHERE kind = :mode ORDER BY offset DESC LIMIT 1 OFFSET :n_kept)",
        {"mode": MODE, "n_kept": _KEPT_MODES - 1},
    )


def _roll_back(connection: sqlite3.Connection) -> None:
    if connection.in_transaction:
        connection.execute("ROLLBACK")
