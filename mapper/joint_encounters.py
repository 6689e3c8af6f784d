"""Records of several gateways that tell of one encounter become one, for map and counts. Pure.

The rule is the gateway's own (`gateway.encounters`): each record covers its interval and a margin at both ends, and records of a pair
whose covers overlap tell of one encounter. So do records whose biobot, of either side, has told of the same ticks of its own clock
(`mapper.own_spans`): a report that was told to two gateways is one, however wrong one of them dates it. Encounters are what is connected,
directly or over others. It needs records of two gateways at least: what one gateway has kept apart stays apart. The answer depends only
on the records and the shifts of their clocks, never on the order.

Each record bounds the true begin: by its error on either side of its own. Where beacons are sensed, one side's record is widened by what
was not heard; the union of two such records would be widened twice. So the earliest begin and those whose bounds it can agree with are
taken together: the middle of what all of them allow, which is what one gateway with both sides would say. The end likewise. Before that,
records that are dated badly are put where the same ticks are by a clock that is known better (`mapper.dating`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapper.dating import SAME_LIFE_NS, DatedRecord, agree
from mapper.own_spans import N_NUMBERS
from mapper.pair_spans import PairSpans, find_pieces, insert, no_spans, overlapping, remove
from mapper.record_columns import EncounterRows
from mapper.types import BoolArray, IntArray

_FIRST_CAPACITY = 1024
_BEGIN, _END, _LOW, _HIGH, _COUNTS, _MARGIN, _GATEWAY, _ERROR = range(8)
_ON_SITES_CLOCK = 2
"""Axis of the covers, beside those of the two biobots' own clocks: 0 of the lower id, 1 of the other."""

