"""Laws of the watch over landmarks, and of who may become one."""

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, EncounterRecord, EncounterSide, Mode, ModeRecord
from firmware_protocol.units import NS_PER_S, BootId, Nanoseconds, NodeId, RssiDbm
from gateway.mission.watch import EDGE_DB, SETTLING_NS, LandmarkWatch, Suspicion

_GAP_NS = 300 * NS_PER_S
_LANDMARKS = frozenset(NodeId(node) for node in range(1, 7))
_HEAD = {"gateway": "g", "journal": "j", "offset": 1, "boot": BootId(1), "revision": 0, "wall_anchor_ns": Nanoseconds(0)}


def a_watch(*, armed_s: float = 0.0) -> LandmarkWatch:
    """Over six landmarks that stand since 0."""
    watch = LandmarkWatch(gap_ns=_GAP_NS, armed_ns=int(armed_s * NS_PER_S))
    watch.set_landmarks(_LANDMARKS, now_ns=0)
    return watch


def meet(watch: LandmarkWatch, one: int, other: int, *, at_s: float, rssi_dbm: int = -50, enter_dbm: int | None = -60) -> Suspicion | None:
    t_ns = Nanoseconds(int(at_s * NS_PER_S))
    record = EncounterRecord(
        **_HEAD,  # type: ignore[arg-type]
        sequence=int(at_s * 1000),
        node_a=NodeId(min(one, other)),
        node_b=NodeId(max(one, other)),
        t_start_ns=t_ns,
        t_end_ns=t_ns,
        error_ns=Nanoseconds(1000),
        is_reciprocal=True,
        sides=(EncounterSide(node=NodeId(one), t_start_ns=t_ns, t_end_ns=t_ns, rssi_dbm=RssiDbm(rssi_dbm)),),
    )
    enter = None if enter_dbm is None else RssiDbm(enter_dbm)
    return watch.take_encounter(record, t_start_ns=t_ns, t_end_ns=t_ns, enter_dbm=enter, now_ns=t_ns)


def a_mode(node: int, mode: Mode, cause: Cause, *, at_s: float, sequence: int = 1) -> ModeRecord:
    return ModeRecord(
        **_HEAD,  # type: ignore[arg-type]
        sequence=sequence,
        node=NodeId(node),
        mode=mode,
        cause=cause,
        t_start_ns=Nanoseconds(int(at_s * NS_PER_S)),
        t_end_ns=None,
        error_ns=Nanoseconds(1000),
    )


def test_who_contradicts_two_others_has_wandered_and_with_one_both_are_watched() -> None:
    watch = a_watch()
    assert meet(watch, 1, 2, at_s=100) is None
    assert watch.watched == {1: (2,), 2: (1,)}
    suspicion = meet(watch, 3, 1, at_s=110)
    assert suspicion is not None
    assert suspicion.node == 1
    assert not suspicion.is_told
    assert "2, 3" in suspicion.reason
    watch.set_landmarks(_LANDMARKS - {NodeId(1)}, now_ns=120 * NS_PER_S)
    assert watch.watched == {}, "those that it met are clear"


def test_landmarks_that_have_met_before_contradict_nobody_when_they_meet_again() -> None:
    """At the edge of reach a meeting ends and begins, again and again."""
    watch = a_watch()
    for at_s in range(5, 2000, 200):
        meet(watch, 1, 2, at_s=at_s)
        meet(watch, 1, 3, at_s=at_s)
    assert watch.watched == {}


def test_a_meeting_at_the_edge_of_what_begins_one_says_nothing() -> None:
    watch = a_watch()
    assert meet(watch, 1, 2, at_s=100, rssi_dbm=-60 + EDGE_DB - 1) is None
    assert meet(watch, 1, 3, at_s=100, rssi_dbm=-60 + EDGE_DB - 1) is None
    assert watch.watched == {}
    meet(watch, 1, 4, at_s=100, rssi_dbm=-60 + EDGE_DB)
    meet(watch, 5, 6, at_s=100, rssi_dbm=-90, enter_dbm=None)
    assert watch.watched.keys() == {1, 4, 5, 6}


def test_who_has_just_stood_still_and_what_was_before_this_process_are_not_judged() -> None:
    watch = a_watch(armed_s=200)
    meet(watch, 1, 2, at_s=199)
    meet(watch, 1, 3, at_s=199)
    assert watch.watched == {}
    watch.set_landmarks(_LANDMARKS | {NodeId(9)}, now_ns=1000 * NS_PER_S)
    meet(watch, 1, 9, at_s=999 + SETTLING_NS / NS_PER_S)
    assert watch.watched == {}
    meet(watch, 2, 9, at_s=1001 + SETTLING_NS / NS_PER_S)
    assert watch.watched.keys() == {2, 9}


def test_one_contradiction_alone_is_forgotten_after_a_while() -> None:
    watch = a_watch()
    meet(watch, 1, 2, at_s=100)
    assert meet(watch, 1, 3, at_s=1200) is None
    assert watch.watched == {1: (3,), 3: (1,)}


@given(st.sampled_from(Mode), st.sampled_from(Cause), st.booleans())
def test_a_landmark_that_says_it_does_not_stand_by_command_is_doubted_once_for_each_spell(
    mode: Mode, cause: Cause, was_before: bool
) -> None:
    watch = a_watch()
    record = a_mode(1, mode, cause, at_s=-5 if was_before else 50)
    doubt = watch.take_mode(record, t_start_ns=record.t_start_ns)
    assert (doubt is not None) == (not was_before and (mode, cause) != (Mode.S, Cause.COMMAND))
    assert watch.take_mode(msgspec.structs.replace(record, revision=1), t_start_ns=record.t_start_ns) is None
    if doubt is not None:
        again = msgspec.structs.replace(record, sequence=2)
        assert watch.take_mode(again, t_start_ns=again.t_start_ns) is not None


def test_those_who_are_no_landmarks_are_not_judged() -> None:
    watch = a_watch()
    meet(watch, 1, 7, at_s=100)
    meet(watch, 2, 7, at_s=100)
    assert watch.watched == {}
    assert watch.take_mode(a_mode(7, Mode.CRW, Cause.NATURAL, at_s=50), t_start_ns=50 * NS_PER_S) is None
