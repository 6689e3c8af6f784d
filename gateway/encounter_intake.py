"""What becomes of one entry of an encounter report: dated, put beside what is known of the pair, in memory or from the journal."""

import sqlite3

from firmware_protocol.contract.records import EncounterRecord
from firmware_protocol.messages import BROADCAST_NODE, EncounterEntry, UplinkHeader
from firmware_protocol.units import NS_PER_MS, NS_PER_S, Nanoseconds
from gateway.clocks import NodeClock
from gateway.encounters import EncounterMerger, SideReport, margin_of
from gateway.health import Health
from gateway.issuer import RecordIssuer
from gateway.journal_file import JournalReader
from gateway.nodes import Node, NodeBook

MAX_AHEAD_MS = 1_000
"""A time this far after the message was sent cannot be; less may come from rounding."""

_ABSENT_AFTER_NS = 120 * NS_PER_S
"""A biobot that was last heard so long before another is out of range of this gateway: only the other reports what the two share."""

_RECALL_SLACK_NS = 10 * NS_PER_S
"""Encounters this far around a late report, beside twice its margin, are brought back: more than the error of any clock."""


class EncounterIntake:
    """Takes entries of reports; see the module's description. Belongs to one event loop."""

    def __init__(self, *, issuer: RecordIssuer, nodes: NodeBook, reader: JournalReader, health: Health, now_ns: int) -> None:
        self._issuer = issuer
        self._nodes = nodes
        self._reader = reader
        self._health = health
        self._horizon_ns = now_ns
        self._merger = EncounterMerger(issuer=issuer)

    def __len__(self) -> int:
        return len(self._merger)

    def forget_before(self, t_ns: int) -> None:
        """Drop what ended before ``t_ns`` from memory; the journal has it."""
        self._horizon_ns = max(self._horizon_ns, t_ns)
        self._merger.forget_before(self._horizon_ns)

    def take(self, entry: EncounterEntry, *, header: UplinkHeader, node: Node, clock: NodeClock) -> list[EncounterRecord]:
        """Take one entry of a biobot's report; return the records that it brings about."""
        end_ms = entry.start_ms + entry.duration_ms
        if entry.peer in {header.node, BROADCAST_NODE} or end_ms > header.sent_ms + MAX_AHEAD_MS:
            self._health.count("encounter.impossible")
            return []
        t_start_ns, t_end_ns, error_ns = clock.read_span(entry.start_ms, end_ms)
        peer = self._nodes.find(entry.peer)
        period_ms = self._period_ms(node, peer)
        margin_ns = margin_of(beacon_period_ms=period_ms, error_ns=error_ns, n_bridged=self._n_bridged(node, peer))
        report = SideReport(
            node=header.node,
            peer=entry.peer,
            t_start_ns=Nanoseconds(t_start_ns),
            t_end_ns=Nanoseconds(t_end_ns),
            error_ns=Nanoseconds(error_ns),
            rssi_dbm=entry.rssi_dbm,
            is_ongoing=entry.is_ongoing,
            margin_ns=margin_ns,
            period_ns=period_ms * NS_PER_MS,
            path_mm=entry.path_mm,
        )
        if t_start_ns - margin_ns <= self._horizon_ns:
            self._recall(report)
        self._health.count("encounter.reports")
        return self._merger.merge(report)

    @staticmethod
    def _period_ms(*nodes: Node | None) -> int:
        """Return the pause between the beacons of a pair [ms], the longer one; 0: neither sends any, or has said so."""
        return max((node.beacon_period_ms for node in nodes if node is not None), default=0)

    def _recall(self, report: SideReport) -> None:
        """Bring back from the journal what the merger has forgotten and this late report may belong to."""
        node_a, node_b = sorted((report.node, report.peer))
        # What is known of an encounter's ends grows better, so a later revision may be shorter than an earlier one by up to two
        # periods: less than four margins. Of what is found, only that counts whose newest revision is near.
        slack_ns = 6 * report.margin_ns + _RECALL_SLACK_NS
        from_wall_ns, to_wall_ns = self._issuer.to_recorded_wall_ns(report.t_start_ns - slack_ns, report.t_end_ns + slack_ns)
        try:
            records = self._reader.read_pair(node_a=node_a, node_b=node_b, from_wall_ns=from_wall_ns, to_wall_ns=to_wall_ns)
        except sqlite3.Error:
            # The report is kept as an encounter of its own; its other half, if there is one, stays another.
            self._health.count("encounter.unread_journal")
            return
        newest = {record.identity: record for record in records}
        near_ns = 4 * report.margin_ns
        near = [one for one in newest.values() if _is_near(one, from_wall_ns=from_wall_ns + near_ns, to_wall_ns=to_wall_ns - near_ns)]
        if near:
            self._merger.restore(near, margin=self._margin_of_record, period=lambda record: self._period_ms_of(record) * NS_PER_MS)

    def _n_bridged(self, node: Node | None, peer: Node | None) -> int:
        """Return how many lost beacons in a row are bridged: more where the other's reports are not to be expected here."""
        guesses = self._merger.loss.now
        is_alone = node is None or peer is None or abs(node.last_heard_ns - peer.last_heard_ns) > _ABSENT_AFTER_NS
        return guesses.n_bridged_alone if is_alone else guesses.n_bridged

    def _period_ms_of(self, record: EncounterRecord) -> int:
        return self._period_ms(self._nodes.find(record.node_a), self._nodes.find(record.node_b))

    def _margin_of_record(self, record: EncounterRecord) -> int:
        error_ns = max((side.error_ns or record.error_ns for side in record.sides), default=record.error_ns)
        n_bridged = self._n_bridged(self._nodes.find(record.node_a), self._nodes.find(record.node_b))
        return margin_of(beacon_period_ms=self._period_ms_of(record), error_ns=error_ns, n_bridged=n_bridged)


def _is_near(record: EncounterRecord, *, from_wall_ns: int, to_wall_ns: int) -> bool:
    return record.t_start_ns + record.wall_anchor_ns <= to_wall_ns and record.t_end_ns + record.wall_anchor_ns >= from_wall_ns
