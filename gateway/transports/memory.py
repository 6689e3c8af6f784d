"""A connected pair of in-memory transports, for tests and for wiring a device model into the same process."""

import asyncio
from collections import deque

from gateway.errors import TransportClosedError

_CAPACITY = 65_536
"""Bytes that wait in one direction before ``write`` waits."""


class MemoryTransport:
    """One end of a pair; see ``connected_pair``."""

    def __init__(self, *, name: str, incoming: "_Pipe", outgoing: "_Pipe") -> None:
        self._name = name
        self._incoming = incoming
        self._outgoing = outgoing

    @property
    def name(self) -> str:
        """What the port is called."""
        return self._name

    async def read(self) -> bytes:
        """Return the next bytes; raise ``TransportClosedError`` when either end is closed and nothing is left."""
        chunk = await self._incoming.take()
        if not chunk:
            raise TransportClosedError(name=self._name, reason="closed")
        return chunk

    async def write(self, data: bytes) -> None:
        """Send ``data``; wait while the reader is far behind."""
        if not await self._outgoing.put(data):
            raise TransportClosedError(name=self._name, reason="closed")

    def write_at_once(self, data: bytes) -> bytes:
        """Send nothing: the reader is another task's affair."""
        return data

    async def aclose(self) -> None:
        """Close both ends; what was written before can still be read."""
        await self._incoming.close()
        await self._outgoing.close()


class _Pipe:
    """One direction: bounded, and closed once."""

    def __init__(self) -> None:
        self._chunks: deque[bytes] = deque()
        self._size = 0
        self._is_closed = False
        self._changed = asyncio.Condition()

    async def put(self, data: bytes) -> bool:
        async with self._changed:
            await self._changed.wait_for(lambda: self._size < _CAPACITY or self._is_closed)
            if self._is_closed:
                return False
            self._chunks.append(data)
            self._size += len(data)
            self._changed.notify_all()
            return True

    async def take(self) -> bytes:
        async with self._changed:
            await self._changed.wait_for(lambda: bool(self._chunks) or self._is_closed)
            if not self._chunks:
                return b""
            chunk = self._chunks.popleft()
            self._size -= len(chunk)
            self._changed.notify_all()
            return chunk

    async def close(self) -> None:
        async with self._changed:
            self._is_closed = True
            self._changed.notify_all()


def connected_pair() -> tuple[MemoryTransport, MemoryTransport]:
    """Return two transports; what is written to one is read from the other."""
    there, back = _Pipe(), _Pipe()
    return MemoryTransport(name="memory:a", incoming=back, outgoing=there), MemoryTransport(name="memory:b", incoming=there, outgoing=back)
