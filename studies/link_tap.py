"""Between a dongle and its gateway: passes all bytes on, and measures how long each payload waits for its acknowledgement.

A base station acknowledges a payload when what it says is on disk (WIRE_FORMAT.md §3.3), so that is the time a gateway takes.
"""

import asyncio
import struct
import threading
import time
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final, Self

from firmware_protocol.framing.cobs import CobsDecoder

# Kind, session, sequence number (WIRE_FORMAT.md §3.1).
_HEADER: Final = struct.Struct("<BHB")
_DATA: Final = 3
_ACK: Final = 4
_CHUNK: Final = 65_536


@dataclass(slots=True)
class _Line:
    """One connection: payloads under way by their sequence numbers, with the instants at which they were first seen."""

    session: int = -1
    under_way: dict[int, float] = field(default_factory=dict)


class LinkTap:
    """A TCP port for a gateway to open, in front of a dongle's; runs on a thread of its own while its context lasts."""

    def __init__(self, *, host: str, port: int) -> None:
        self.waits: list[tuple[float, float]] = []
        """When a payload was acknowledged [s, monotonic], and how long it had waited [s]."""
        self.port = 0
        self._dongle = (host, port)
        self._loop = asyncio.new_event_loop()
        self._is_up = threading.Event()
        self._thread = threading.Thread(target=self._run, name="link tap")

    def __enter__(self) -> Self:
        self._thread.start()
        self._is_up.wait()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def waits_between(self, begin: float, end: float) -> list[float]:
        """Return the waits [s] that ended in a stretch of time."""
        return [wait for at, wait in list(self.waits) if begin <= at < end]

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(asyncio.start_server(self._serve, "127.0.0.1", 0))
        self.port = server.sockets[0].getsockname()[1]
        self._is_up.set()
        self._loop.run_forever()
        server.close()
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._loop.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        line = _Line()
        try:
            from_dongle, to_dongle = await asyncio.open_connection(*self._dongle)
        except OSError:
            writer.close()  # the dongle is gone; the gateway sees a line that ends at once, and tries again
            return
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._pass_on(from_dongle, writer, line, is_up=True))
                group.create_task(self._pass_on(reader, to_dongle, line, is_up=False))
        except* ConnectionError:
            pass  # one end is gone: the gateway opens the port again, and gets a new line
        finally:
            writer.close()
            to_dongle.close()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, line: _Line, *, is_up: bool) -> None:
        decoder = CobsDecoder()
        while chunk := await reader.read(_CHUNK):
            now = time.monotonic()
            writer.write(chunk)
            for body in decoder.feed(chunk):
                if isinstance(body, bytes) and len(body) >= _HEADER.size:
                    self._note(line, *_HEADER.unpack_from(body), now=now, is_up=is_up)
            await writer.drain()
        raise ConnectionResetError

    def _note(self, line: _Line, kind: int, session: int, sequence: int, *, now: float, is_up: bool) -> None:
        if session != line.session:
            line.session = session
            line.under_way.clear()
        if is_up and kind == _DATA:
            line.under_way.setdefault(sequence, now)
        elif not is_up and kind == _ACK:
            # An ACK names the next payload expected: all before it, at most half of the 256 numbers, are safe.
            for number in [number for number in line.under_way if 0 < (sequence - number) % 256 < 128]:
                self.waits.append((now, now - line.under_way.pop(number)))
