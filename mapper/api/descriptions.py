"""How endpoints' answers are described in the OpenAPI document."""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, Final

from mapper.api.errors import PROBLEM_TYPE
from mapper.api.schemas import Problem

_SUMMARIES: Final = {
    HTTPStatus.UNAUTHORIZED: "No token is shown, or one that opens nothing",
    HTTPStatus.FORBIDDEN: "The token's role does not reach so far (`role_needed`), or a page of another site asked for it",
    HTTPStatus.NOT_FOUND: "Unknown here",
    HTTPStatus.MISDIRECTED_REQUEST: "The service is called by a name that is not its own",
    HTTPStatus.CONFLICT: "Refused as things stand; of a command, `reason` is for people and `refusal` for programs",
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE: "The body is too large",
    HTTPStatus.UNPROCESSABLE_ENTITY: "The request is malformed",
    HTTPStatus.TOO_MANY_REQUESTS: "Too much at the same time, or too often: try again after Retry-After",
    HTTPStatus.SERVICE_UNAVAILABLE: "Not now: try again after Retry-After",
    HTTPStatus.INTERNAL_SERVER_ERROR: "A computation failed",
    HTTPStatus.NOT_IMPLEMENTED: "A library that this needs is not installed here",
    HTTPStatus.BAD_REQUEST: "The body is no JSON, or a token stands in the URL",
}
_FRESHNESS_HEADERS: Final = {
    "Map-Behind": {"description": "No record that is missing in the map came earlier than this [s] ago", "schema": {"type": "number"}},
    "Map-Waiting": {"description": "Records that have come since the map was begun", "schema": {"type": "integer"}},
}

_LOCATION: Final = {"Location": {"description": "Where it is", "schema": {"type": "string"}}}
_FEATURE_COLLECTION: Final[dict[str, Any]] = {
    "type": "object",
    "title": "FeatureCollection",
    "description": "GeoJSON (RFC 7946), but that `coordinate_frame` says what coordinates mean",
    "required": ["type", "coordinate_frame", "features"],
    "properties": {
        "type": {"type": "string", "enum": ["FeatureCollection"]},
        "coordinate_frame": {"type": "object", "description": "`kind`, `unit`, and how the map was brought there"},
        "features": {
            "type": "array",
            "items": {
                "type": "object",
                "title": "Feature",
                "required": ["type", "id", "geometry", "properties"],
                "properties": {
                    "id": {"type": "string"},
                    "type": {"type": "string", "enum": ["Feature"]},
                    "geometry": {"type": ["object", "null"], "description": "`type` and `coordinates`; null where there is no place"},
                    "properties": {"type": "object", "description": "`kind` is component, hole, landmark, pin or point"},
                },
            },
        },
    },
}

_ETAG: Final = {"ETag": {"description": "Names this version: send it as If-None-Match", "schema": {"type": "string"}}}

BODY_PROBLEMS: Final = (
    HTTPStatus.BAD_REQUEST,
    HTTPStatus.FORBIDDEN,
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    HTTPStatus.UNPROCESSABLE_ENTITY,
)
"""What may be wrong with any request that has a body."""


def describe_answers(
    content: type | str | None,
    problems: Sequence[HTTPStatus] = (),
    *,
    is_versioned: bool = False,
    has_freshness: bool = True,
    made: str | None = None,
    accepted: tuple[type, str] | None = None,
    under_way: str | None = None,
    examples: Mapping[HTTPStatus, object] | None = None,
) -> dict[int | str, dict[str, Any]]:
    """Describe an endpoint's answers: a model or a media type, or that there is nothing to be said (204), and the errors it may tell.

    Parameters
    ----------
    is_versioned, has_freshness
        It has an ETag; and headers that say how far the map is behind.
    made
        What 201 means; None: it is not answered.
    accepted
        What 202 has and means where it is all that is answered.
    under_way
        What 202 means; None: it is not answered.
    examples
        An example of an error's body by its status.
    """
    fine: dict[str, Any] = {"description": "The newest state"}
    if isinstance(content, str):
        kind = {"type": "string"} if content.startswith("text/") else {"type": "string", "format": "binary"}
        if content.endswith("json"):
            kind = _FEATURE_COLLECTION
        elif content == "image/svg+xml":
            kind = {"type": "string"}
        fine["content"] = {content: {"schema": kind}}
    elif content is not None:
        fine["model"] = content
    answers: dict[int | str, dict[str, Any]] = {200: fine}
    if content is None:
        answers = {204: {"description": "Done"}}
    if accepted is not None:
        answers = {202: {"model": accepted[0], "description": accepted[1], "headers": _LOCATION}}
    if under_way is not None:
        answers[202] = {"model": content, "description": under_way}
    if made is not None:
        answers[201] = {"model": content, "description": made}
    if is_versioned:
        fine["headers"] = _ETAG | (_FRESHNESS_HEADERS if has_freshness else {})
        answers[304] = {"description": "The client has this version (If-None-Match)", "headers": _ETAG}
    for status in problems:
        answers[int(status)] = describe_problem(status, example=(examples or {}).get(status))
    answers[421] = describe_problem(HTTPStatus.MISDIRECTED_REQUEST)
    return answers


def describe_problem(status: HTTPStatus, *, example: object = None) -> dict[str, Any]:
    """Describe an error's answer."""
    content: dict[str, Any] = {"schema": {"$ref": f"#/components/schemas/{Problem.__name__}"}}
    if example is not None:
        content["example"] = example
    return {"description": _SUMMARIES[status], "content": {PROBLEM_TYPE: content}}
