"""A transport that tells a listener of every byte that passes, both ways, and of how the port came and went."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from gateway.errors import TransportClosedError
from gateway.transports.interface import Transport


class RecordKind(IntEnum):
    """What happened on a line (docs/recordings.md)."""

    BYTES_IN = 1
    """Bytes from the dongle, as one read gave them."""
    BYTES_OUT = 2
    """Bytes to the dongle, as one write took them; told before they are written, so that an answer never comes first."""
    OPENED = 3
    CLOSED = 4
    """Closed by this side."""
    LOST = 5
    """Gone by itself; the data is the reason, in UTF-8."""
    GAP = 6
    """So much was not recorded, because the disk was too slow; the data is the number of bytes, in decimal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineRecord:
    """What happened, and when, on two clocks: the monotonic one for intervals, the wall clock for people."""

    kind: RecordKind
    monotonic_ns: int
    wall_ns: int
    data: bytes = b""


TakeRecord = Callable[[LineRecord], None]


class RecordingTransport:
    """Passes all on to another transport; see the module.

    Parameters
    ----------
    transport
        The one that is open.
    take
        Is given each record, in order; must return at once and not raise.
    """

    def __init__(self, transport: Transport, *, take: TakeRecord) -> None:
        self._transport = transport
        self._take = take
        self._is_over = False
        self._tell(RecordKind.OPENED, transport.name.encode())

    @property
    def name(self) -> str:
        """What the port is called."""
        return self._transport.name

    async def read(self) -> bytes:
        """Return the next bytes; see ``Transport``."""
        try:
            chunk = await self._transport.read()
        except TransportClosedError as error:
            self._end(RecordKind.LOST, error.reason)
            raise
        self._tell(RecordKind.BYTES_IN, chunk)
        return chunk

    async def write(self, data: bytes) -> None:
        """Send all of ``data``; see ``Transport``."""
        self._tell(RecordKind.BYTES_OUT, data)
        try:
            await self._transport.write(data)
        except TransportClosedError as error:
            self._end(RecordKind.LOST, error.reason)
            raise

    def write_at_once(self, data: bytes) -> bytes:
        """Send what goes without waiting; see ``Transport``. An answer to it is read later than this returns, and told after it."""
        rest = self._transport.write_at_once(data)
        if len(rest) < len(data):
            self._tell(RecordKind.BYTES_OUT, data[: len(data) - len(rest)])
        return rest

    async def aclose(self) -> None:
        """Close; closing twice is no fault."""
        self._end(RecordKind.CLOSED, "")
        await self._transport.aclose()

    def _end(self, kind: RecordKind, reason: str) -> None:
        if not self._is_over:
            self._is_over = True
            self._tell(kind, reason.encode())

    def _tell(self, kind: RecordKind, data: bytes) -> None:
        self._take(LineRecord(kind=kind, monotonic_ns=time.monotonic_ns(), wall_ns=time.time_ns(), data=data))
