"""Records of several gateways that tell of one encounter become one, for map and counts. Pure.

The rule is the gateway's own (`gateway.encounters`): each record covers its interval and a margin at both ends, and records of a pair
whose covers overlap, directly or over others, tell of one encounter. It needs records of two gateways at least: what one gateway has
kept apart stays apart. The answer depends only on the records and the shifts of their clocks, never on the order.

Each record bounds the true begin: by its error on either side of its own. Where beacons are sensed, one side's record is widened by what
was not heard; the union of two such records would be widened twice. So the earliest begin and those whose bounds it can agree with are
taken together: the middle of what all of them allow, which is what one gateway with both sides would say. The end likewise.
"""

from array import array
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mapper.record_columns import EncounterRows
from mapper.types import BoolArray, IntArray

_FIRST_CAPACITY = 1024
_BEGIN, _END, _LOW, _HIGH, _COUNTS, _MARGIN, _GATEWAY, _ERROR = range(8)

_Pair = tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToldRows:
    """Records on the site's clock and what joins them: margin and error [ns] and number of the gateway, each of shape (m,)."""

    rows: EncounterRows
    margin_ns: IntArray
    error_ns: IntArray
    gateway: IntArray


@dataclass(slots=True)
class _Meetings:
    """Covers of one pair by begin, then row; columns side by side. ``longest`` is no shorter than any."""

    begins: "array[int]" = field(default_factory=lambda: array("q"))
    ends: "array[int]" = field(default_factory=lambda: array("q"))
    rows: "array[int]" = field(default_factory=lambda: array("q"))
    longest: int = 0

    def place(self, begin: int, row: int) -> int:
        """Return where a cover is, or would be."""
        at = bisect_left(self.begins, begin)
        while at < len(self.begins) and self.begins[at] == begin and self.rows[at] < row:
            at += 1
        return at

    def insert(self, begin: int, end: int, row: int) -> None:
        at = self.place(begin, row)
        self.begins.insert(at, begin)
        self.ends.insert(at, end)
        self.rows.insert(at, row)
        self.longest = max(self.longest, end - begin)

    def remove(self, begin: int, row: int) -> None:
        at = self.place(begin, row)
        del self.begins[at], self.ends[at], self.rows[at]

    def piece(self, at: int) -> tuple[int, int]:
        """Return first and last place of the connected piece of covers that the cover at ``at`` is in."""
        first = last = at
        reach = self.ends[at]
        while True:
            before = first, last
            while last + 1 < len(self.begins) and self.begins[last + 1] <= reach:
                last += 1
                reach = max(reach, self.ends[last])
            look = first - 1
            while look >= 0 and self.begins[look] >= self.begins[first] - self.longest:
                if self.ends[look] >= self.begins[first]:
                    first = look
                    reach = max(reach, self.ends[look])
                look -= 1
            if (first, last) == before:
                return first, last


