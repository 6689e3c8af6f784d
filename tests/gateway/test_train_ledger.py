"""Laws of the stimulation limits."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.train_ledger import TrainLedger

_NODE = NodeId(1)


@given(st.lists(st.integers(0, 4_000), max_size=120), st.sampled_from([100, 300, 500]))
def test_no_history_exceeds_a_limit(pauses_ms: list[int], train_ms: int) -> None:
    limits = StimulationTable()
    ledger = TrainLedger(limits=limits)
    admitted: list[int] = []
    now_ns = 0
    for pause_ms in pauses_ms:
        now_ns += pause_ms * NS_PER_MS
        if ledger.refusal(_NODE, train_ms=train_ms, now_ns=now_ns) is None:
            ledger.admit(_NODE, train_ms=train_ms, at_ns=now_ns)
            admitted.append(now_ns)
    for at_ns in admitted:
        recent = [one for one in admitted if at_ns - 60 * NS_PER_S < one <= at_ns]
        assert len(recent) <= 30
        assert len(recent) * train_ms <= 9_000
        assert all(at_ns - one >= 2 * NS_PER_S + train_ms * NS_PER_MS for one in recent if one != at_ns)


def test_biobots_have_limits_of_their_own() -> None:
    ledger = TrainLedger(limits=StimulationTable())
    ledger.admit(_NODE, train_ms=500, at_ns=0)
    assert ledger.refusal(_NODE, train_ms=500, now_ns=NS_PER_S) is not None
    assert ledger.refusal(NodeId(2), train_ms=500, now_ns=NS_PER_S) is None
    assert ledger.refusal(_NODE, train_ms=500, now_ns=3 * NS_PER_S) is None
