"""The simulated backpack's outbox against the gateway's window: what one acknowledges, the other must have."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.messages import Acknowledge, StimulateReply, StimulationResult, TimeSyncReply, WireMode
from firmware_protocol.units import BootId, Milliseconds
from gateway.sequences import SequenceWindow
from simulator.backpacks.outbox import MAX_REPORT_WINDOW, Outbox, OutboxConfig

_REPORT = TimeSyncReply(token=0, received_ms=Milliseconds(0))
_ANSWER = StimulateReply(command=1, result=StimulationResult.DONE, executed_ms=Milliseconds(0), mode=WireMode.S)


@given(st.lists(st.booleans(), max_size=400), st.lists(st.booleans(), max_size=200), st.integers(1, MAX_REPORT_WINDOW))
def test_nothing_is_acknowledged_that_never_came_whatever_the_radio_loses(up: list[bool], down: list[bool], window: int) -> None:
    """``up`` and ``down`` say which uplink messages and acknowledgements are lost; then the radio is perfect until all is through."""
    outbox = Outbox(biobot=1, seed=1, config=OutboxConfig(window=window))
    station = SequenceWindow()
    came: set[int] = set()
    n_given, now_ms = 0, 0
    while n_given < 150 or not outbox.is_empty:
        now_ms += 500
        while n_given < 150 and outbox.n_free and outbox.put(_ANSWER if n_given % 5 == 4 else _REPORT):
            n_given += 1
        for copy in outbox.take_due(now_ms):
            if not (up and up.pop()):
                number = station.unwrap(copy.sequence)
                came.add(number)
                station.add(number)
        next_sequence, bitmap = station.acknowledgement()
        if came and not (down and down.pop()):
            answer = Acknowledge(boot=BootId(0), next_sequence=next_sequence, bitmap=bitmap)
            assert {sequence for sequence, _ in outbox.acknowledge(answer, now_ms=now_ms)} <= came

    assert came == set(range(150))
    assert station.n_skipped == 0