_Span: TypeAlias = tuple[int, int, int]
"""Number of a pair and an axis, begin and end."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToldRows:
    """Records on the site's clock and what joins them: margin and error [ns] and number of the gateway, each of shape (m,).

    ``own``, shape (8, m): see `mapper.own_spans`; the instants in it are on the site's clock. None: nothing was told.
    """

    rows: EncounterRows
    margin_ns: IntArray
    error_ns: IntArray
    gateway: IntArray
    own: IntArray | None = None


class JointEncounters:
    """Records by row, as they came, and what they amount to: rows that stand for encounters.

    Of the rows of one encounter that which begins first (of several, of the gateway with the lowest name, then the lowest row) stands for
    it, with the interval that all of them allow; the others do not count.
    """

    def __init__(self) -> None:
        # Rows: begin and end [ns, site's clock], lower and higher id, whether it counts, margin [ns], number of the gateway, error.
        self._columns: IntArray
        # What both biobots told on their own clocks; of no rows until any is told.
        self._own: IntArray | None = None
        # Of rows that stand for several: what these agree in. Of all: the row that stands for it, and the next one of the same encounter,
        # both plus 1; 0 where it is alone, and where there is none.
        self._joint: IntArray
        self._links: NDArray[np.int32]
        self._reserve(_FIRST_CAPACITY, is_anew=True)
        self._spans: dict[int, PairSpans] = {}

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
        self._spans = {}
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
        for row, spans in self._spans_of(known[self._columns[_COUNTS, known] == 1]):
            for key, begin, _ in spans:
                remove(self._spans[key], begin, row)
            self._part(row, touched)
        self._put(told)
        for row, spans in self._spans_of(rows.row[rows.counts]):
            for key, begin, end in spans:
                insert(self._spans.setdefault(key, no_spans()), begin, end, row)
        waiting = np.fromiter(touched, dtype=np.int64, count=len(touched))
        done: set[int] = set()
        for row, spans in self._spans_of(waiting[self._columns[_COUNTS, waiting] == 1]):
            if row in done:
                continue
            piece = self._piece(row, spans)
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
        begin, end, error, gateway = self._begin_at, self._end_at, self._error_at, self._gateway_at
        members = tuple(sorted(rows, key=lambda row: (begin[row], names[gateway[row]], row)))
        for one, following in zip(members, (*members[1:], -1), strict=True):
            self._stands_at[one] = members[0] + 1
            self._next_at[one] = following + 1
        told = self._own_of(np.array(members)).T.tolist()
        self._joint[:, members[0]] = agree(
            [
                DatedRecord(begin=begin[one], end=end[one], error=error[one], gateway=names[gateway[one]], own=tuple(own))
                for one, own in zip(members, told, strict=True)
            ]
        )

    def _own_of(self, rows: IntArray) -> IntArray:
        """Return what was told of rows, shape (8, m)."""
        if self._own is None:
            return np.full((N_NUMBERS, len(rows)), -1, dtype=np.int64)
        own: IntArray = self._own[:, rows]
        return own

    def _piece(self, row: int, spans: list[_Span]) -> list[int]:
        """Return all rows that are connected with a row, and itself; ``spans`` are where it is to be found."""
        found, known = [row], {row}
        looked_at = 0
        while looked_at < len(found):
            if looked_at:
                ((_, spans),) = self._spans_of(np.array([found[looked_at]]))
            for key, begin, end in spans:
                near = overlapping(self._spans[key], begin, end)
                if len(near) == 1:
                    continue
                axis = key & 3
                if axis != _ON_SITES_CLOCK and self._own is not None:
                    zero = self._own[4 * axis + 2]
                    near = [other for other in near if abs(int(zero[other]) - int(zero[found[looked_at]])) <= SAME_LIFE_NS]
                fresh = [other for other in near if other not in known]
                found += fresh
                known.update(fresh)
            looked_at += 1
        return found

    def _spans_of(self, rows: IntArray) -> Iterator[tuple[int, list[_Span]]]:
        """Yield rows and where each is to be found: on the site's clock, and on each own clock that was told."""
        columns = self._columns[:_GATEWAY, rows].T.tolist()
        told = self._own_of(rows)[[0, 1, 4, 5]].T.tolist()
        for row, (begin, end, low, high, _, margin), (first, last, first_b, last_b) in zip(rows.tolist(), columns, told, strict=True):
            spans: list[_Span] = [(_key(low, high, _ON_SITES_CLOCK), begin - margin, end + margin)]
            if first >= 0:
                spans.append((_key(low, high, 0), first, last))
            if first_b >= 0:
                spans.append((_key(low, high, 1), first_b, last_b))
            yield row, spans

    def _put(self, told: ToldRows) -> None:
        rows = told.rows
        n = 1 + int(rows.row.max(initial=0))
        if n > self._columns.shape[1]:
            self._reserve(max(n, 2 * self._columns.shape[1]))
        low, high = np.minimum(rows.id1, rows.id2), np.maximum(rows.id1, rows.id2)
        others = (told.margin_ns, told.gateway, told.error_ns)
        for column, values in enumerate((rows.t_start_ns, rows.t_end_ns, low, high, rows.counts, *others)):
            self._columns[column, rows.row] = values
        if told.own is not None and self._own is None and (told.own[[0, 4]] >= 0).any():
            self._own = np.zeros((N_NUMBERS, self._columns.shape[1]), dtype=np.int64)
            self._own[[0, 1, 4, 5]] = -1
        if told.own is not None and self._own is not None:
            self._own[:, rows.row] = told.own

    def _reserve(self, n: int, *, is_anew: bool = False) -> None:
        """Have room for so many rows, which costs nothing before it is used; ``is_anew``: for none of those before."""
        columns, joint, links = (np.zeros((width, n), dtype=kind) for width, kind in ((8, np.int64), (2, np.int64), (2, np.int32)))
        if not is_anew:
            for grown, before in ((columns, self._columns), (joint, self._joint), (links, self._links)):
                grown[:, : before.shape[1]] = before
            if self._own is not None:
                self._own = np.pad(self._own, ((0, 0), (0, n - self._own.shape[1])), constant_values=-1)
        else:
            self._own = None
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
        """Put rows, at least one, into the spans of their pairs, and join what is connected."""
        from scipy.sparse import coo_array  # noqa: PLC0415  # a service starts without SciPy (ADR 54)
        from scipy.sparse.csgraph import connected_components  # noqa: PLC0415  # same

        begin, end, _, _, _, margin, gateway, _ = self._columns[:, rows]
        places = np.arange(len(rows))
        joined = [self._index_axis(_ON_SITES_CLOCK, rows, places, begins=begin - margin, ends=end + margin)]
        told = self._own_of(rows)
        for axis in (0, 1):
            first, last = told[4 * axis], told[4 * axis + 1]
            is_told = first >= 0
            joined.append(self._index_axis(axis, rows[is_told], places[is_told], begins=first[is_told], ends=last[is_told]))
        one, other = np.concatenate(joined, axis=1)
        if not len(one):
            return
        graph = coo_array((np.ones(len(one), dtype=np.int8), (one, other)), shape=(len(rows), len(rows)))
        _, label = connected_components(graph, directed=False)
        order = np.argsort(label, kind="stable")
        firsts = np.flatnonzero(np.diff(label[order], prepend=-1))
        lasts = np.append(firsts[1:], len(rows))
        is_shared = np.maximum.reduceat(gateway[order], firsts) != np.minimum.reduceat(gateway[order], firsts)
        for start, stop in zip(firsts[is_shared].tolist(), lasts[is_shared].tolist(), strict=True):
            self._join(rows[order[start:stop]].tolist(), names)

    def _index_axis(self, axis: int, rows: IntArray, places: IntArray, *, begins: IntArray, ends: IntArray) -> IntArray:
        """Put spans of one axis where they belong; return places of rows that it joins, shape (2, k), enough to connect all that are."""
        low, high = self._columns[_LOW, rows], self._columns[_HIGH, rows]
        order = np.lexsort((rows, begins, high, low))
        rows, places, begins, ends = (column[order] for column in (rows, places, begins, ends))
        pieces = find_pieces(low[order], high[order], begins=begins, ends=ends)
        for pair, spans in pieces.spans(begins, ends, rows):
            self._spans[_key(*pair, axis)] = spans
        joined: list[IntArray] = []
        if axis == _ON_SITES_CLOCK:
            within = np.flatnonzero(~pieces.is_new_piece)
            joined.append(np.array((places[within - 1], places[within])))
        else:
            zero = self._own_of(rows)[4 * axis + 2]
            for apart in count(1):
                is_near = pieces.number[apart:] == pieces.number[:-apart]
                if not is_near.any():
                    break
                is_near &= (begins[apart:] <= ends[:-apart]) & (np.abs(zero[apart:] - zero[:-apart]) <= SAME_LIFE_NS)
                joined.append(np.array((places[:-apart][is_near], places[apart:][is_near])))
        return np.concatenate(joined, axis=1) if joined else np.zeros((2, 0), dtype=np.int64)


def _key(low: int, high: int, axis: int) -> int:
    """Return one number for two signed ids and an axis: an object less for each pair, and one that is smaller."""
    return ((low << 64) + high << 2) + axis
