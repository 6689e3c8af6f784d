"""Laws of what steers: scripts, keys, and what is known."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.errors import ConfigurationError
from gateway.steering import Steering, Step, parse_keys, parse_script
from tests.gateway.test_control_book import a_command, a_stage


def test_a_script_is_actions_and_pauses() -> None:
    assert parse_script("left 2; start 0.5 ;stop") == [
        Step(action=StimulationAction.TURN_LEFT, wait_s=2.0),
        Step(action=StimulationAction.START, wait_s=0.5),
        Step(action=StimulationAction.STOP, wait_s=0.0),
    ]


@pytest.mark.parametrize("text", ["", ";", "jump", "left -1", "left nan", "left 2 3", "left two", "start inf"])
def test_what_is_no_script_is_refused_with_the_step_and_what_is_wanted(text: str) -> None:
    with pytest.raises(ConfigurationError, match="'left 4; start 5; stop'"):
        parse_script(text)


@given(st.lists(st.sampled_from([b"\x1b[A", b"\x1bOB", b"\x1b[C", b"\x1b[D", b"a", b"W", b" ", b"\x1b[Z"])), st.lists(st.integers(0, 60)))
def test_chunking_never_changes_the_keys(pressed: list[bytes], cuts: list[int]) -> None:
    typed = b"".join(pressed)
    keys, rest = parse_keys(typed)
    assert rest == b""
    chunked: list[str] = []
    before, waiting = 0, b""
    for cut in [*sorted(cuts), len(typed)]:
        found, waiting = parse_keys(waiting + typed[before:cut])
        before = max(before, cut)
        chunked += found
    assert chunked == keys


@given(st.binary(max_size=40))
def test_no_input_crashes_the_keys(typed: bytes) -> None:
    keys, rest = parse_keys(typed)
    assert len(rest) <= 2
    assert all(keys)


def test_whom_somebody_else_stops_is_halted_until_our_next_command() -> None:
    steering = Steering()
    start, stop = a_command(1, StimulationAction.START), a_command(2, StimulationAction.STOP)
    halted: list[bool] = []
    steering.sent(start.command_id, start.action)
    for heard in (a_stage(start, Stage.BIOBOT_CONFIRMED), a_stage(stop, Stage.ACCEPTED), a_stage(stop, Stage.BIOBOT_CONFIRMED)):
        steering.take_stage(heard)
        halted.append(steering.is_halted)
    for ours in (start, stop):
        steering.sent(ours.command_id, ours.action)
        halted.append(steering.is_halted)
    steering.take_stage(a_stage(stop, Stage.ACCEPTED))
    halted.append(steering.is_halted)
    assert halted == [False, True, True, False, False, False], "our own stop halts nothing"


def test_it_beats_until_the_newest_stop_is_confirmed() -> None:
    steering = Steering()
    start, first, second = (
        a_command(number, action) for number, action in enumerate((StimulationAction.START, *[StimulationAction.STOP] * 2))
    )
    steering.sent(start.command_id, start.action)
    assert steering.is_moving
    steering.sent(first.command_id, first.action)
    steering.sent(second.command_id, second.action)
    steering.take_stage(a_stage(first, Stage.BIOBOT_CONFIRMED))
    assert steering.is_moving, "an answer to an earlier command says nothing of the newest"
    steering.take_stage(a_stage(second, Stage.UNKNOWN))
    assert steering.is_moving
    assert steering.has_ended
    steering.sent(first.command_id, first.action)
    steering.take_stage(a_stage(first, Stage.BIOBOT_CONFIRMED))
    assert steering.is_confirmed
    assert not steering.is_moving


def test_a_stop_of_somebody_else_ends_its_motion_but_not_what_was_commanded_after_it() -> None:
    steering = Steering()
    start, foreign = a_command(0, StimulationAction.START), a_command(9, StimulationAction.STOP)
    steering.sent(start.command_id, start.action)
    steering.take_stage(a_stage(foreign, Stage.BIOBOT_CONFIRMED))
    assert steering.is_moving, "the start is under way still, and may come after it"
    steering.take_stage(a_stage(start, Stage.BIOBOT_CONFIRMED))
    steering.take_stage(a_stage(foreign, Stage.BIOBOT_CONFIRMED))
    assert not steering.is_moving
