"""Laws of the account of controlled motion."""

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.units import NS_PER_MS, Nanoseconds, NodeId
from gateway.control_book import ControlBook

_FINAL = (Stage.BIOBOT_CONFIRMED, Stage.REFUSED, Stage.FAILED, Stage.UNKNOWN)


def a_command(
    number: int, action: StimulationAction, *, node: int = 1, commander: str = "", hold_ms: int = 0, part_of: str = ""
) -> StimulationRequest:
    return StimulationRequest(
        command_id=f"c{number}",
        node=NodeId(node),
        action=action,
        operator="tester",
        issued_wall_ns=Nanoseconds(0),
        commander=commander,
        hold_ms=hold_ms,
    )


def a_stage(request: StimulationRequest, stage: Stage) -> CommandStage:
    return CommandStage(
        command_id=request.command_id, gateway="base1", node=request.node, action=request.action, stage=stage, wall_ns=Nanoseconds(0)
    )


def tell(book: ControlBook, request: StimulationRequest, *stages: Stage, now_ns: int = 0) -> None:
    for stage in stages:
        book.note(request, a_stage(request, stage), now_ns=now_ns)


def test_to_follow_walls_is_a_start() -> None:
    """With a commander or a hold it is controlled motion, and without either it ends what was."""
    book = ControlBook()
    tell(book, a_command(1, StimulationAction.FOLLOW_WALLS, hold_ms=500), Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)
    assert [control.command_id for control in book.overdue(now_ns=500 * NS_PER_MS)] == ["c1"]
    tell(book, a_command(2, StimulationAction.FOLLOW_WALLS), Stage.ACCEPTED)
    assert not book.controlled


def test_a_stop_ends_control_when_the_biobot_confirms_it_and_not_before() -> None:
    book = ControlBook()
    tell(book, a_command(1, StimulationAction.START, commander="ann"), Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)
    tell(book, a_command(2, StimulationAction.STOP), Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.UNKNOWN)
    assert [control.commander for control in book.controlled.values()] == ["ann"]
    tell(book, a_command(3, StimulationAction.STOP), Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)
    assert not book.controlled


def test_a_stop_that_is_confirmed_late_does_not_end_what_began_after_it() -> None:
    book = ControlBook()
    stop = a_command(2, StimulationAction.STOP)
    tell(book, a_command(1, StimulationAction.START, commander="ann"), Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)
    tell(book, stop, Stage.ACCEPTED)
    tell(book, a_command(3, StimulationAction.START, commander="bob"), Stage.ACCEPTED)
    tell(book, stop, Stage.BIOBOT_CONFIRMED)
    assert [control.commander for control in book.controlled.values()] == ["bob"]


def test_a_command_that_never_reached_the_biobot_leaves_what_was() -> None:
    for failed in (Stage.FAILED, Stage.REFUSED):
        book = ControlBook()
        tell(book, a_command(1, StimulationAction.START, commander="ann"), Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)
        tell(book, a_command(2, StimulationAction.START), Stage.ACCEPTED)
        assert not book.controlled, "a start without hold and commander lets it go"
        tell(book, a_command(2, StimulationAction.START), failed)
        assert [control.command_id for control in book.controlled.values()] == ["c1"]


def test_a_hold_is_counted_from_the_acceptance() -> None:
    book = ControlBook()
    tell(book, a_command(1, StimulationAction.TURN_LEFT, hold_ms=250), Stage.ACCEPTED, now_ns=7)
    end_ns = 7 + 250 * NS_PER_MS
    assert book.next_end_ns() == end_ns
    assert not book.overdue(now_ns=end_ns - 1)
    assert [control.command_id for control in book.overdue(now_ns=end_ns)] == ["c1"]


def test_who_commands_what_another_moves_takes_it_over() -> None:
    book = ControlBook()
    tell(book, a_command(1, StimulationAction.START, commander="ann"), Stage.ACCEPTED)
    second = a_command(2, StimulationAction.TURN_LEFT, commander="bob")
    takeover = book.note(second, a_stage(second, Stage.ACCEPTED), now_ns=0)
    assert takeover is not None
    assert (takeover.before.commander, takeover.after.commander) == ("ann", "bob")
    assert not book.of_commander("ann")


@dataclass
class Obvious:
    """The same account, found anew from the whole history each time."""

    history: list[tuple[StimulationRequest, Stage]] = field(default_factory=list)

    def controlling(self, node: int) -> str | None:
        """Return the command that the biobot is under: replay all that was accepted, without what turned out not to have reached it."""
        ends = {request.command_id: stage for request, stage in self.history if stage in _FINAL}
        current: str | None = None
        at_stop: dict[str, str | None] = {}
        for request, stage in self.history:
            if request.node != node:
                continue
            reached = ends.get(request.command_id) not in {Stage.FAILED, Stage.REFUSED}
            is_stop = request.action is StimulationAction.STOP
            if is_stop and stage is Stage.ACCEPTED:
                at_stop[request.command_id] = current
            elif is_stop and stage is Stage.BIOBOT_CONFIRMED and current is not None and at_stop[request.command_id] == current:
                current = None
            elif not is_stop and stage is Stage.ACCEPTED and reached:
                if request.commander or request.hold_ms:
                    current = request.command_id
                elif request.action in {StimulationAction.START, StimulationAction.FOLLOW_WALLS}:
                    current = None
        return current


@given(st.data())
def test_control_is_what_the_whole_history_says(data: st.DataObject) -> None:
    """One command of a biobot is under way at a time, stops aside: only then can what was before be told from what never was."""
    book, obvious = ControlBook(), Obvious()
    for number in range(data.draw(st.integers(1, 12))):
        action = data.draw(st.sampled_from([one for one in StimulationAction if one is not StimulationAction.STOP_ALL]))
        request = a_command(
            number,
            action,
            node=data.draw(st.integers(1, 2)),
            commander=data.draw(st.sampled_from(["", "ann", "bob"])),
            hold_ms=data.draw(st.sampled_from([0, 100])),
        )
        for stage in (Stage.ACCEPTED, data.draw(st.sampled_from(_FINAL))):
            obvious.history.append((request, stage))
            tell(book, request, stage)
    for node in (1, 2):
        control = book.controlled.get(NodeId(node))
        assert (None if control is None else control.command_id) == obvious.controlling(node)
    assert not book._pending
    assert not book._stopping
