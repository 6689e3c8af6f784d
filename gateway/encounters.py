"""Two sides' reports become one encounter, and corrections its revisions. Pure.

Each report covers its interval and a margin at both ends. Reports of a pair whose covers overlap belong to one encounter, so the
encounters of a pair are the connected pieces of all covers: the result does not depend on the order of the reports. The
margin is half of 1.15 beacon periods (the gap that a lost beacon leaves, doubled by the other report's margin), more where many beacons are
lost, or, where sensing is continuous, the error of the clock (at most 1 s; 0.1 s where no
time sync has bounded it).

A biobot may tell of an encounter while its clock is hardly known, and of its end when it is, or what was told is dated anew then: no margin
may connect the two dates. What it says on its own clock does: such reports are dated alike, as the better-known clock has it, before they
are put together.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from itertools import islice

from firmware_protocol.contract.records import EncounterRecord
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, NodeId
from gateway.clocks import ROUGH_ERROR_NS
from gateway.issuer import RecordIssuer
from gateway.meetings import Meeting, SideReport, date_alike, has_told, meeting_of, meeting_of_record, part
from gateway.unheard import BeaconLoss

__all__ = ["MAX_ERROR_MARGIN_NS", "EncounterMerger", "SideReport", "margin_of"]

MAX_ERROR_MARGIN_NS = ROUGH_ERROR_NS
"""As wrong as a clock may be that a time sync has bounded: with such margins both sides of a meeting overlap, whatever the clocks' errors.
So separate meetings of a pair that are closer than both errors are joined; with settled clocks these are some milliseconds."""

_ASSUMED_ERROR_NS = 3 * NS_PER_S // 2
"""So wrong is only a clock that no time sync has bounded: less than ``ASSUMED_DELAY_NS``, more than a rough clock's drift can add."""

_ASSUMED_MARGIN_NS = 100 * NS_PER_MS
"""The error of such a clock is an assumption: separate meetings must not be joined for want of a time sync."""

_MAX_EXCESS = 20_000
"""Of too many encounters so many are looked at in one go: about two milliseconds."""

_Pair = tuple[NodeId, NodeId]


