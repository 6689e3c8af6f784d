"""Laws of what is known of biobots: who is a landmark, and whose gateways have spoken of it."""

import msgspec
import pytest

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction
from firmware_protocol.contract.presence import Kind, Token
from firmware_protocol.contract.records import Cause, Mode, ModeRecord
from firmware_protocol.units import EVERYBODY, NS_PER_S, BootId, Nanoseconds, NodeId
from mapper.fleet import Fleet

ANCHOR_NS = 1_700_000_000 * NS_PER_S
STOPPED_S = 100.0


def a_mode(*, start_s: float, mode: Mode = Mode.S, cause: Cause = Cause.COMMAND, gateway: str = "base1") -> ModeRecord:
    return ModeRecord(
        gateway=gateway,
        journal="j",
        boot=BootId(1),
        sequence=1,
        revision=0,
        offset=1,
        wall_anchor_ns=Nanoseconds(ANCHOR_NS),
        node=NodeId(7),
        mode=mode,
        cause=cause,
        t_start_ns=Nanoseconds(round(start_s * NS_PER_S)),
        t_end_ns=None,
        error_ns=Nanoseconds(0),
    )


def stop_of_all(at_s: float) -> CommandStage:
    return CommandStage(
        command_id=f"all-{at_s}",
        gateway="base1",
        node=EVERYBODY,
        action=StimulationAction.STOP_ALL,
        stage=Stage.ACCEPTED,
        wall_ns=Nanoseconds(ANCHOR_NS + round(at_s * NS_PER_S)),
    )


def stopped_fleet() -> Fleet:
    """Return what knows that ``base1`` stopped all at 100 s."""
    fleet = Fleet()
    fleet.take_presence(Token(site="local", kind=Kind.GATEWAY, name="base1"), is_alive=True, now_ns=0)
    fleet.take_stage(stop_of_all(STOPPED_S))
    return fleet


@pytest.mark.parametrize(
    ("start_s", "is_halted"),
    [(10.0, False), (STOPPED_S, True), (STOPPED_S - 0.2, True), (STOPPED_S + 5, True), (STOPPED_S + 100, False)],
    ids=["it stood before", "it stood at once", "its clock is late", "it stood after a repetition", "it was told so later"],
)
def test_who_stands_because_all_were_stopped_is_no_landmark(start_s: float, is_halted: bool) -> None:
    fleet = stopped_fleet()
    fleet.take_modes([a_mode(start_s=start_s)])
    (view,) = fleet.biobots(now_ns=0)
    assert (view.is_halted, view.is_landmark) == (is_halted, not is_halted)
    fleet.take_modes([a_mode(start_s=start_s + 0.1, mode=Mode.CRW)])
    (view,) = fleet.biobots(now_ns=0)
    assert (view.is_halted, view.is_landmark) == (False, False)


def test_who_stops_all_once_more_makes_nobody_a_landmark() -> None:
    fleet = stopped_fleet()
    fleet.take_modes([a_mode(start_s=STOPPED_S + 1)])
    for minutes in range(1, 10):
        fleet.take_stage(stop_of_all(STOPPED_S + 60 * minutes))
        (view,) = fleet.biobots(now_ns=0)
        assert (view.is_halted, view.is_landmark) == (True, False)


@pytest.mark.parametrize(("part_of", "is_halted"), [("", False), ("all", True)], ids=["by itself", "as one of all"])
def test_who_is_told_to_stop_by_itself_soon_after_a_stop_of_all_stands_of_its_own(part_of: str, is_halted: bool) -> None:
    fleet = stopped_fleet()
    spell = a_mode(start_s=STOPPED_S + 5)
    fleet.take_modes([spell])
    fleet.take_stage(
        CommandStage(
            command_id="one",
            gateway="base1",
            node=spell.node,
            action=StimulationAction.STOP,
            stage=Stage.ACCEPTED,
            wall_ns=Nanoseconds(ANCHOR_NS + round((STOPPED_S + 4) * NS_PER_S)),
            part_of=part_of,
        )
    )
    (view,) = fleet.biobots(now_ns=0)
    assert (view.is_halted, view.is_landmark) == (is_halted, not is_halted)


def test_who_is_halted_by_its_record_is_no_landmark_though_nobody_told_of_the_stop() -> None:
    """After a restart of the mapper the records alone are there."""
    fleet = Fleet()
    fleet.take_modes([msgspec.structs.replace(a_mode(start_s=STOPPED_S), is_halted=True)])
    (view,) = fleet.biobots(now_ns=0)
    assert (view.is_halted, view.is_landmark) == (True, False)


def test_a_stop_of_all_at_one_gateway_halts_nobody_at_another() -> None:
    fleet = stopped_fleet()
    fleet.take_modes([a_mode(start_s=STOPPED_S, gateway="base2")])
    (view,) = fleet.biobots(now_ns=0)
    assert view.is_landmark


def test_every_gateway_that_spoke_of_a_biobot_is_named_the_last_first() -> None:
    fleet = Fleet()
    assert fleet.hearers_of(NodeId(7)) == []
    for start_s, gateway in ((1.0, "base2"), (3.0, "base3"), (2.0, "base1")):
        fleet.take_modes([a_mode(start_s=start_s, gateway=gateway)])
    assert fleet.hearers_of(NodeId(7)) == ["base3", "base2", "base1"]
