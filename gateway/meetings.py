"""What is known of one encounter: the reports of both sides put together, and the interval that they make likely. Pure.

A side's reports are joined to the first start and the last end that it told; that is what the record keeps in ``sides``. Where encounters
are sensed by beacons, the record's own interval is wider, for the two were near each other before the first beacon and after the last
(``unheard``).
"""

# ruff: noqa: PLR1730, FURB136  # calls of min and max would be a tenth of what an encounter costs

from msgspec import UNSET, Struct, UnsetType
from msgspec.structs import force_setattr, replace

from firmware_protocol.contract.records import EncounterRecord, EncounterSide, OwnSpan
from firmware_protocol.units import NS_PER_MS, BootId, Nanoseconds, NodeId, RssiDbm
from gateway.clocks import SETTLED_ERROR_NS
from gateway.issuer import RecordIssuer
from gateway.radio import strongest
from gateway.unheard import Guesses

_NEVER_NS = -(1 << 62)


class SideReport(Struct, kw_only=True, gc=False):
    """What one biobot says of a meeting with another, on the gateway's clock. Not changed by who takes it.

    Parameters
    ----------
    error_ns
        How wrong the fit of the backpack's clock may be [ns].
    margin_ns
        Half the gap to another report of the pair that is bridged [ns].
    period_ns
        Between the other's beacons [ns]; 0: sensed continuously.
    path_mm
        Path since the start of the biobot's encounter before [mm].
    own_clock
        What it says, on its own clock.
    """

    node: NodeId
    peer: NodeId
    t_start_ns: Nanoseconds
    t_end_ns: Nanoseconds
    error_ns: Nanoseconds
    rssi_dbm: RssiDbm
    is_ongoing: bool
    margin_ns: int
    period_ns: int = 0
    path_mm: int | None = None
    own_clock: OwnSpan | UnsetType = UNSET


