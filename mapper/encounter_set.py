"""The encounters that count, kept in canonical order while rows come, change and go.

What costs time in proportion to everything is moving memory; sorting is for what is new, and for what it ties with.
"""

import numpy as np

from mapper.record_columns import EncounterRows
from mapper.types import EncounterTable, IntArray, read_only

_FIRST_CAPACITY = 1024


class EncounterSet:
    """Encounters by row of the store, in the order of an `EncounterTable`; of those that tie in all, the lower row is first.

    The law: whatever was taken in, in whatever pieces and order, the table is the one that `make_encounter_table` makes of all rows.
    """

    def __init__(self) -> None:
        # Rows: start, end [ns], lower id, higher id, row of the store. Places from _n on are spare.
        self._columns: IntArray = np.zeros((5, _FIRST_CAPACITY), dtype=np.int64)
        self._n = 0
        self._highest_row = -1

    def __len__(self) -> int:
        return self._n

    def take(self, rows: EncounterRows) -> None:
        """Take in rows that are new or have changed; one that does not count goes."""
        if not len(rows):
            return
        self._drop(rows.row)
        self._highest_row = max(self._highest_row, int(rows.row.max()))
        fresh = np.stack([rows.t_start_ns, rows.t_end_ns, np.minimum(rows.id1, rows.id2), np.maximum(rows.id1, rows.id2), rows.row])[
            :, rows.counts
        ]
        if fresh.shape[1]:
            self._merge(fresh[:, _order_with_rows(fresh)])

    def table(self) -> EncounterTable:
        """Return the encounters without copying them: the table is good until the next `take`. ``source_row`` is the row of the store."""
        start, end, id1, id2, row = self._columns[:, : self._n]
        return EncounterTable(
            t_start_ns=read_only(start), t_end_ns=read_only(end), id1=read_only(id1), id2=read_only(id2), source_row=read_only(row)
        )

    def _drop(self, rows: IntArray) -> None:
        known = rows[rows <= self._highest_row]
        if not len(known):
            return
        goes = np.zeros(self._highest_row + 1, dtype=np.bool_)
        goes[known] = True
        stays = ~goes[self._columns[4, : self._n]]
        if stays.all():
            return
        first = int(np.argmin(stays))
        kept = self._columns[:, first : self._n][:, stays[first:]]
        self._n = first + kept.shape[1]
        self._columns[:, first : self._n] = kept

    def _merge(self, fresh: IntArray) -> None:
        """Put sorted encounters behind those that start no later, then sort those that start together."""
        n_before, n = self._n, self._n + fresh.shape[1]
        self._reserve(n)
        places = np.searchsorted(self._columns[0, :n_before], fresh[0], side="right")
        first = int(places[0])
        is_fresh = np.zeros(n - first, dtype=np.bool_)
        is_fresh[places - first + np.arange(fresh.shape[1])] = True
        tail = self._columns[:, first:n_before].copy()
        for column, old, new in zip(self._columns[:, first:n], tail, fresh, strict=True):
            column[~is_fresh] = old
            column[is_fresh] = new
        self._n = n
        self._settle_ties(int(np.searchsorted(self._columns[0, :n], fresh[0, 0], side="left")))

    def _settle_ties(self, first: int) -> None:
        start = self._columns[0, first : self._n]
        is_tied = start[1:] == start[:-1]
        if not is_tied.any():
            return
        in_tie = np.zeros(len(start), dtype=np.bool_)
        in_tie[1:] |= is_tied
        in_tie[:-1] |= is_tied
        # Sorted by start first, the encounters of one tie come back to the places of that tie.
        places = first + np.flatnonzero(in_tie)
        tied = self._columns[:, places]
        self._columns[:, places] = tied[:, _order_with_rows(tied)]

    def _reserve(self, n: int) -> None:
        capacity = self._columns.shape[1]
        if n > capacity:
            grown = np.zeros((5, max(capacity + capacity // 2, n)), dtype=np.int64)
            grown[:, : self._n] = self._columns[:, : self._n]
            self._columns = grown


def _order_with_rows(columns: IntArray) -> IntArray:
    """Return the order by start, end, ids and row of the store, of columns in any order."""
    start, end, low, high, row = columns
    return np.lexsort((row, high, low, end, start)).astype(np.int64, copy=False)
