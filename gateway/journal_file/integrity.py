"""Is a journal whole? SQLite's own check, sums, lengths, offsets without gaps, and that each record can be read."""

import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import decode_journal_record
from firmware_protocol.errors import RecordError
from gateway.journal_file.audit_verify import verify_audit
from gateway.journal_file.blobs import (
    RECORDS_COMPRESSED,
    REPORTS_COMPRESSED,
    DamagedSegmentError,
    checksum,
    decompress,
    unpack_records,
    unpack_reports,
)

MAX_FAULTS = 20
"""Faults that are told; the others are counted."""

_MAX_PAGE_FAULTS = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What is whole, the first `MAX_FAULTS` faults, and how many there are."""

    n_segments: int
    n_records: int
    n_reports: int
    faults: tuple[str, ...]
    n_faults: int

    @property
    def fault(self) -> str | None:
        """The first fault; None: there is none."""
        return self.faults[0] if self.faults else None


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
        verdicts = [verdict for (verdict,) in connection.execute(f"PRAGMA integrity_check({_MAX_PAGE_FAULTS})") if verdict != "ok"]
        counts = _Counts()
        for verdict in verdicts:
            counts.add_fault(f"the database is damaged: {' '.join(verdict.split())}")
        try:
            _check_segments(connection, counts, tell=tell)
            fault = verify_audit(connection, tell=tell).fault
            if fault is not None:
                counts.add_fault(f"audit log: {fault}")
        except sqlite3.DatabaseError as error:
            if not verdicts:
                raise
            counts.add_fault(f"what comes after {counts.n_segments} segments cannot be read: {error}")
        return counts.findings()
    finally:
        connection.close()


class _Counts:
    """What a check has found so far."""

    def __init__(self) -> None:
        self.n_segments = self.n_records = self.n_reports = 0
        self._faults: list[str] = []
        self._n_faults = 0

    def add_fault(self, fault: str) -> None:
        self._n_faults += 1
        if self._n_faults <= MAX_FAULTS:
            self._faults.append(fault)

    def findings(self) -> Findings:
        sums = {"n_segments": self.n_segments, "n_records": self.n_records, "n_reports": self.n_reports}
        return Findings(**sums, faults=tuple(self._faults), n_faults=self._n_faults)


def _check_segments(connection: sqlite3.Connection, counts: _Counts, *, tell: Callable[[str], None]) -> None:
    (total,) = connection.execute("SELECT count(*) FROM segments").fetchone()
    rows = connection.execute(
        "SELECT s.first_offset, s.segment, s.n_records, s.n_reports, s.encoding, s.crc, c.pairs, c.records, c.reports "
        "FROM segments s LEFT JOIN contents c ON c.segment = s.segment ORDER BY s.first_offset, s.segment"
    )
    expected: int | None = None
    for n_done, (first, segment, n_records, n_reports, encoding, crc, *blobs) in enumerate(rows, start=1):
        if expected is not None and first > expected:
            counts.add_fault(f"offsets {expected} to {first - 1} are missing")
        elif expected is not None and first < expected:
            counts.add_fault(f"{segment_name(segment, first, n_records)}: it begins at offset {first}, not {expected}")
        expected = max(expected or 0, first + n_records)
        fault = segment_fault((first, n_records, n_reports), encoding=encoding, crc=crc, blobs=blobs)
        if fault is not None:
            counts.add_fault(f"{segment_name(segment, first, n_records)}: {fault}")
        else:
            counts.n_segments, counts.n_records, counts.n_reports = (
                counts.n_segments + 1,
                counts.n_records + n_records,
                counts.n_reports + n_reports,
            )
        if n_done % 256 == 0:
            tell(f"{100 * n_done // total} % of {total} segments")


def segment_name(segment: int, first: int, n_records: int) -> str:
    """Return what a segment is called in faults."""
    return f"segment {segment} ({f'offsets {first} to {first + n_records - 1}' if n_records else 'messages alone'})"


def segment_fault(head: tuple[int, int, int], *, encoding: int, crc: int, blobs: Sequence[bytes | None]) -> str | None:
    """Return why a segment is damaged, or None; ``head`` is its first offset and its numbers of records and reports."""
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
