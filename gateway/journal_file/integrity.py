"""Is a journal whole? SQLite's own check, sums, lengths, offsets without gaps, and that each record can be read."""

import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import decode_journal_record
from firmware_protocol.errors import RecordError
from gateway.journal_file.blobs import DamagedSegmentError, checksum, decompress, unpack_records, unpack_reports
from gateway.journal_file.segments import RECORDS_COMPRESSED, REPORTS_COMPRESSED


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What a check has looked at, and the first fault; None: there is none."""

    n_segments: int
    n_records: int
    n_reports: int
    fault: str | None


def check_journal(path: Path, *, tell: Callable[[str], None]) -> Findings:
    """Look at everything, in bounded memory; ``tell`` hears how far it has come.

    Raises
    ------
    sqlite3.Error
        The file cannot be read at all.
    """
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None, timeout=5.0)
    try:
        tell("checking the database")
        connection.execute("BEGIN")  # one moment of the file
        (verdict,) = connection.execute("PRAGMA integrity_check(1)").fetchone()
        if verdict != "ok":
            return Findings(n_segments=0, n_records=0, n_reports=0, fault=f"the database is damaged: {verdict}")
        return _check_segments(connection, tell=tell)
    finally:
        connection.close()


def _check_segments(connection: sqlite3.Connection, *, tell: Callable[[str], None]) -> Findings:
    (total,) = connection.execute("SELECT count(*) FROM segments").fetchone()
    rows = connection.execute(
        "SELECT s.first_offset, s.segment, s.n_records, s.n_reports, s.encoding, s.crc, c.pairs, c.records, c.reports "
        "FROM segments s LEFT JOIN contents c ON c.segment = s.segment ORDER BY s.first_offset, s.segment"
    )
    n_segments = n_records = n_reports = 0
    expected: int | None = None
    for first, segment, of_records, of_reports, encoding, crc, *blobs in rows:
        fault: str | None = None
        if expected is not None and first != expected:
            fault = f"offsets {expected} to {first - 1} are missing" if first > expected else f"it begins at offset {first}, not {expected}"
        head = (first, of_records, of_reports)
        fault = fault or _segment_fault(head, encoding=encoding, crc=crc, blobs=blobs)
        if fault is not None:
            named = f"segment {segment} (offsets {first} to {first + of_records - 1}): {fault}"
            return Findings(n_segments=n_segments, n_records=n_records, n_reports=n_reports, fault=named)
        expected = first + of_records
        n_segments, n_records, n_reports = n_segments + 1, n_records + of_records, n_reports + of_reports
        if n_segments % 256 == 0:
            tell(f"{100 * n_segments // total} % of {total} segments")
    return Findings(n_segments=n_segments, n_records=n_records, n_reports=n_reports, fault=None)


def _segment_fault(head: tuple[int, int, int], *, encoding: int, crc: int, blobs: Sequence[bytes | None]) -> str | None:
    first, n_records, n_reports = head
    pairs, records, reports = blobs
    if pairs is None or records is None or reports is None:
        return "it has no contents"
    if checksum(pairs, records, reports) != crc:
        return "its bytes are not those that were written (CRC-32)"
    try:
        packed = decompress(records, is_compressed=bool(encoding & RECORDS_COMPRESSED))
        bodies = unpack_records(packed) if packed else []
        found = sum(1 for _ in unpack_reports(decompress(reports, is_compressed=bool(encoding & REPORTS_COMPRESSED))))
        offsets = [decode_journal_record(body).offset for body in bodies]
    except (DamagedSegmentError, RecordError) as error:
        return str(error)
    if len(bodies) != n_records or found != n_reports or len(pairs) != 4 * n_records:
        return f"it has {len(bodies)} records and {found} reports, but should have {n_records} and {n_reports}"
    wrong = next((offset for at, offset in enumerate(offsets, start=first) if offset != at), None)
    return None if wrong is None else f"a record in it says that its offset is {wrong}"
