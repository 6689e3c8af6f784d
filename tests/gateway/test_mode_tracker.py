"""Laws of mode spells."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode, ModeRecord
from firmware_protocol.units import NS_PER_MS, BootId, Milliseconds, Nanoseconds, NodeId
from gateway.modes import ModeReport, ModeTracker
from tests.gateway.makers import an_issuer, newest_modes

_CHANGES = ((0, Mode.CRW), (5_000, Mode.S), (9_000, Mode.CRW), (20_000, Mode.S), (31_000, Mode.CRW))


def _report(
    since_ms: int, mode: Mode, *, cause: Cause = Cause.NATURAL, is_from_reply: bool = False, boot: int = 1, shift: int = 0
) -> ModeReport:
    return ModeReport(
        node=NodeId(1),
        boot=BootId(boot),
        since_ms=Milliseconds(since_ms),
        t_start_ns=Nanoseconds((since_ms + shift) * NS_PER_MS),
        error_ns=Nanoseconds(NS_PER_MS),
        mode=mode,
        cause=cause,
        is_from_reply=is_from_reply,
    )


@given(st.permutations(_CHANGES), st.lists(st.sampled_from(_CHANGES), max_size=5))
def test_any_order_and_repetition_of_reports_gives_the_same_spells(order: list[tuple[int, Mode]], again: list[tuple[int, Mode]]) -> None:
    tracker = ModeTracker(issuer=an_issuer())
    records: list[ModeRecord] = []
    for since_ms, mode in [*order, *again]:
        records += tracker.observe(_report(since_ms, mode))
    ends = [since_ms * NS_PER_MS for since_ms, _ in _CHANGES[1:]]
    assert newest_modes(records) == [
        (mode, since_ms * NS_PER_MS, end) for (since_ms, mode), end in zip(_CHANGES, [*ends, None], strict=True)
    ]


def test_a_commands_reply_and_the_status_after_it_are_one_spell() -> None:
    tracker = ModeTracker(issuer=an_issuer())
    tracker.observe(_report(0, Mode.CRW))
    closed, begun = tracker.observe(_report(5_000, Mode.S, cause=Cause.COMMAND, is_from_reply=True))
    assert (closed.revision, closed.t_end_ns, begun.t_end_ns) == (1, 5_000 * NS_PER_MS, None)
    assert tracker.observe(_report(5_300, Mode.S, cause=Cause.COMMAND)) == []
    assert tracker.observe(_report(5_000, Mode.S, cause=Cause.COMMAND, is_from_reply=True)) == []


def test_a_status_corrects_the_cause_that_a_reply_made_believe() -> None:
    tracker = ModeTracker(issuer=an_issuer())
    (begun,) = tracker.observe(_report(5_000, Mode.CRW, cause=Cause.COMMAND, is_from_reply=True))
    (revised,) = tracker.observe(_report(5_000, Mode.CRW, cause=Cause.NATURAL))
    assert (revised.identity, revised.revision, revised.cause) == (begun.identity, 1, Cause.NATURAL)


def test_a_start_while_it_walks_begins_no_spell() -> None:
    tracker = ModeTracker(issuer=an_issuer())
    tracker.observe(_report(0, Mode.CRW))
    assert tracker.observe(_report(7_000, Mode.CRW, cause=Cause.COMMAND, is_from_reply=True)) == []


def test_the_open_spell_survives_a_restart_of_the_gateway() -> None:
    before = ModeTracker(issuer=an_issuer())
    records = [*before.observe(_report(0, Mode.CRW)), *before.observe(_report(5_000, Mode.S))]
    after = ModeTracker(issuer=an_issuer(boot=2, anchor_ns=-3_000 * NS_PER_MS))
    after.restore(records)
    assert after.observe(_report(5_000, Mode.S, shift=3_010)) == [], "the same spell, on a clock fitted anew"
    closed, begun = after.observe(_report(9_000, Mode.CRW, shift=3_000))
    assert closed.identity == records[-1].identity
    assert closed.revision == records[-1].revision + 1
    assert closed.t_end_ns == begun.t_start_ns
    assert begun.boot == 2


def test_a_spell_of_another_history_is_begun_anew_and_never_revised() -> None:
    before = ModeTracker(issuer=an_issuer())
    records = before.observe(_report(5_000, Mode.S))
    issuer = an_issuer(boot=2)
    issuer.journal = "renamed"
    after = ModeTracker(issuer=issuer)
    after.restore(records)
    (begun,) = after.observe(_report(5_000, Mode.S))
    assert (begun.journal, begun.boot, begun.revision) == ("renamed", 2, 0)


def test_a_backpack_that_restarts_ends_the_spell_of_its_last_life() -> None:
    tracker = ModeTracker(issuer=an_issuer())
    tracker.observe(_report(60_000, Mode.S))
    closed, begun = tracker.observe(_report(100, Mode.CRW, boot=2, shift=90_000))
    assert (closed.mode, closed.t_end_ns) == (Mode.S, 90_100 * NS_PER_MS)
    assert (begun.mode, begun.t_end_ns) == (Mode.CRW, None)


def test_a_late_spell_does_not_end_before_it_begins_where_the_clock_was_fitted_anew() -> None:
    tracker = ModeTracker(issuer=an_issuer())
    tracker.observe(_report(12_000, Mode.CRW))
    (late,) = tracker.observe(_report(11_000, Mode.S, shift=1_500))
    assert (late.t_start_ns, late.t_end_ns) == (12_500 * NS_PER_MS, 12_500 * NS_PER_MS)
