"""A client for `studies.rest_speed` that costs little itself: it writes requests made beforehand and reads answers by their length."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import urlsplit

_LIMIT: Final = 2**24
_HEAD_END: Final = b"\r\n\r\n"
_DEADLINE_S: Final = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """A request that is repeated: what it is called, where, and with which headers besides."""

    name: str
    url: str
    path: str
    headers: tuple[tuple[str, str], ...] = ()

    @property
    def address(self) -> tuple[str, int]:
        """Where it goes."""
        parts = urlsplit(self.url)
        assert parts.hostname is not None
        assert parts.port is not None
        return parts.hostname, parts.port

    def encode(self) -> bytes:
        """Return the request as it is sent."""
        lines = [f"GET {self.path} HTTP/1.1", f"Host: {urlsplit(self.url).netloc}", *(f"{name}: {value}" for name, value in self.headers)]
        return ("\r\n".join(lines) + "\r\n\r\n").encode()


@dataclass(slots=True)
class Slice:
    """What a slice of time brought: answers by status, and how long each took [s]."""

    seconds: float = 0.0
    statuses: dict[int, int] = field(default_factory=dict)
    waits_s: list[float] = field(default_factory=list)
    n_bytes: int = 0

    @property
    def per_s(self) -> float:
        """Answers a second."""
        return len(self.waits_s) / self.seconds


async def ask_for(ask: Ask, *, seconds: float, n_connections: int, period_s: float = 0.0) -> Slice:
    """Repeat a request on so many connections that stay open; each asks again ``period_s`` after it asked, or at once."""
    found, request = Slice(), ask.encode()
    begun = time.perf_counter()
    end = begun + seconds

    async def repeat() -> None:
        async with _connected(ask.address) as (reader, writer):
            due = time.perf_counter()
            while (asked := time.perf_counter()) < end:
                writer.write(request)
                async with asyncio.timeout(_DEADLINE_S):
                    status, length = _read_head(await reader.readuntil(_HEAD_END))
                    if length:
                        await reader.readexactly(length)
                found.waits_s.append(time.perf_counter() - asked)
                found.statuses[status] = found.statuses.get(status, 0) + 1
                found.n_bytes += length
                if period_s:
                    due = max(due + period_s, time.perf_counter())
                    await asyncio.sleep(max(0.0, due - time.perf_counter()))

    async with asyncio.TaskGroup() as group:
        for _ in range(n_connections):
            group.create_task(repeat())
    found.seconds = time.perf_counter() - begun
    return found


@dataclass(slots=True)
class Streams:
    """Event streams that are held open: how many, what they brought, and how many ended by themselves."""

    n_open: int = 0
    n_messages: int = 0
    n_lost: int = 0


@asynccontextmanager
async def streams_held(ask: Ask, *, n_streams: int) -> AsyncIterator[Streams]:
    """Hold event streams while the context lasts, and read what comes."""
    found = Streams()

    async def hold() -> None:
        async with _connected(ask.address) as (reader, writer):
            writer.write(ask.encode())
            await reader.readuntil(_HEAD_END)
            found.n_open += 1
            while line := await reader.readline():
                found.n_messages += line.startswith(b"data: ")
            found.n_lost += 1

    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(hold()) for _ in range(n_streams)]
        try:
            async with asyncio.timeout(_DEADLINE_S):
                while found.n_open < n_streams:  # noqa: ASYNC110  # each waits for its own answer
                    await asyncio.sleep(0.05)
            yield found
        finally:
            for task in tasks:
                task.cancel()


@asynccontextmanager
async def _connected(address: tuple[str, int]) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection(*address, limit=_LIMIT)
    try:
        yield reader, writer
    finally:
        writer.close()


def _read_head(head: bytes) -> tuple[int, int]:
    """Return status and length of the body."""
    status = int(head[9:12])
    place = head.lower().find(b"\r\ncontent-length: ")
    return status, int(head[place + 18 : head.index(b"\r\n", place + 2)]) if place >= 0 else 0
