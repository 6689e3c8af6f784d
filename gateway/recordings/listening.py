"""Listens to a port: all that passes is handed on as records. Nothing that is heard is taken away from the gateway that comes later."""

import asyncio
import contextlib
import signal
from collections.abc import AsyncIterator
from dataclasses import dataclass

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.dialects.interface import HostEvent, HostLost, HostOpened, PayloadHeard
from gateway.host_session import HostSession, run_until
from gateway.recordings.dialects import make_line_dissector
from gateway.recordings.dissection import LineDissector
from gateway.transports.interface import Transport
from gateway.transports.recording import LineRecord, RecordingTransport, RecordKind, TakeRecord
from gateway.transports.spec import PortSpec, open_transport


@dataclass(frozen=True, slots=True, kw_only=True)
class Listening:
    """How to listen.

    Parameters
    ----------
    is_passive
        Write nothing at all; a dongle that waits to be opened then says nothing either.
    confirms
        Let the dongle forget what was shown. A backpack repeats it all the same, because no Acknowledge is sent to it; but a dongle
        that keeps a window open, as those of the native dialect do, goes on only then.
    duration_s
        End after so long; None: on SIGINT or SIGTERM.
    """

    is_passive: bool = False
    confirms: bool = False
    duration_s: float | None = None


@dataclass(slots=True)
class _Answer:
    """Whether the dongle answers in its dialect."""

    dissector: LineDissector
    was_open: bool = False
    was_lost: bool = False
    has_frames: bool = False

    @property
    def came(self) -> bool:
        return self.was_open or (self.has_frames and not self.was_lost)

    def look(self, record: LineRecord) -> None:
        if record.kind is RecordKind.BYTES_IN and not self.has_frames:
            self.has_frames = any(not one.fault for one in self.dissector.feed(record.data, is_outgoing=False))


async def listen(spec: PortSpec, *, how: Listening, take: TakeRecord) -> bool:
    """Listen until told to end; returns whether the dongle answered in its dialect; True of a passive listener, who asks nothing.

    It answered if it was opened, or if it was still being opened without a failure and frames had come.

    Raises
    ------
    TransportOpenError, TransportClosedError
        The port cannot be opened, or has gone.
    """
    async with stopped_by_signals(how.duration_s) as stop:
        answer = _Answer(make_line_dissector(spec.dialect, path=spec.name))

        def take_and_look(record: LineRecord) -> None:
            answer.look(record)
            take(record)

        transport = RecordingTransport(await open_transport(spec), take=take_and_look)
        try:
            if how.is_passive:
                await _only_read(transport, stop)
            else:
                await run_until(_make_session(transport, spec, how, answer), stop)
                return answer.came
        finally:
            await transport.aclose()
    return True


@contextlib.asynccontextmanager
async def stopped_by_signals(duration_s: float | None = None) -> AsyncIterator[asyncio.Event]:
    """Yield an event that SIGINT, SIGTERM or the end of ``duration_s`` sets; a second signal has its default effect."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    timer = None if duration_s is None else loop.call_later(duration_s, stop.set)

    def on_signal(number: signal.Signals) -> None:
        loop.remove_signal_handler(number)
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, on_signal, number)
    try:
        yield stop
    finally:
        if timer is not None:
            timer.cancel()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)


def _make_session(transport: Transport, spec: PortSpec, how: Listening, answer: _Answer) -> HostSession:
    def on_event(event: HostEvent, _now_ns: int) -> None:
        answer.was_open = answer.was_open or isinstance(event, HostOpened)
        answer.was_lost = answer.was_lost or isinstance(event, HostLost)
        if how.confirms and isinstance(event, PayloadHeard):
            session.confirm(event.receipt)

    session = HostSession(transport, make_host(spec.dialect, network=spec.network), on_event=on_event)
    return session


async def _only_read(transport: Transport, stop: asyncio.Event) -> None:
    stopping = asyncio.ensure_future(stop.wait())
    reading = asyncio.ensure_future(_read_on(transport))
    try:
        await asyncio.wait({stopping, reading}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        stopping.cancel()
        reading.cancel()
        end, _ = await asyncio.gather(reading, stopping, return_exceptions=True)
    if isinstance(end, Exception):
        raise end


async def _read_on(transport: Transport) -> None:
    while True:
        await transport.read()
