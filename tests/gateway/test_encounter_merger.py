"""Laws of merging the two sides' reports."""

from itertools import pairwise

import msgspec.structs
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import EncounterRecord
from firmware_protocol.units import NS_PER_MS, RSSI_UNKNOWN, Nanoseconds, NodeId, RssiDbm
from gateway.encounters import EncounterMerger, SideReport, margin_of
from tests.gateway.makers import an_issuer, newest_encounters

_MS = NS_PER_MS


def _report(
    node: int, peer: int, start: int, end: int, *, margin: int = 5, is_ongoing: bool = False, rssi: int = -60, path: int | None = None
) -> SideReport:
    """A report with times in ms."""
    return SideReport(
        node=NodeId(node),
        peer=NodeId(peer),
        t_start_ns=Nanoseconds(start * _MS),
        t_end_ns=Nanoseconds(end * _MS),
        error_ns=Nanoseconds(margin * _MS),
        rssi_dbm=RssiDbm(rssi),
        is_ongoing=is_ongoing,
        margin_ns=margin * _MS,
        path_mm=path,
    )


@st.composite
def _reports(draw: st.DrawFn) -> list[SideReport]:
    reports = []
    for _ in range(draw(st.integers(1, 12))):
        node, peer = draw(st.permutations([1, 2, 3]))[:2]
        start = draw(st.integers(0, 400))
        end = start + draw(st.integers(0, 60))
        margin = draw(st.sampled_from([0, 2, 5, 30]))
        rssi = draw(st.integers(-90, -40) | st.just(RSSI_UNKNOWN))
        path = draw(st.none() | st.integers(0, 3))
        reports.append(_report(node, peer, start, end, margin=margin, is_ongoing=draw(st.booleans()), rssi=rssi, path=path))
    return reports


def _facts(records: list[EncounterRecord]) -> list[tuple[object, ...]]:
    return [
        (one.node_a, one.node_b, one.t_start_ns, one.t_end_ns, one.error_ns, one.is_reciprocal, one.is_ongoing, one.sides)
        for one in newest_encounters(records)
    ]


def _merge_all(reports: list[SideReport]) -> list[EncounterRecord]:
    merger = EncounterMerger(issuer=an_issuer())
    return [record for report in reports for record in merger.merge(report)]


def _obvious(reports: list[SideReport]) -> list[tuple[int, int, int, int]]:
    """Connected pieces by comparing all pairs: slow and plain."""
    pieces: list[list[SideReport]] = []
    for report in reports:
        touching = [
            piece
            for piece in pieces
            if any(
                {one.node, one.peer} == {report.node, report.peer}
                and one.t_start_ns - one.margin_ns <= report.t_end_ns + report.margin_ns
                and report.t_start_ns - report.margin_ns <= one.t_end_ns + one.margin_ns
                for one in piece
            )
        ]
        pieces = [piece for piece in pieces if piece not in touching] + [[report, *(one for piece in touching for one in piece)]]
    return sorted(
        (
            min(piece[0].node, piece[0].peer),
            max(piece[0].node, piece[0].peer),
            min(o.t_start_ns for o in piece),
            max(o.t_end_ns for o in piece),
        )
        for piece in pieces
    )


@given(_reports(), st.data())
def test_any_order_and_repetition_of_the_reports_ends_in_the_same_encounters(reports: list[SideReport], data: st.DataObject) -> None:
    shuffled = data.draw(st.permutations(reports)) + data.draw(st.lists(st.sampled_from(reports), max_size=4))
    assert _facts(_merge_all(shuffled)) == _facts(_merge_all(reports))


@given(_reports())
def test_the_merger_agrees_with_comparing_all_pairs(reports: list[SideReport]) -> None:
    assert [fact[:4] for fact in _facts(_merge_all(reports))] == _obvious(reports)


@given(_reports())
def test_revisions_of_a_record_count_up_by_one_and_a_void_one_is_the_last(reports: list[SideReport]) -> None:
    by_identity: dict[object, list[EncounterRecord]] = {}
    for record in _merge_all(reports):
        by_identity.setdefault(record.identity, []).append(record)
    for revisions in by_identity.values():
        assert [record.revision for record in revisions] == list(range(len(revisions)))
        assert not any(record.is_void for record in revisions[:-1])
        for older, newer in pairwise(revisions):
            assert older != newer
            assert newer.t_start_ns <= older.t_start_ns
            assert newer.t_end_ns >= older.t_end_ns


