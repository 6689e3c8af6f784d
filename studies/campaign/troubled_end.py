"""A line that is damaged when it is told to be: around any of the simulator's ends of lines."""

import random

from simulator.lines.faults import FaultConfig, FaultDraws
from simulator.lines.faulty_line import FaultyLine
from simulator.lines.line import SerialEnd

DAMAGE = 0.02
"""Share of bytes that are harmed while a line is bad: hardly a frame comes through whole."""

_LONGEST_RUN = 32


class TroubledEnd:
    """A ``SerialEnd``. ``is_bad``: bytes are turned, lost and made up now, both ways."""

    def __init__(self, line: SerialEnd, *, seed: int, number: int) -> None:
        self.is_bad = False
        self.cable = FaultyLine(line, FaultDraws(config=FaultConfig(), seed=seed, line=number))
        """Pulls and puts back, stops and goes on, when it is told to; by itself it does nothing."""
        self._random = random.Random(seed * 1_000 + number)
        self._noise = b""

    @property
    def address(self) -> str:
        """See ``SerialEnd``."""
        return self.cable.address

    def inject(self, n_bytes: int) -> None:
        """Put noise on the line before what goes to the gateway next."""
        self._noise += self._random.randbytes(n_bytes)

    async def read(self) -> bytes:
        """See ``SerialEnd``."""
        while True:
            if data := self._harm(await self.cable.read()):
                return data

    async def write(self, data: bytes) -> None:
        """See ``SerialEnd``."""
        noise, self._noise = self._noise, b""
        if harmed := noise + self._harm(data):
            await self.cable.write(harmed)

    async def unplug(self) -> None:
        """See ``SerialEnd``."""
        await self.cable.unplug()

    async def plug_in(self) -> None:
        """See ``SerialEnd``."""
        await self.cable.plug_in()

    async def aclose(self) -> None:
        """See ``SerialEnd``."""
        await self.cable.aclose()

    def _harm(self, data: bytes) -> bytes:
        if not self.is_bad:
            return data
        out = bytearray()
        n_to_lose = 0
        for octet in data:
            if n_to_lose:
                n_to_lose -= 1
                continue
            draw = self._random.random() / DAMAGE
            if draw < 0.5:
                out.append(octet ^ 1 << self._random.randrange(8))
            elif draw < 0.8:
                out += bytes([self._random.randrange(256), octet])
            elif draw < 1.0:
                n_to_lose = self._random.randrange(_LONGEST_RUN)
            else:
                out.append(octet)
        return bytes(out)
