"""The mapper as a commander: as long as it is there, whom it moves may go on moving.

Gateways stop a biobot under controlled motion when its commander's token goes, or its beats fall silent (CONTRACT.md §4). The beats come
from the event loop that takes commands: where that hangs, nobody can stop anybody from here, and the gateways do.
"""

import asyncio
import time
from collections.abc import Callable
from typing import Final

from firmware_protocol.units import NS_PER_MS
from mapper.bus import Bus
from mapper.controlled_motion import ControlledMotion
from mapper.log import EventLog

_log = EventLog(__name__)

BEAT_S: Final = 0.25


class Commander:
    """Holds the token of this mapper, and beats while it has anybody under control; ``run`` is its task."""

    def __init__(
        self,
        *,
        bus: Bus,
        name: str,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.name = name
        self.motion = ControlledMotion()
        self._bus = bus
        self._now_ns = monotonic_ns
        self._wall_ns = wall_ns
        self._is_there = asyncio.Event()

    async def run(self) -> None:
        """Be there, until cancelled. The token waits until the mapper's name is known to be its own alone."""
        await self._bus.be_commander(self.name)
        self._is_there.set()
        # Higher than those of a life before, whose token a gateway may still take for this one's.
        number = self._wall_ns() // NS_PER_MS
        while True:
            if self.motion.nodes(now_ns=self._now_ns()):
                self._bus.publish_beat(commander=self.name, number=number)
                number += 1
            await asyncio.sleep(BEAT_S)

    async def wait_until_there(self, *, timeout_s: float) -> bool:
        """Wait until gateways can see that this commander is there; False where that takes too long."""
        try:
            await asyncio.wait_for(self._is_there.wait(), timeout_s)
        except TimeoutError:
            return False
        return True

    async def resign(self) -> None:
        """Give the token back: gateways stop whoever is still moved from here."""
        self._is_there.clear()
        await self._bus.resign()
        _log.info("commander.resigned", name=self.name)
