"""A wrong clock is a fault, told once when it begins and once when it ends."""

import pytest

from firmware_protocol.contract.records import Cause, Mode, NodeStatus
from firmware_protocol.units import BootId, Nanoseconds, NodeId, RssiDbm
from mapper.clock_watch import ClockWatch, clock_shifts
from mapper.fleet import Fleet
from mapper.gateway_clocks import Source, SourceClock
from tests.mapper.fake_gateway import ANCHOR_NS, S


def clock(gateway: str, offset_s: float | None, *, anchor_s: int = 0, last_row: int = 1) -> SourceClock:
    return SourceClock(
        source=Source(gateway=gateway, anchor_ns=ANCHOR_NS + anchor_s * S),
        reference=Source(gateway="north", anchor_ns=ANCHOR_NS),
        offset_ns=None if offset_s is None else round(offset_s * S),
        bound_ns=S // 50,
        n_votes=40,
        since_ns=ANCHOR_NS,
        is_corrected=offset_s is not None,
        last_row=last_row,
    )


def test_only_the_newest_start_counts_and_only_what_no_set_clock_is_wrong_by(caplog: pytest.LogCaptureFixture) -> None:
    watch = ClockWatch()
    watch.look([clock("north", 0.0), clock("south", 1.9), clock("west", None)])
    assert not watch.faults
    wrong = clock("south", -7200.25, anchor_s=7200, last_row=5)
    for _ in range(3):
        watch.look([clock("north", 0.0), wrong, clock("south", 0.1)])
    (fault,) = watch.faults
    assert fault.startswith("the clock of gateway south differs by +7200.250 s from that of north, by 40 shared encounters")
    assert fault.endswith("7200.250 s earlier")
    watch.look([clock("north", 0.0), wrong, clock("south", 0.1, anchor_s=1, last_row=9)])
    assert not watch.faults
    told = [(record.levelname, record.getMessage()) for record in caplog.records]
    assert told == [("ERROR", "gateway.clock_wrong"), ("WARNING", "gateway.clock_right")]


def status(gateway: str, heard_s: float) -> NodeStatus:
    return NodeStatus(
        gateway=gateway,
        radio="pty",
        node=NodeId(7),
        eui64=7,
        boot=BootId(1),
        mode=Mode.CRW,
        cause=Cause.NATURAL,
        battery_mv=3900,
        rssi_dbm=RssiDbm(-60),
        lqi=200,
        last_heard_wall_ns=Nanoseconds(ANCHOR_NS + round(heard_s * S)),
        buffered=0,
        dropped=0,
    )


def test_a_biobot_belongs_to_the_gateway_that_heard_it_last_not_to_the_one_whose_clock_is_ahead() -> None:
    fleet = Fleet()
    fleet.set_clock_shifts(clock_shifts([clock("north", 0.0), clock("south", -300.0)]))
    fleet.take_node_status(status("south", 310.0))
    fleet.take_node_status(status("north", 11.0))
    assert fleet.gateway_of(NodeId(7)) == "north"
    fleet.take_node_status(status("south", 310.5))
    assert fleet.gateway_of(NodeId(7)) == "north"
    fleet.take_node_status(status("south", 312.0))
    assert fleet.gateway_of(NodeId(7)) == "south"
    (view,) = fleet.biobots(now_ns=0)
    assert view.last_heard_wall_ns == ANCHOR_NS + 12 * S