@given(_reports(), st.integers(0, 12), st.integers(-500, 500))
def test_a_restart_in_between_changes_no_encounter(reports: list[SideReport], n_before: int, anchor_ms: int) -> None:
    """Margins are alike here: a record does not tell its reports' margins, the journal's reader gives them anew."""
    reports = [_report(r.node, r.peer, r.t_start_ns // _MS, r.t_end_ns // _MS, rssi=r.rssi_dbm, is_ongoing=r.is_ongoing) for r in reports]
    first = EncounterMerger(issuer=an_issuer())
    published = [record for report in reports[:n_before] for record in first.merge(report)]
    second = EncounterMerger(issuer=an_issuer(boot=2, anchor_ns=anchor_ms * _MS))
    second.restore(published, margin=lambda _: 5 * _MS)
    shift_ns = anchor_ms * _MS
    for old in reports[n_before:]:
        published += second.merge(
            msgspec.structs.replace(old, t_start_ns=Nanoseconds(old.t_start_ns - shift_ns), t_end_ns=Nanoseconds(old.t_end_ns - shift_ns))
        )
    found = [
        (one.node_a, one.node_b, one.t_start_ns + one.wall_anchor_ns, one.t_end_ns + one.wall_anchor_ns)
        for one in newest_encounters(published)
    ]
    assert sorted(found) == _obvious(reports)


def test_the_first_report_is_published_at_once_and_a_repeat_says_nothing() -> None:
    merger = EncounterMerger(issuer=an_issuer())
    (first,) = merger.merge(_report(2, 1, 0, 100))
    assert (first.revision, first.is_reciprocal, first.node_a, first.node_b) == (0, False, 1, 2)
    assert merger.merge(_report(2, 1, 0, 100)) == []
    (second,) = merger.merge(_report(1, 2, 3, 101))
    assert (second.revision, second.is_reciprocal, second.t_start_ns, second.t_end_ns) == (1, True, 0, 101 * _MS)


def test_a_report_that_bridges_two_records_extends_the_earlier_and_voids_the_later() -> None:
    merger = EncounterMerger(issuer=an_issuer())
    (one,) = merger.merge(_report(1, 2, 0, 100))
    (two,) = merger.merge(_report(1, 2, 300, 400))
    extended, void = merger.merge(_report(2, 1, 0, 400))
    assert (extended.identity, extended.is_void, extended.t_end_ns) == (one.identity, False, 400 * _MS)
    assert (void.identity, void.is_void, void.revision) == (two.identity, True, 1)


def test_an_ongoing_encounter_is_extended_and_ends() -> None:
    merger = EncounterMerger(issuer=an_issuer())
    (begun,) = merger.merge(_report(1, 2, 0, 30_000, is_ongoing=True))
    (ended,) = merger.merge(_report(1, 2, 0, 47_000))
    assert (begun.is_ongoing, ended.is_ongoing) == (True, False)
    assert ended.t_end_ns == 47_000 * _MS


def test_a_gap_up_to_1_15_beacon_periods_is_bridged_and_a_longer_one_is_not() -> None:
    """Period 1000 ms: the margins are 575 ms on both sides, so 1150 ms are bridged and 1152 ms are not."""
    margin = margin_of(beacon_period_ms=1000, error_ns=0) // _MS
    assert margin == 575
    for gap, n_encounters in ((1150, 1), (1152, 2)):
        records = _merge_all([_report(1, 2, 0, 5000, margin=margin), _report(1, 2, 5000 + gap, 9000, margin=margin)])
        assert len(newest_encounters(records)) == n_encounters


def test_what_is_forgotten_and_restored_is_the_same_record() -> None:
    merger = EncounterMerger(issuer=an_issuer())
    published = merger.merge(_report(1, 2, 0, 100))
    merger.forget_before(10_000 * _MS)
    assert len(merger) == 0
    merger.restore(published, margin=lambda _: 5 * _MS)
    merger.restore(published, margin=lambda _: 5 * _MS)
    assert len(merger) == 1
    (revised,) = merger.merge(_report(2, 1, 50, 120))
    assert (revised.identity, revised.revision) == (published[0].identity, 1)


def test_the_path_to_a_meeting_is_that_of_its_first_report_and_an_unknown_strength_is_no_strength() -> None:
    merger = EncounterMerger(issuer=an_issuer())
    merger.merge(_report(1, 2, 100, 200, path=50, rssi=RSSI_UNKNOWN))
    (grown,) = merger.merge(_report(1, 2, 0, 100, path=700, rssi=-80))
    assert [(side.path_mm, side.rssi_dbm) for side in grown.sides] == [(700, -80)]
    (later,) = merger.merge(_report(1, 2, 200, 300, path=20, rssi=-90))
    assert [(side.path_mm, side.rssi_dbm) for side in later.sides] == [(700, -80)]
