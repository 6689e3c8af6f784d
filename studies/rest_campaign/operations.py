"""The operations that the OpenAPI document describes."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final

import schemathesis
from jsonschema_rs import Validator, validator_for
from schemathesis import APIOperation
from schemathesis.core.result import Err
from schemathesis.schemas import BaseSchema

from mapper.access import Role
from mapper.api.errors import PROBLEM_TYPE

_ENDLESS: Final = "text/event-stream"
_ORDER: Final = {"GET": 0, "PUT": 1, "POST": 1, "DELETE": 2}
_LAST: Final = "/api/v1/stop"


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One method of one path."""

    name: str
    method: str
    path: str
    needed: Role | None
    """The role without which it is refused."""
    api: APIOperation[Any, Any, Any, Any]
    answers: Mapping[str, Any]
    """By status: what the document says of them."""
    closed: Mapping[int, Validator]
    """By status: the JSON of an answer, with nothing in it that the document does not name."""
    parameters: tuple[str, ...]
    has_body: bool
    is_endless: bool

    @property
    def has_input(self) -> bool:
        """Whether there is anything in a request that can be wrong."""
        return bool(self.parameters) or self.has_body

    def fill_path(self, make: Callable[[], str]) -> str:
        """Put something into each of the path's parameters."""
        return re.sub(r"\{[^}]*\}", lambda _match: make(), self.path)


def load_operations(document: dict[str, Any]) -> list[Operation]:
    """Return all operations; those that stop everything last, so that the others find insects that walk."""
    config = schemathesis.Config.from_dict({"generation": {"with-security-parameters": False}})
    schema: BaseSchema = schemathesis.openapi.from_dict(document, config=config)
    operations = []
    for found in schema.get_all_operations():
        if isinstance(found, Err):
            raise found.err()
        operations.append(_describe(found.ok(), document))
    return sorted(operations, key=lambda one: (one.path == _LAST, _ORDER[one.method], one.path))


def _closed_schemas(described: Mapping[str, Any], document: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    # Problems may say more than their schema has: RFC 9457 allows it.
    for status, answer in described["responses"].items():
        for kind, content in answer.get("content", {}).items():
            if kind.endswith("json") and kind != PROBLEM_TYPE:
                yield status, _close({**content["schema"], "components": document.get("components", {})})


def _close(schema: Any) -> Any:
    """Forbid what an object is not said to have."""
    if isinstance(schema, list):
        return [_close(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    closed = {name: _close(part) for name, part in schema.items()}
    if schema.get("type") == "object" and "properties" in schema:
        closed.setdefault("additionalProperties", False)
    return closed


def _describe(api: APIOperation[Any, Any, Any, Any], document: dict[str, Any]) -> Operation:
    described = document["paths"][api.path][api.method.lower()]
    role = described.get("x-role")
    fine = described["responses"].get(str(HTTPStatus.OK.value), {})
    return Operation(
        name=described["operationId"],
        method=api.method.upper(),
        path=api.path,
        needed=None if role is None else Role(role),
        api=api,
        answers=described["responses"],
        closed={int(status): validator_for(schema) for status, schema in _closed_schemas(described, document)},
        parameters=tuple(parameter["name"] for parameter in described.get("parameters", [])),
        has_body="requestBody" in described,
        is_endless=_ENDLESS in fine.get("content", {}),
    )
