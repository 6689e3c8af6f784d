"""The store's memory of encounters: columns of numbers by row, and what has changed in them since a moment.

Node ids are unsigned 64-bit numbers (an EUI-64 is), but columns and tables hold signed ones: ids from 2**63 on are kept as
negative numbers, by `to_signed`, and named properly again, by `to_unsigned`, where people see them.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, MissionRecord
from firmware_protocol.units import NodeId
from mapper.own_spans import make_own_spans
from mapper.types import BoolArray, IntArray

_MIN_INTEGER, _MAX_INTEGER = -(2**63), 2**63 - 1
_MAX_NODE = 2**64 - 1
# Year 2116: any two instants below differ by less than a table can span.
MAX_WALL_NS = 2**62
# As `gateway.encounters` has them: a clock known badly widens no margin beyond 0.1 s, and no beacon period exceeds 65.5 s.
_MAX_ERROR_MARGIN_NS = 100_000_000
_MAX_MARGIN_NS = 40_000_000_000
_FIRST_CAPACITY = 1024
_FEW = 32
"""Encounters that are counted one by one: arrays cost more there than they save (measured 2026-11)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncounterRows:
    """Encounters by row of the store, in any order.

    All arrays have shape (m,). ``t_start_ns <= t_end_ns`` on the wall clock [ns]; ``id1`` and ``id2`` signed, different, in either order.
    No ``row`` is there twice. An encounter that is void has a row too, which does not ``count``.
    """

    row: IntArray
    t_start_ns: IntArray
    t_end_ns: IntArray
    id1: IntArray
    id2: IntArray
    counts: BoolArray

    def __len__(self) -> int:
        return len(self.row)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncounterOrigins:
    """Where encounters come from, and what joins them to others; arrays of shape (m,), beside an `EncounterRows`.

    ``source`` is the number of a start of a gateway; ``margin_ns`` and ``error_ns`` as in CONTRACT.md §3, the latter at most the longest
    margin; ``is_final``: the encounter was not under way; ``own``, shape (8, m): see `mapper.own_spans`.
    """

    source: IntArray
    margin_ns: IntArray
    error_ns: IntArray
    is_final: BoolArray
    own: IntArray


def to_signed(node: int) -> NodeId:
    """Return the 64-bit two's complement number of an unsigned id."""
    return NodeId(node - 2**64 if node > _MAX_INTEGER else node)


def to_unsigned(node: int) -> NodeId:
    """Invert `to_signed`."""
    return NodeId(node + 2**64 if node < 0 else node)


def wall_interval(record: JournalRecord) -> tuple[int, int | None]:
    """Return begin and end of what is recorded on the wall clock [ns since 1970, UTC]."""
    end = record.t_start_ns if isinstance(record, MissionRecord) else record.t_end_ns
    return record.t_start_ns + record.wall_anchor_ns, None if end is None else end + record.wall_anchor_ns


def is_fit(record: JournalRecord) -> bool:
    """Say whether a record can be meant: it ends after it begins, between 1970 and 2116, and nobody meets itself.

    Each of its numbers fits a signed column of 64 bits, not only the sums on the wall clock: a store is read by columns.
    """
    begin, end = wall_interval(record)
    instants = (record.wall_anchor_ns, record.t_start_ns, 0 if isinstance(record, MissionRecord) else record.t_end_ns or 0)
    if min(instants) < _MIN_INTEGER or max(instants) > _MAX_INTEGER:
        return False
    if not 0 <= begin <= (begin if end is None else end) < MAX_WALL_NS:
        return False
    if isinstance(record, EncounterRecord) and record.node_a == record.node_b:
        return False
    return record.boot >= 0 and max(record.boot, record.sequence, record.revision) <= _MAX_INTEGER


def is_fit_for_columns(*, begin_ns: int, end_ns: int, node_a: int, node_b: int) -> bool:
    """Say whether an encounter's interval on the wall clock and its ids can stand in columns."""
    return 0 <= begin_ns <= end_ns < MAX_WALL_NS and 0 <= node_a <= _MAX_NODE and 0 <= node_b <= _MAX_NODE


def make_rows(rows: Sequence[int], records: Sequence[EncounterRecord]) -> EncounterRows:
    """Put records beside their rows."""
    begins, ends = [], []
    for record in records:
        begins.append(record.t_start_ns + record.wall_anchor_ns)
        ends.append(record.t_end_ns + record.wall_anchor_ns)
    return EncounterRows(
        row=np.array(rows, dtype=np.int64),
        t_start_ns=np.array(begins, dtype=np.int64),
        t_end_ns=np.array(ends, dtype=np.int64),
        id1=np.array([record.node_a for record in records], dtype=np.uint64).view(np.int64),
        id2=np.array([record.node_b for record in records], dtype=np.uint64).view(np.int64),
        counts=np.array([not record.is_void for record in records], dtype=np.bool_),
    )


def limit_margins(*, margin_ns: Sequence[int], error_ns: Sequence[int]) -> IntArray:
    """Return how far records cover the time around their intervals [ns], shape (m,); where a gateway does not tell (0), their error."""
    # Numbers of any size may come in a record; as floats they are in order, and within the limits exact.
    told, errors = (np.array(values, dtype=np.float64) for values in (margin_ns, error_ns))
    limited: IntArray = np.clip(np.maximum(told, np.minimum(errors, _MAX_ERROR_MARGIN_NS)), 0, _MAX_MARGIN_NS).astype(np.int64)
    return limited


