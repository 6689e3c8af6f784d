"""Random histories of the gate break no law; and the laws are awake: each is broken where it should be."""

import dataclasses

import msgspec
import pytest
from hypothesis import settings

from firmware_protocol.contract.commands import CommandStage, PulseRequest, Refusal, Stage, StimulationAction
from firmware_protocol.messages import Action
from gateway.config import StimulationTable
from gateway.radio import Fate
from studies.gate_histories import sites
from studies.gate_histories.air import FrameFate
from studies.gate_histories.campaign import Batch, run_batch
from studies.gate_histories.disk import MemoryRows
from studies.gate_histories.laws import violations
from studies.gate_histories.machine import GateHistory
from studies.gate_histories.story import tell
from studies.gate_histories.world import Order, World

TestGateHistory = GateHistory.TestCase
TestGateHistory.settings = settings(max_examples=100, stateful_step_count=25, deadline=None)

_TURN, _STOP = StimulationAction.TURN_LEFT, StimulationAction.STOP


def _world(**table: float) -> World:
    site = dataclasses.replace(sites.SITES[0], table=StimulationTable(**table))  # type: ignore[arg-type]
    world = World(site, rows=MemoryRows())
    world.wait(50)
    world.hear(1, announces=True)
    return world


def _turns(world: World, *, n: int, every_ms: int, pulse: PulseRequest | None = None) -> None:
    world.wait(10_000)  # after a start the gate lets an insect rest
    for _ in range(n):
        world.order(Order(action=_TURN, node=1, pulse=pulse))
        world.wait(every_ms)


def _kinds(world: World) -> set[str]:
    world.close()
    return {one.partition(":")[0] for one in violations(world)}


def test_trains_that_are_closer_more_or_longer_than_the_table_says_are_seen() -> None:
    world = _world(flight_s=0.1)
    _turns(world, n=6, every_ms=2_600)
    assert _kinds(world) == set()
    stricter = StimulationTable(flight_s=0.1, min_gap_s=2.2, max_trains=5, max_on_s=2.9, max_amplitude_mv=1_900)
    world.site = dataclasses.replace(world.site, table=stricter)
    assert {one.partition(":")[0] for one in violations(world)} == {"pause", "number", "time", "pulse"}


def test_a_backpack_that_announced_less_than_it_got_is_seen() -> None:
    world = _world(flight_s=0.1)
    _turns(world, n=3, every_ms=2_600)
    world.close()
    first = world.announced[0]
    less = msgspec.structs.replace(first.limits, min_gap_ms=3_000, max_on_ms_per_minute=1_400, channels=0)
    world.announced[0] = dataclasses.replace(first, limits=less)
    assert {one.partition(":")[0] for one in violations(world)} == {"pause", "the backpack's time", "pulse"}


def test_a_train_that_comes_late_twice_or_for_nobody_is_seen() -> None:
    world = _world(flight_s=0.1)
    _turns(world, n=1, every_ms=3_000)
    biobot = world.biobots[world.calls[0].request.node]
    train = biobot.log[-1]
    assert train.action is Action.TURN_LEFT
    biobot.log.append(dataclasses.replace(train, begin_ns=train.begin_ns + 10**10, end_ns=train.end_ns + 10**10))
    biobot.log.append(dataclasses.replace(train, begin_ns=train.begin_ns + 2 * 10**10, end_ns=train.end_ns + 2 * 10**10, command=999))
    assert {"late", "twice", "nobody's"} <= _kinds(world)


def test_a_stop_that_did_nothing_and_a_frame_after_it_are_seen() -> None:
    world = _world(flight_s=0.1)
    _turns(world, n=1, every_ms=3_000)
    stopped = world.order(Order(action=_STOP, node=1))
    world.wait(3_000)
    assert stopped.last is not None
    assert stopped.last.stage is Stage.BIOBOT_CONFIRMED
    biobot = world.biobots[stopped.request.node]
    turn, stop = world.air.frames[0], biobot.log[-1]
    assert stop.action is Action.STOP
    biobot.log.append(dataclasses.replace(biobot.log[0], begin_ns=world.time.now_ns))
    turn.written_ns = world.time.now_ns
    world.wait(20_000)
    assert {"moved after a stop", "sent after a stop"} <= _kinds(world)
    biobot.log.remove(stop)
    assert "not stopped" in {one.partition(":")[0] for one in violations(world)}


