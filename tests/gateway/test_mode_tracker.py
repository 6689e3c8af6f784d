"""Laws of mode spells."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import Cause, Mode, ModeRecord
from firmware_protocol.units import EVERYBODY, NS_PER_MS, BootId, Milliseconds, Nanoseconds, NodeId
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


class _Stops:
    """Stops that a tracker hears of at times of its choice [ms]."""

    def __init__(self, tracker: ModeTracker) -> None:
        self._now_ns = 0
        tracker.halts.now_ns = lambda: self._now_ns
        self._halts = tracker.halts

    def tell(self, at_ms: int, action: StimulationAction, *, part_of: str = "", stage: Stage = Stage.ACCEPTED) -> None:
        self._now_ns = at_ms * NS_PER_MS
        node = EVERYBODY if action is StimulationAction.STOP_ALL else NodeId(1)
        request = StimulationRequest(command_id="c", node=node, action=action, operator="anna", issued_wall_ns=Nanoseconds(0))
        told = CommandStage(command_id="c", gateway="base1", node=node, action=action, stage=stage, wall_ns=Nanoseconds(0), part_of=part_of)
        self._halts.hear(request, told)


def _stands_by_command(since_ms: int = 60_000) -> ModeReport:
    return _report(since_ms, Mode.S, cause=Cause.COMMAND)


@pytest.mark.parametrize(
    ("stood_ms", "alone_ms", "is_halted"),
    [
        (60_100, None, True),
        (59_800, None, True),
        (65_000, None, True),
        (20_000, None, False),
        (100_000, None, False),
        (60_100, 59_900, False),
        (60_100, 62_000, False),
        (60_100, 5_000, True),
    ],
    ids=[
        "at once",
        "clock is late",
        "at a repetition",
        "landmark",
        "told so later",
        "alone before",
        "alone after",
        "alone once, walked since",
    ],
)
def test_who_stands_because_all_were_stopped_is_halted(stood_ms: int, alone_ms: int | None, is_halted: bool) -> None:
    """It is the gateway that knows it, and the record that keeps it: for maps of any time, after any restart."""
    tracker = ModeTracker(issuer=an_issuer())
    stops = _Stops(tracker)
    for at_ms, action in sorted([(60_000, StimulationAction.STOP_ALL), *([(alone_ms, StimulationAction.STOP)] if alone_ms else [])]):
        if at_ms > 10_000:
            tracker.observe(_report(10_000, Mode.CRW))
        stops.tell(at_ms, action)
    stops.tell(60_000, StimulationAction.STOP, part_of="all")
    begun = tracker.observe(_stands_by_command(stood_ms))[-1]
    assert (begun.mode, begun.is_halted) == (Mode.S, is_halted)
    restored = ModeTracker(issuer=an_issuer(boot=2))
    restored.restore([begun])
    record = restored.newest_record(NodeId(1))
    assert record is not None
    assert record.is_halted == is_halted


def test_a_stop_of_it_alone_makes_a_halted_biobot_stand_of_its_own() -> None:
    tracker = ModeTracker(issuer=an_issuer())
    stops = _Stops(tracker)
    tracker.observe(_report(0, Mode.CRW))
    stops.tell(60_000, StimulationAction.STOP_ALL)
    begun = tracker.observe(_stands_by_command())[-1]
    stops.tell(90_000, StimulationAction.STOP_ALL)
    assert tracker.observe(_stands_by_command()) == []
    stops.tell(95_000, StimulationAction.STOP)
    stops.tell(96_000, StimulationAction.STOP, stage=Stage.FAILED)
    assert tracker.observe(_stands_by_command()) == [], "its backpack said no"
    stops.tell(99_000, StimulationAction.STOP)
    (revised,) = tracker.observe(_stands_by_command())
    assert (revised.identity, revised.revision, revised.is_halted) == (begun.identity, 1, False)
    assert tracker.observe(_stands_by_command()) == []


def test_who_rests_by_itself_while_all_are_stopped_is_not_halted() -> None:
    tracker = ModeTracker(issuer=an_issuer())
    _Stops(tracker).tell(60_000, StimulationAction.STOP_ALL)
    assert not tracker.observe(_report(60_000, Mode.S))[-1].is_halted
