"""When the journal commits next: at once, or, where many writes come one after the other, at a pace at which they share commits."""

import asyncio

MANY_WRITES = 16
PACE_S = 0.012
"""After a group of many writes the next one begins no sooner than so long after that one began, unless somebody waits for one of its
writes. A commit costs 0.6 to 0.7 ms of processor time beside what its writes cost (measured 2026-11, docs/gateway-speed.md). A native
dongle stalls at 16 payloads: at this pace each brings five times what its line of 115,200 baud carries."""


class CommitPace:
    """See the module. Belongs to one event loop; instants are of its clock [s]."""

    def __init__(self) -> None:
        self._until_s = 0.0
        self._hurry = asyncio.Event()

    def begin(self, n_writes: int, *, now_s: float) -> None:
        """Take note that a group of so many writes is being committed from now on."""
        self._until_s = now_s + PACE_S if n_writes >= MANY_WRITES else 0.0

    def hurry(self) -> None:
        """Let the next group go at once, also if it waits already."""
        self._hurry.set()

    async def wait(self, *, is_urgent: bool) -> None:
        """Return when the next group may be committed."""
        loop = asyncio.get_running_loop()
        pause_s = self._until_s - loop.time()
        if pause_s > 0 and not is_urgent and not self._hurry.is_set():
            alarm = loop.call_later(pause_s, self._hurry.set)
            try:
                await self._hurry.wait()
            finally:
                alarm.cancel()
        self._hurry.clear()
