"""Keeping the file small and quick: small segments are merged, old ones go, free pages are given back. Each call is one short step.

The oldest segments go first, and whole. What is younger than ``keep_ns`` stays whatever it takes. What a known mapper has not said to
have yet outlives its age, and goes only where the size demands it; that is told.
"""

import itertools
import sqlite3
from dataclasses import dataclass

from gateway.journal_file.blobs import decompress
from gateway.journal_file.segments import MODE, RECORDS_COMPRESSED, REPORTS_COMPRESSED, join_contents

_SMALL = (512, 2560)
"""Records and reports of a segment of level 0, and of level 1, that is worth merging."""

_MERGED_TOGETHER = (64, 16)
"""Neighbours of level 0, and of level 1, that become one: from a few records each to some thousand."""

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
class Upkeep:
    """What a step has done. ``n_undelivered``: dropped records that a known mapper did not have; ``is_oversized``: nothing more may go."""

    n_dropped: int = 0
    n_undelivered: int = 0
    is_oversized: bool = False
    has_more: bool = False


def merge_neighbours(connection: sqlite3.Connection) -> bool:
    """Merge a run of small neighbours among the newest segments, if one is long enough; return whether there was one."""
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
        _merge(connection, oldest=members[-1][:2], newest=members[-n_merged][:2], level=level + 1)
        return True
    return False


def drop_old(connection: sqlite3.Connection, retention: Retention, *, now_wall_ns: int) -> Upkeep:
    """Drop the oldest segments that are over age, or that the size has no room for; a few at a time."""
    _drop_tables(connection, retention, now_wall_ns=now_wall_ns)
    if retention.max_age_ns is None and retention.max_size is None:
        return Upkeep()
    excess = 0 if retention.max_size is None else used_size(connection) - retention.max_size
    delivered = _delivered(connection, retention, now_wall_ns=now_wall_ns)
    # The newest one says how far the journal has come: it stays.
    rows = connection.execute(
        f"SELECT s.segment, s.first_offset, s.n_records, s.wall_ns, {_STORED} "  # noqa: S608  # constants of this file
        "FROM segments s JOIN contents c ON c.segment = s.segment "
        "WHERE s.segment < (SELECT segment FROM segments ORDER BY first_offset DESC, segment DESC LIMIT 1) "
        "ORDER BY s.first_offset, s.segment LIMIT ?",
        (_DROPPED_TOGETHER,),
    ).fetchall()
    last, n_dropped, n_undelivered = None, 0, 0
    is_kept_by_age = False
    for segment, first, n_records, wall_ns, size in rows:
        if now_wall_ns - wall_ns < retention.keep_ns:
            is_kept_by_age = True
            break
        n_missing = 0 if delivered is None else max(0, first + n_records - 1 - max(delivered, first - 1))
        is_old = retention.max_age_ns is not None and now_wall_ns - wall_ns > retention.max_age_ns
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
    return Upkeep(n_dropped=n_dropped, n_undelivered=n_undelivered, is_oversized=is_oversized, has_more=last is not None)


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


def _delivered(connection: sqlite3.Connection, retention: Retention, *, now_wall_ns: int) -> int | None:
    """Return the offset up to which every known mapper has everything; None where no mapper is known."""
    since = 0 if retention.mapper_age_ns is None else now_wall_ns - retention.mapper_age_ns
    (offset,) = connection.execute("SELECT min(offset) FROM watermarks WHERE wall_ns >= ?", (since,)).fetchone()
    return None if offset is None else int(offset)


def _drop_tables(connection: sqlite3.Connection, retention: Retention, *, now_wall_ns: int) -> None:
    if retention.audit_age_ns is not None:
        # The last number on the wire is kept: a backpack remembers it.
        connection.execute(
            "DELETE FROM audit WHERE id IN (SELECT id FROM audit WHERE wall_ns < ? AND id IS NOT "
            "(SELECT max(id) FROM audit WHERE wire_command IS NOT NULL) ORDER BY wall_ns LIMIT 1000)",
            (now_wall_ns - retention.audit_age_ns,),
        )
    if retention.node_age_ns is not None:
        before = now_wall_ns - retention.node_age_ns
        silent = "SELECT node FROM windows GROUP BY node HAVING max(wall_ns) < ?"
        connection.execute(f"DELETE FROM nodes WHERE node IN ({silent})", (before,))  # noqa: S608  # a constant of this file
        connection.execute(f"DELETE FROM windows WHERE node IN ({silent})", (before,))  # noqa: S608  # same
    if retention.mapper_age_ns is not None:
        connection.execute("DELETE FROM watermarks WHERE wall_ns < ?", (now_wall_ns - retention.mapper_age_ns,))


def _merge(connection: sqlite3.Connection, *, oldest: tuple[int, int], newest: tuple[int, int], level: int) -> None:
    connection.execute("BEGIN IMMEDIATE")
    try:
        rows = connection.execute(
            "SELECT s.n_records, s.n_reports, s.wall_ns, s.min_start, s.max_end, s.encoding, c.pairs, c.records, c.reports "
            "FROM segments s JOIN contents c ON c.segment = s.segment "
            "WHERE (s.first_offset, s.segment) BETWEEN (?, ?) AND (?, ?) ORDER BY s.first_offset, s.segment",
            (*oldest, *newest),
        ).fetchall()
        contents = join_contents(
            [
                (
                    pairs,
                    decompress(records, is_compressed=bool(encoding & RECORDS_COMPRESSED)),
                    decompress(reports, is_compressed=bool(encoding & REPORTS_COMPRESSED)),
                )
                for *_, encoding, pairs, records, reports in rows
            ]
        )
        starts, ends = [row[3] for row in rows if row[3] is not None], [row[4] for row in rows if row[4] is not None]
        connection.execute("DELETE FROM segments WHERE (first_offset, segment) BETWEEN (?, ?) AND (?, ?)", (*oldest, *newest))
        connection.execute("DELETE FROM contents WHERE segment BETWEEN ? AND ?", (oldest[1], newest[1]))
        connection.execute(
            "INSERT INTO segments VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                oldest[0],
                newest[1],
                sum(row[0] for row in rows),
                sum(row[1] for row in rows),
                level,
                max(row[2] for row in rows),
                min(starts, default=None),
                max(ends, default=None),
                contents.encoding,
                contents.crc,
            ),
        )
        connection.execute("INSERT INTO contents VALUES (?, ?, ?, ?)", (newest[1], contents.pairs, contents.records, contents.reports))
        connection.execute("COMMIT")
    finally:
        _roll_back(connection)


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
