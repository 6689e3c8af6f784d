"""A wrong clock is a fault, told once when it begins and once when it ends."""

import pytest

from mapper.clock_watch import ClockWatch
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
