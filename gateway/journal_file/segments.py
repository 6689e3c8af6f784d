"""A segment: what is committed together, gathered write by write and sealed for the disk. Pure.

All that can be wrong with a write is found when it is added: a segment that was gathered can be stored.
"""

# ruff: noqa: PLR1730  # calls of min and max for each record cost as much as encoding a third of it

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import msgspec
from msgspec.structs import force_setattr

from firmware_protocol.contract.records import (
    EncounterRecord,
    JournalRecord,
    MissionRecord,
    encode_journal_record,
)
from gateway.journal_file.audit_chain import ChainHead, link, row_of, storable_node
from gateway.journal_file.blobs import (
    NO_PAIR,
    RECORDS_COMPRESSED,
    REPORTS_COMPRESSED,
    checksum,
    compress,
    join_records,
    pack_pairs,
    pack_records,
    pack_report,
    pair_key,
)
from gateway.journal_file.writes import AuditEntry, JournalWrite, UplinkReport

MODE, MISSION = 1, 2
"""Kinds of states: records that are few, and wanted by themselves at a restart."""

_MIN_INTEGER, _MAX_INTEGER = -(1 << 63), (1 << 63) - 1  # SQLite's
_MAX_AHEAD = 62
"""Numbers above a window's lowest that are remembered in one integer; WIRE_FORMAT.md §5.1 allows 32."""

Window = tuple[int, int, int]
"""Lowest number that is not done, those done above it (bit i: that many more), and when it was last heard [ns, UTC]."""

Row = tuple[int | bytes | str | None, ...]