class Meeting(Struct, kw_only=True, gc=False):
    """An encounter: its identity, its last revision, and what is known of it; the sum of its reports in any order.

    Parameters
    ----------
    cover_start_ns, cover_end_ns
        Of all reports with their margins: another one of the pair that overlaps this belongs to the encounter.
    side_a, side_b
        Of the lower and the higher node number.
    final_end_a_ns, final_end_b_ns
        Where the final report of the side ends that reaches furthest. A provisional one that reaches no further than the error of the
        side's clock beyond it was dated by a clock that was known worse: the encounter is over.
    """

    boot: BootId
    sequence: int
    revision: int
    cover_start_ns: int
    cover_end_ns: int
    period_ns: int
    side_a: EncounterSide | None = None
    side_b: EncounterSide | None = None
    final_end_a_ns: int = _NEVER_NS
    final_end_b_ns: int = _NEVER_NS

    @property
    def heard_from_ns(self) -> int:
        """When the first report of either side begins [ns]."""
        return min((side.t_start_ns for side in (self.side_a, self.side_b) if side is not None), default=self.cover_start_ns)

    @property
    def is_final_a(self) -> bool:
        """Whether the lower number's side has told the end."""
        return _is_final(self.side_a, self.final_end_a_ns)

    @property
    def is_final_b(self) -> bool:
        """Whether the higher number's side has told the end."""
        return _is_final(self.side_b, self.final_end_b_ns)

    @property
    def identity(self) -> tuple[BootId, int]:
        """Return what orders encounters by when they were first told of."""
        return self.boot, self.sequence

    def take(self, report: SideReport) -> bool:
        """Add a report; return whether it says anything new."""
        side, is_a = side_of(report), report.node < report.peer
        old, known_final_ns = (self.side_a, self.final_end_a_ns) if is_a else (self.side_b, self.final_end_b_ns)
        was_final = _is_final(old, known_final_ns)
        if old is not None:
            side = _join(old, side)
        final_end_ns = known_final_ns if report.is_ongoing or report.t_end_ns < known_final_ns else report.t_end_ns
        if is_a:
            self.side_a, self.final_end_a_ns = side, final_end_ns
        else:
            self.side_b, self.final_end_b_ns = side, final_end_ns
        cover_start_ns, cover_end_ns = report.t_start_ns - report.margin_ns, report.t_end_ns + report.margin_ns
        if cover_start_ns < self.cover_start_ns:
            self.cover_start_ns = cover_start_ns
        if cover_end_ns > self.cover_end_ns:
            self.cover_end_ns = cover_end_ns
        if report.period_ns > self.period_ns:
            self.period_ns = report.period_ns
        return old is None or side != old or _is_final(side, final_end_ns) is not was_final

    def absorb(self, other: "Meeting") -> None:
        """Add all that is known of another encounter of the pair, which turned out to be the same."""
        self.side_a, self.side_b = _join_known(self.side_a, other.side_a), _join_known(self.side_b, other.side_b)
        self.final_end_a_ns = max(self.final_end_a_ns, other.final_end_a_ns)
        self.final_end_b_ns = max(self.final_end_b_ns, other.final_end_b_ns)
        self.cover_start_ns = min(self.cover_start_ns, other.cover_start_ns)
        self.cover_end_ns = max(self.cover_end_ns, other.cover_end_ns)
        self.period_ns = max(self.period_ns, other.period_ns)

    def gap(self) -> float:
        """Return how far apart the starts of both sides are [beacon periods]; there must be both, and beacons."""
        assert self.side_a is not None
        assert self.side_b is not None
        return abs(self.side_a.t_start_ns - self.side_b.t_start_ns) / self.period_ns

    def record(self, pair: tuple[NodeId, NodeId], *, issuer: RecordIssuer, guesses: Guesses, is_void: bool = False) -> EncounterRecord:
        """Make the record of it, with a provisional offset."""
        start_ns, end_ns, error_ns, is_ongoing = self._interval(guesses)
        a, b = self.side_a, self.side_b
        at_start_ns, at_end_ns = start_ns - self.cover_start_ns, self.cover_end_ns - end_ns
        margin_ns = at_start_ns if at_start_ns < at_end_ns else at_end_ns
        # A call with more than 15 keywords costs four times as much: CPython makes a dictionary of them (compile.c, STACK_USE_GUIDELINE).
        record = EncounterRecord(
            gateway=issuer.gateway,
            journal=issuer.journal,
            offset=1,
            boot=self.boot,
            sequence=self.sequence,
            revision=self.revision,
            wall_anchor_ns=issuer.wall_anchor_ns,
            node_a=pair[0],
            node_b=pair[1],
            t_start_ns=Nanoseconds(start_ns),
            t_end_ns=Nanoseconds(end_ns),
            error_ns=Nanoseconds(error_ns),
            is_reciprocal=a is not None and b is not None,
            # No more than what is left of the cover at either end, so that no two records of a pair cover the same instant.
            margin_ns=margin_ns if margin_ns > 0 else 0,
            sides=(a, b) if a is not None and b is not None else (a,) if a is not None else () if b is None else (b,),
        )
        if is_ongoing:
            force_setattr(record, "is_ongoing", is_ongoing)
        if is_void:
            force_setattr(record, "is_void", is_void)
        return record

    def _interval(self, guesses: Guesses) -> tuple[int, int, int, bool]:
        """Return start, end and bound of their error [ns], and whether the encounter goes on."""
        a, b, period_ns = self.side_a, self.side_b, self.period_ns
        if a is None or b is None:
            one = a or b
            assert one is not None, "a meeting is made of a report"
            is_ongoing = not (self.is_final_b if a is None else self.is_final_a)
            if not period_ns:
                return one.t_start_ns, one.t_end_ns, one.error_ns or 0, is_ongoing
            earlier, half = guesses.of_one((one.t_end_ns - one.t_start_ns) / period_ns)
            shift_ns = int(earlier * period_ns)
            error_ns = (one.error_ns or 0) + int(half * period_ns)
            return one.t_start_ns - shift_ns, one.t_end_ns if is_ongoing else one.t_end_ns + shift_ns, error_ns, is_ongoing
        start_ns: int = a.t_start_ns if a.t_start_ns < b.t_start_ns else b.t_start_ns
        apart_ns = a.t_end_ns - b.t_end_ns
        end_ns: int = a.t_end_ns if apart_ns > 0 else b.t_end_ns
        error_ns, error_b_ns = a.error_ns or 0, b.error_ns or 0
        if error_b_ns > error_ns:
            error_ns = error_b_ns
        is_ongoing = not ((apart_ns >= 0 and self.is_final_a) or (apart_ns <= 0 and self.is_final_b))
        if not period_ns:
            return start_ns, end_ns, error_ns, is_ongoing
        earlier, half = guesses.between(self.gap())
        start_ns -= int(earlier * period_ns)
        if not is_ongoing:
            both_final = self.is_final_a and self.is_final_b
            later, half_end = guesses.between(abs(apart_ns) / period_ns) if both_final else guesses.of_short
            end_ns += int(later * period_ns)
            half = max(half, half_end)
        return start_ns, end_ns, error_ns + int(half * period_ns), is_ongoing


