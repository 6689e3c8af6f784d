"""Frames onto one open port, each when the line is about to be free.

A task writes them; whoever has a stop to send need not wait for the task's turn, where the line takes it at once.
"""

import time
from collections.abc import Callable

from gateway.line_pace import LinePace
from gateway.transports.interface import Transport

NextFrame = Callable[[int], bytes | None]
"""Gives the frame that is to be written at this instant of the monotonic clock [ns], None where there is none."""


class LineWriter:
    """See the module."""

    def __init__(self, transport: Transport, *, pace: LinePace) -> None:
        self._transport = transport
        self._pace = pace
        self._rest = b""
        """Of a frame that the port did not take at once."""
        self._is_busy = False
        """A frame is being chosen or written."""
        pace.start_anew()

    async def write_what_fits(self, next_frame: NextFrame) -> None:
        """Write frame by frame while the line is free; raises what ``Transport.write`` does."""
        if self._rest:
            rest, self._rest = self._rest, b""
            await self._write(rest)
        while (frame := self._take(next_frame)) is not None:
            await self._write(frame)
            self._pace.note(len(frame), now_ns=time.monotonic_ns())

    def write_at_once(self, next_frame: NextFrame) -> None:
        """Write frames while the line is free and takes them without waiting; the task must have its turn after that."""
        while (frame := self._take(next_frame)) is not None:
            self._rest = self._transport.write_at_once(frame)
            self._pace.note(len(frame), now_ns=time.monotonic_ns())

    def _take(self, next_frame: NextFrame) -> bytes | None:
        now_ns = time.monotonic_ns()
        if self._is_busy or self._rest or self._pace.free_at_ns > now_ns:
            return None
        self._is_busy = True
        try:
            return next_frame(now_ns)
        finally:
            self._is_busy = False

    async def _write(self, data: bytes) -> None:
        self._is_busy = True
        try:
            await self._transport.write(data)
        finally:
            self._is_busy = False