def test_a_stop_of_all_that_nobody_obeyed_and_that_is_said_to_be_confirmed_is_seen() -> None:
    world = _world(flight_s=0.1)
    world.wait(10_000)
    stopped = world.order(Order(action=StimulationAction.STOP_ALL, node=1))
    world.wait(20_000)
    assert stopped.last is not None
    assert stopped.last.stage is Stage.BIOBOT_CONFIRMED
    assert "nobody stopped" not in _kinds(world)
    for biobot in world.biobots.values():
        biobot.log.clear()
    assert "nobody stopped" in {one.partition(":")[0] for one in violations(world)}


def test_a_stop_that_comes_again_word_for_word_is_answered_and_stops_nobody_who_was_moved_since() -> None:
    world = _world(flight_s=0.1)
    world.wait(10_000)
    world.order(Order(action=_STOP, node=1))
    world.wait(3_000)
    world.order(Order(action=_TURN, node=1))
    world.wait(3_000)
    again = world.repeat(1)
    assert again is not None
    assert again.request.action is _STOP
    assert _kinds(world) == set()
    assert again.last is not None
    assert again.last.stage is Stage.BIOBOT_CONFIRMED


def test_stages_that_are_late_missing_or_too_many_are_seen() -> None:
    world = _world(flight_s=0.1)
    _turns(world, n=4, every_ms=2_600)
    first, second, third, fourth = world.calls
    first.stages[-1] = (first.stages[-1][0] + 10**11, first.stages[-1][1])
    second.stages.append(second.stages[-1])
    third.life.end_ns = None
    del third.stages[-1]
    told_ns, stage = fourth.stages[0]
    refused = CommandStage(**{**msgspec.structs.asdict(stage), "stage": Stage.REFUSED})
    fourth.stages[:] = [(told_ns, refused)]
    assert {"deadline", "final stages", "no reason for programs", "refused and sent"} <= _kinds(world)


def test_the_same_events_are_the_same_history() -> None:
    def live() -> tuple[list[object], ...]:
        world = _world(flight_s=0.5)
        world.set_fates(0, (FrameFate(n_copies=2, flight=0.9), FrameFate(confirm=Fate.NO_ACK, n_lost_answers=3)))
        _turns(world, n=4, every_ms=2_600)
        world.order(Order(action=_STOP, node=1))
        world.restart_gateway(down_ms=500, is_reboot=True)
        _turns(world, n=3, every_ms=3_000)
        world.close()
        assert "electrode 1: turn_left" in tell(world)
        instants: list[object] = [(one.begin_ns, one.end_ns, one.action) for one in world.biobots[world.calls[0].request.node].log]
        return instants, [(call.given_ns, [(at, one.stage, one.reason) for at, one in call.stages]) for call in world.calls]

    assert live() == live()


@pytest.mark.parametrize("number", [0, 1, sites.N_FATES - 1])
def test_every_number_is_a_fate_and_nothing_is_a_good_radio(number: int) -> None:
    assert (sites.fate(number) == FrameFate()) == (number == 0)


def test_a_batch_is_told_in_numbers_and_is_the_same_again() -> None:
    one, other = (run_batch(Batch(number=5, n_histories=10)) for _ in range(2))
    assert one == other
    assert one.broken == ""
    assert one.counts["histories"] >= 10
    assert one.counts["trains at an electrode"] > 0


def _can_not(world: World) -> None:
    """Have all that was announced say that nobody can follow walls."""
    world.announced[:] = [dataclasses.replace(one, can_follow_walls=False) for one in world.announced]


def test_a_walk_along_walls_that_nobody_can_or_with_a_train_that_nobody_wants_is_seen() -> None:
    world = _world(flight_s=0.1)
    world.wait(10_000)
    walk = world.order(Order(action=StimulationAction.FOLLOW_WALLS, node=1))
    world.wait(3_000)
    done = world.biobots[walk.request.node].log[-1]
    assert (done.action, done.train) == (Action.FOLLOW_WALLS, None)
    assert _kinds(world) == set()
    frame = world.air.frames[-1]
    frame.message = msgspec.structs.replace(frame.message, duration_ms=500)
    _can_not(world)
    assert {"along walls", "a train that nobody asked for"} <= {one.partition(":")[0] for one in violations(world)}


