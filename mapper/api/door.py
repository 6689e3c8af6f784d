"""The door: no request passes to an endpoint that `mapper.access` does not admit, whatever the endpoint says or forgets.

It stands before the application, so it holds for every route alike, also for those that are no FastAPI routes, and costs some
microseconds. Who asks is then in the request's scope (`person_of`).
"""

from http import HTTPStatus
from typing import Final
from urllib.parse import unquote_plus

from starlette.types import ASGIApp, Receive, Scope, Send

from mapper.access import Access, contains_token
from mapper.access.access import PERSON_KEY
from mapper.api.errors import answer_error, problem
from mapper.errors import MapError

_IN_URL: Final = ("token", "access_token", "bearer", "authorization")


class Door:
    """Admits requests, or answers why not."""

    def __init__(self, app: ASGIApp, *, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if _shows_token(scope):
            detail = (
                "a token stands in this URL, where logs and browsers keep it: send it as the header `Authorization: Bearer biobot_...`, "
                "and have one that was sent like this revoked"
            )
            await problem(HTTPStatus.BAD_REQUEST, detail=detail)(scope, receive, send)
            return
        client = scope.get("client")
        authorization = _authorization(scope)
        await self._access.learn(authorization)
        try:
            person = self._access.admit(
                method=scope["method"], path=scope["path"], authorization=authorization, address=client[0] if client else ""
            )
        except MapError as error:
            await answer_error(error)(scope, receive, send)
            return
        await self._app({**scope, PERSON_KEY: person}, receive, send)


def _authorization(scope: Scope) -> str | None:
    """Return what is shown; of several headers of that name none counts."""
    shown = [value for name, value in scope["headers"] if name == b"authorization"]
    if not shown:
        return None
    return shown[0].decode("latin-1") if len(shown) == 1 else ""


def _shows_token(scope: Scope) -> bool:
    query: bytes = scope["query_string"]
    if not query and "biobot_" not in scope["path"]:
        return False
    text = unquote_plus(query.decode("latin-1"))
    names = {part.partition("=")[0].lower() for part in text.split("&")}
    return not names.isdisjoint(_IN_URL) or contains_token(text) or contains_token(scope["path"])
