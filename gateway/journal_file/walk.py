"""All of a journal, segment by segment, while a gateway writes it or not; what is damaged ends the walk, or is left out and told."""

import contextlib
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

from gateway.journal_file.blobs import (
    RECORDS_COMPRESSED,
    REPORTS_COMPRESSED,
    DamagedSegmentError,
    decompress,
    unpack_records,
    unpack_reports,
)
from gateway.journal_file.integrity import segment_fault, segment_name
from gateway.journal_file.schema import head_offset
from gateway.journal_file.writes import UplinkReport

LeftOut = Callable[[str], object]
"""Hears of a part that is left out; who gives none has the walk end there."""

_HEAD = "first_offset, segment, n_records, n_reports, encoding, crc"
_Head = tuple[int, int, int, int, int, int]


def newest_offset(path: Path) -> int:
    """Return the newest offset of a journal, 0 where it has none; raises ``sqlite3.Error``."""
    with contextlib.closing(_open(path)) as connection:
        return head_offset(connection)


def walk_records(path: Path, *, until: int, left_out: LeftOut | None = None) -> Iterator[list[tuple[int, bytes]]]:
    """Yield the records of each segment with their offsets, as MessagePack, up to an offset. Each segment is a moment.

    Raises
    ------
    DamagedSegmentError
        A segment is damaged, or offsets are missing, and there is no ``left_out``.
    sqlite3.Error
        The file cannot be read.
    """
    with contextlib.closing(_open(path)) as connection:
        at = 0
        while True:
            connection.execute("BEGIN")
            (oldest,) = connection.execute("SELECT coalesce(min(first_offset), 1) FROM segments").fetchone()
            at = max(at, oldest)
            # Neighbours may have been merged since: the one that has this offset, else the first one after it.
            query = (
                f"SELECT {_HEAD} FROM segments WHERE n_records > 0 AND first_offset + n_records > ? "  # noqa: S608  # constants
                "AND first_offset >= coalesce((SELECT max(first_offset) FROM segments WHERE first_offset <= ? AND n_records > 0), 0) "
                "ORDER BY first_offset LIMIT 1"
            )
            head: _Head | None = connection.execute(query, (at, at)).fetchone()
            if head is None or head[0] > until:
                connection.execute("COMMIT")
                return
            first, n_records = head[0], head[2]
            contents = _contents(connection, head, left_out)
            connection.execute("COMMIT")
            if first > at:
                _leave_out(f"offsets {at} to {first - 1} are missing", left_out)
            if contents is not None:
                bodies = enumerate(unpack_records(decompress(contents[1], is_compressed=bool(head[4] & RECORDS_COMPRESSED))), start=first)
                yield [(offset, body) for offset, body in bodies if at <= offset <= until]
            at = first + n_records


def walk_reports(path: Path, *, left_out: LeftOut | None = None) -> Iterator[UplinkReport]:
    """Yield all uplink messages, in the order in which they were committed: one moment of the file. Raises as ``walk_records``."""
    with contextlib.closing(_open(path)) as connection:
        connection.execute("BEGIN")
        query = f"SELECT {_HEAD} FROM segments WHERE n_reports > 0 ORDER BY first_offset, segment"  # noqa: S608  # a constant
        for head in connection.execute(query):
            contents = _contents(connection, head, left_out)
            if contents is not None:
                yield from unpack_reports(decompress(contents[2], is_compressed=bool(head[4] & REPORTS_COMPRESSED)))


def _contents(connection: sqlite3.Connection, head: _Head, left_out: LeftOut | None) -> tuple[bytes, bytes, bytes] | None:
    """Return what a segment holds, or None where that is damaged and was told to ``left_out``."""
    first, segment, n_records, n_reports, encoding, crc = head
    try:
        blobs = connection.execute("SELECT pairs, records, reports FROM contents WHERE segment = ?", (segment,)).fetchone()
        fault = segment_fault((first, n_records, n_reports), encoding=encoding, crc=crc, blobs=blobs or (None, None, None))
    except sqlite3.DatabaseError as error:
        blobs, fault = None, f"its bytes cannot be read: {error}"
    if fault is None and blobs is not None:
        pairs, records, reports = blobs
        return pairs, records, reports
    _leave_out(f"{segment_name(segment, first, n_records)}: {fault} (also {n_reports} messages)", left_out)
    return None


def _leave_out(fault: str, left_out: LeftOut | None) -> None:
    if left_out is None:
        raise DamagedSegmentError(fault)
    left_out(fault)


def _open(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, timeout=5.0)
    connection.execute("PRAGMA query_only = ON")
    return connection
