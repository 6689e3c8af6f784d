"""Laws of the timer that wakes for deadlines that move."""

import asyncio
import time

from firmware_protocol.units import NS_PER_MS, NS_PER_S
from gateway.wake_timer import WakeTimer


def test_it_wakes_by_the_deadline_however_often_that_moves() -> None:
    async def story() -> None:
        wake = asyncio.Event()
        timer = WakeTimer(wake.set)
        begun_ns = time.monotonic_ns()
        timer.aim(None)
        timer.aim(begun_ns + 3_600 * NS_PER_S)
        timer.aim(begun_ns + 30 * NS_PER_MS)
        for later in range(1, 100):  # away again: the timer stays where it was
            timer.aim(begun_ns + later * NS_PER_S)
        await wake.wait()
        assert time.monotonic_ns() >= begun_ns + 29 * NS_PER_MS, "not before anything was due"
        wake.clear()
        timer.aim(begun_ns)  # what is over by now wakes at once
        await wake.wait()
        wake.clear()
        timer.aim(time.monotonic_ns() + NS_PER_MS)
        timer.stop()
        after = asyncio.get_running_loop().create_future()
        asyncio.get_running_loop().call_later(0.02, after.set_result, None)
        await after
        assert not wake.is_set(), "one that was stopped does not wake"

    asyncio.run(story())
