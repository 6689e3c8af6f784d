"""A line with faults: bytes are damaged, nothing moves for a while, and the cable is pulled and put back."""

import asyncio
import contextlib
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable

from firmware_protocol.units import NS_PER_S
from simulator.errors import LineError
from simulator.lines.byte_damage import ByteDamage
from simulator.lines.faults import Direction, FaultDraws, SpellKind
from simulator.lines.line import SerialEnd
from simulator.log import EventLog

log = EventLog(__name__)

_REPLUG_RETRY_S = 1.0


class FaultyLine:
    """A ``SerialEnd`` around another one; ``play`` makes the spells of its run happen.

    What is written while the cable is out is lost; what is under way during a stall comes after it.
    """

    def __init__(self, line: SerialEnd, draws: FaultDraws) -> None:
        self._line = line
        self._draws = draws
        self._up = ByteDamage(draws, Direction.UP)
        self._down = ByteDamage(draws, Direction.DOWN)
        self._spells: Counter[SpellKind] = Counter()
        self._moves, self._is_plugged, self._is_idle = asyncio.Event(), asyncio.Event(), asyncio.Event()
        for event in (self._moves, self._is_plugged, self._is_idle):
            event.set()
        self._cuts: set[asyncio.Timeout] = set()

    @property
    def address(self) -> str:
        """See ``SerialEnd``."""
        return self._line.address

    @property
    def counts(self) -> dict[str, int]:
        """What was done to the line so far, by kind; damage to bytes by direction and kind."""
        damage = {
            f"{direction.value}.{kind.value}": count
            for direction, one in ((Direction.UP, self._up), (Direction.DOWN, self._down))
            for kind, count in one.counts.items()
        }
        return damage | {kind.value: count for kind, count in self._spells.items()}

    async def read(self) -> bytes:
        """See ``SerialEnd``."""
        while True:
            await self._is_plugged.wait()
            data = b""
            with contextlib.suppress(TimeoutError):
                async with self._while_plugged():
                    data = await self._line.read()
            await self._moves.wait()
            if damaged := self._down.apply(data):
                return damaged

    async def write(self, data: bytes) -> None:
        """See ``SerialEnd``."""
        await self._moves.wait()
        damaged = self._up.apply(data)
        if damaged and self._is_plugged.is_set():
            with contextlib.suppress(TimeoutError):
                async with self._while_plugged():
                    await self._line.write(damaged)

    async def unplug(self) -> None:
        """See ``SerialEnd``."""
        self._is_plugged.clear()
        now_s = asyncio.get_running_loop().time()
        for cut in self._cuts:
            cut.reschedule(now_s)
        await self._is_idle.wait()  # nobody may still wait for a descriptor that is closed
        await self._line.unplug()

    async def plug_in(self) -> None:
        """See ``SerialEnd``; tried again until the place is free."""
        while True:
            try:
                await self._line.plug_in()
            except LineError as error:
                log.warning("fault.cannot_plug_in", line=self.address, reason=str(error))
                await asyncio.sleep(_REPLUG_RETRY_S)
            else:
                break
        self._is_plugged.set()

    async def aclose(self) -> None:
        """See ``SerialEnd``."""
        await self._line.aclose()

    async def stall(self) -> None:
        """Let nothing move, either way, until ``go_on``."""
        self._moves.clear()

    async def go_on(self) -> None:
        """Let everything move again."""
        self._moves.set()

    async def play(self) -> None:
        """Let stalls and pulled cables happen when they are due, counted from this call, until cancelled."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._play(SpellKind.STALL, begin=self.stall, end=self.go_on))
            group.create_task(self._play(SpellKind.UNPLUG, begin=self.unplug, end=self.plug_in))

    async def _play(self, kind: SpellKind, *, begin: Callable[[], Awaitable[None]], end: Callable[[], Awaitable[None]]) -> None:
        zero_s = asyncio.get_running_loop().time()
        for spell in self._draws.spells(kind):
            await _sleep_until(zero_s + spell.begin_ns / NS_PER_S)
            log.warning("fault.begins", fault=kind.value, line=self.address)
            self._spells[kind] += 1
            await begin()
            await _sleep_until(zero_s + spell.end_ns / NS_PER_S)
            await end()
            log.info("fault.ended", fault=kind.value, line=self.address)

    @contextlib.asynccontextmanager
    async def _while_plugged(self) -> AsyncIterator[None]:
        """Let ``unplug`` end what is done within by a TimeoutError."""
        async with asyncio.timeout(None) as cut:
            self._cuts.add(cut)
            self._is_idle.clear()
            try:
                yield
            finally:
                self._cuts.remove(cut)
                if not self._cuts:
                    self._is_idle.set()


async def _sleep_until(at_s: float) -> None:
    await asyncio.sleep(at_s - asyncio.get_running_loop().time())
