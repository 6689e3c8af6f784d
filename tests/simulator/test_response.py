"""Laws of an insect's response: as often and as far as published, less when it is used to it or pressed, and a function of its key."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.messages import Action
from simulator.response import Responder, Response, ResponseConfig, Train, mean_turn_rad

FRESH = ResponseConfig(habituation_per_train=0.0)
TURNS = (Action.TURN_LEFT, Action.TURN_RIGHT)


def a_train(t_s: float = 0.0, *, action: Action = Action.TURN_LEFT, amplitude_v: float = 2.0) -> Train:
    return Train(action=action, amplitude_v=amplitude_v, t_s=t_s)


def first_responses(action: Action, *, amplitude_v: float = 2.0, config: ResponseConfig = FRESH, count: int = 4_000) -> list[Response]:
    """Each of many insects' response to its first train."""
    responder = Responder(seed=1, config=config)
    return [responder.respond(biobot, a_train(action=action, amplitude_v=amplitude_v)) for biobot in range(1, count + 1)]


def share(responses: list[Response]) -> float:
    return sum(one.has_responded for one in responses) / len(responses)


def mean(values: list[float]) -> float:
    return sum(values) / len(values)


@pytest.mark.parametrize(("amplitude_v", "degrees"), [(1.0, 149.0), (2.0, 126.0), (4.0, 80.0), (0.5, 149.0), (5.0, 80.0)])
def test_the_mean_turn_falls_from_149_degrees_at_1_v_to_80_at_4_v(amplitude_v: float, degrees: float) -> None:
    assert math.degrees(mean_turn_rad(amplitude_v)) == pytest.approx(degrees)


@pytest.mark.parametrize(("action", "sign"), [(Action.TURN_LEFT, 1), (Action.TURN_RIGHT, -1)])
@pytest.mark.parametrize("amplitude_v", [1.0, 2.5, 4.0])
def test_fresh_insects_turn_in_76_of_100_trials_by_the_mean_angle_to_the_side_asked(action: Action, sign: int, amplitude_v: float) -> None:
    """4,000 trials: a standard error of 0.7 % of the share and 0.4 % of the angle; four of them are allowed."""
    responses = first_responses(action, amplitude_v=amplitude_v)
    assert share(responses) == pytest.approx(0.76, abs=0.028)
    turns = [sign * one.turn_rad for one in responses if one.has_responded]
    assert min(turns) > 0
    assert mean(turns) == pytest.approx(mean_turn_rad(amplitude_v), rel=0.016)
    assert {one.turn_rad for one in responses if not one.has_responded} == {0.0}
    assert {one.run_m for one in responses} == {0.0}


def test_a_start_makes_a_run_of_15_6_to_25_6_cm() -> None:
    runs = [one.run_m for one in first_responses(Action.START) if one.has_responded]
    assert 0.156 <= min(runs) < 0.157
    assert 0.255 < max(runs) <= 0.256
    assert mean(runs) == pytest.approx(0.206, abs=0.002)


def test_a_stop_always_works() -> None:
    assert share(first_responses(Action.STOP, amplitude_v=0.0, count=200)) == 1.0


@pytest.mark.parametrize(("amplitude_v", "expected"), [(0.0, 0.0), (0.5, 0.38)])
def test_below_1_v_fewer_insects_respond_and_none_at_0_v(amplitude_v: float, expected: float) -> None:
    assert share(first_responses(Action.START, amplitude_v=amplitude_v)) == pytest.approx(expected, abs=0.03)


def test_habituation_grows_with_every_train_fades_with_time_and_spares_some() -> None:
    responder = Responder(seed=1, config=ResponseConfig(habituation_per_train=0.1, recovery_s=100.0))
    levels = {}
    for biobot in range(1, 401):
        before = 0.0
        for number in range(20):
            responder.respond(biobot, a_train(3.0 * number))
            level = responder.habituation(biobot, t_s=3.0 * number)
            assert level == 0.0 or level > before * math.exp(-0.03)
            before = level
        levels[biobot] = before
    habituating = {biobot for biobot, level in levels.items() if level > 0}
    assert 160 < len(habituating) < 240
    for biobot in habituating:
        later = responder.habituation(biobot, t_s=57.0 + 100.0)
        assert later == pytest.approx(levels[biobot] / math.e)


def test_habituated_insects_respond_less_often_and_less_far_and_recover() -> None:
    config = ResponseConfig(share_habituating=1.0, habituation_per_train=1.0, recovery_s=100.0, turn_spread=0.0)
    responder = Responder(seed=1, config=config)
    fresh, tired, rested = (
        [responder.respond(biobot, a_train(t_s)) for biobot in range(1, 4_001)] for t_s in (0.0, 5.0, 5_000.0)
    )  # fmt: skip
    assert share(fresh) == pytest.approx(0.76, abs=0.028)
    assert share(tired) == pytest.approx(0.5 + 0.26 * (1 - math.exp(-0.05)), abs=0.032)
    assert share(rested) == pytest.approx(0.76, abs=0.028)
    assert max(one.turn_rad for one in tired) < 0.6 * max(one.turn_rad for one in fresh)
    assert max(one.turn_rad for one in rested) == pytest.approx(max(one.turn_rad for one in fresh))


@pytest.mark.parametrize(("gap_s", "expected"), [(1.9, 0.38), (2.0, 0.76)])
def test_trains_less_than_2_s_apart_work_half_as_well(gap_s: float, expected: float) -> None:
    config = ResponseConfig(habituation_per_train=0.0, turn_spread=0.0)
    responder = Responder(seed=1, config=config)
    for biobot in range(1, 4_001):
        responder.respond(biobot, a_train(0.0))
    second = [responder.respond(biobot, a_train(gap_s)) for biobot in range(1, 4_001)]
    assert share(second) == pytest.approx(expected, abs=0.031)
    assert max(one.turn_rad for one in second) == pytest.approx(mean_turn_rad(2.0) * (0.5 if gap_s < 2 else 1.0))


@given(st.lists(st.tuples(st.integers(1, 5), st.sampled_from(list(Action)), st.floats(0, 4)), max_size=60), st.integers(0, 2**64 - 1))
def test_an_insects_responses_do_not_depend_on_the_others(trains: list[tuple[int, Action, float]], seed: int) -> None:
    together = Responder(seed=seed, config=ResponseConfig())
    heard = [
        (biobot, together.respond(biobot, a_train(float(k), action=action, amplitude_v=volt)))
        for k, (biobot, action, volt) in enumerate(trains)
    ]
    alone = Responder(seed=seed, config=ResponseConfig())
    mine = [
        alone.respond(1, a_train(float(k), action=action, amplitude_v=volt)) for k, (one, action, volt) in enumerate(trains) if one == 1
    ]
    assert mine == [response for biobot, response in heard if biobot == 1]
    for _, response in heard:
        assert abs(response.turn_rad) <= 1.5 * math.radians(149.0)
        assert 0 <= response.run_m <= 0.256
        assert 0 <= response.latency_s <= 0.2