class JointEncounters:
    """Records by row, as they came, and what they amount to: rows that stand for encounters.

    Of the rows of one encounter that which begins first (of several, of the gateway with the lowest name, then the lowest row) stands for
    it, with the interval that all of them allow; the others do not count.
    """

    def __init__(self) -> None:
        # Rows: begin and end [ns, site's clock], lower and higher id, whether it counts, margin [ns], number of the gateway, error.
        self._look_at(np.zeros((8, _FIRST_CAPACITY), dtype=np.int64))
        self._meetings: dict[_Pair, _Meetings] = {}
        self._members: dict[int, tuple[int, ...]] = {}
        self._stands: dict[int, int] = {}
        self._intervals: dict[int, tuple[int, int]] = {}

    def members(self, row: int) -> tuple[int, ...]:
        """Return all rows of the encounter that a row tells of, the one that stands for it first; only itself where it is alone."""
        return self._members[self._stands[row]] if row in self._stands else (row,)

    def rebuild(self, told: ToldRows, *, names: Mapping[int, str]) -> EncounterRows:
        """Begin anew with all rows, and return what they amount to."""
        rows = told.rows
        self._meetings, self._members, self._stands, self._intervals = {}, {}, {}, {}
        self._look_at(np.zeros((8, max(_FIRST_CAPACITY, 1 + int(rows.row.max(initial=0)))), dtype=np.int64))
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
            self._meetings[pair].remove(begin, row)
            self._part(row, touched)
        self._put(told)
        for row, pair, begin, end in self._covers(rows.row[rows.counts]):
            self._meetings.setdefault(pair, _Meetings()).insert(begin, end, row)
        waiting = np.fromiter(touched, dtype=np.int64, count=len(touched))
        done: set[int] = set()
        for row, pair, begin, _ in self._covers(waiting[self._columns[_COUNTS, waiting] == 1]):
            if row in done:
                continue
            meetings = self._meetings[pair]
            first, last = meetings.piece(meetings.place(begin, row))
            if first == last:
                continue
            piece = meetings.rows[first : last + 1].tolist()
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
        if row in self._stands:
            stands = self._stands[row]
            members = self._members.pop(stands)
            del self._intervals[stands]
            freed.update(members)
            for one in members:
                del self._stands[one]

    def _join(self, rows: list[int], names: Mapping[int, str]) -> None:
        begin, gateway = self._begin_at, self._gateway_at
        members = tuple(sorted(rows, key=lambda row: (begin[row], names[gateway[row]], row)))
        self._members[members[0]] = members
        for one in members:
            self._stands[one] = members[0]
        end, error = self._end_at, self._error_at
        begins = _agreed((begin[one], error[one]) for one in members)
        self._intervals[members[0]] = begins, max(begins, -_agreed((-end[one], error[one]) for one in members))

    def _covers(self, rows: IntArray) -> Iterable[tuple[int, _Pair, int, int]]:
        """Return row, pair, begin and end of cover of rows."""
        begin, end, low, high, _, margin, _, _ = self._columns[:, rows]
        pairs = zip(low.tolist(), high.tolist(), strict=True)
        return list(zip(rows.tolist(), pairs, (begin - margin).tolist(), (end + margin).tolist(), strict=True))

    def _put(self, told: ToldRows) -> None:
        rows = told.rows
        n = 1 + int(rows.row.max(initial=0))
        if n > self._columns.shape[1]:
            self._look_at(np.pad(self._columns, ((0, 0), (0, max(n, 2 * self._columns.shape[1]) - self._columns.shape[1]))))
        low, high = np.minimum(rows.id1, rows.id2), np.maximum(rows.id1, rows.id2)
        others = (told.margin_ns, told.gateway, told.error_ns)
        for column, values in enumerate((rows.t_start_ns, rows.t_end_ns, low, high, rows.counts, *others)):
            self._columns[column, rows.row] = values

    def _look_at(self, columns: IntArray) -> None:
        """Take columns, and views of them that give single numbers fast."""
        self._columns = columns
        views = (memoryview(columns[column]) for column in (_BEGIN, _END, _GATEWAY, _ERROR))
        self._begin_at, self._end_at, self._gateway_at, self._error_at = views

    def _amount(self, row: IntArray) -> EncounterRows:
        """Return what rows stand for."""
        begin, end, id1, id2, counts = (column[row] for column in self._columns[:5])
        counts = counts.astype(np.bool_)
        stands = self._stands
        for place, one in enumerate(row.tolist()):
            if one in stands:
                counts[place] = stands[one] == one
                if stands[one] == one:
                    begin[place], end[place] = self._intervals[one]
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
        for first, last, span in zip(firsts.tolist(), lasts.tolist(), longest.tolist(), strict=True):
            begins, ends, places = (array("q", column[first:last].tobytes()) for column in (begin, end, rows))
            self._meetings[int(low[first]), int(high[first])] = _Meetings(begins=begins, ends=ends, rows=places, longest=span)


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
