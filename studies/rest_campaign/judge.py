"""What must hold for every answer, whoever asked and however."""

from collections.abc import Iterator
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final

import requests
from schemathesis import Case, CheckFunction
from schemathesis.core.failures import FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from mapper.api.errors import PROBLEM_TYPE
from studies.rest_campaign.asked import Asked, Way
from studies.rest_campaign.askers import Asker, is_let_in
from studies.rest_campaign.operations import Operation

_SECURITY_FIELDS: Final = ("Content-Security-Policy", "X-Content-Type-Options", "X-Frame-Options", "Referrer-Policy")
_CHECKS: Final[list[CheckFunction]] = [
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
_NOT_NOW: Final = frozenset({HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.NOT_IMPLEMENTED})
_BEFORE_THE_DOOR: Final = frozenset(
    {HTTPStatus.BAD_REQUEST, HTTPStatus.FORBIDDEN, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, HTTPStatus.MISDIRECTED_REQUEST}
)
"""What is refused for itself, before anybody asks who sent it."""
_PROBLEM_KEYS: Final = frozenset({"type", "title", "status", "detail"})
_MOST_SHOWN: Final = 400


@dataclass(frozen=True, slots=True)
class Fault:
    """A rule that an answer breaks."""

    rule: str
    detail: str


def judge(operation: Operation, asked: Asked, answer: requests.Response) -> list[Fault]:
    """Return the rules that an answer breaks."""
    return [*_judge_status(answer.status_code), *_judge_access(operation, asked, answer), *_judge_content(operation, asked, answer)]


def _judge_status(status: int) -> Iterator[Fault]:
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR and status not in _NOT_NOW:
        yield Fault("no server error", f"the answer is {status}")


def _judge_access(operation: Operation, asked: Asked, answer: requests.Response) -> Iterator[Fault]:
    status = answer.status_code
    missing = [name for name in _SECURITY_FIELDS if name not in answer.headers]
    if missing:
        yield Fault("strict headers", f"without {', '.join(missing)}")
    if is_let_in(asked.asker, needed=operation.needed):
        if status == HTTPStatus.UNAUTHORIZED or (status == HTTPStatus.FORBIDDEN and "Origin" not in asked.headers):
            yield Fault("whoever may is let in", f"{asked.asker} is refused ({status})")
        return
    refused = {HTTPStatus.FORBIDDEN} if asked.asker.role is not None else {HTTPStatus.UNAUTHORIZED}
    if asked.asker is Asker.STRANGER:
        refused |= {HTTPStatus.TOO_MANY_REQUESTS}
    if status not in refused | _BEFORE_THE_DOOR:
        yield Fault(
            "whoever may not is refused", f"{asked.asker} gets {status}, not {' or '.join(str(int(one)) for one in sorted(refused))}"
        )
    if status == HTTPStatus.UNAUTHORIZED and not answer.headers.get("WWW-Authenticate", "").startswith("Bearer"):
        yield Fault("401 says how to be let in", "without WWW-Authenticate: Bearer")


def _judge_content(operation: Operation, asked: Asked, answer: requests.Response) -> Iterator[Fault]:
    if asked.way is Way.HEAD:
        if answer.content:
            yield Fault("HEAD has no body", f"{len(answer.content)} bytes")
        is_told = str(answer.status_code) in operation.answers or (
            answer.status_code == HTTPStatus.METHOD_NOT_ALLOWED and "Allow" in answer.headers
        )
        if not is_told:
            yield Fault("Undocumented status code", f"{answer.status_code} to HEAD")
        return
    if answer.status_code in {HTTPStatus.NO_CONTENT, HTTPStatus.NOT_MODIFIED} and answer.content:
        yield Fault("no body where there is none", f"{answer.status_code} with {len(answer.content)} bytes")
    checks = [*_CHECKS, negative_data_rejection] if asked.way is Way.INVALID and not asked.headers else _CHECKS
    yield from _broken(asked.case, answer, checks=checks)
    closed = operation.closed.get(answer.status_code)
    if closed is not None and answer.content:
        error = next(closed.iter_errors(answer.json()), None)
        if error is not None:
            yield Fault("nothing is told that is not described", _shorten(f"{list(error.instance_path)}: {error.message[-_MOST_SHOWN:]}"))


def _broken(case: Case[Any], answer: requests.Response, *, checks: list[CheckFunction]) -> Iterator[Fault]:
    try:
        case.validate_response(answer, checks=checks)
    except FailureGroup as group:
        for failure in group.exceptions:
            yield Fault(str(getattr(failure, "title", type(failure).__name__)), _shorten(str(failure)))


def judge_other(answer: requests.Response) -> Iterator[Fault]:
    """Return what is wrong with the answer to a method or a path that the document does not have."""
    yield from _judge_status(answer.status_code)
    if answer.headers.get("Content-Type") != PROBLEM_TYPE:
        yield Fault("errors are problems", f"{answer.status_code} as {answer.headers.get('Content-Type')}")
    elif not set(answer.json()) >= _PROBLEM_KEYS:
        yield Fault("errors are problems", _shorten(answer.text))


def _shorten(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _MOST_SHOWN else f"{line[:_MOST_SHOWN]}…"
