"""What is said of a request that does not fit its description: the field, the value that was sent, the limit, and what to do.

Values are shortened, and none that may be a secret is repeated. A query parameter that an endpoint does not have is refused, because
whoever asks with it would take another answer for the one that was asked for.
"""

import json
from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher
from typing import Any, Final, get_args

from fastapi import Request
from fastapi.routing import APIRoute
from pydantic import BaseModel

from mapper.access import contains_token
from mapper.api.command_schemas import COMMANDS_PATH, STOP_PATH
from mapper.request_errors import UnknownParameterError

_MAX_SHOWN: Final = 60
"""Characters of a value, and of a name that somebody made up."""
_SECRET: Final = ("token", "secret", "password", "authorization", "key")
CHECKED: Final = "/api/"
"""Others, as ``/healthz``, are asked by tools that add what they like."""
_HIDDEN: Final = "(not repeated here)"
_DESCRIBED: Final = "/openapi.json describes what is wanted"

# By the kind of a fault, as pydantic names them; {…} is of its context.
_NEXT_STEPS: Final[Mapping[str, str]] = {
    "missing": "give it",
    "json_invalid": "send JSON, in double quotes and without a comma at the end",
    "greater_than": "give more than {gt}",
    "greater_than_equal": "give {ge} or more",
    "less_than": "give less than {lt}",
    "less_than_equal": "give {le} or less",
    "string_too_long": "shorten it to {max_length} characters",
    "string_too_short": "give {min_length} or more characters",
    "string_pattern_mismatch": "write it as the regular expression {pattern} has it",
    "too_long": "give {max_length} at most",
    "too_short": "give {min_length} at least",
    "literal_error": "give one of these",
    "enum": "give one of these",
    "finite_number": "give a finite number",
}
_OF_A_TYPE: Final[Mapping[str, str]] = {
    "int": "give a whole number, as 12",
    "float": "give a number, as 12.5",
    "bool": "give true or false",
    "string": "give text in quotes",
    "list": "give a list, as [1, 2]",
    "model": "give an object, as {}",
    "dict": "give an object, as {}",
}


async def refuse_unknown_parameters(request: Request) -> None:
    """Refuse as `check_parameters` does; but no stop is refused for that, nor what may be one before it is read.

    Raises
    ------
    UnknownParameterError
        As there.
    """
    if request.scope["query_string"] and request.scope["path"].startswith(CHECKED) and not _may_be_a_stop(request):
        check_parameters(request)


def check_parameters(request: Request) -> None:
    """Refuse a query parameter that the endpoint of this request does not have.

    Raises
    ------
    UnknownParameterError
        It names those that there are, the nearest first.
    """
    known = [field.alias for field in _route_of(request).dependant.query_params]
    for name in request.query_params:
        if name not in known:
            place = f"{request.method} {_route_of(request).path}"
            raise UnknownParameterError(name=_shown_name(name), place=place, known=nearest_first(name, known))


def nearest_first(name: str, known: Iterable[str]) -> tuple[str, ...]:
    """Sort names by how alike they are to one, the most alike first; of equals the earlier."""
    asked = name[:_MAX_SHOWN].lower()
    return tuple(sorted(known, key=lambda one: -SequenceMatcher(None, asked, one.lower()).ratio()))


def describe_fault(fault: Mapping[str, Any], *, fields: Iterable[str] = ()) -> str:
    """Say what is wrong with a field, in one line.

    Parameters
    ----------
    fault
        As pydantic tells it: ``loc``, ``type``, ``msg``, ``input``, ``ctx``.
    fields
        Of the body, for one that it does not have.
    """
    place = fault.get("loc", ())
    where = ".".join(_shown_name(part) for part in place)
    kind, context, told = fault.get("type", ""), fault.get("ctx") or {}, str(fault.get("msg", ""))
    if kind == "value_error":  # our own words: they have all that is wanted
        return f"{where}: {told.removeprefix('Value error, ')}"
    if kind == "missing":
        return f"{where} is missing; give it ({_DESCRIBED})"
    if kind == "json_invalid":
        return f"{where}: the body is no JSON: {context.get('error', told)}; {_NEXT_STEPS[kind]}"
    if kind == "extra_forbidden":
        there = ", ".join(nearest_first(str(place[-1]), fields)) if len(place) == 2 else ""  # body, field
        return f"{where} is no field of this request; leave it out{f', or give one of: {there}' if there else f'; {_DESCRIBED}'}"
    limit = told.removeprefix("Input ") or "does not fit"
    return f"{where} is {_shown_value(place, fault.get('input'))}, but {limit}; {_next_step(kind, context)}"


def fields_of_body(request: Request) -> tuple[str, ...]:
    """Name the fields that the body of a request may have; none where it has no body, or no endpoint."""
    route = request.scope.get("route")
    body = route.body_field if isinstance(route, APIRoute) else None
    kinds = [] if body is None else [body.field_info.annotation, *get_args(body.field_info.annotation)]
    return tuple(name for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel) for name in kind.model_fields)


def _next_step(kind: str, context: Mapping[str, Any]) -> str:
    template = _NEXT_STEPS.get(kind)
    if template is not None:
        return template.format_map(context) if "{" in template else template
    return next((step for begin, step in _OF_A_TYPE.items() if kind.startswith(begin)), _DESCRIBED)


def _shown_value(place: Iterable[object], value: object) -> str:
    names = [str(part).lower() for part in place]
    if any(secret in name for name in names for secret in _SECRET):
        return _HIDDEN
    try:
        text = json.dumps(value, ensure_ascii=True, default=str)
    except (TypeError, ValueError, RecursionError):
        return f"of the type {type(value).__name__}"
    if contains_token(text):
        return _HIDDEN
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}… ({len(text)} characters)"


def _shown_name(name: object) -> str:
    """Show what may be made up by the client: printable, short, and no token."""
    text = str(name).encode("ascii", errors="backslashreplace").decode()
    text = "".join(letter if letter.isprintable() else "?" for letter in text)
    return _HIDDEN if contains_token(text) else text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}…"


def _may_be_a_stop(request: Request) -> bool:
    return request.method == "POST" and request.scope["path"] in {STOP_PATH, COMMANDS_PATH}


def _route_of(request: Request) -> APIRoute:
    route = request.scope["route"]
    assert isinstance(route, APIRoute), "these are the endpoints of this application alone"
    return route
