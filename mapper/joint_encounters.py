"""Records of several gateways that tell of one encounter become one, for map and counts. Pure.

The rule is the gateway's own (`gateway.encounters`): each record covers its interval and a margin at both ends, and records of a pair
whose covers overlap, directly or over others, tell of one encounter. It needs records of two gateways at least: what one gateway has
kept apart stays apart. The answer depends only on the records and the shifts of their clocks, never on the order.

Each record bounds the true begin: by its error on either side of its own. Where beacons are sensed, one side's record is widened by what
was not heard; the union of two such records would be widened twice. So the earliest begin and those whose bounds it can agree with are
taken together: the middle of what all of them allow, which is what one gateway with both sides would say. The end likewise.
"""

import itertools
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapper.record_columns import EncounterRows
from mapper.types import BoolArray, IntArray

_FIRST_CAPACITY = 1024
_BEGIN, _END, _LOW, _HIGH, _COUNTS, _MARGIN, _GATEWAY, _ERROR = range(8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToldRows:
    """Records on the site's clock and what joins them: margin and error [ns] and number of the gateway, each of shape (m,)."""

    rows: EncounterRows
    margin_ns: IntArray
    error_ns: IntArray
    gateway: IntArray


_Covers: TypeAlias = "array[int]"
"""Covers of one pair by begin, then row: begin, end and row of each, one after the other, behind a length no shorter than any. It is one
object for a pair, because of pairs there are as many as of encounters where a swarm is large."""


def _place(covers: _Covers, begin: int, row: int) -> int:
    """Return where a cover is, or would be."""
    low, high = 0, len(covers) // 3
    while low < high:
        middle = (low + high) // 2
        if (covers[3 * middle + 1], covers[3 * middle + 3]) < (begin, row):
            low = middle + 1
        else:
            high = middle
    return low


def _insert(covers: _Covers, begin: int, end: int, row: int) -> None:
    at = 3 * _place(covers, begin, row) + 1
    covers[at:at] = array("q", (begin, end, row))
    covers[0] = max(covers[0], end - begin)


def _remove(covers: _Covers, begin: int, row: int) -> None:
    at = 3 * _place(covers, begin, row) + 1
    del covers[at : at + 3]


def _piece(covers: _Covers, at: int) -> list[int]:
    """Return the rows of the connected piece of covers that the cover at a place is in, in order."""
    first = last = 3 * at + 1
    reach = covers[first + 1]
    while True:
        before = first, last
        while last + 3 < len(covers) and covers[last + 3] <= reach:
            last += 3
            reach = max(reach, covers[last + 1])
        look = first - 3
        while look > 0 and covers[look] >= covers[first] - covers[0]:
            if covers[look + 1] >= covers[first]:
                first = look
                reach = max(reach, covers[look + 1])
            look -= 3
        if (first, last) == before:
            return covers[first + 2 : last + 3 : 3].tolist()


class JointEncounters:
    """Records by row, as they came, and what they amount to: rows that stand for encounters.

    Of the rows of one encounter that which begins first (of several, of the gateway with the lowest name, then the lowest row) stands for
    it, with the interval that all of them allow; the others do not count.
    """

    def __init__(self) -> None:
        # Rows: begin and end [ns, site's clock], lower and higher id, whether it counts, margin [ns], number of the gateway, error.
        self._columns: IntArray
        # Of rows that stand for several: what these agree in. Of all: the row that stands for it, and the next one of the same encounter,
        # both plus 1; 0 where it is alone, and where there is none.
        self._joint: IntArray
        self._links: NDArray[np.int32]
        self._reserve(_FIRST_CAPACITY, is_anew=True)
        self._covers_of: dict[int, _Covers] = {}

    def members(self, row: int) -> tuple[int, ...]:
        """Return all rows of the encounter that a row tells of, the one that stands for it first; only itself where it is alone."""
        if row >= len(self._stands_at) or not self._stands_at[row]:
            return (row,)
        members = []
        following = self._stands_at[row]
        while following:
            members.append(following - 1)
            following = self._next_at[following - 1]
        return tuple(members)

    def rebuild(self, told: ToldRows, *, names: Mapping[int, str]) -> EncounterRows:
        """Begin anew with all rows, and return what they amount to."""
        rows = told.rows
        self._covers_of = {}
        self._reserve(max(_FIRST_CAPACITY, 1 + int(rows.row.max(initial=0))), is_anew=True)
        self._put(told)
        if rows.counts.any():
            self._index(rows.row[rows.counts], names)
        return self._amount(rows.row)

    def take(self, told: ToldRows, *, names: Mapping[int, str]) -> EncounterRows:
        """Take rows that are new or have changed; return all rows that stand for something else now, and the given ones."""
        rows = told.rows
        touched = set(rows.row.tolist())
        known = rows.row[rows.row < self._columns.shape[1]]
        for row, pair, begin, _ in self._covers(known[self._columns[_COUNTS, known] == 1]):
            _remove(self._covers_of[pair], begin, row)
            self._part(row, touched)
        self._put(told)
        for row, pair, begin, end in self._covers(rows.row[rows.counts]):
            _insert(self._covers_of.setdefault(pair, array("q", (0,))), begin, end, row)
        waiting = np.fromiter(touched, dtype=np.int64, count=len(touched))
        done: set[int] = set()
        for row, pair, begin, _ in self._covers(waiting[self._columns[_COUNTS, waiting] == 1]):
            if row in done:
                continue
            covers = self._covers_of[pair]
            piece = _piece(covers, _place(covers, begin, row))
            if len(piece) == 1:
                continue
            for one in piece:
                self._part(one, done)
            done.update(piece)
            if len({self._gateway_at[one] for one in piece}) > 1:
                self._join(piece, names)
        touched |= done
        return self._amount(np.fromiter(touched, dtype=np.int64, count=len(touched)))

    def differs(self, rows: EncounterRows) -> BoolArray:
        """Say of each of some known rows, shape (m,), whether it is at another time now."""
        differs: BoolArray = (self._columns[_BEGIN, rows.row] != rows.t_start_ns) | (self._columns[_END, rows.row] != rows.t_end_ns)
        return differs

    def _part(self, row: int, freed: set[int]) -> None:
        """Take the encounter of a row apart, if it is of several; note whom that concerns."""
        if self._stands_at[row]:
            members = self.members(row)
            freed.update(members)
            for one in members:
                self._stands_at[one] = self._next_at[one] = 0

    def _join(self, rows: list[int], names: Mapping[int, str]) -> None:
        begin, gateway = self._begin_at, self._gateway_at
        members = tuple(sorted(rows, key=lambda row: (begin[row], names[gateway[row]], row)))
        for one, following in zip(members, (*members[1:], -1), strict=True):
            self._stands_at[one] = members[0] + 1
            self._next_at[one] = following + 1
        end, error = self._end_at, self._error_at
        begins = _agreed((begin[one], error[one]) for one in members)
        self._joint[:, members[0]] = begins, max(begins, -_agreed((-end[one], error[one]) for one in members))

    def _covers(self, rows: IntArray) -> Iterable[tuple[int, int, int, int]]:
        """Return row, number of the pair, begin and end of cover of rows."""
        begin, end, low, high, _, margin, _, _ = self._columns[:, rows]
        pairs = itertools.starmap(_number_pair, zip(low.tolist(), high.tolist(), strict=True))
        return list(zip(rows.tolist(), pairs, (begin - margin).tolist(), (end + margin).tolist(), strict=True))

    def _put(self, told: ToldRows) -> None:
        rows = told.rows
        n = 1 + int(rows.row.max(initial=0))
        if n > self._columns.shape[1]:
            self._reserve(max(n, 2 * self._columns.shape[1]))
        low, high = np.minimum(rows.id1, rows.id2), np.maximum(rows.id1, rows.id2)
        others = (told.margin_ns, told.gateway, told.error_ns)
        for column, values in enumerate((rows.t_start_ns, rows.t_end_ns, low, high, rows.counts, *others)):
            self._columns[column, rows.row] = values

    def _reserve(self, n: int, *, is_anew: bool = False) -> None:
        """Have room for so many rows, which costs nothing before it is used; ``is_anew``: for none of those before."""
        columns, joint, links = (np.zeros((width, n), dtype=kind) for width, kind in ((8, np.int64), (2, np.int64), (2, np.int32)))
        if not is_anew:
            for grown, before in ((columns, self._columns), (joint, self._joint), (links, self._links)):
                grown[:, : before.shape[1]] = before
        self._columns, self._joint, self._links = columns, joint, links
        # Views that give single numbers fast.
        views = (memoryview(columns[column]) for column in (_BEGIN, _END, _GATEWAY, _ERROR))
        self._begin_at, self._end_at, self._gateway_at, self._error_at = views
        self._stands_at, self._next_at = memoryview(links[0]), memoryview(links[1])

    def _amount(self, row: IntArray) -> EncounterRows:
        """Return what rows stand for."""
        begin, end, id1, id2, counts = (column[row] for column in self._columns[:5])
        counts = counts.astype(np.bool_)
        stands = self._links[0, row]
        leads = stands == row + 1
        counts &= (stands == 0) | leads
        begin[leads], end[leads] = self._joint[:, row[leads]]
        return EncounterRows(row=row, t_start_ns=begin, t_end_ns=end, id1=id1, id2=id2, counts=counts)

    def _index(self, rows: IntArray, names: Mapping[int, str]) -> None:
        """Sort rows, at least one, by pair and begin of cover, and join the connected pieces."""
        begin, end, low, high, _, margin, gateway, _ = self._columns[:, rows]
        order = np.lexsort((rows, begin - margin, high, low))
        rows, begin, end, low, high, gateway = (column[order] for column in (rows, begin - margin, end + margin, low, high, gateway))
        is_new_pair = np.ones(len(rows), dtype=np.bool_)
        is_new_pair[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
        is_new_piece = is_new_pair.copy()
        is_new_piece[1:] |= begin[1:] > _running_maximum(end, is_new_pair)[:-1]
        firsts = np.flatnonzero(is_new_piece)
        lasts = np.append(firsts[1:], len(rows))
        is_shared = np.maximum.reduceat(gateway, firsts) != np.minimum.reduceat(gateway, firsts)
        for first, last in zip(firsts[is_shared].tolist(), lasts[is_shared].tolist(), strict=True):
            self._join(rows[first:last].tolist(), names)
        firsts = np.flatnonzero(is_new_pair)
        lasts = np.append(firsts[1:], len(rows))
        longest = np.maximum.reduceat(end - begin, firsts)
        told = np.stack((begin, end, rows), axis=1)
        for first, last, span in zip(firsts.tolist(), lasts.tolist(), longest.tolist(), strict=True):
            covers = array("q", (span,))
            covers.frombytes(told[first:last].tobytes())
            self._covers_of[_number_pair(int(low[first]), int(high[first]))] = covers


def _number_pair(low: int, high: int) -> int:
    """Return one number for two signed ids: an object less for each pair, and one that is smaller."""
    return (low << 64) + high


def _agreed(told: Iterable[tuple[int, int]]) -> int:
    """Return the middle of what the earliest instant, and those after it that can agree with it, allow; each is given with its error."""
    (instant, error), *others = sorted(told)
    earliest, latest = instant - error, instant + error
    for instant, error in others:
        if max(earliest, instant - error) <= min(latest, instant + error):
            earliest, latest = max(earliest, instant - error), min(latest, instant + error)
    return (earliest + latest) // 2


def _running_maximum(values: IntArray, is_first: BoolArray) -> IntArray:
    """Return the maximum so far of each run; ``is_first`` says where runs begin."""
    # Runs lie above each other by more than any of them spans, so that one running maximum does for all.
    run = np.cumsum(is_first)
    ranked = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    highest = np.maximum.accumulate(ranked + run * len(values)) - run * len(values)
    reached: IntArray = np.sort(values)[highest]
    return reached
