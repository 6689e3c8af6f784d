"""Answers that are bytes made once: by their name (304) or whole, as they are or compressed; and the short way to those asked for most.

Between the server and an endpoint lie routing, dependencies and validation of parameters. An endpoint without parameters needs none of
them, so `QuickAnswers` asks it first.
"""

from collections.abc import Awaitable, Callable, Mapping
from typing import Final

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from mapper.errors import MapError
from mapper.served_bytes import ServedBytes

VARY: Final = "Accept-Encoding"

Answer = Callable[[Headers], Awaitable[Response]]
"""Makes an answer of the headers of a request; raises ``MapError`` where it cannot."""


class QuickAnswers:
    """An application before another: it answers GET of some paths, without a query.

    What fails is asked of the other, which knows how to say so; and so is what has a query, which these endpoints do not have.
    """

    def __init__(self, app: ASGIApp, answers: Mapping[str, Answer]) -> None:
        self._app = app
        self._answers = answers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        is_short = scope["type"] == "http" and scope["method"] == "GET" and not scope["query_string"]
        answer = self._answers.get(scope["path"]) if is_short else None
        if answer is None:
            await self._app(scope, receive, send)
            return
        try:
            response = await answer(Headers(scope=scope))
        except MapError:
            await self._app(scope, receive, send)
            return
        await response(scope, receive, send)


async def served(request: Headers, body: ServedBytes, *, media_type: str, headers: Mapping[str, str], can_pack: bool = True) -> Response:
    """Answer with bytes made once for a version, or with 304 where the client has them (RFC 9110, 13.1.2).

    Parameters
    ----------
    request
        Headers of the request.
    can_pack
        Compressing them makes them shorter.
    """
    is_packed = can_pack and body.is_worth_packing and accepts_gzip(request.get("accept-encoding"))
    fields = {"ETag": body.packed_etag if is_packed else body.etag, "Cache-Control": "no-cache", "Vary": VARY, **headers}
    if _matches(request.get("if-none-match"), body):
        return Response(status_code=304, headers=fields)
    if not is_packed:
        return Response(body.plain, media_type=media_type, headers=fields)
    fields["Content-Encoding"] = "gzip"
    return Response(body.packed or await body.pack(), media_type=media_type, headers=fields)


def accepts_gzip(accepted: str | None) -> bool:
    """Say whether a client takes gzip, by its ``Accept-Encoding`` (RFC 9110, 12.5.3)."""
    if not accepted:
        return False
    weights: dict[str, float] = {}
    for part in accepted.lower().split(","):
        coding, _, parameter = part.partition(";")
        name, _, value = parameter.partition("=")
        weight = 1.0
        if name.strip() == "q":
            try:
                weight = float(value)
            except ValueError:
                weight = 0.0
        weights[coding.strip()] = weight
    return weights.get("gzip", weights.get("*", 0.0)) > 0.0


def _matches(if_none_match: str | None, body: ServedBytes) -> bool:
    if if_none_match is None:
        return False
    tags = {tag.strip().removeprefix("W/") for tag in if_none_match.split(",")}
    return "*" in tags or body.etag in tags or body.packed_etag in tags
