"""The pace of acknowledgements: few while many biobots report at once, and none so late that its biobot repeats."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.units import NS_PER_MS
from gateway.acknowledger import Pace


@given(pauses_ms=st.lists(st.integers(0, 60), min_size=1, max_size=200))
def test_a_hundred_a_second_and_a_burst_of_eight_go_out_at_most(pauses_ms: list[int]) -> None:
    pace, now_ns, sent_ns = Pace(), 10**12, list[int]()
    for pause_ms in pauses_ms:
        now_ns += pause_ms * NS_PER_MS
        if pace.take("r", due_ns=now_ns, now_ns=now_ns):
            sent_ns.append(now_ns)
    assert sent_ns[0] == 10**12 + pauses_ms[0] * NS_PER_MS, "a radio that was quiet is free"
    for first, begun_ns in enumerate(sent_ns):
        for last in range(first, len(sent_ns)):
            assert last - first + 1 <= 9 + (sent_ns[last] - begun_ns) // (10 * NS_PER_MS)


def test_one_that_waited_for_400_ms_goes_out_whatever_the_pace() -> None:
    pace, now_ns = Pace(), 10**12
    while pace.take("r", due_ns=now_ns, now_ns=now_ns):
        pass
    assert not pace.take("r", due_ns=now_ns - 399 * NS_PER_MS, now_ns=now_ns)
    assert pace.take("r", due_ns=now_ns - 400 * NS_PER_MS, now_ns=now_ns)
    assert pace.take("another", due_ns=now_ns, now_ns=now_ns), "each radio has a pace of its own"
