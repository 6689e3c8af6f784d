"""Compress answers on their way out for clients that ask for it: those that are long, and no pictures or streams of events.

What is served many times is compressed once instead (`quick_answers`) and passes as it is.
"""

import asyncio
import zlib
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mapper.api.quick_answers import VARY, accepts_gzip
from mapper.served_bytes import LEAST_PACKED

_TYPES: Final = ("application/json", "application/problem+json", "application/geo+json", "image/svg+xml", "text/")
_NOT_STREAMS: Final = "text/event-stream"
_FAST: Final = 1
_GZIP: Final = 31  # of zlib's window bits: 15, with gzip's header
_LONG: Final = 64 * 1024
"""What is longer is compressed off the event loop."""


class Packing:
    """An application before another: it compresses what that answers."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http" or not accepts_gzip(Headers(scope=scope).get("accept-encoding")):
            await self._app(scope, receive, send)
            return
        await self._app(scope, receive, _Packer(send).send)


class _Packer:
    """Holds the head of an answer back until it is known whether the body is worth it."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._head: Message | None = None
        self._stream: zlib._Compress | None = None

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start" and _can_be_packed(message):
            self._head = message
            return
        if message["type"] != "http.response.body":
            await self._send(message)
            return
        if self._head is not None:
            head, self._head = self._head, None
            if not message.get("more_body", False) and len(message.get("body", b"")) < LEAST_PACKED:
                await self._send(head)
                await self._send(message)
                return
            await self._begin(head, message)
        if self._stream is not None:
            message = {**message, "body": await self._pack(message)}
        await self._send(message)

    async def _begin(self, head: Message, message: Message) -> None:
        self._stream = zlib.compressobj(_FAST, zlib.DEFLATED, _GZIP)
        headers = MutableHeaders(scope=head)
        if not message.get("more_body", False):
            message["body"] = await self._pack(message)
            self._stream = None
            headers["Content-Length"] = str(len(message["body"]))
        else:
            del headers["Content-Length"]
        headers["Content-Encoding"] = "gzip"
        headers.add_vary_header(VARY)
        if "etag" in headers and not headers["etag"].startswith("W/"):
            headers["ETag"] = f"W/{headers['etag']}"  # the same, but not octet by octet (RFC 9110, 8.8.1)
        await self._send(head)

    async def _pack(self, message: Message) -> bytes:
        stream, body, is_last = self._stream, message.get("body", b""), not message.get("more_body", False)
        assert stream is not None

        def work() -> bytes:
            return stream.compress(body) + (stream.flush() if is_last else b"")

        return await asyncio.to_thread(work) if len(body) > _LONG else work()


def _can_be_packed(head: Message) -> bool:
    headers = Headers(raw=head["headers"])
    kind = headers.get("content-type", "")
    return kind.startswith(_TYPES) and not kind.startswith(_NOT_STREAMS) and "content-encoding" not in headers
