"""Two sides' reports become one encounter: union of the intervals, corrections as revisions. Pure.

Each report covers its interval and a margin at both ends. Reports of a pair whose covers overlap belong to one encounter, so the
encounters of a pair are the connected pieces of all covers: the result does not depend on the order of the reports. The
margin is half of 1.15 beacon periods (the gap that a lost beacon leaves, doubled by the other report's margin) or, where sensing is
continuous, the error of the clock (at most 0.1 s).
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

from firmware_protocol.contract.records import EncounterRecord, EncounterSide
from firmware_protocol.units import NS_PER_MS, BootId, Nanoseconds, NodeId, RssiDbm
from gateway.issuer import RecordIssuer
from gateway.radio import strongest

MAX_ERROR_MARGIN_NS = 100 * NS_PER_MS
"""A clock that is known badly widens a margin no further: separate meetings must not be joined for want of a time sync."""

_Pair = tuple[NodeId, NodeId]


@dataclass(frozen=True, slots=True, kw_only=True)
class SideReport:
    """What one biobot says of a meeting with another, on the gateway's clock."""

    node: NodeId
    peer: NodeId
    t_start_ns: Nanoseconds
    t_end_ns: Nanoseconds
    error_ns: Nanoseconds
    rssi_dbm: RssiDbm
    is_ongoing: bool
    margin_ns: int
    path_mm: int | None = None
    """Path since the start of the biobot's encounter before [mm]."""