def meeting_of(report: SideReport, *, boot: BootId, sequence: int) -> Meeting:
    """Begin an encounter with a report."""
    side, is_a = side_of(report), report.node < report.peer
    final_end_ns = _NEVER_NS if report.is_ongoing else report.t_end_ns
    return Meeting(
        boot=boot,
        sequence=sequence,
        revision=0,
        cover_start_ns=report.t_start_ns - report.margin_ns,
        cover_end_ns=report.t_end_ns + report.margin_ns,
        period_ns=report.period_ns,
        side_a=side if is_a else None,
        side_b=None if is_a else side,
        final_end_a_ns=final_end_ns if is_a else _NEVER_NS,
        final_end_b_ns=_NEVER_NS if is_a else final_end_ns,
    )


def meeting_of_record(record: EncounterRecord, *, issuer: RecordIssuer, margin_ns: int, period_ns: int) -> Meeting:
    """Know an encounter again from its record, which another start of the gateway may have written."""

    def here(t_ns: int) -> Nanoseconds:
        return issuer.to_own_monotonic_ns(t_ns, anchor_ns=record.wall_anchor_ns)

    sides = {
        side.node: EncounterSide(
            node=side.node,
            t_start_ns=here(side.t_start_ns),
            t_end_ns=here(side.t_end_ns),
            rssi_dbm=side.rssi_dbm,
            path_mm=side.path_mm,
            error_ns=record.error_ns if side.error_ns is None else side.error_ns,
            own_clock=side.own_clock,
        )
        for side in record.sides
    }
    start_ns = min((side.t_start_ns for side in sides.values()), default=here(record.t_start_ns))
    end_ns = max((side.t_end_ns for side in sides.values()), default=here(record.t_end_ns))
    side_a, side_b = sides.get(record.node_a), sides.get(record.node_b)
    return Meeting(
        boot=record.boot,
        sequence=record.sequence,
        revision=record.revision,
        cover_start_ns=start_ns - margin_ns,
        cover_end_ns=end_ns + margin_ns,
        period_ns=period_ns,
        side_a=side_a,
        side_b=side_b,
        final_end_a_ns=_NEVER_NS if record.is_ongoing or side_a is None else side_a.t_end_ns,
        final_end_b_ns=_NEVER_NS if record.is_ongoing or side_b is None else side_b.t_end_ns,
    )


