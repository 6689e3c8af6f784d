"""What of a journal becomes a row, and its columns. Reads a journal in bounded memory, while a gateway writes it or not."""

import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Self

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, MissionRecord, ModeRecord, decode_journal_record
from gateway.journal_file import LeftOut, newest_offset, walk_records, walk_reports

Value = int | bool | str | None


class Kind(Enum):
    """What is exported."""

    ENCOUNTERS = "encounters"
    MODES = "modes"
    MISSION = "mission"
    REPORTS = "reports"


COLUMNS: dict[Kind, dict[str, type]] = {
    Kind.ENCOUNTERS: {
        "gateway": str, "journal": str, "offset": int, "boot": int, "sequence": int, "revision": int, "node_a": int, "node_b": int,
        "start_wall_ns": int, "end_wall_ns": int, "error_ns": int, "is_reciprocal": bool, "is_ongoing": bool, "is_void": bool,
        "rssi_a_dbm": int, "rssi_b_dbm": int, "path_a_mm": int, "path_b_mm": int,
    },
    Kind.MODES: {
        "gateway": str, "journal": str, "offset": int, "boot": int, "sequence": int, "revision": int, "node": int, "mode": str,
        "cause": str, "start_wall_ns": int, "end_wall_ns": int, "error_ns": int, "is_halted": bool,
    },
    Kind.MISSION: {
        "gateway": str, "journal": str, "offset": int, "boot": int, "sequence": int, "revision": int, "phase": str,
        "start_wall_ns": int, "landmarks": str, "reason": str,
    },
    Kind.REPORTS: {
        "node": int, "boot": int, "number": int, "received_wall_ns": int, "radio": str, "address": int, "rssi_dbm": int, "lqi": int,
        "payload": str,
    },
}  # fmt: skip
"""Column names and types; wall_ns: UTC [ns since 1970]; empty: not known. A void encounter is a part of another one."""

_TYPES: dict[Kind, type[JournalRecord]] = {Kind.ENCOUNTERS: EncounterRecord, Kind.MODES: ModeRecord, Kind.MISSION: MissionRecord}
_TELL_EVERY = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Which rows: of one kind, that overlap a time (UTC [ns]; None: open).

    Of each record the newest revision, encounters that are void left out; or all revisions.
    """

    kind: Kind
    from_wall_ns: int | None = None
    until_wall_ns: int | None = None
    has_all_revisions: bool = False

    def overlaps(self, start_ns: int, end_ns: int | None) -> bool:
        """Whether a span counts; one without an end goes on."""
        is_over = self.from_wall_ns is not None and end_ns is not None and end_ns < self.from_wall_ns
        return not is_over and (self.until_wall_ns is None or start_ns < self.until_wall_ns)


def read_rows(
    path: Path, selection: Selection, *, tell: Callable[[str], None], left_out: LeftOut | None = None
) -> Iterator[tuple[Value, ...]]:
    """Yield the rows, in the order of offsets or, of reports, of their coming; ``left_out`` hears of what is damaged, maybe twice.

    Raises
    ------
    sqlite3.Error
        The journal cannot be read, or a part of it is damaged and there is no ``left_out``.
    """
    if selection.kind is Kind.REPORTS:
        yield from _report_rows(path, selection, left_out)
        return
    until = newest_offset(path)

    def records(tell: Callable[[str], None]) -> Iterator[JournalRecord]:
        told_at = 0
        for segment in walk_records(path, until=until, left_out=left_out):
            for _, body in segment:
                record = decode_journal_record(body)
                if isinstance(record, _TYPES[selection.kind]):
                    yield record
            if segment and segment[-1][0] - told_at >= _TELL_EVERY:
                told_at = segment[-1][0]
                tell(f"{100 * told_at // until} % of {until} records")

    with _Newest() as newest:
        if not selection.has_all_revisions:
            for record in records(lambda done: tell(f"looking for revisions: {done}")):
                newest.note(record)
        for record in records(tell):
            is_wanted = selection.has_all_revisions or (newest.is_newest(record) and not _is_void(record))
            if is_wanted and selection.overlaps(*_span(record)):
                yield _row(record)


def _report_rows(path: Path, selection: Selection, left_out: LeftOut | None) -> Iterator[tuple[Value, ...]]:
    for report in walk_reports(path, left_out=left_out):
        if selection.overlaps(report.received_wall_ns, report.received_wall_ns):
            head = (report.node, report.boot, report.number, report.received_wall_ns, report.radio, report.address)
            yield (*head, report.rssi_dbm, report.lqi, report.payload.hex())


class _Newest:
    """The newest revision of each record, kept in a temporary database that spills to disk: a journal has hundreds of millions."""

    def __init__(self) -> None:
        self._connection = sqlite3.connect("", isolation_level=None)  # "": a file of its own, gone when it is closed
        self._connection.execute(
            "CREATE TABLE newest (boot INTEGER, sequence INTEGER, offset INTEGER, PRIMARY KEY (boot, sequence)) WITHOUT ROWID"
        )
        self._connection.execute("BEGIN")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def note(self, record: JournalRecord) -> None:
        # Offsets grow with revisions: a correction is written after what it corrects.
        self._connection.execute("INSERT OR REPLACE INTO newest VALUES (?, ?, ?)", (record.boot, record.sequence, record.offset))

    def is_newest(self, record: JournalRecord) -> bool:
        row = self._connection.execute(
            "SELECT offset FROM newest WHERE boot = ? AND sequence = ?", (record.boot, record.sequence)
        ).fetchone()
        return row is not None and row[0] == record.offset


def _is_void(record: JournalRecord) -> bool:
    return isinstance(record, EncounterRecord) and record.is_void


def _span(record: JournalRecord) -> tuple[int, int | None]:
    anchor_ns = record.wall_anchor_ns
    if isinstance(record, MissionRecord):
        return record.t_start_ns + anchor_ns, record.t_start_ns + anchor_ns
    return record.t_start_ns + anchor_ns, None if record.t_end_ns is None else record.t_end_ns + anchor_ns


def _row(record: JournalRecord) -> tuple[Value, ...]:
    head = (record.gateway, record.journal, record.offset, record.boot, record.sequence, record.revision)
    start_ns, end_ns = _span(record)
    match record:
        case EncounterRecord():
            sides = {side.node: side for side in record.sides}
            both = [sides.get(node) for node in (record.node_a, record.node_b)]
            flags = (record.error_ns, record.is_reciprocal, record.is_ongoing, record.is_void)
            strengths = tuple(None if side is None or side.rssi_dbm == 127 else side.rssi_dbm for side in both)  # CONTRACT.md §3
            paths = tuple(None if side is None else side.path_mm for side in both)
            return (*head, record.node_a, record.node_b, start_ns, end_ns, *flags, *strengths, *paths)
        case ModeRecord():
            return (*head, record.node, record.mode.value, record.cause.value, start_ns, end_ns, record.error_ns, record.is_halted)
        case MissionRecord():
            return (*head, record.phase.value, start_ns, " ".join(map(str, record.landmarks)), record.reason)