def margin_of(*, beacon_period_ms: int, error_ns: int, n_bridged: int = 0) -> int:
    """Return the margin of a report: half the gap that is bridged between two of them [ns].

    Parameters
    ----------
    n_bridged
        So many beacons lost in a row are bridged as well.
    """
    # 1.15 beacon periods: one lost beacon and its jitter (Encounternet joins gaps below a pulse period and its slack, Rutz et al. 2015).
    for_error_ns = error_ns  # as if, not min and max: this is asked for each report, and a call costs as much as all the rest
    if error_ns > MAX_ERROR_MARGIN_NS:
        for_error_ns = MAX_ERROR_MARGIN_NS if error_ns < _ASSUMED_ERROR_NS else _ASSUMED_MARGIN_NS
    if not beacon_period_ms:
        return for_error_ns
    return max(for_error_ns, (1 + n_bridged) * beacon_period_ms * NS_PER_MS * 115 // 200)


@dataclass(slots=True, kw_only=True)
class EncounterMerger:
    """Turns reports into encounter records and their revisions; remembers what ``forget_before`` has not dropped."""

    issuer: RecordIssuer
    loss: BeaconLoss = field(default_factory=BeaconLoss)
    """How many beacons are lost, as far as the encounters tell."""
    _meetings: dict[_Pair, list[Meeting]] = field(default_factory=dict)
    """Of each pair, in the order of their covers, which do not overlap."""
    _order: deque[tuple[_Pair, Meeting]] = field(default_factory=deque)
    """All of them in the order in which they were told of, and those that became a part of another one since."""
    _to_come_again: set[_Pair] = field(default_factory=set)
    """Pairs of which something is told again, when it has ended or its clock is known: of others no encounter is told twice."""
    _voided: set[tuple[BootId, int]] = field(default_factory=set)
    """Identities that became a part of another one, and whose last revision may not be on disk yet: no more than wait for the disk."""
    _voided_before: set[tuple[BootId, int]] = field(default_factory=set)
    """The same, of before the last ``settle_voided``."""

    def merge(self, report: SideReport) -> list[EncounterRecord]:
        """Take a report; return the records it brings about, none where it says nothing new.

        A report that joins two published encounters extends the earlier one and voids the later one. Records carry a
        provisional offset; the journal gives the real one.
        """
        node, peer = report.node, report.peer
        pair = (node, peer) if node < peer else (peer, node)
        meetings = self._meetings.get(pair)
        if meetings is None:
            meetings = self._meetings[pair] = []
        if report.period_ns and not report.is_ongoing:
            self._learn(meetings[-1] if meetings else None, report)
        begin, end = _overlap(meetings, report.t_start_ns - report.margin_ns, report.t_end_ns + report.margin_ns)
        if report.is_ongoing or pair in self._to_come_again:
            self._to_come_again.add(pair)
            told = [one for at, one in enumerate(meetings) if has_told(one, report, is_near=begin <= at < end)]
            if told:
                return self._gather(pair, meetings, report, told)
        if begin == end:
            meeting = meeting_of(report, boot=self.issuer.boot, sequence=self.issuer.take_sequence())
            meetings.insert(begin, meeting)
            self._order.append((pair, meeting))
            return [meeting.record(pair, issuer=self.issuer, guesses=self.loss.now)]
        if end - begin > 1:
            return self._join(pair, meetings, report, begin, end)
        meeting = meetings[begin]
        if not meeting.take(report):
            return []
        meeting.revision += 1
        return [meeting.record(pair, issuer=self.issuer, guesses=self.loss.now)]

    def restore(
        self,
        records: Iterable[EncounterRecord],
        *,
        margin: Callable[[EncounterRecord], int],
        period: Callable[[EncounterRecord], int] = lambda _: 0,
    ) -> None:
        """Remember records of the journal, in the order of their offsets; those already remembered are left as they are.

        With other margins than they were told with, covers of one pair may overlap: these records stay apart, and their covers are parted.

        Parameters
        ----------
        margin, period
            Give the margin and the beacon period [ns] of a record, by what is known of its biobots.
        """
        newest = {(record.boot, record.sequence): record for record in records}
        known_of: dict[_Pair, set[tuple[BootId, int]]] = {}
        for identity, record in newest.items():
            if record.is_void or not record.sides or identity in self._voided or identity in self._voided_before:
                continue
            pair = (record.node_a, record.node_b)
            meetings = self._meetings.setdefault(pair, [])
            known = known_of.get(pair)
            if known is None:
                known = known_of[pair] = {meeting.identity for meeting in meetings}
            if identity in known:
                continue
            known.add(identity)
            meeting = meeting_of_record(record, issuer=self.issuer, margin_ns=margin(record), period_ns=period(record))
            # By what was heard: covers may have been cut for those restored before.
            at = bisect_right(meetings, meeting.heard_from_ns, key=_heard_from)
            if at:
                part(meetings[at - 1], meeting)
            if at < len(meetings):
                part(meeting, meetings[at])
            meetings.insert(at, meeting)
            self._order.append((pair, meeting))
            if record.is_ongoing:
                self._to_come_again.add(pair)

    def expect_again(self, node: NodeId, peer: NodeId) -> None:
        """Say that what is told of a pair now is to be told again, by a clock that is known better."""
        self._to_come_again.add((node, peer) if node < peer else (peer, node))

    def settle_voided(self) -> None:
        """Say that all that was told of before the last time this was said is on disk: the journal now tells itself what is void."""
        self._voided, self._voided_before = set(), self._voided

    def end_of_oldest(self, limit: int) -> int:
        """Return before when encounters end that are more than ``limit``, those told of first [ns]; 0: there are no more."""
        n_old = min(len(self._order) - limit, _MAX_EXCESS)
        return max((meeting.cover_end_ns for _, meeting in islice(self._order, max(n_old, 0))), default=-1) + 1

    def forget_before(self, t_ns: int, *, spare: Collection[_Pair] = (), limit: int | None = None) -> bool:
        """Drop what ended before ``t_ns``, in the order in which it was told of; what stands behind a later one waits for that one.

        Parameters
        ----------
        spare
            Pairs of which nothing is dropped now.
        limit
            Look at no more than so many; None: at all.

        Returns
        -------
        bool
            There may be more.
        """
        order = self._order
        n_left = len(order) if limit is None else min(limit, len(order))
        while n_left and order[0][1].cover_end_ns < t_ns:
            n_left -= 1
            pair, meeting = entry = order.popleft()
            if pair in spare:
                order.append(entry)
                continue
            meetings = self._meetings.get(pair, [])
            for at, known in enumerate(meetings):
                if known is meeting:
                    del meetings[at]
                    break
            if not meetings:
                self._meetings.pop(pair, None)
                self._to_come_again.discard(pair)
        return not n_left and bool(order) and order[0][1].cover_end_ns < t_ns

    def __len__(self) -> int:
        return len(self._order)

    def _learn(self, latest: Meeting | None, report: SideReport) -> None:
        """Learn from a report, and from the pair's latest encounter before it, how many beacons are lost."""
        side = None if latest is None else latest.side_a if report.node < report.peer else latest.side_b
        gap_ns = 0 if side is None else report.t_start_ns - side.t_end_ns
        self.loss.observe(duration=(report.t_end_ns - report.t_start_ns) / report.period_ns, gap=gap_ns / report.period_ns)

    def _gather(self, pair: _Pair, meetings: list[Meeting], report: SideReport, told: list[Meeting]) -> list[EncounterRecord]:
        """Make one encounter of those that a report's biobot told of by another date, and of those that the report connects now."""
        for meeting in told:
            report = date_alike(meeting, report)
        for meeting in told:  # by the best of them all
            report = date_alike(meeting, report)
        cover_start_ns, cover_end_ns = report.t_start_ns - report.margin_ns, report.t_end_ns + report.margin_ns
        apart = [one for one in meetings if all(one is not meeting for meeting in told)]
        while True:
            cover_start_ns = min(cover_start_ns, *(one.cover_start_ns for one in told))
            cover_end_ns = max(cover_end_ns, *(one.cover_end_ns for one in told))
            begin, end = _overlap(apart, cover_start_ns, cover_end_ns)
            if begin == end:
                break
            told += apart[begin:end]
            del apart[begin:end]
        meetings[:] = [*apart[:begin], *told, *apart[begin:]]
        return self._join(pair, meetings, report, begin, begin + len(told))

    def _join(self, pair: _Pair, meetings: list[Meeting], report: SideReport, begin: int, end: int) -> list[EncounterRecord]:
        """Make one encounter of several that a report connects."""
        kept, *voided = sorted(meetings[begin:end], key=_identity)
        for meeting in voided:
            kept.absorb(meeting)
            self._voided.add(meeting.identity)
        kept.take(report)
        meetings[begin:end] = [kept]
        records = []
        for meeting in (kept, *voided):
            meeting.revision += 1
            records.append(meeting.record(pair, issuer=self.issuer, guesses=self.loss.now, is_void=meeting is not kept))
        return records


def _heard_from(meeting: Meeting) -> int:
    return meeting.heard_from_ns


def _overlap(meetings: list[Meeting], cover_start_ns: int, cover_end_ns: int) -> tuple[int, int]:
    """Return begin and end of the slice of ``meetings`` whose covers overlap a span; the latest of them is looked at first."""
    end = len(meetings)
    if not end:
        return 0, 0
    last = meetings[-1]
    if last.cover_end_ns < cover_start_ns:
        return end, end
    if last.cover_start_ns > cover_end_ns:
        end = bisect_right(meetings, cover_end_ns, key=_cover_start)
    begin = end
    while begin and meetings[begin - 1].cover_end_ns >= cover_start_ns:
        begin -= 1
    return begin, end


def _cover_start(meeting: Meeting) -> int:
    return meeting.cover_start_ns


def _identity(meeting: Meeting) -> tuple[int, int]:
    return meeting.identity
