"""Laws of receipts: which payloads of a dongle can be confirmed."""

import asyncio

from hypothesis import given
from hypothesis import strategies as st

from gateway.receipts import PATIENCE_NS, Receipts

_STEPS = st.lists(st.tuples(st.sampled_from(["add", "finish", "take"]), st.integers(0, 4)), max_size=60)
"""Payloads that wait for write 1 to 4, or for nothing (0); writes that are done; and questions what can be confirmed."""


@given(steps=_STEPS)
def test_a_payload_is_confirmed_when_all_up_to_it_are_safe_and_memory_grows_with_the_writes_alone(steps: list[tuple[str, int]]) -> None:
    loop = asyncio.new_event_loop()
    writes = [loop.create_future() for _ in range(5)]
    receipts, waited_for, confirmed = Receipts(), list[int](), 0
    for what, which in steps:
        match what:
            case "add":
                waited_for.append(which)
                receipts.add(len(waited_for), writes[which] if which else None, now_ns=0)
            case "finish" if which and not writes[which].done():
                writes[which].set_result(None)
            case "take":
                is_safe = [not wanted or writes[wanted].done() for wanted in waited_for]
                safe = is_safe.index(False) if False in is_safe else len(is_safe)
                assert receipts.take_ready(now_ns=PATIENCE_NS - 1) == (safe if safe > confirmed else None)
                confirmed = safe
    runs = sum(1 for before, now in zip([0, *waited_for], waited_for, strict=False) if now and now != before)
    assert len(receipts) <= runs
    loop.close()


def test_a_repetition_behind_a_write_that_is_awaited_takes_no_memory() -> None:
    loop = asyncio.new_event_loop()
    receipts, write = Receipts(), loop.create_future()
    began = [receipts.add(number, write if number % 2 else None, now_ns=0) for number in range(1, 10_000)]
    assert began == [write, *[None] * 9_998]
    assert len(receipts) == 1
    assert receipts.take_ready(now_ns=0) is None
    write.set_result(None)
    assert receipts.take_ready(now_ns=0) == 9_999
    loop.close()


def test_a_disk_that_takes_nothing_is_waited_for_once_until_it_takes_something() -> None:
    loop = asyncio.new_event_loop()
    first, second, third = (loop.create_future() for _ in range(3))
    receipts = Receipts()
    before = receipts.next_deadline_ns
    receipts.add(1, first, now_ns=1000)
    receipts.add(2, second, now_ns=PATIENCE_NS)
    assert (before, receipts.next_deadline_ns) == (None, 1000 + PATIENCE_NS)
    assert receipts.take_ready(now_ns=999 + PATIENCE_NS) is None
    assert receipts.take_ready(now_ns=1000 + PATIENCE_NS) == 2, "all that waited"
    assert receipts.add(3, third, now_ns=1001 + PATIENCE_NS) is None
    assert receipts.take_ready(now_ns=1001 + PATIENCE_NS) == 3, "what comes now waits for nothing"
    first.set_result(None)
    receipts.add(4, third, now_ns=2 * PATIENCE_NS)
    assert receipts.take_ready(now_ns=2 * PATIENCE_NS) == 4, "not all is written yet"
    second.set_result(None)
    assert receipts.add(5, third, now_ns=3 * PATIENCE_NS) is third
    assert receipts.take_ready(now_ns=3 * PATIENCE_NS) is None, "it works again"
    third.set_result(None)
    assert receipts.take_ready(now_ns=3 * PATIENCE_NS) == 5
    loop.close()
