"""Frames to single biobots that are not to fill a radio: a few at a time on each, and each radio by itself."""

import asyncio

from gateway.stimulation.outside import Sending

AT_ONCE = 3
"""Frames to single biobots whose fate a radio has not told: one that it sends, one that it has, and one on the line. What is more urgent
than they are then stands behind few of them, and a radio that is stuck is given no more."""


class Turns:
    """See the module; kept over all that sends so, for together they must not be too many."""

    def __init__(self) -> None:
        self._unfinished: dict[str, set[Sending]] = {}

    def begin(self, radio: str, sending: Sending) -> None:
        """Take note of a frame that was given to a radio."""
        unfinished = self._unfinished.setdefault(radio, set())
        unfinished.add(sending)
        sending.add_done_callback(unfinished.discard)

    async def wait_for(self, radio: str) -> None:
        """Return when a radio may have another frame; others have their turn in any case."""
        await asyncio.sleep(0)
        while len(unfinished := self._unfinished.get(radio, set())) >= AT_ONCE:
            await asyncio.wait(unfinished, return_when=asyncio.FIRST_COMPLETED)
