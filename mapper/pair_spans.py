"""Spans of one pair of biobots on one axis, in order, each with the row it is of: which of them overlap. Pure."""

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from mapper.types import BoolArray, IntArray


@dataclass(slots=True)
class PairSpans:
    """Spans by begin, then row; columns side by side. ``longest`` is no shorter than any."""

    begins: "array[int]" = field(default_factory=lambda: array("q"))
    ends: "array[int]" = field(default_factory=lambda: array("q"))
    rows: "array[int]" = field(default_factory=lambda: array("q"))
    longest: int = 0

    def place(self, begin: int, row: int) -> int:
        """Return where a span is, or would be."""
        at = bisect_left(self.begins, begin)
        while at < len(self.begins) and self.begins[at] == begin and self.rows[at] < row:
            at += 1
        return at

    def insert(self, begin: int, end: int, row: int) -> None:
        """Add a span."""
        at = self.place(begin, row)
        self.begins.insert(at, begin)
        self.ends.insert(at, end)
        self.rows.insert(at, row)
        self.longest = max(self.longest, end - begin)

    def remove(self, begin: int, row: int) -> None:
        """Take out a span that is there."""
        at = self.place(begin, row)
        del self.begins[at], self.ends[at], self.rows[at]

    def overlapping(self, begin: int, end: int) -> list[int]:
        """Return the rows of the spans that have an instant in common with a span, both ends included."""
        first, last = bisect_left(self.begins, begin - self.longest), bisect_right(self.begins, end)
        if last - first == 1:
            return [self.rows[first]] if self.ends[first] >= begin else []
        return [row for row, until in zip(self.rows[first:last], self.ends[first:last], strict=True) if until >= begin]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pieces:
    """Spans sorted by pair, then begin, in pieces of those that overlap directly or over others; arrays of shape (m,).

    ``is_new_piece``: the first of its piece; ``number``: of its piece.
    """

    low: IntArray
    high: IntArray
    is_new_pair: BoolArray
    is_new_piece: BoolArray
    number: IntArray

    def spans(self, begins: IntArray, ends: IntArray, rows: IntArray) -> Iterator[tuple[tuple[int, int], PairSpans]]:
        """Yield the spans of each pair."""
        if not len(rows):
            return
        firsts = np.flatnonzero(self.is_new_pair)
        lasts = np.append(firsts[1:], len(rows))
        longest = np.maximum.reduceat(ends - begins, firsts)
        for first, last, span in zip(firsts.tolist(), lasts.tolist(), longest.tolist(), strict=True):
            own_begins, own_ends, own_rows = (array("q", column[first:last].tobytes()) for column in (begins, ends, rows))
            spans = PairSpans(begins=own_begins, ends=own_ends, rows=own_rows, longest=span)
            yield (int(self.low[first]), int(self.high[first])), spans


def find_pieces(low: IntArray, high: IntArray, *, begins: IntArray, ends: IntArray) -> Pieces:
    """Find the pieces of spans that are sorted by pair, then begin; all of shape (m,)."""
    is_new_pair = np.ones(len(low), dtype=np.bool_)
    is_new_pair[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    is_new_piece = is_new_pair.copy()
    is_new_piece[1:] |= begins[1:] > _running_maximum(ends, is_new_pair)[:-1]
    return Pieces(low=low, high=high, is_new_pair=is_new_pair, is_new_piece=is_new_piece, number=np.cumsum(is_new_piece))


def _running_maximum(values: IntArray, is_first: BoolArray) -> IntArray:
    """Return the maximum so far of each run; ``is_first`` says where runs begin."""
    # Runs lie above each other by more than any of them spans, so that one running maximum does for all.
    run = np.cumsum(is_first)
    ranked = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    highest = np.maximum.accumulate(ranked + run * len(values)) - run * len(values)
    reached: IntArray = np.sort(values)[highest]
    return reached