# Faults that random histories found, as short as they could be made.


def test_the_train_of_a_stop_that_no_radio_took_at_first_is_on_record() -> None:
    world = _world(flight_s=0.1)
    world.set_radio(0, is_up=False)
    world.order(Order(action=_STOP, node=1))
    world.wait(500)
    world.set_radio(0, is_up=True)
    world.wait(3_000)
    assert _kinds(world) == set()


def test_a_number_of_a_stop_that_did_not_come_to_disk_is_not_used_again() -> None:
    """A backpack takes a stop of a number that it knows for a repetition, and lets the insect walk."""
    world = _world(flight_s=0.1)
    _turns(world, n=1, every_ms=3_000)
    for _ in range(2):
        world.restart_gateway(down_ms=100)
        world.wait(0)
        world.order(Order(action=_STOP, node=1))
        world.wait(1)
    assert _kinds(world) == set()


def test_a_frame_does_not_wait_in_the_gateway_beyond_its_time_to_live() -> None:
    world = _world(flight_s=1.0)
    world.set_fates(0, (FrameFate(queued_ms=200, flight=1.0),))
    world.order(Order(action=_TURN, node=1, ttl_ms=100))
    world.wait(3_000)
    assert _kinds(world) == set()


def test_a_wall_clock_that_is_set_back_while_the_disk_is_slow_makes_no_command_younger() -> None:
    world = _world(flight_s=1.0)
    world.set_disk(is_full=False, commit_ms=400)
    world.set_fates(0, (FrameFate(queued_ms=0, flight=1.0),))
    world.order(Order(action=_TURN, node=1, ttl_ms=100))
    world.wait(200)
    world.jump_wall_clock(-3_600_000)
    world.wait(3_000)
    assert _kinds(world) == set()


@pytest.mark.parametrize("confirm", [Fate.SENT, Fate.NO_ACK, Fate.UNKNOWN])
@pytest.mark.parametrize("n_lost_answers", [0, 3])
def test_an_insect_that_an_older_frame_moves_after_a_stop_is_stopped_again(n_lost_answers: int, confirm: Fate) -> None:
    """Frames pass each other: a dongle may try for seconds to deliver a start, and deliver the stop that follows at once."""
    world = _world(flight_s=3.0)
    world.set_fates(0, (FrameFate(flight=0.9, n_lost_answers=n_lost_answers, confirm=confirm),))
    world.order(Order(action=StimulationAction.START, node=1))
    world.wait(100)
    world.set_fates(0, (FrameFate(),))
    stop = world.order(Order(action=_STOP, node=1))
    world.wait(20_000)
    assert [one.action for one in world.biobots[stop.request.node].log] == [Action.STOP, Action.START, Action.STOP]
    assert _kinds(world) == set()


def test_limits_that_a_backpack_announces_while_the_disk_is_slow_hold_for_what_waits_for_it() -> None:
    world = World(dataclasses.replace(sites.SITES[0], limits=sites.LIMITS[3]), rows=MemoryRows())
    world.wait(50)
    world.set_disk(is_full=False, commit_ms=200)
    call = world.order(Order(action=_TURN, node=2))
    world.wait(100)
    world.hear(2, announces=True)
    world.wait(3_000)
    assert call.last is not None
    assert call.last.refusal is Refusal.PULSE
    assert _kinds(world) == set()


def test_a_backpack_that_starts_anew_while_the_disk_is_slow_is_not_sent_along_walls() -> None:
    """What it can is not known before it has said so again: it may be another one's, put on the same insect."""
    world = _world(flight_s=1.0)
    world.set_disk(is_full=False, commit_ms=200)
    call = world.order(Order(action=StimulationAction.FOLLOW_WALLS, node=1))
    world.wait(100)
    world.restart_backpack(1)
    world.hear(1)
    world.wait(3_000)
    assert call.last is not None
    assert call.last.refusal is Refusal.UNFIT_BIOBOT
    assert _kinds(world) == set()
