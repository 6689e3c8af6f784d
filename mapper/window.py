"""The records that count: encounters in canonical order, and who stood still for how long."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.errors import UnknownBiobotError
from mapper.types import BoolArray, EncounterTable, IntArray, ModeSpell, read_only

# A centre in half nanoseconds must fit 63 bits.
_MAX_SPAN_NS = 2**62 - 1
_AHEAD_NS: Final = 60 * 10**9
"""Clocks of machines that are set by NTP differ by less than a second (RFC 5905, 1); what is dated a minute ahead is dated wrongly."""


def make_encounter_table(*, t_start_ns: ArrayLike, t_end_ns: ArrayLike, id1: ArrayLike, id2: ArrayLike) -> EncounterTable:
    """Put encounters in canonical order: by start, end, then ids; ``id1`` becomes the lower id.

    Parameters
    ----------
    t_start_ns, t_end_ns
        When each encounter began and ended [ns], shape (n,), of one clock; whole numbers of magnitude below 4e18.
    id1, id2
        Its biobots, shape (n,), in either order.

    Raises
    ------
    ValueError
        Shapes differ, an encounter ends before it begins, a biobot meets itself, or the whole record spans more than 2**62 ns (146 years).
    """
    start, end, first, second = (np.asarray(column, dtype=np.int64) for column in (t_start_ns, t_end_ns, id1, id2))
    if not (start.ndim == 1 and start.shape == end.shape == first.shape == second.shape):
        raise ValueError(f"columns have shapes {start.shape}, {end.shape}, {first.shape}, {second.shape}; wanted one length for all")
    if np.any(end < start) or np.any(first == second):
        raise ValueError("an encounter ends before it begins, or a biobot meets itself; check rows where they enter")
    if len(start) and int(end.max()) - int(start.min()) > _MAX_SPAN_NS:
        raise ValueError(f"encounters span {int(end.max()) - int(start.min())} ns; wanted at most {_MAX_SPAN_NS}; are two clocks mixed?")
    low, high = np.minimum(first, second), np.maximum(first, second)
    order = _canonical_order(start, end, low, high)
    if order is None:
        # The caller's arrays stay the caller's; the ids are new in any case.
        columns = start.copy(), end.copy(), low, high, np.arange(len(start), dtype=np.int64)
    else:
        columns = start[order], end[order], low[order], high[order], order
    start, end, low, high, source_row = map(read_only, columns)
    return EncounterTable(t_start_ns=start, t_end_ns=end, id1=low, id2=high, source_row=source_row)


def _canonical_order(start: IntArray, end: IntArray, low: IntArray, high: IntArray) -> IntArray | None:
    """Return the rows by start, end and ids, equal ones as they came, or None where they are in that order already.

    Few encounters begin in the same nanosecond: rows are sorted by start alone, and those that tie by the other columns.
    """
    order = None if np.all(start[:-1] <= start[1:]) else np.argsort(start, kind="stable")
    begun = start if order is None else start[order]
    is_next_equal = begun[:-1] == begun[1:]
    if not is_next_equal.any():
        return order
    tied = np.flatnonzero(np.append(is_next_equal, False) | np.insert(is_next_equal, 0, False))
    rows = tied if order is None else order[tied]
    repaired = rows[np.lexsort((high[rows], low[rows], end[rows], start[rows]))]
    if order is None:
        if np.array_equal(repaired, rows):
            return None
        order = np.arange(len(start), dtype=np.int64)
    order[tied] = repaired
    return order


def window_begin(table: EncounterTable, *, window_ns: int | None, since_ns: int | None) -> int | None:
    """Say from when encounters count: from ``since_ns`` on, and from ``window_ns`` before the end of the newest on; None: all do."""
    if window_ns is None or len(table) == 0:
        return since_ns
    begin = int(table.t_end_ns.max()) - window_ns
    return begin if since_ns is None else max(begin, since_ns)


def rows_dated_ahead(table: EncounterTable, *, now_ns: int) -> BoolArray:
    """Say of each encounter, shape (n,), whether it ended more than a minute after ``now_ns``, which is of the table's clock."""
    return table.t_end_ns > now_ns + _AHEAD_NS


