"""Server-sent events: only version numbers; whoever wants the content asks for it. A slow client skips what lies between."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Final

import msgspec
from starlette.responses import StreamingResponse

from mapper.changes import Changes, Topic
from mapper.errors import TooManyError

_MAX_CLIENTS: Final = 500
_MIN_PERIOD_S: Final = 0.2
# Proxies and browsers give up on a silent connection; a comment keeps it.
_HEARTBEAT_S: Final = 15.0


class EventStream:
    """All open event streams; `close` ends them, so that the server can stop."""

    def __init__(self, changes: Changes) -> None:
        self._changes = changes
        self._is_closing = False
        self._n_clients = 0

    def open(self, *, is_welcome: Callable[[], bool] = lambda: True) -> StreamingResponse:
        """Make the answer to one client.

        Parameters
        ----------
        is_welcome
            Asked before each event and at each sign of life; the stream ends when it says no.

        Raises
        ------
        TooManyError
            500 clients are connected.
        """
        if self._n_clients >= _MAX_CLIENTS:
            raise TooManyError(what="event streams", limit=_MAX_CLIENTS)
        return StreamingResponse(
            self._tell(is_welcome), media_type="text/event-stream", headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        )

    def close(self) -> None:
        """End all streams."""
        self._is_closing = True
        self._changes.bump(Topic.BIOBOTS)

    async def _tell(self, is_welcome: Callable[[], bool]) -> AsyncIterator[bytes]:
        self._n_clients += 1
        try:
            seen = self._changes.versions
            # A client that lost its connection comes back after this.
            yield b"retry: 1000\n" + _format(seen)
            while not self._is_closing and is_welcome():
                try:
                    async with asyncio.timeout(_HEARTBEAT_S):
                        seen = await self._changes.wait(seen=seen)
                except TimeoutError:
                    yield b": still here\n\n"
                    continue
                if not is_welcome():
                    break
                yield _format(seen)
                await asyncio.sleep(_MIN_PERIOD_S)
        finally:
            self._n_clients -= 1


def _format(versions: object) -> bytes:
    return b"event: change\ndata: " + msgspec.json.encode(versions) + b"\n\n"