def margin_of(*, beacon_period_ms: int, error_ns: int) -> int:
    """Return the margin of a report: half the gap that is bridged between two of them [ns]."""
    # 1.15 beacon periods: one lost beacon and its jitter (Encounternet joins gaps below a pulse period and its slack, Rutz et al. 2015).
    return max(min(error_ns, MAX_ERROR_MARGIN_NS), beacon_period_ms * NS_PER_MS * 115 // 200)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Span:
    """All that is known of one encounter; a union of spans is independent of order."""

    t_start_ns: int
    t_end_ns: int
    cover_start_ns: int
    cover_end_ns: int
    error_ns: int
    reach: tuple[int, bool]
    """End of the report that reaches furthest, and whether it was final."""
    sides: tuple[EncounterSide, ...]

    def union(self, other: "_Span") -> "_Span":
        sides = {side.node: side for side in self.sides}
        for side in other.sides:
            known = sides.get(side.node)
            sides[side.node] = side if known is None else _join_sides(known, side)
        return _Span(
            t_start_ns=min(self.t_start_ns, other.t_start_ns),
            t_end_ns=max(self.t_end_ns, other.t_end_ns),
            cover_start_ns=min(self.cover_start_ns, other.cover_start_ns),
            cover_end_ns=max(self.cover_end_ns, other.cover_end_ns),
            error_ns=max(self.error_ns, other.error_ns),
            reach=max(self.reach, other.reach),
            sides=tuple(sides[node] for node in sorted(sides)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Meeting:
    """A published encounter: its identity, its last revision and its span."""

    boot: BootId
    sequence: int
    revision: int
    span: _Span


@dataclass(slots=True, kw_only=True)
class EncounterMerger:
    """Turns reports into encounter records and their revisions; remembers what ``forget_before`` has not dropped."""

    issuer: RecordIssuer
    _meetings: dict[_Pair, list[_Meeting]] = field(default_factory=dict)
    """Of each pair, in the order of their covers, which do not overlap."""

    def merge(self, report: SideReport) -> list[EncounterRecord]:
        """Take a report; return the records it brings about, none where it says nothing new.

        A report that joins two published encounters extends the earlier one and voids the later one. Records carry a
        provisional offset; the journal gives the real one.
        """
        pair = _pair_of(report.node, report.peer)
        span = _span_of(report)
        meetings = self._meetings.setdefault(pair, [])
        begin, end = _overlap(meetings, span)
        joined = sorted(meetings[begin:end], key=lambda meeting: (meeting.boot, meeting.sequence))
        if not joined:
            meeting = _Meeting(boot=self.issuer.boot, sequence=self.issuer.take_sequence(), revision=0, span=span)
            meetings.insert(begin, meeting)
            return [self._record(pair, meeting)]
        kept, *voided = joined
        for meeting in joined:
            span = span.union(meeting.span)
        grown = replace(kept, span=span)
        is_news = bool(voided) or self._record(pair, grown) != self._record(pair, kept)  # the cover may grow, but is not published
        if is_news:
            grown = replace(grown, revision=kept.revision + 1)
        meetings[begin:end] = [grown]
        if not is_news:
            return []
        voids = [self._record(pair, replace(meeting, revision=meeting.revision + 1), is_void=True) for meeting in voided]
        return [self._record(pair, grown), *voids]

    def restore(self, records: Iterable[EncounterRecord], *, margin: Callable[[EncounterRecord], int]) -> None:
        """Remember records of the journal, in the order of their offsets; those already remembered are left as they are.

        Parameters
        ----------
        margin
            Gives the margin [ns] of a record, by what is known of its biobots.
        """
        newest = {(record.boot, record.sequence): record for record in records}
        for record in newest.values():
            if record.is_void:
                continue
            pair = _pair_of(record.node_a, record.node_b)
            meetings = self._meetings.setdefault(pair, [])
            span = self._span_of_record(record, margin_ns=margin(record))
            begin, end = _overlap(meetings, span)
            if all((known.boot, known.sequence) != (record.boot, record.sequence) for known in meetings[begin:end]):
                meetings.insert(begin, _Meeting(boot=record.boot, sequence=record.sequence, revision=record.revision, span=span))

    def forget_before(self, t_ns: int) -> None:
        """Drop what ended before ``t_ns``."""
        for pair, meetings in list(self._meetings.items()):
            recent = [meeting for meeting in meetings if meeting.span.cover_end_ns >= t_ns]
            if recent:
                self._meetings[pair] = recent
            else:
                del self._meetings[pair]

    def __len__(self) -> int:
        return sum(len(meetings) for meetings in self._meetings.values())

    def _span_of_record(self, record: EncounterRecord, *, margin_ns: int) -> _Span:
        def here(t_ns: int) -> Nanoseconds:
            return self.issuer.to_own_monotonic_ns(t_ns, anchor_ns=record.wall_anchor_ns)

        sides = tuple(
            EncounterSide(
                node=side.node,
                t_start_ns=here(side.t_start_ns),
                t_end_ns=here(side.t_end_ns),
                rssi_dbm=side.rssi_dbm,
                path_mm=side.path_mm,
            )
            for side in record.sides
        )
        start_ns, end_ns = here(record.t_start_ns), here(record.t_end_ns)
        return _Span(
            t_start_ns=start_ns,
            t_end_ns=end_ns,
            cover_start_ns=start_ns - margin_ns,
            cover_end_ns=end_ns + margin_ns,
            error_ns=record.error_ns,
            reach=(end_ns, not record.is_ongoing),
            sides=tuple(sorted(sides, key=lambda side: side.node)),
        )

    def _record(self, pair: _Pair, meeting: _Meeting, *, is_void: bool = False) -> EncounterRecord:
        span = meeting.span
        return EncounterRecord(
            gateway=self.issuer.gateway,
            journal=self.issuer.journal,
            offset=1,
            boot=meeting.boot,
            sequence=meeting.sequence,
            revision=meeting.revision,
            wall_anchor_ns=self.issuer.wall_anchor_ns,
            node_a=pair[0],
            node_b=pair[1],
            t_start_ns=Nanoseconds(span.t_start_ns),
            t_end_ns=Nanoseconds(span.t_end_ns),
            error_ns=Nanoseconds(span.error_ns),
            is_reciprocal=len(span.sides) == 2,
            is_ongoing=not span.reach[1],
            is_void=is_void,
            sides=span.sides,
        )


def _overlap(meetings: list[_Meeting], span: _Span) -> tuple[int, int]:
    """Return begin and end of the slice of ``meetings`` whose covers overlap that of ``span``."""
    end = bisect_right(meetings, span.cover_end_ns, key=_cover_start)
    begin = end
    while begin and meetings[begin - 1].span.cover_end_ns >= span.cover_start_ns:
        begin -= 1
    return begin, end


def _cover_start(meeting: _Meeting) -> int:
    return meeting.span.cover_start_ns


def _pair_of(node: NodeId, peer: NodeId) -> _Pair:
    return (node, peer) if node < peer else (peer, node)


def _span_of(report: SideReport) -> _Span:
    side = EncounterSide(
        node=report.node, t_start_ns=report.t_start_ns, t_end_ns=report.t_end_ns, rssi_dbm=report.rssi_dbm, path_mm=report.path_mm
    )
    return _Span(
        t_start_ns=report.t_start_ns,
        t_end_ns=report.t_end_ns,
        cover_start_ns=report.t_start_ns - report.margin_ns,
        cover_end_ns=report.t_end_ns + report.margin_ns,
        error_ns=report.error_ns,
        reach=(report.t_end_ns, not report.is_ongoing),
        sides=(side,),
    )


def _join_sides(one: EncounterSide, other: EncounterSide) -> EncounterSide:
    first = min(one, other, key=_path_order)
    return EncounterSide(
        node=one.node,
        t_start_ns=first.t_start_ns,
        t_end_ns=max(one.t_end_ns, other.t_end_ns),
        rssi_dbm=strongest(one.rssi_dbm, other.rssi_dbm),
        path_mm=first.path_mm,
    )


def _path_order(side: EncounterSide) -> tuple[int, bool, int]:
    """Order sides by which of them has the path to the meeting: the one that began first; of two, one that knows it, then the shorter."""
    return (side.t_start_ns, side.path_mm is None, side.path_mm or 0)
