"""The entries of encounter batches, dated and merged: the gateway's most frequent work, on plain numbers.

Encounters leave memory when they are older than the window, or when there are too many of them; a late report brings them back from the
journal. After a start the first report brings back all of the last window at once, for many late ones follow.
"""

import asyncio
import sqlite3
from collections import deque
from collections.abc import Iterable, Sequence

from firmware_protocol.contract.records import EncounterRecord, OwnSpan
from firmware_protocol.errors import RecordError
from firmware_protocol.message_codec import EncounterFields
from firmware_protocol.messages import BROADCAST_NODE
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, NodeId
from gateway.clocks import NodeClock
from gateway.config import EncounterTable
from gateway.encounters import EncounterMerger, SideReport, margin_of
from gateway.health import Health
from gateway.issuer import RecordIssuer
from gateway.journal_file import JournalReader
from gateway.nodes import Node, NodeBook

MAX_AHEAD_MS = 1_000
"""A time this far after the message was sent cannot be; less may come from rounding."""

_FORGOTTEN_AT_ONCE = 1_000
"""Encounters that are forgotten in one step of the loop: about a millisecond."""

_ABSENT_AFTER_NS = 120 * NS_PER_S
"""A biobot that was last heard so long before another is out of range of this gateway: only the other reports what the two share."""

_MAX_BROUGHT_BACK = 20_000
"""Encounters that are brought back together after a start: a fifth of a second. Of more than these, only the latest."""

_MAX_BADLY_DATED, _MAX_LIVES_BADLY_DATED = 256, 256
"""So many reports of so many starts of backpacks are dated anew when the clock is known, 10 MB at most; of more, the first dates stay."""

_BEFORE_ALL_NS, _AFTER_ALL_NS = -(1 << 62), (1 << 63) - 1

_RECALL_SLACK_NS = 10 * NS_PER_S
"""Encounters this far around a late report, beside twice its margin, are brought back: more than the error of any clock."""


