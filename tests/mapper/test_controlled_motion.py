"""Whom a mapper moves: whoever may still be moved is listed, until the hold must be over or a stop is confirmed."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.units import NS_PER_S, Nanoseconds, NodeId
from mapper.controlled_motion import ControlledMotion


def request_of(command_id: str, *, node: int = 5, hold_s: int = 10, commander: str = "mapper1") -> StimulationRequest:
    return StimulationRequest(
        command_id=command_id,
        node=NodeId(node),
        action=StimulationAction.TURN_LEFT,
        operator="anna",
        issued_wall_ns=Nanoseconds(0),
        ttl_ms=1000,
        hold_ms=1000 * hold_s,
        commander=commander,
    )


def stage_of(command_id: str, stage: Stage, *, node: int = 5, action: StimulationAction = StimulationAction.TURN_LEFT) -> CommandStage:
    return CommandStage(command_id=command_id, gateway="g", node=NodeId(node), action=action, stage=stage, wall_ns=Nanoseconds(0))


def test_a_hold_ends_by_itself_not_before_it_can_be_over() -> None:
    motion = ControlledMotion()
    motion.begin(request_of("a"), now_ns=0)
    motion.begin(request_of("b", node=6, commander=""), now_ns=0)
    assert motion.nodes(now_ns=12 * NS_PER_S) == [5]
    assert motion.nodes(now_ns=14 * NS_PER_S) == []


def test_a_refused_command_leaves_the_one_before_it_in_force() -> None:
    motion = ControlledMotion()
    motion.begin(request_of("a"), now_ns=0)
    motion.heed(stage_of("a", Stage.BIOBOT_CONFIRMED))
    motion.begin(request_of("b", hold_s=100), now_ns=0)
    motion.heed(stage_of("b", Stage.REFUSED))
    assert motion.nodes(now_ns=NS_PER_S) == [5]
    assert motion.nodes(now_ns=20 * NS_PER_S) == []


def test_a_confirmed_stop_or_a_start_without_control_ends_it() -> None:
    for command_id, stage, action in (
        ("s", Stage.BIOBOT_CONFIRMED, StimulationAction.STOP),
        ("t", Stage.ACCEPTED, StimulationAction.START),
    ):
        motion = ControlledMotion()
        motion.begin(request_of("a"), now_ns=0)
        motion.heed(stage_of(command_id, stage, action=action, node=6))
        assert motion.nodes(now_ns=0) == [5]
        motion.heed(stage_of(command_id, stage, action=action))
        assert motion.nodes(now_ns=0) == []


events = st.lists(
    st.one_of(
        st.tuples(st.just("begin"), st.integers(0, 3)),
        st.tuples(st.sampled_from([Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.FAILED, Stage.UNKNOWN]), st.integers(0, 3)),
    ),
    max_size=80,
)


@given(events)
def test_whatever_is_unknown_of_it_a_biobot_that_may_be_moved_is_listed(events: list[tuple[str | Stage, int]]) -> None:
    motion = ControlledMotion()
    begun: set[int] = set()
    for number, (what, node) in enumerate(events):
        if what == "begin":
            motion.begin(request_of(f"{node}-{number}", node=node, hold_s=3600), now_ns=0)
            begun.add(node)
        elif isinstance(what, Stage):
            motion.heed(stage_of(f"{node}-0", what, node=node))
    assert set(motion.nodes(now_ns=3600 * NS_PER_S)) == begun
    assert all(len(holds) <= 16 for holds in motion._ends_ns.values())