def select_rows(table: EncounterTable, chosen: BoolArray) -> EncounterTable:
    """Leave out the encounters that are not chosen, shape (n,); the others stay in their order."""
    start, end, id1, id2, row = (
        read_only(column[chosen]) for column in (table.t_start_ns, table.t_end_ns, table.id1, table.id2, table.source_row)
    )
    return EncounterTable(t_start_ns=start, t_end_ns=end, id1=id1, id2=id2, source_row=row)


def drop_repeated(table: EncounterTable) -> tuple[EncounterTable, int]:
    """Leave out encounters that repeat another one, and say how many: of one pair two cannot begin and end at the same instants."""
    columns = (table.t_start_ns, table.t_end_ns, table.id1, table.id2)
    # In canonical order equal ones follow each other.
    repeats = np.logical_and.reduce([column[1:] == column[:-1] for column in columns])
    n = int(np.count_nonzero(repeats))
    return (select_rows(table, np.concatenate([[True], ~repeats])), n) if n else (table, 0)


def clip_table(table: EncounterTable, *, since_ns: int | None = None, until_ns: int | None = None) -> EncounterTable:
    """Leave out what was over at ``since_ns`` or had not begun at ``until_ns``, and cut what was under way then.

    Notes
    -----
    Order, ties too, is as in a table made of the clipped encounters. What lies between is not sorted again; without ``until_ns`` it is not
    even copied where nothing was under way at ``since_ns``.
    """
    columns: tuple[IntArray, ...] = (table.t_start_ns, table.t_end_ns, table.id1, table.id2, table.source_row)
    if until_ns is not None:
        n = int(np.searchsorted(table.t_start_ns, until_ns, side="left"))
        start, end, id1, id2, row = (column[:n] for column in columns)
        end = np.minimum(end, until_ns)
        order = np.lexsort((row, id2, id1, end, start))
        columns = (start[order], end[order], id1[order], id2[order], row[order])
    if since_ns is not None:
        n = int(np.searchsorted(columns[0], since_ns, side="right"))
        _, end, id1, id2, row = (column[:n][columns[1][:n] > since_ns] for column in columns)
        order = np.lexsort((row, id2, id1, end))
        begun = (np.full(len(end), since_ns), end[order], id1[order], id2[order], row[order])
        rest = tuple(column[n:] for column in columns)
        columns = tuple(np.concatenate([cut, whole]) for cut, whole in zip(begun, rest, strict=True)) if len(end) else rest
    start, end, id1, id2, row = (read_only(column) for column in columns)
    return EncounterTable(t_start_ns=start, t_end_ns=end, id1=id1, id2=id2, source_row=row)


def stationary_spells(table: EncounterTable, ids: Sequence[int]) -> tuple[ModeSpell, ...]:
    """Make one commanded static spell over the whole record for each biobot named, in ascending order of ids."""
    if len(table) == 0:
        return ()
    begin = int(table.t_start_ns[0])
    return tuple(
        ModeSpell(node=NodeId(node), t_start_ns=begin, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for node in sorted(set(ids))
    )


def absent_biobots(table: EncounterTable, ids: Sequence[int]) -> tuple[int, ...]:
    """List those of some biobots that are in no encounter, ascending.

    Raises
    ------
    UnknownBiobotError
        None of them is in any; with no ids nothing is raised.
    """
    wanted = np.unique(np.array(ids, dtype=np.int64))
    if len(wanted) == 0:
        return ()
    is_present = np.zeros(len(wanted), dtype=bool)
    for column in (table.id1, table.id2):
        place = np.minimum(np.searchsorted(wanted, column), len(wanted) - 1)
        is_present[place[wanted[place] == column]] = True
    absent = tuple(wanted[~is_present].tolist())
    if len(absent) == len(wanted):
        raise UnknownBiobotError(ids=absent)
    return absent
