"""A radio whose port is opened anew while its dongle goes on."""

import asyncio
import contextlib
import time
from functools import partial

import pytest

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.envelope import RadioStatus
from firmware_protocol.units import ShortAddress
from gateway.config import LinkTable
from gateway.coordinator import Coordinator
from gateway.errors import TransportClosedError
from gateway.health import Health
from gateway.radio import Fate
from gateway.transports.memory import MemoryTransport, connected_pair
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from tests.gateway.fake_radio import until

A, B = ShortAddress(0x1111), ShortAddress(0x2222)


class Line:
    """A dongle that outlives its ports, each one a new pair of transports."""

    def __init__(self, dialect: str) -> None:
        self.dongle: Dongle = make_dongle(dialect, index=0)
        self.dongle.start(now_ns=time.monotonic_ns())
        self.n_opened = 0
        self._ends: list[MemoryTransport] = []
        self._reading: asyncio.Task[None] | None = None

    async def open(self) -> MemoryTransport:
        self.n_opened += 1
        near, far = connected_pair()
        self._ends = [far]
        self._reading = asyncio.ensure_future(self._read(far))
        return near

    async def pull(self) -> None:
        await self._ends[0].aclose()

    async def run(self) -> None:
        """Let the dongle's time pass and its bytes out; where no port is open they are lost."""
        while True:
            due_ns = self.dongle.next_deadline_ns()
            if due_ns is not None and due_ns <= time.monotonic_ns():
                self.dongle.handle_deadline(now_ns=time.monotonic_ns())
            said = self.dongle.take_bytes()
            if said and self._ends:
                with contextlib.suppress(TransportClosedError):
                    await self._ends[0].write(said)
            await asyncio.sleep(0.001)

    async def _read(self, far: MemoryTransport) -> None:
        with contextlib.suppress(TransportClosedError):
            while True:
                self.dongle.feed(await far.read(), now_ns=time.monotonic_ns())


@pytest.mark.parametrize("dialect", ["native", "xbee", "znp"])
def test_what_a_dongle_tells_of_a_payload_from_before_its_port_was_opened_anew_settles_no_other(dialect: str) -> None:
    async def story() -> None:
        line = Line(dialect)
        radio = Coordinator(
            radio="radio",
            make_host=partial(make_host, dialect),
            open_port=line.open,
            on_radio=lambda _: None,
            config=LinkTable(first_backoff_s=0.01),
            health=Health(),
            first_session=1,
        )
        tasks = [asyncio.ensure_future(one) for one in (radio.run(), line.run())]
        await until(lambda: radio.is_up, what="up")
        old = radio.send(destination=A, payload=b"for A")
        await until(lambda: bool(line.dongle.requests), what="the radio has it")
        request = line.dongle.requests.popleft()
        await line.pull()
        assert (await old).fate is Fate.UNKNOWN
        await until(lambda: radio.is_up and line.n_opened == 2, what="up again")

        new = radio.send(destination=B, payload=b"for B")
        await until(lambda: bool(line.dongle.requests), what="the radio has that too")
        line.dongle.confirm(request.handle, RadioStatus.UNKNOWN_ADDRESS, now_ns=time.monotonic_ns())
        line.dongle.confirm(line.dongle.requests.popleft().handle, RadioStatus.SENT, now_ns=time.monotonic_ns())
        assert (await new).fate is Fate.SENT
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    asyncio.run(story())
