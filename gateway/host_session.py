"""Keeps one dongle open on one open port, for tools: what the dongle says is handed up, and the owner decides what is confirmed.

The gateway itself has ``coordinator.py``, which also opens ports again and settles futures; this has no patience of its own.
"""

import asyncio
import random
import time
from collections.abc import Callable

from firmware_protocol.dialects.interface import Host, HostEvent, HostLost
from firmware_protocol.units import NS_PER_S, ShortAddress
from gateway.transports.interface import Transport

_REOPEN_NS = NS_PER_S
"""Pause before a dongle that was lost is opened again."""

OnEvent = Callable[[HostEvent, int], None]
"""Is given an event and the monotonic instant [ns] at which the bytes came that brought it about."""


class HostSession:
    """See the module; ``run`` is its task.

    Parameters
    ----------
    transport
        An open port; the caller closes it.
    host
        The base station's end of the dongle's dialect, not yet opened.
    on_event
        Is given every event in order; must return at once.
    """

    def __init__(self, transport: Transport, host: Host, *, on_event: OnEvent) -> None:
        self.host = host
        self._transport = transport
        self._on_event = on_event
        self._wake = asyncio.Event()
        # Other than the last one, with which the dongle may still believe itself connected (WIRE_FORMAT.md §3.2).
        self._session = random.randrange(1 << 16)
        self._reopen_at_ns: int | None = None

    def send(self, *, destination: ShortAddress, payload: bytes) -> int:
        """Send a radio payload; see ``Host.send``."""
        ticket = self.host.send(destination=destination, payload=payload, now_ns=time.monotonic_ns())
        self._wake.set()
        return ticket

    def confirm(self, receipt: int) -> None:
        """Let the dongle forget what was heard up to ``receipt``."""
        self.host.confirm(receipt)
        self._wake.set()

    async def run(self) -> None:
        """Keep the dongle open, for ever.

        Raises
        ------
        TransportClosedError
            The port has gone.
        """
        self._open()
        writing = asyncio.ensure_future(self._write())
        reading = asyncio.ensure_future(self._read())
        try:
            await asyncio.wait({writing, reading}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            writing.cancel()
            reading.cancel()
            # Their ends are awaited, so that nobody still waits on the port when it is closed.
            ends = await asyncio.gather(writing, reading, return_exceptions=True)
        raise next(end for end in ends if isinstance(end, BaseException) and not isinstance(end, asyncio.CancelledError))

    def _open(self) -> None:
        self._session = (self._session + 1) % (1 << 16)
        self._reopen_at_ns = None
        now_ns = time.monotonic_ns()
        self._hand_up(self.host.open(session=self._session, now_ns=now_ns), now_ns)

    async def _read(self) -> None:
        while True:
            chunk = await self._transport.read()
            now_ns = time.monotonic_ns()
            self._hand_up(self.host.feed(chunk, now_ns=now_ns), now_ns)
            self._wake.set()

    async def _write(self) -> None:
        while True:
            while frames := self.host.take_frames(at_most=1):
                await self._transport.write(frames[0])
            deadlines = [at for at in (self.host.next_deadline_ns(), self._reopen_at_ns) if at is not None]
            wait_s = max(0.0, (min(deadlines) - time.monotonic_ns()) / NS_PER_S) if deadlines else None
            try:
                async with asyncio.timeout(wait_s):
                    await self._wake.wait()
            except TimeoutError:
                now_ns = time.monotonic_ns()
                self._hand_up(self.host.handle_deadline(now_ns=now_ns), now_ns)
                if self._reopen_at_ns is not None and now_ns >= self._reopen_at_ns:
                    self._open()
            self._wake.clear()

    def _hand_up(self, events: list[HostEvent], now_ns: int) -> None:
        for event in events:
            if isinstance(event, HostLost):
                self._reopen_at_ns = now_ns + _REOPEN_NS
            self._on_event(event, now_ns)


async def run_until(session: HostSession, stop: asyncio.Event) -> None:
    """Run a session until ``stop`` is set.

    Raises
    ------
    TransportClosedError
        The port has gone before that.
    """
    running = asyncio.ensure_future(session.run())
    stopping = asyncio.ensure_future(stop.wait())
    try:
        await asyncio.wait({running, stopping}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        stopping.cancel()
        running.cancel()
        end, _ = await asyncio.gather(running, stopping, return_exceptions=True)
    if isinstance(end, Exception):
        raise end