class EncounterReports:
    """See the module. Belongs to one event loop.

    Parameters
    ----------
    config
        How long an encounter stays in memory after its end, and how many do.
    now_ns
        What ended before this is in the journal alone.
    """

    def __init__(
        self, *, issuer: RecordIssuer, reader: JournalReader, nodes: NodeBook, health: Health, config: EncounterTable, now_ns: int
    ) -> None:
        self._issuer = issuer
        self._reader = reader
        self._nodes = nodes
        self._health = health
        self._window_ns, self._max_in_memory = int(config.window_s * NS_PER_S), config.max_in_memory
        self._horizon_ns = self._next_horizon_ns = now_ns + _RECALL_SLACK_NS  # what the journal has may end a little later than now
        self.max_brought_back = _MAX_BROUGHT_BACK
        self._is_fresh = True
        """No report has come yet, so all that is known is in the journal."""
        self._late_pairs: set[tuple[NodeId, NodeId]] = set()
        """Of reports older than the next horizon that may not be on disk yet."""
        self._is_forgetting = False
        self._badly_dated: dict[tuple[NodeId, BootId], deque[EncounterFields]] = {}
        """What each start of a backpack told before its clock was settled."""
        self._merger = EncounterMerger(issuer=issuer)

    def take(
        self, entries: Sequence[EncounterFields], *, node: Node, boot: BootId, sent_ms: int, clock: NodeClock
    ) -> list[EncounterRecord]:
        """Return the records that the entries of a biobot's message bring about. ``clock`` is that of the message's boot.

        What it told before its clock was settled is dated anew with the first message after that, with entries or without.
        """
        if self._is_fresh:
            self._bring_back()
        name, latest_ms = node.node, sent_ms + MAX_AHEAD_MS
        taken = [one for one in entries if one[0] != name and one[0] != BROADCAST_NODE and one[1] + one[2] <= latest_ms]
        self._health.count("encounter.reports", len(taken))
        if len(taken) < len(entries):
            self._health.count("encounter.impossible", len(entries) - len(taken))
        records: list[EncounterRecord] = []
        if not clock.is_settled:
            self._note_badly_dated(name, boot, taken)
        elif self._badly_dated:
            taken = [*self._badly_dated.pop((name, boot), ()), *taken]
        if not taken:
            return records
        merge, find, n_bridged = self._merger.merge, self._nodes.find, self._n_bridged
        own_period_ms, next_horizon_ns = node.beacon_period_ms, self._next_horizon_ns
        spans = clock.read_spans([(start_ms, start_ms + duration_ms) for _, start_ms, duration_ms, *_ in taken])
        for (peer, start_ms, duration_ms, rssi_dbm, is_ongoing, path_mm), (t_start_ns, t_end_ns, error_ns) in zip(
            taken, spans, strict=True
        ):
            other = find(peer)
            period_ms = own_period_ms if other is None or other.beacon_period_ms < own_period_ms else other.beacon_period_ms
            margin_ns = margin_of(beacon_period_ms=period_ms, error_ns=error_ns, n_bridged=n_bridged(node, other) if period_ms else 0)
            report = SideReport(
                node=name,
                peer=peer,
                t_start_ns=t_start_ns,
                t_end_ns=t_end_ns,
                error_ns=error_ns,
                rssi_dbm=rssi_dbm,
                is_ongoing=is_ongoing,
                margin_ns=margin_ns,
                period_ns=period_ms * NS_PER_MS,
                path_mm=path_mm,
                own_clock=OwnSpan(boot, start_ms, start_ms + duration_ms),
            )
            if t_start_ns - margin_ns <= next_horizon_ns:
                self._late_pairs.add((name, peer) if name < peer else (peer, name))
                if t_start_ns - margin_ns <= self._horizon_ns:
                    self._recall(report)
            records += merge(report)
        return records

    def _note_badly_dated(self, name: NodeId, boot: BootId, entries: Sequence[EncounterFields]) -> None:
        """Keep in mind what is to be dated anew; of too much, what was told last."""
        known = self._badly_dated.setdefault((name, boot), deque(maxlen=_MAX_BADLY_DATED))
        known += entries
        for peer, *_ in entries:
            self._merger.expect_again(name, peer)
        if len(self._badly_dated) > _MAX_LIVES_BADLY_DATED:
            del self._badly_dated[next(iter(self._badly_dated))]

    def begin_forgetting(self, *, now_ns: int) -> bool:
        """Choose what is to be forgotten: what is older than the window, and the oldest of too many; False where that is under way.

        ``forget_old`` does it, when all that was reported until now is on disk; what is reported late until then stays.
        """
        if self._is_forgetting:
            return False
        self._is_forgetting = True
        self._late_pairs.clear()
        self._merger.settle_voided()  # what was told before the last choice is on disk: that was waited for
        self._next_horizon_ns = max(self._next_horizon_ns, now_ns - self._window_ns, self._merger.end_of_oldest(self._max_in_memory))
        return True

    def forget_old(self, n_left: int | None = None) -> None:
        """Forget what ``begin_forgetting`` chose, a little at each step of the loop; ``n_left`` are still to be looked at."""
        self._horizon_ns = self._next_horizon_ns
        n_left = len(self._merger) if n_left is None else n_left
        n_now = min(n_left, _FORGOTTEN_AT_ONCE)
        if self._merger.forget_before(self._horizon_ns, spare=self._late_pairs, limit=n_now) and n_left > n_now:
            asyncio.get_running_loop().call_soon(self.forget_old, n_left - n_now)
            return
        self._is_forgetting = False
        self._health.set_level("encounters.in_memory", len(self._merger))

    def _bring_back(self) -> None:
        """Bring back what the journal has of its last window, or the latest part of that; what is older is recalled pair by pair."""
        self._is_fresh = False
        try:
            latest_ns = self._reader.read_latest_end()
            if latest_ns is None:
                self._horizon_ns = self._next_horizon_ns = _BEFORE_ALL_NS
                return
            latest_ns = min(latest_ns, self._issuer.to_wall_ns(self._horizon_ns))
            span_ns, newest = self._window_ns, self._read_latest(latest_ns - self._window_ns)
            while newest is None and span_ns > NS_PER_S:
                span_ns //= 4
                newest = self._read_latest(latest_ns - span_ns)
        except (sqlite3.Error, RecordError):
            self._health.count("encounter.unread_journal")
            return
        if newest is None:
            return
        # As in ``_recall``: of what is found, only that counts whose newest revision is in the span as well, on this start's clock: before
        # the earliest anchor's span, a later revision of what an earlier start told may lie unseen.
        near_ns = 4 * max(map(self._margin_of_record, newest), default=0)
        first_anchor_ns, _ = self._issuer.to_recorded_wall_ns(0, 0)
        from_ns = latest_ns - span_ns + near_ns - first_anchor_ns
        self._restore(record for record in newest if self._own_span(record)[1] >= from_ns)
        self._horizon_ns = self._next_horizon_ns = min(self._horizon_ns, from_ns + _RECALL_SLACK_NS)

    def _read_latest(self, from_wall_ns: int) -> list[EncounterRecord] | None:
        """Return the newest revisions of what ended after an instant, or None where these are too many."""
        newest: dict[tuple[int, int], EncounterRecord] = {}
        for record in self._reader.read_encounters(from_wall_ns=from_wall_ns, to_wall_ns=_AFTER_ALL_NS):
            newest[record.boot, record.sequence] = record
            if len(newest) > self.max_brought_back:
                return None
        return list(newest.values())

    def _restore(self, records: Iterable[EncounterRecord]) -> None:
        self._merger.restore(records, margin=self._margin_of_record, period=lambda record: self._period_ms_of(record) * NS_PER_MS)

    def _recall(self, report: SideReport) -> None:
        """Bring back from the journal what the merger has forgotten and this late report may belong to."""
        node_a, node_b = sorted((report.node, report.peer))
        # What is known of an encounter's ends grows better, so a later revision may be shorter than an earlier one by up to two
        # periods: less than four margins. Of what is found, only that counts whose newest revision is near, on this start's clock: the wall
        # clock may have been set between two revisions, and an earlier one lie in the span without the later one.
        slack_ns = 6 * report.margin_ns + _RECALL_SLACK_NS
        from_wall_ns, to_wall_ns = self._issuer.to_recorded_wall_ns(report.t_start_ns - slack_ns, report.t_end_ns + slack_ns)
        try:
            records = self._reader.read_pair(node_a=node_a, node_b=node_b, from_wall_ns=from_wall_ns, to_wall_ns=to_wall_ns)
        except (sqlite3.Error, RecordError):
            # The report is kept as an encounter of its own; its other half, if there is one, stays another.
            self._health.count("encounter.unread_journal")
            return
        newest = {record.identity: record for record in records}
        near_ns = slack_ns - 4 * report.margin_ns
        from_ns, to_ns = report.t_start_ns - near_ns, report.t_end_ns + near_ns
        spans = ((one, *self._own_span(one)) for one in newest.values())
        near = [one for one, start_ns, end_ns in spans if start_ns <= to_ns and end_ns >= from_ns]
        if near:
            self._restore(near)

    def _own_span(self, record: EncounterRecord) -> tuple[int, int]:
        """Return when a record begins and ends on this start's clock."""
        own, anchor_ns = self._issuer.to_own_monotonic_ns, record.wall_anchor_ns
        return own(record.t_start_ns, anchor_ns=anchor_ns), own(record.t_end_ns, anchor_ns=anchor_ns)

    def _n_bridged(self, node: Node | None, peer: Node | None) -> int:
        """Return how many lost beacons in a row are bridged: more where the other's reports are not to be expected here."""
        guesses = self._merger.loss.now
        is_alone = node is None or peer is None or abs(node.last_heard_ns - peer.last_heard_ns) > _ABSENT_AFTER_NS
        return guesses.n_bridged_alone if is_alone else guesses.n_bridged

    def _period_ms_of(self, record: EncounterRecord) -> int:
        """Return the pause between the beacons of a pair [ms], the longer one; 0: neither sends any, or has said so."""
        nodes = (self._nodes.find(record.node_a), self._nodes.find(record.node_b))
        return max((node.beacon_period_ms for node in nodes if node is not None), default=0)

    def _margin_of_record(self, record: EncounterRecord) -> int:
        error_ns = max((side.error_ns or record.error_ns for side in record.sides), default=record.error_ns)
        n_bridged = self._n_bridged(self._nodes.find(record.node_a), self._nodes.find(record.node_b))
        return margin_of(beacon_period_ms=self._period_ms_of(record), error_ns=error_ns, n_bridged=n_bridged)
