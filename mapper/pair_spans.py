"""Spans of one pair of biobots on one axis, in order, each with the row it is of: which of them overlap. Pure.

One object for a pair, because of pairs there are as many as of encounters where a swarm is large.
"""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mapper.types import BoolArray, IntArray

PairSpans: TypeAlias = "array[int]"
"""By begin, then row: begin, end and row of each, one after the other, behind a length no shorter than any."""


def no_spans() -> PairSpans:
    """Return those of a pair that has none."""
    return array("q", (0,))


def insert(spans: PairSpans, begin: int, end: int, row: int) -> None:
    """Add a span."""
    at = 3 * _place(spans, begin, row) + 1
    spans[at:at] = array("q", (begin, end, row))
    spans[0] = max(spans[0], end - begin)


def remove(spans: PairSpans, begin: int, row: int) -> None:
    """Take out a span that is there."""
    at = 3 * _place(spans, begin, row) + 1
    del spans[at : at + 3]


def overlapping(spans: PairSpans, begin: int, end: int) -> list[int]:
    """Return the rows of the spans that have an instant in common with a span, both ends included."""
    at = 3 * _place(spans, begin - spans[0], -1) + 1
    rows = []
    while at < len(spans) and spans[at] <= end:
        if spans[at + 1] >= begin:
            rows.append(spans[at + 2])
        at += 3
    return rows


def _place(spans: PairSpans, begin: int, row: int) -> int:
    """Return where a span is, or would be."""
    low, high = 0, len(spans) // 3
    while low < high:
        middle = (low + high) // 2
        if (spans[3 * middle + 1], spans[3 * middle + 3]) < (begin, row):
            low = middle + 1
        else:
            high = middle
    return low


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
        told = np.stack((begins, ends, rows), axis=1)
        for first, last, span in zip(firsts.tolist(), lasts.tolist(), longest.tolist(), strict=True):
            spans = array("q", (span,))
            spans.frombytes(told[first:last].tobytes())
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
