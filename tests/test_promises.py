"""What a released version answered and took over REST, and its commands' flags, are still there (docs/formats.md)."""

import json
import lzma
import random
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from scripts.release.formats import FROZEN
from scripts.release.freeze_formats import INTERFACES
from scripts.release.promises import broken, tell_interfaces

RELEASED = sorted(path for path in FROZEN.iterdir() if path.name[0].isdigit())
Interfaces = dict[str, Any]


@cache
def _told() -> str:
    return json.dumps(tell_interfaces())


def _now() -> Interfaces:
    told: Interfaces = json.loads(_told())
    return told


@pytest.mark.parametrize("folder", RELEASED, ids=lambda folder: folder.name)
def test_a_released_version_is_only_added_to(folder: Path) -> None:
    then = json.loads(lzma.decompress((folder / INTERFACES).read_bytes()))
    assert len(then["openapi"]["paths"]) >= 50
    assert broken(then, _now()) == []


def _walk(value: Any) -> Iterator[dict[str, Any]]:
    """Yield every object in a document."""
    if isinstance(value, dict):
        yield value
    for one in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _walk(one)


def _removable(document: Interfaces) -> Iterator[tuple[str, dict[str, Any] | list[Any], Any]]:
    """Yield all that may be taken away: what it is called, what holds it, and its key there."""
    for command, flags in document["flags"].items():
        yield command, document["flags"], command
        yield from ((f"{command} {flag}", flags, place) for place, flag in enumerate(flags))
    paths = document["openapi"]["paths"]
    for path, methods in paths.items():
        yield path, paths, path
        for method, operation in methods.items():
            yield from ((f"{method} {path} {status}", operation["responses"], status) for status in operation["responses"])
            parameters = operation.get("parameters", [])
            yield from ((f"{method} {path} {one['name']}", parameters, place) for place, one in enumerate(parameters))
    for name, schema in document["openapi"]["components"]["schemas"].items():
        for one in _walk(schema):
            yield from ((f"{name}.{key}", one["properties"], key) for key in one.get("properties", ()))


def test_whatever_is_taken_away_is_told() -> None:
    then, now = _now(), _now()
    removable = list(_removable(now))
    assert len(removable) > 1000
    for what, holder, key in random.Random(0).sample(removable, 60):
        taken = holder.pop(key)
        assert broken(then, now), what
        if isinstance(holder, list):
            holder.insert(key, taken)
        else:
            holder[key] = taken
    assert broken(then, now) == []


SENT: dict[str, Any] = {
    "type": "object",
    "required": ["id"],
    "properties": {"id": {"type": "integer", "minimum": 1}, "kind": {"enum": ["a", "b"]}},
}
"""A body that is sent, and some that take less."""
NARROWER: dict[str, dict[str, Any]] = {
    "field kind is required now": SENT | {"required": ["id", "kind"]},
    "minimum is 2, and was 1": SENT | {"properties": SENT["properties"] | {"id": {"type": "integer", "minimum": 2}}},
    "integer is no longer taken": SENT | {"properties": SENT["properties"] | {"id": {"type": "string"}}},
    "only ['a'] are taken": SENT | {"properties": SENT["properties"] | {"kind": {"enum": ["a"]}}},
    "maximum is 9, and was not limited": SENT
    | {"properties": SENT["properties"] | {"id": {"type": "integer", "minimum": 1, "maximum": 9}}},
}
WIDER: dict[str, dict[str, Any]] = {
    "nothing required": SENT | {"required": []},
    "one more": SENT | {"properties": SENT["properties"] | {"name": {"type": "string"}}},
    "any number": SENT | {"properties": SENT["properties"] | {"id": {"type": "number"}}},
    "or null": SENT | {"properties": SENT["properties"] | {"id": {"anyOf": [{"type": "integer"}, {"type": "null"}]}}},
    "more values": SENT | {"properties": SENT["properties"] | {"kind": {"enum": ["a", "b", "c"]}}},
}


def _service(*, sent: Interfaces | None = None, answered: Interfaces | None = None) -> Interfaces:
    """Return the interfaces of a service with one operation."""
    body = {"requestBody": {"required": True, "content": {"application/json": {"schema": sent}}}} if sent else {}
    content = {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/Answer"}}}} if answered else {}
    paths = {"/thing": {"post": {**body, "responses": {"200": content}}}}
    return {"flags": {}, "openapi": {"paths": paths, "components": {"schemas": {"Answer": answered or {}}}}}


@pytest.mark.parametrize("told", NARROWER)
def test_a_body_of_which_less_is_taken_is_told(told: str) -> None:
    faults = broken(_service(sent=SENT), _service(sent=NARROWER[told]))
    assert len(faults) == 1
    assert told in faults[0]
    assert faults[0].startswith("POST /thing body")


@pytest.mark.parametrize("change", WIDER)
def test_a_body_of_which_more_is_taken_is_an_addition(change: str) -> None:
    assert broken(_service(sent=SENT), _service(sent=WIDER[change])) == []


@pytest.mark.parametrize("change", [one for one in WIDER if one not in {"one more", "more values"}])
def test_an_answer_that_says_what_was_not_foreseen_is_told(change: str) -> None:
    assert broken(_service(answered=SENT), _service(answered=WIDER[change]))


def test_an_answer_with_more_fields_and_values_is_an_addition() -> None:
    assert broken(_service(answered=SENT), _service(answered=WIDER["one more"])) == []
    assert broken(_service(answered=SENT), _service(answered=WIDER["more values"])) == []