def part(before: Meeting, after: Meeting) -> None:
    """Let the covers of two encounters of a pair no longer overlap: they meet in the middle of what lies between the encounters."""
    if before.cover_end_ns < after.cover_start_ns:
        return
    heard_until_ns = max((side.t_end_ns for side in (before.side_a, before.side_b) if side is not None), default=before.cover_end_ns)
    cut_ns = min((heard_until_ns + after.heard_from_ns + 1) // 2, before.cover_end_ns + 1, after.cover_end_ns)
    cut_ns = max(cut_ns, before.cover_start_ns + 1, after.cover_start_ns)
    before.cover_end_ns, after.cover_start_ns = cut_ns - 1, cut_ns


def side_of(report: SideReport) -> EncounterSide:
    """Return what is kept of a report."""
    return EncounterSide(
        node=report.node,
        t_start_ns=report.t_start_ns,
        t_end_ns=report.t_end_ns,
        rssi_dbm=report.rssi_dbm,
        path_mm=report.path_mm,
        error_ns=report.error_ns,
        own_clock=report.own_clock,
    )


def has_told(meeting: Meeting, report: SideReport, *, is_near: bool) -> bool:
    """Whether a report's biobot has told of the encounter what it tells now, or a part of it, by its own clock, but by another date.

    That is another date which does not connect them by time (``is_near``: it does), or is so much worse.
    """
    side, told = meeting.side_a if report.node < report.peer else meeting.side_b, report.own_clock
    if side is None or isinstance(side.own_clock, UnsetType) or isinstance(told, UnsetType):
        return False
    if is_near and abs((side.error_ns or 0) - report.error_ns) <= SETTLED_ERROR_NS:
        return False
    known = side.own_clock
    return known.boot == told.boot and known.start_ms <= told.end_ms and told.start_ms <= known.end_ms


def date_alike(meeting: Meeting, report: SideReport) -> SideReport:
    """Move what is dated worse, the report or the side that ``has_told`` found, to where the other has it; return the report.

    Where the other biobot has told of the encounter too, by another clock, the time that it covers stays.
    """
    is_a = report.node < report.peer
    side, peers = (meeting.side_a, meeting.side_b) if is_a else (meeting.side_b, meeting.side_a)
    if side is None or isinstance(side.own_clock, UnsetType) or isinstance(report.own_clock, UnsetType):
        return report
    later_ns = (report.own_clock.start_ms - side.own_clock.start_ms) * NS_PER_MS - (report.t_start_ns - side.t_start_ns)
    error_ns = side.error_ns or Nanoseconds(0)
    if error_ns < report.error_ns:
        start_ns, end_ns = report.t_start_ns + later_ns, report.t_end_ns + later_ns
        return replace(report, t_start_ns=Nanoseconds(start_ns), t_end_ns=Nanoseconds(end_ns), error_ns=error_ns)
    start_ns, end_ns = side.t_start_ns - later_ns, side.t_end_ns - later_ns
    moved = replace(side, t_start_ns=Nanoseconds(start_ns), t_end_ns=Nanoseconds(end_ns), error_ns=report.error_ns)
    if peers is None:
        meeting.cover_start_ns -= later_ns
        meeting.cover_end_ns -= later_ns
    if is_a:
        meeting.side_a, meeting.final_end_a_ns = moved, meeting.final_end_a_ns - later_ns
    else:
        meeting.side_b, meeting.final_end_b_ns = moved, meeting.final_end_b_ns - later_ns
    return report


def _is_final(side: EncounterSide | None, final_end_ns: int) -> bool:
    return side is not None and side.t_end_ns <= final_end_ns + (side.error_ns or 0)


def _join_known(one: EncounterSide | None, other: EncounterSide | None) -> EncounterSide | None:
    return one or other if one is None or other is None else _join(one, other)


def _join(one: EncounterSide, other: EncounterSide) -> EncounterSide:
    first = one if _path_order(one) <= _path_order(other) else other
    return EncounterSide(
        node=one.node,
        t_start_ns=first.t_start_ns,
        t_end_ns=max(one.t_end_ns, other.t_end_ns),
        rssi_dbm=strongest(one.rssi_dbm, other.rssi_dbm),
        path_mm=first.path_mm,
        error_ns=max(one.error_ns or Nanoseconds(0), other.error_ns or Nanoseconds(0)),
        own_clock=_join_own(one.own_clock, other.own_clock),
    )


def _join_own(one: OwnSpan | UnsetType, other: OwnSpan | UnsetType) -> OwnSpan | UnsetType:
    """Return all of two spans of one start; of two starts the later one's, for what a backpack kept of an earlier one is told no more."""
    if isinstance(one, UnsetType):
        return other
    if isinstance(other, UnsetType) or one.boot > other.boot:
        return one
    if one.boot < other.boot:
        return other
    return OwnSpan(one.boot, min(one.start_ms, other.start_ms), max(one.end_ms, other.end_ms))


def _path_order(side: EncounterSide) -> tuple[int, bool, int]:
    """Order sides by which of them has the path to the meeting: the one that began first; of two, one that knows it, then the shorter."""
    return (side.t_start_ns, side.path_mm is None, side.path_mm or 0)
