"""Laws of steering: what a train brings about happens a moment later, scaled to the world, and a stop cancels it."""

import math

import pytest

from firmware_protocol.messages import Action, WireCause, WireMode
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from simulator.backpacks.stimulator import Actuation
from simulator.response import ResponseConfig
from simulator.steering import Steering
from tests.simulator.base_station import a_command
from tests.simulator.fake_habitat import ScriptedWorld

NODE = NodeId(3)
SURE = ResponseConfig(probability=1.0, probability_habituated=1.0, turn_spread=0.0, habituation_per_train=0.0)


def an_actuation(action: Action, *, command: int = 1, has_train: bool = True) -> Actuation:
    mode = {Action.STOP: WireMode.S, Action.START: WireMode.CRW, Action.FOLLOW_WALLS: WireMode.CRW}.get(action)
    train = a_command(command, action) if has_train else None
    return Actuation(mode=mode, cause=WireCause.COMMAND, command=command, action=action, train=train)


class Story:
    def __init__(self, *, response: ResponseConfig = SURE, metres_per_unit: float = 1.0, speed_factor: float = 1.0, seed: int = 1) -> None:
        self.world = ScriptedWorld({3: (5.0, 5.0)})
        self.steering = Steering(
            self.world, seed=seed, response=response, metres_per_unit=metres_per_unit, speed_factor=speed_factor, keeps_history=True
        )  # fmt: skip

    def actuate(self, actuation: Actuation, *, at_s: float) -> None:
        self.world.now_s = at_s
        self.steering.actuate(NODE, actuation, now_ns=round(at_s * NS_PER_S))

    def react(self) -> float:
        """Let the next reaction happen; return when it did [s]."""
        due_ns = self.steering.next_due_ns()
        assert due_ns is not None
        self.world.now_s = due_ns / NS_PER_S
        self.steering.react(due_ns - 1)
        before = len(self.world.done)
        self.steering.react(due_ns)
        assert len(self.world.done) == before + 1
        return self.world.now_s


def test_a_turn_comes_after_its_latency_by_the_angle_of_its_amplitude() -> None:
    story = Story()
    story.actuate(an_actuation(Action.TURN_RIGHT), at_s=2.0)
    assert story.world.done == []
    at_s = story.react()
    assert 2.05 <= at_s <= 2.2
    ((turned_at_s, verb, one, angle_rad),) = story.world.done
    assert (turned_at_s, verb, one) == (at_s, "turn", 3)
    assert angle_rad == pytest.approx(-math.radians(126.0))
    (noted,) = story.steering.executed
    assert (noted.t_s, noted.id, noted.command, noted.action, noted.mode, noted.responded) == (2.0, 3, 1, "turn_right", "CRW", True)
    assert noted.turn_deg == pytest.approx(-126.0)
    assert noted.run == 0.0
    assert noted.latency_s == pytest.approx(at_s - 2.0, abs=1e-6)
    assert story.steering.next_due_ns() is None


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.04, 0.01])
def test_a_start_lets_the_insect_go_at_once_and_makes_it_run_so_many_centimetres(metres_per_unit: float) -> None:
    story = Story(metres_per_unit=metres_per_unit)
    story.actuate(an_actuation(Action.START), at_s=0.0)
    assert story.world.done == [(0.0, "CRW", 3, 0.0)]
    story.react()
    (_, verb, _, distance) = story.world.done[-1]
    assert verb == "run"
    assert 0.156 <= distance * metres_per_unit <= 0.256
    assert story.steering.executed[0].run == pytest.approx(distance, abs=1e-6)


def test_walls_are_followed_at_once_and_a_train_makes_the_insect_run_as_that_of_a_start_does() -> None:
    story = Story()
    story.actuate(an_actuation(Action.FOLLOW_WALLS, has_train=False), at_s=0.0)
    assert (story.world.done, story.steering.next_due_ns()) == ([(0.0, "walls", 3, 0.0), (0.0, "CRW", 3, 0.0)], None)
    story.actuate(an_actuation(Action.FOLLOW_WALLS, command=2), at_s=1.0)
    story.react()
    assert [verb for _, verb, _, _ in story.world.done[2:]] == ["walls", "CRW", "run"]
    story.actuate(an_actuation(Action.START, command=3, has_train=False), at_s=9.0)
    assert [verb for _, verb, _, _ in story.world.done[5:]] == ["CRW"]
    assert [one.action for one in story.steering.executed] == ["follow_walls", "follow_walls", "start"]


