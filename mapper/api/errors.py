"""One table: exception class to HTTP status; and the form of every error, ``application/problem+json`` (RFC 9457)."""

from collections.abc import Mapping
from http import HTTPStatus
from math import ceil
from typing import Final

import msgspec
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException

from mapper.access import LastAdminError, NoTokenError, RateLimitError, RoleError, TokenFileError, TokenNameError, TokenNotFoundError
from mapper.api.command_schemas import STOP_PATH
from mapper.api.refusals import describe_fault, fields_of_body
from mapper.errors import (
    BiobotNotFoundError,
    CommandNotFoundError,
    CommandRefusedError,
    EngineMissingError,
    GatewayAwayError,
    JobError,
    MapError,
    NoMapYetError,
    OrderRefusedError,
    PlaceError,
    RouteError,
    StopUnansweredError,
    StoreError,
    TooManyError,
    WorkerDiedError,
)
from mapper.request_errors import (
    AlertNotFoundError,
    HoleNotFoundError,
    LengthsNotKeptError,
    MapNotFoundError,
    NoResultError,
    OtherVersionError,
    PeriodError,
    PinNotFoundError,
    PinRefusedError,
    TaskNotFoundError,
    UnknownParameterError,
)

PROBLEM_TYPE: Final = "application/problem+json"

STATUS_OF: Final[Mapping[type[MapError], HTTPStatus]] = {
    AlertNotFoundError: HTTPStatus.NOT_FOUND,
    NoTokenError: HTTPStatus.UNAUTHORIZED,
    RoleError: HTTPStatus.FORBIDDEN,
    RateLimitError: HTTPStatus.TOO_MANY_REQUESTS,
    TokenFileError: HTTPStatus.SERVICE_UNAVAILABLE,
    TokenNameError: HTTPStatus.UNPROCESSABLE_ENTITY,
    TokenNotFoundError: HTTPStatus.NOT_FOUND,
    LastAdminError: HTTPStatus.CONFLICT,
    BiobotNotFoundError: HTTPStatus.NOT_FOUND,
    CommandNotFoundError: HTTPStatus.NOT_FOUND,
    HoleNotFoundError: HTTPStatus.NOT_FOUND,
    PinNotFoundError: HTTPStatus.NOT_FOUND,
    TaskNotFoundError: HTTPStatus.NOT_FOUND,
    CommandRefusedError: HTTPStatus.CONFLICT,
    PinRefusedError: HTTPStatus.CONFLICT,
    NoResultError: HTTPStatus.CONFLICT,
    OrderRefusedError: HTTPStatus.CONFLICT,
    UnknownParameterError: HTTPStatus.UNPROCESSABLE_ENTITY,
    PeriodError: HTTPStatus.UNPROCESSABLE_ENTITY,
    OtherVersionError: HTTPStatus.CONFLICT,
    MapNotFoundError: HTTPStatus.NOT_FOUND,
    PlaceError: HTTPStatus.UNPROCESSABLE_ENTITY,
    RouteError: HTTPStatus.NOT_FOUND,
    TooManyError: HTTPStatus.TOO_MANY_REQUESTS,
    NoMapYetError: HTTPStatus.SERVICE_UNAVAILABLE,
    LengthsNotKeptError: HTTPStatus.SERVICE_UNAVAILABLE,
    GatewayAwayError: HTTPStatus.SERVICE_UNAVAILABLE,
    StopUnansweredError: HTTPStatus.SERVICE_UNAVAILABLE,
    WorkerDiedError: HTTPStatus.SERVICE_UNAVAILABLE,
    StoreError: HTTPStatus.SERVICE_UNAVAILABLE,
    JobError: HTTPStatus.INTERNAL_SERVER_ERROR,
    EngineMissingError: HTTPStatus.NOT_IMPLEMENTED,
}

