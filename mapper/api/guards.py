"""What every request and answer passes: limits, headers that keep the page to itself, and HEAD.

A page of another site that the operator's browser happens to show must not reach the service: its requests carry another ``Host`` or
``Origin``. Who may do what is looked at behind this (`door`).
"""

from collections.abc import Collection
from http import HTTPStatus
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mapper.api.errors import problem

MAX_BODY_BYTES: Final = 64 * 1024

SECURITY_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), display-capture=(), geolocation=(), microphone=(), payment=(), usb=()",
}
STRICT_TRANSPORT: Final = {"Strict-Transport-Security": "max-age=31536000"}
"""Sent over TLS alone: a browser that has read it does not come back by http for a year."""

_SAFE_METHODS: Final = {"GET", "HEAD", "OPTIONS"}
_NO_HEAD: Final = {"/api/v1/events", "/api/v1/encounters.csv", "/api/v1/encounters.parquet"}
"""What is written as it is sent has no length to tell."""


class Guard:
    """The outermost layer of the application.

    Parameters
    ----------
    allowed_hosts
        Host names (no ports) by which the service may be called; None for any, on a machine that others may reach.
    is_tls
        The service is reached by https.
    """

    def __init__(self, app: ASGIApp, *, allowed_hosts: Collection[str] | None, is_tls: bool = False) -> None:
        self._app = app
        # What is compressed for one client must not be given to another.
        fields = {**SECURITY_HEADERS, **(STRICT_TRANSPORT if is_tls else {}), "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
        self._fields = [(name.lower().encode(), value.encode()) for name, value in fields.items()]
        self._allowed_hosts = None if allowed_hosts is None else {host.lower() for host in allowed_hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        is_head = scope["method"] == "HEAD" and scope["path"] not in _NO_HEAD

        async def guarded_send(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = list(message["headers"])
                given = {name for name, _ in headers}
                message = {**message, "headers": headers + [field for field in self._fields if field[0] not in given]}
            elif is_head and message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        refusal = self._refuse(scope)
        if refusal is not None:
            await refusal(scope, receive, guarded_send)
            return
        body = _Body(receive)
        inner = {**scope, "method": "GET"} if is_head else scope
        await self._app(inner, body.receive, body.answer_too_large(guarded_send, scope))

    def _refuse(self, scope: Scope) -> ASGIApp | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if self._allowed_hosts is not None and _host_name(host) not in self._allowed_hosts:
            detail = f"this service is not called {host!r}; use {' or '.join(sorted(self._allowed_hosts))}"
            return problem(HTTPStatus.MISDIRECTED_REQUEST, detail=detail)
        origin = headers.get("origin")
        if scope["method"] not in _SAFE_METHODS and origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return problem(HTTPStatus.FORBIDDEN, detail=f"a page of {origin} may not do this; open the page of this service")
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdigit()) or int(length[:20]) > MAX_BODY_BYTES:
            return problem(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, detail=_too_large())
        return None


class _Body:
    """Counts a body that comes without its length, and cuts it off."""

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._n_bytes = 0

    @property
    def is_too_large(self) -> bool:
        return self._n_bytes > MAX_BODY_BYTES

    async def receive(self) -> Message:
        message = await self._receive()
        if message["type"] == "http.request":
            self._n_bytes += len(message.get("body", b""))
            if self.is_too_large:
                return {"type": "http.request", "body": b"", "more_body": False}
        return message

    def answer_too_large(self, send: Send, scope: Scope) -> Send:
        has_begun = is_answered = False

        async def checked_send(message: Message) -> None:
            nonlocal has_begun, is_answered
            if is_answered:
                return
            # An answer that has begun needs no more of the body: what is streamed only listens for the client's leave.
            if self.is_too_large and not has_begun:
                is_answered = True
                await problem(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, detail=_too_large())(scope, self._receive, send)
                return
            has_begun = True
            await send(message)

        return checked_send


def _host_name(host: str) -> str:
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


def _too_large() -> str:
    return f"the body may have {MAX_BODY_BYTES} bytes at most, and its length must be a number"