@dataclass(slots=True, kw_only=True)
class SegmentBuilder:
    """Gathers writes. ``windows`` is shared by all segments of a journal: it is what the disk will know of backpacks' messages."""

    first_offset: int
    windows: "Windows"
    records: list[JournalRecord] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    n_writes: int = 0
    size: int = 0
    """Octets of records and reports."""
    _pairs: list[int] = field(default_factory=list)
    _min_start: int = _MAX_INTEGER
    _max_end: int = _MIN_INTEGER
    _reports: list[bytes] = field(default_factory=list)
    _windows: dict[tuple[int, int], Window] = field(default_factory=dict)
    _nodes: dict[int, bytes] = field(default_factory=dict)
    _states: list[tuple[int, int, bytes]] = field(default_factory=list)
    _audits: list[AuditEntry] = field(default_factory=list)

    @property
    def next_offset(self) -> int:
        """The offset that the next record gets."""
        return self.first_offset + len(self.bodies)

    def counts(self) -> dict[str, int]:
        """Return how much of each kind it has."""
        return {"records": len(self.bodies), "messages": len(self._reports), "audit_rows": len(self._audits)}

    def add(self, write: JournalWrite) -> None:
        """Take a write, and give its records their offsets.

        Raises
        ------
        OverflowError, TypeError, ValueError
            It can never be stored; the segment is as it was.
        """
        report, audit = write.report, write.audit
        packed = None if report is None else pack_report(report)
        if audit is not None:
            _check_range(audit.wall_ns, audit.train_ms, audit.wire_command or 0, audit.mono_ns or 0, storable_node(audit) or 0)
            f"{audit.kind}{audit.operator}{audit.command_id}{audit.stage}".encode()
        if write.node is not None:
            _check_range(write.node[0])
        if write.records:
            self._add_records(write.records)
        if report is not None and packed is not None:
            self._reports.append(packed)
            self.size += len(packed)
            self._windows[report.node, report.boot] = self.windows.note(report)
        if write.node is not None:
            self._nodes[write.node[0]] = write.node[1]
        if audit is not None:
            self._audits.append(audit)
        self.n_writes += 1

    def _add_records(self, records: tuple[JournalRecord, ...]) -> None:
        bodies, pairs, states = [], [], []
        low, high, size = self._min_start, self._max_end, 0
        offset = self.next_offset
        for record in records:
            # The writer handed it over and it was told to nobody: it is made whole here, not changed.
            force_setattr(record, "offset", offset)
            body = encode_journal_record(record)
            if isinstance(record, EncounterRecord):
                start_ns, end_ns = record.t_start_ns + record.wall_anchor_ns, record.t_end_ns + record.wall_anchor_ns
                if start_ns < low:
                    low = start_ns
                if end_ns > high:
                    high = end_ns
                pairs.append(pair_key(record.node_a, record.node_b))
            else:
                states.append((offset, MISSION if isinstance(record, MissionRecord) else MODE, body))
                pairs.append(NO_PAIR)
            bodies.append(body)
            size += len(body)
            offset += 1
        _check_range(low, high)
        self._min_start, self._max_end = low, high
        self.records += records
        self.bodies += bodies
        self._pairs += pairs
        self._states += states
        self.size += size

    def seal(self, *, segment: int, now_wall_ns: int, ran_ns: int, boot: int, audit_head: ChainHead) -> "SealedSegment":
        """Return it ready for the disk, as segment number ``segment``; its audit rows follow on ``audit_head``."""
        first_head = audit_head
        blobs: list[bytes] = []
        at = 1  # SQLite's substr counts from 1

        def place(blob: bytes) -> tuple[int, int]:
            nonlocal at
            blobs.append(blob)
            at += len(blob)
            return at - len(blob), len(blob)

        states = [(offset, kind, *place(body)) for offset, kind, body in self._states]
        nodes = [(node, *place(body)) for node, body in self._nodes.items()]
        audits = []
        for number, entry in enumerate(self._audits, start=audit_head.n_rows + 1):
            row = row_of(entry, number=number, ran_ns=ran_ns, boot=boot)
            audit_head = ChainHead(n_rows=number, chain=link(audit_head.chain, row))
            texts = [text.encode() for text in (entry.kind, entry.operator, entry.command_id, entry.stage)]
            placed = map(place, (*texts, entry.request, entry.body, audit_head.chain))
            cells = (number, entry.wall_ns, ran_ns, boot, entry.mono_ns, storable_node(entry), entry.wire_command, entry.train_ms)
            audits.append((*cells, *itertools.chain.from_iterable(placed)))
        contents = _store(pack_records(self.bodies) if self.bodies else b"", pack_pairs(self._pairs), b"".join(self._reports))
        has_encounters = self._max_end >= self._min_start
        return SealedSegment(
            segment=segment,
            first_offset=self.first_offset,
            n_records=len(self.bodies),
            n_reports=len(self._reports),
            wall_ns=now_wall_ns,
            ran_ns=ran_ns,
            min_start=self._min_start if has_encounters else None,
            max_end=self._max_end if has_encounters else None,
            contents=contents,
            windows=[(node, boot, *window) for (node, boot), window in self._windows.items()],
            states=states,
            nodes=nodes,
            audits=audits,
            audit_head=None if audit_head is first_head else audit_head,
            blobs=b"".join(blobs),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """A segment's bytes as they are stored."""

    pairs: bytes
    records: bytes
    reports: bytes
    encoding: int
    crc: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SealedSegment:
    """A segment, ready for the disk, and what is said in tables of its own; places in ``blobs`` are (first, length), from 1."""

    segment: int
    first_offset: int
    n_records: int
    n_reports: int
    wall_ns: int
    ran_ns: int
    min_start: int | None
    max_end: int | None
    contents: Contents
    windows: Sequence[tuple[int, ...]]
    states: Sequence[tuple[int, ...]]
    nodes: Sequence[tuple[int, ...]]
    audits: Sequence[tuple[int | None, ...]]
    audit_head: ChainHead | None
    """After its audit rows; None: it has none."""
    blobs: bytes

    def row(self) -> Row:
        """Return the values of one row of the view ``commits``."""
        contents = self.contents
        return (
            self.segment,
            self.first_offset,
            self.n_records,
            self.n_reports,
            self.wall_ns,
            self.ran_ns,
            self.min_start,
            self.max_end,
            contents.encoding,
            contents.crc,
            contents.pairs,
            contents.records,
            contents.reports,
            *(msgspec.json.encode(rows).decode() for rows in (self.windows, self.states, self.nodes, self.audits)),
            None if self.audit_head is None else self.audit_head.text(),
            self.blobs,
        )


def join_contents(parts: Sequence[tuple[bytes, bytes, bytes]]) -> Contents:
    """Return the contents of neighbours as those of one segment; each part is pairs, records and reports, not compressed.

    Raises
    ------
    DamagedSegmentError
        The records of one cannot be told apart.
    """
    records = [records for _, records, _ in parts if records]
    return _store(
        join_records(records) if records else b"", b"".join(pairs for pairs, _, _ in parts), b"".join(reports for _, _, reports in parts)
    )


def _store(packed_records: bytes, packed_pairs: bytes, reports: bytes) -> Contents:
    stored_records, is_compressed = compress(packed_records)
    stored_reports, are_compressed = compress(reports)
    encoding = (RECORDS_COMPRESSED if is_compressed else 0) | (REPORTS_COMPRESSED if are_compressed else 0)
    crc = checksum(packed_pairs, stored_records, stored_reports)
    return Contents(pairs=packed_pairs, records=stored_records, reports=stored_reports, encoding=encoding, crc=crc)


class Windows:
    """Which numbers of each life of each backpack are done, as the disk will know it; the newest lives of each."""

    MAX_LIVES = 16
    """More than are ever asked for: messages of four lives are taken."""

    def __init__(self, known: Iterable[tuple[int, int, int, int, int]] = ()) -> None:
        self._lives: dict[int, dict[int, Window]] = {}
        for node, boot, next_number, above, wall_ns in known:
            self._lives.setdefault(node, {})[boot] = (next_number, above, wall_ns)

    def note(self, report: UplinkReport) -> Window:
        """Take note of a report; return its life's window."""
        lives = self._lives.get(report.node)
        if lives is None:
            lives = self._lives[report.node] = {}
        next_number = report.next_number
        known = lives.get(report.boot)
        above = 0
        if known is not None:
            above = known[1] >> max(0, next_number - known[0])
        ahead = report.number - next_number
        if 0 <= ahead < _MAX_AHEAD:
            above |= 1 << ahead
        window = lives[report.boot] = (next_number, above, report.received_wall_ns)
        if known is None and len(lives) > self.MAX_LIVES:
            del lives[min(lives, key=lambda boot: lives[boot][2])]
        return window


def _check_range(*values: int) -> None:
    for value in values:
        if not _MIN_INTEGER <= value <= _MAX_INTEGER:
            raise OverflowError(f"{value} has more than the 64 bits of a number in the journal")