_RETRY_AFTER_S: Final[Mapping[type[MapError], int]] = {
    NoMapYetError: 1,
    LengthsNotKeptError: 5,
    WorkerDiedError: 1,
    TooManyError: 1,
    GatewayAwayError: 5,
    StopUnansweredError: 1,
    StoreError: 5,
    TokenFileError: 5,
}
_MAX_SHOWN_FAULTS: Final = 10


def problem(
    status: HTTPStatus, *, detail: str, headers: Mapping[str, str] | None = None, facts: Mapping[str, object] | None = None
) -> Response:
    """Make the answer that tells an error: title and status, ``detail`` for a person, and facts for a program."""
    body = {"type": "about:blank", "title": status.phrase, "status": status.value, "detail": detail, **(facts or {})}
    fields = {"Cache-Control": "no-store", **(headers or {})}
    return Response(msgspec.json.encode(body), status_code=status, media_type=PROBLEM_TYPE, headers=fields)


def add_error_handlers(app: FastAPI) -> None:
    """Answer every error as a problem."""
    app.add_exception_handler(MapError, _on_map_error)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(Exception, _on_unforeseen)


def answer_error(error: MapError) -> Response:
    """Make the answer that tells an error of ours."""
    status = STATUS_OF.get(type(error), HTTPStatus.INTERNAL_SERVER_ERROR)
    retry_after_s = _RETRY_AFTER_S.get(type(error))
    headers = {} if retry_after_s is None else {"Retry-After": str(retry_after_s)}
    facts: dict[str, object] = {}
    match error:
        case NoTokenError():
            headers = {"WWW-Authenticate": 'Bearer realm="biobot mapper"' + (', error="invalid_token"' if error.is_wrong else "")}
            facts = {"role_needed": error.needed}
        case RoleError():
            facts = {"role": error.role, "role_needed": error.needed}
        case RateLimitError():
            headers = {"Retry-After": str(ceil(error.wait_s))}
        case UnknownParameterError():
            facts = {"parameter": error.name, "parameters": error.known}
        case NoMapYetError():
            facts = {"state": "waiting", "n_encounters": error.n_encounters, "minimum": error.minimum}
        case CommandRefusedError():
            facts = {"command_id": error.command_id, "outcome": "refused", "reason": error.reason, "refusal": error.refusal}
        case OrderRefusedError():
            answers = [{"gateway": gateway, "reason": reason} for gateway, reason in error.answers]
            facts = {"order_id": error.order_id, "answers": answers}
        case StopUnansweredError():
            facts = {**error.facts, "unanswered": error.gateways}
        case GatewayAwayError():
            facts = {"command_id": error.command_id, "outcome": "undelivered", "gateway": error.gateway}
    return problem(status, detail=str(error), headers=headers, facts=facts)


async def _on_map_error(request: Request, error: Exception) -> Response:
    return answer_error(error) if isinstance(error, MapError) else await _on_unforeseen(request, error)


async def _on_invalid_request(request: Request, error: Exception) -> Response:
    fields = fields_of_body(request)
    faults = (
        [describe_fault(fault, fields=fields) for fault in error.errors()] if isinstance(error, RequestValidationError) else [str(error)]
    )
    shown = faults[:_MAX_SHOWN_FAULTS]
    warning = "nothing was stopped (a POST without a body stops all): " if request.url.path == STOP_PATH else ""
    return problem(HTTPStatus.UNPROCESSABLE_ENTITY, detail=warning + "; ".join(shown), facts={"faults": shown})


async def _on_http_exception(request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException):
        return await _on_unforeseen(request, error)
    status = HTTPStatus(error.status_code)
    detail = str(error.detail)
    if detail == status.phrase:
        detail = f"{request.method} {request.url.path}: {status.description or status.phrase}; /openapi.json describes what there is"
    return problem(status, detail=detail, headers=error.headers)


async def _on_unforeseen(_request: Request, _error: Exception) -> Response:
    return problem(HTTPStatus.INTERNAL_SERVER_ERROR, detail="an unforeseen error; its details are in the mapper's log")