def limit_errors(error_ns: Sequence[int]) -> IntArray:
    """Return how wrong the ends of records may be [ns], shape (m,), of numbers of any size."""
    limited: IntArray = np.clip(np.array(error_ns, dtype=np.float64), 0, _MAX_MARGIN_NS).astype(np.int64)
    return limited


def make_origins(records: Sequence[EncounterRecord], *, number_source: Callable[[str, int], int]) -> EncounterOrigins:
    """Say where records come from; ``number_source`` gives the number of a gateway's start by name and anchor."""
    return EncounterOrigins(
        source=np.array([number_source(record.gateway, record.wall_anchor_ns) for record in records], dtype=np.int64),
        margin_ns=limit_margins(margin_ns=[record.margin_ns for record in records], error_ns=[record.error_ns for record in records]),
        error_ns=limit_errors([record.error_ns for record in records]),
        is_final=np.array([not record.is_ongoing for record in records], dtype=np.bool_),
        own=make_own_spans(records),
    )


class EncounterColumns:
    """Encounters by row number; a row that holds none, or a void one, does not count. Rows are numbered from 1, almost without gaps."""

    def __init__(self) -> None:
        # Rows: begin, end [ns, wall clock], the two ids (signed), whether it counts, and the number of its last change (0: no encounter).
        self._columns: IntArray = np.zeros((6, _FIRST_CAPACITY), dtype=np.int64)
        self._n_rows = 0
        self._n_of: Counter[int] = Counter()
        self.n_counting = 0

    def put(self, rows: EncounterRows, *, changes: IntArray) -> None:
        """Set rows; ``changes``, shape (m,), positive, says by which change each was set."""
        if not len(rows):
            return
        self._reserve(int(rows.row.max()) + 1)
        before = self._columns[:, rows.row]
        self._count(before[2], before[3], before[4].astype(np.bool_), sign=-1)
        self._count(rows.id1, rows.id2, rows.counts, sign=1)
        self._columns[:, rows.row] = np.array((rows.t_start_ns, rows.t_end_ns, rows.id1, rows.id2, rows.counts, changes))

    def changed_after(self, change: int) -> EncounterRows:
        """Return the encounters that were set after a change, void ones too; after 0, all of them."""
        _, _, _, _, counts, changes = self._columns[:, : self._n_rows]
        row = np.flatnonzero(changes > change)
        begin, end, id1, id2 = (column[row] for column in self._columns[:4])
        return EncounterRows(row=row, t_start_ns=begin, t_end_ns=end, id1=id1, id2=id2, counts=counts[row].astype(np.bool_))

    def page(self, *, first: int, limit: int) -> tuple[EncounterRows, int | None]:
        """Return the encounters that count among so many rows from ``first`` on, and the row to go on with; None: that is all."""
        last = min(first + limit, self._n_rows)
        begin, end, id1, id2, counts, changes = self._columns[:, first:last]
        row = np.flatnonzero((counts > 0) & (changes > 0))
        page = EncounterRows(
            row=row + first,
            t_start_ns=begin[row],
            t_end_ns=end[row],
            id1=id1[row],
            id2=id2[row],
            counts=np.ones(len(row), dtype=np.bool_),
        )
        return page, last if last < self._n_rows else None

    def differs(self, rows: EncounterRows) -> BoolArray:
        """Say of each row, shape (m,), whether it is another one here, or not here."""
        self._reserve(int(rows.row.max(initial=-1)) + 1)
        begin, end, id1, id2, counts, changes = self._columns[:, rows.row]
        is_same = (begin == rows.t_start_ns) & (end == rows.t_end_ns) & (id1 == rows.id1) & (id2 == rows.id2) & (counts == rows.counts)
        differs: BoolArray = ~(is_same & (changes > 0))
        return differs

    def interval(self, row: int) -> tuple[int, int] | None:
        """Return begin and end [ns] of a row; None where there is no encounter."""
        if row >= self._n_rows or not self._columns[5, row]:
            return None
        return int(self._columns[0, row]), int(self._columns[1, row])

    def count_by_node(self) -> Mapping[NodeId, int]:
        """Count the encounters of each biobot that has any."""
        return {to_unsigned(node): number for node, number in self._n_of.items() if number}

    def _reserve(self, n_rows: int) -> None:
        capacity = self._columns.shape[1]
        if n_rows > capacity:
            grown = np.zeros((6, max(2 * capacity, n_rows)), dtype=np.int64)
            grown[:, : self._n_rows] = self._columns[:, : self._n_rows]
            self._columns = grown
        self._n_rows = max(self._n_rows, n_rows)

    def _count(self, id1: IntArray, id2: IntArray, counts: BoolArray, *, sign: int) -> None:
        n_counting = int(np.count_nonzero(counts))
        self.n_counting += sign * n_counting
        if 0 < n_counting <= _FEW:
            for node in (*id1[counts].tolist(), *id2[counts].tolist()):
                self._n_of[node] += sign
        elif n_counting:
            nodes, numbers = np.unique(np.concatenate([id1[counts], id2[counts]]), return_counts=True)
            self._n_of.update(dict(zip(nodes.tolist(), (sign * numbers).tolist(), strict=True)))
