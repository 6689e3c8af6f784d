"""A body that is too large is refused, unless the answer has begun already: then it is not read, and the answer is whole."""

import asyncio
from collections.abc import Sequence
from http import HTTPStatus

import pytest
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mapper.api.guards import MAX_BODY_BYTES, Guard

PIECES = (b"one", b"two", b"three")


def streaming(*, n_before: int) -> ASGIApp:
    """Send three pieces, and read the request's body after some of them."""

    async def app(_scope: Scope, receive: Receive, send: Send) -> None:
        async def read() -> None:
            while (await receive()).get("more_body", False):
                pass

        if n_before == 0:
            await read()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        for number, piece in enumerate(PIECES, start=1):
            await send({"type": "http.response.body", "body": piece, "more_body": True})
            if number == n_before:
                await read()
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    return app


def ask(app: ASGIApp, pieces: Sequence[bytes]) -> list[Message]:
    """Send a request in pieces; return what is sent back."""
    sent: list[Message] = []
    waiting = [{"type": "http.request", "body": piece, "more_body": n < len(pieces)} for n, piece in enumerate(pieces, start=1)]

    async def receive() -> Message:
        return waiting.pop(0) if waiting else {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        sent.append(message)

    scope = {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": [(b"host", b"here")]}
    asyncio.run(Guard(app, allowed_hosts=None)(scope, receive, send))
    return sent


def told(sent: list[Message]) -> tuple[list[int], bytes]:
    statuses = [message["status"] for message in sent if message["type"] == "http.response.start"]
    return statuses, b"".join(message.get("body", b"") for message in sent if message["type"] == "http.response.body")


@pytest.mark.parametrize("n_before", [1, 2, 3])
def test_an_answer_that_has_begun_is_whole_whatever_is_sent_meanwhile(n_before: int) -> None:
    sent = ask(streaming(n_before=n_before), [b"x" * MAX_BODY_BYTES, b"x"])
    assert told(sent) == ([HTTPStatus.OK], b"".join(PIECES))


def test_a_body_that_is_too_large_is_refused_once() -> None:
    statuses, body = told(ask(streaming(n_before=0), [b"x" * MAX_BODY_BYTES, b"x"]))
    assert statuses == [HTTPStatus.REQUEST_ENTITY_TOO_LARGE]
    assert str(MAX_BODY_BYTES).encode() in body
    assert b"three" not in body


def test_one_that_is_as_large_as_allowed_is_not() -> None:
    assert told(ask(streaming(n_before=0), [b"x" * MAX_BODY_BYTES])) == ([HTTPStatus.OK], b"".join(PIECES))