def test_a_stop_cancels_what_the_insect_had_not_yet_done() -> None:
    story = Story()
    story.actuate(an_actuation(Action.START), at_s=0.0)
    story.actuate(an_actuation(Action.STOP, command=2), at_s=0.01)
    assert story.steering.next_due_ns() is None
    assert [verb for _, verb, _, _ in story.world.done] == ["CRW", "S"]
    assert [(one.command, one.mode, one.responded) for one in story.steering.executed] == [(1, "CRW", False), (2, "S", True)]


def test_an_insect_that_is_held_still_does_not_turn_until_it_is_let_go() -> None:
    story = Story()
    story.actuate(an_actuation(Action.STOP, has_train=False), at_s=0.0)
    story.actuate(an_actuation(Action.TURN_LEFT, command=2), at_s=3.0)
    assert story.steering.next_due_ns() is None
    story.actuate(Actuation(mode=WireMode.CRW, cause=WireCause.NATURAL, command=None), at_s=6.0)
    story.actuate(an_actuation(Action.TURN_LEFT, command=3), at_s=9.0)
    story.react()
    assert [one.responded for one in story.steering.executed] == [None, False, None, True]
    assert [one.action for one in story.steering.executed] == ["stop", "turn_left", None, "turn_left"]


def test_the_end_of_a_starts_hold_makes_the_insect_stand_and_cancels_what_it_had_not_yet_done() -> None:
    story = Story()
    story.actuate(an_actuation(Action.START), at_s=0.0)
    story.actuate(Actuation(mode=WireMode.S, cause=WireCause.COMMAND, command=None), at_s=0.01)
    assert story.steering.next_due_ns() is None
    story.actuate(an_actuation(Action.TURN_LEFT, command=2), at_s=3.0)
    assert [verb for _, verb, _, _ in story.world.done] == ["CRW", "S"]
    assert [(one.command, one.mode, one.cause, one.responded) for one in story.steering.executed] == [
        (1, "CRW", "command", False),
        (None, "S", "command", None),
        (2, "S", "command", False),
    ]


def test_an_insect_that_does_not_respond_is_left_alone() -> None:
    story = Story(response=ResponseConfig(probability=0.0, probability_habituated=0.0))
    story.actuate(an_actuation(Action.TURN_LEFT), at_s=0.0)
    assert story.steering.next_due_ns() is None
    assert story.steering.executed[0].responded is False
    assert story.world.done == []


def test_insects_that_live_faster_respond_and_recover_as_much_sooner() -> None:
    slow, fast = Story(), Story(speed_factor=10.0)
    for story in (slow, fast):
        story.actuate(an_actuation(Action.TURN_LEFT), at_s=0.0)
    assert fast.react() == pytest.approx(slow.react() / 10, abs=1e-6)
    for story in (slow, fast):
        story.actuate(an_actuation(Action.TURN_LEFT, command=2), at_s=1.0)  # too soon for the slow one, 10 s of the fast one's life
        story.react()
    assert fast.world.done[-1][3] == pytest.approx(2 * slow.world.done[-1][3])


def test_the_same_seed_gives_the_same_responses() -> None:
    stories = [Story(response=ResponseConfig(), seed=seed) for seed in (7, 7, 8)]
    for story in stories:
        for number in range(40):
            story.actuate(an_actuation(Action.TURN_LEFT, command=number), at_s=3.0 * number)
            story.steering.react(round((3.0 * number + 1.0) * NS_PER_S))
    first, same, other = (story.steering.executed for story in stories)
    assert first == same
    assert first != other
    assert 15 < sum(bool(one.responded) for one in first) < 40


def test_a_run_without_end_keeps_no_history_and_steers_all_the_same() -> None:
    world = ScriptedWorld({3: (5.0, 5.0)})
    steering = Steering(world, seed=1, response=SURE, metres_per_unit=1.0, speed_factor=1.0, keeps_history=False)
    steering.actuate(NODE, an_actuation(Action.TURN_LEFT), now_ns=0)
    steering.react(300 * NS_PER_MS)
    assert [verb for _, verb, _, _ in world.done] == ["turn"]
    assert steering.executed == []
