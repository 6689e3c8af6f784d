"""Laws of the mission's state machine."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import MissionPhase
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import MissionTable
from gateway.mission import EnterPhase, MakeLandmark, MissionPlanner, MissionStep

_ALL = {NodeId(node) for node in range(1, 11)}
_ROW = {node: frozenset({NodeId(node - 1), NodeId(node + 1)}) & frozenset(_ALL) for node in _ALL}


def _picks(steps: list[MissionStep]) -> list[NodeId]:
    return [step.node for step in steps if isinstance(step, MakeLandmark)]


def _begin(planner: MissionPlanner) -> list[MissionStep]:
    """Through dispersion; returns the first selection's steps."""
    planner.tick(now_ns=0, known=_ALL, adjacency=_ROW)
    planner.tick(now_ns=61 * NS_PER_S, known=_ALL, adjacency=_ROW)
    assert planner.phase is MissionPhase.LANDMARK_SELECTION
    return planner.tick(now_ns=61 * NS_PER_S, known=_ALL, adjacency=_ROW)


def test_nothing_happens_before_a_biobot_is_heard() -> None:
    planner = MissionPlanner(config=MissionTable())
    assert planner.tick(now_ns=10**12, known=set(), adjacency={}) == []
    assert planner.phase is MissionPhase.IDLE


def test_the_landmarks_are_those_of_the_rule() -> None:
    planner = MissionPlanner(config=MissionTable(n_landmarks=4))
    assert _picks(_begin(planner)) == list(select_landmarks({int(node): heard for node, heard in _ROW.items()}, count=4))


@given(st.sets(st.sampled_from(sorted(_ALL))))
def test_exploration_begins_when_each_landmark_stands_or_no_candidate_is_left(unreachable: set[NodeId]) -> None:
    planner = MissionPlanner(config=MissionTable(n_landmarks=3))
    waiting = _picks(_begin(planner))
    asked = set(waiting)
    while waiting:
        assert planner.tick(now_ns=62 * NS_PER_S, known=_ALL, adjacency=_ROW) == []
        node = waiting.pop()
        steps = planner.settle(node, is_standing=node not in unreachable)
        assert not asked & set(_picks(steps)), "nobody is asked twice"
        waiting += _picks(steps)
        asked |= set(waiting)
    (step,) = planner.tick(now_ns=63 * NS_PER_S, known=_ALL, adjacency=_ROW)
    assert isinstance(step, EnterPhase)
    assert step.phase is MissionPhase.EXPLORATION
    assert set(step.landmarks) == asked - unreachable
    assert len(step.landmarks) == min(3, len(_ALL - unreachable))


def test_selection_waits_for_neighbour_reports_but_not_for_ever() -> None:
    planner = MissionPlanner(config=MissionTable(selection_timeout_s=30, n_landmarks=2))
    some = {node: heard for node, heard in _ROW.items() if node <= 4}
    planner.tick(now_ns=0, known=_ALL, adjacency=some)
    planner.tick(now_ns=60 * NS_PER_S, known=_ALL, adjacency=some)
    assert planner.tick(now_ns=80 * NS_PER_S, known=_ALL, adjacency=some) == []
    assert set(_picks(planner.tick(now_ns=91 * NS_PER_S, known=_ALL, adjacency=some))) == {1, 4}


def test_the_share_counts_all_that_were_heard() -> None:
    planner = MissionPlanner(config=MissionTable(landmark_share=0.3))
    assert len(_picks(_begin(planner))) == 3


def test_a_resumed_exploration_chooses_no_new_landmarks_and_ends_when_it_would_have() -> None:
    planner = MissionPlanner(config=MissionTable(exploration_s=100))
    planner.resume(MissionPhase.EXPLORATION, since_ns=5 * NS_PER_S, now_ns=90 * NS_PER_S, standing={NodeId(1), NodeId(2)})

    assert planner.tick(now_ns=104 * NS_PER_S, known=_ALL, adjacency=_ROW) == []
    (step,) = planner.tick(now_ns=106 * NS_PER_S, known=_ALL, adjacency=_ROW)

    assert isinstance(step, EnterPhase)
    assert step.phase is MissionPhase.DONE
    assert step.landmarks == (NodeId(1), NodeId(2))


def test_a_resumed_selection_counts_those_that_stand_already() -> None:
    planner = MissionPlanner(config=MissionTable(n_landmarks=3, selection_timeout_s=0.1))
    planner.resume(MissionPhase.LANDMARK_SELECTION, since_ns=0, now_ns=0, standing={NodeId(4), NodeId(7)})

    (first,) = _picks(planner.tick(now_ns=NS_PER_S, known=_ALL, adjacency=_ROW))
    planner.settle(first, is_standing=True)
    (step,) = planner.tick(now_ns=2 * NS_PER_S, known=_ALL, adjacency=_ROW)

    assert first not in {NodeId(4), NodeId(7)}
    assert isinstance(step, EnterPhase)
    assert set(step.landmarks) == {NodeId(4), NodeId(7), first}


def test_after_a_mission_that_was_done_the_next_one_begins() -> None:
    planner = MissionPlanner(config=MissionTable())
    planner.resume(MissionPhase.DONE, since_ns=0, now_ns=0, standing={NodeId(1)})

    (step,) = planner.tick(now_ns=0, known=_ALL, adjacency=_ROW)

    assert isinstance(step, EnterPhase)
    assert step.phase is MissionPhase.DISPERSION
    assert step.reason.endswith("1 biobots still stand by command")


def test_a_resumed_selection_waits_from_its_own_start_and_never_picks_among_nobody() -> None:
    planner = MissionPlanner(config=MissionTable(n_landmarks=5, selection_timeout_s=30))
    planner.resume(MissionPhase.LANDMARK_SELECTION, since_ns=0, now_ns=1000 * NS_PER_S, standing=set())

    one = {NodeId(1): _ROW[NodeId(1)]}
    assert planner.tick(now_ns=1001 * NS_PER_S, known=_ALL, adjacency=one) == []
    assert planner.tick(now_ns=1031 * NS_PER_S, known=set(), adjacency={}) == []
    assert planner.phase is MissionPhase.LANDMARK_SELECTION
    assert len(_picks(planner.tick(now_ns=1032 * NS_PER_S, known=_ALL, adjacency=_ROW))) == 5


def test_a_selection_in_which_nobody_answers_ends_instead_of_stopping_everyone() -> None:
    """With 3 landmarks wanted among 60, ten failures end the replacing; at most two more were under way by then."""
    everyone = {NodeId(node) for node in range(1, 61)}
    row = {node: frozenset({NodeId(node - 1), NodeId(node + 1)}) & frozenset(everyone) for node in everyone}
    planner = MissionPlanner(config=MissionTable(n_landmarks=3, dispersion_s=0))
    waiting: list[NodeId] = []
    for now_s in range(3):
        waiting += _picks(planner.tick(now_ns=now_s * NS_PER_S, known=everyone, adjacency=row))
    assert len(waiting) == 3
    asked = list(waiting)
    while waiting:
        more = _picks(planner.settle(waiting.pop(), is_standing=False))
        waiting += more
        asked += more

    assert 10 <= len(asked) <= 12
