"""What a version promises to its callers: operations of REST with their parameters and fields, and flags of every command.

A later version only adds (docs/formats.md). ``broken`` tells, in words, what it took away or made narrower: of what a caller may send, no
less is taken, and nothing more is asked for; of what it is answered, no field is missing or of another type. New values of an enumeration
that is answered are additions.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from studies.reference import COMMANDS, help_text
from studies.reference_tables import openapi_document

_Schema = Mapping[str, Any]

_LOWER_LIMITS = ("minimum", "exclusiveMinimum", "minLength", "minItems")
_UPPER_LIMITS = ("maximum", "exclusiveMaximum", "maxLength", "maxItems")
_FLAG = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")


def tell_interfaces() -> dict[str, Any]:
    """Return the OpenAPI document, and the flags of each command, of this tree."""
    flags = {}
    for program, (module, commands) in COMMANDS.items():
        for command in (None, *commands):
            flags[f"{program} {command}" if command else program] = sorted(set(_FLAG.findall(help_text(module, command))))
    return {"openapi": openapi_document(), "flags": flags}


def broken(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return what ``now`` lacks of the interfaces that were promised ``then``, a line each; empty: nothing."""
    faults = []
    for command, flags in then["flags"].items():
        if command not in now["flags"]:
            faults.append(f"{command}: the command is gone")
        else:
            faults += [f"{command} {flag}: the flag is gone" for flag in flags if flag not in now["flags"][command]]
    return [*faults, *dict.fromkeys(_Comparison(then["openapi"], now["openapi"]).operations())]


@dataclass(slots=True)
class _Comparison:
    """Two OpenAPI documents."""

    then: _Schema
    now: _Schema
    _found: dict[tuple[str, str, bool], list[str]] = field(default_factory=dict)
    """What the comparison of two named schemas told; empty while it goes on, for they may hold themselves."""

    def operations(self) -> Iterator[str]:
        for path, methods in self.then["paths"].items():
            for method, old in methods.items():
                where = f"{method.upper()} {path}"
                new = self.now["paths"].get(path, {}).get(method)
                if new is None:
                    yield f"{where}: the operation is gone"
                    continue
                yield from self._parameters(where, old.get("parameters", []), new.get("parameters", []))
                yield from self._body(where, old.get("requestBody"), new.get("requestBody"))
                for status, answer in old["responses"].items():
                    yield from self._answer(f"{where} {status}", answer, new["responses"].get(status))

    def _parameters(self, where: str, old: list[_Schema], new: list[_Schema]) -> Iterator[str]:
        named = {(one["in"], one["name"]): one for one in new}
        known = {(one["in"], one["name"]): one for one in old}
        for key, one in known.items():
            if key not in named:
                yield f"{where}: the {key[0]} parameter {key[1]} is gone"
            else:
                yield from self._schema(f"{where} {key[1]}", one["schema"], named[key]["schema"], is_sent=True)
        for key, one in named.items():
            if one.get("required") and not known.get(key, {}).get("required"):
                yield f"{where}: the {key[0]} parameter {key[1]} is required now"

    def _body(self, where: str, old: _Schema | None, new: _Schema | None) -> Iterator[str]:
        if new is not None and new.get("required") and not (old or {}).get("required"):
            yield f"{where}: a body is required now"
        if old is not None:
            yield from self._content(f"{where} body", old["content"], (new or {}).get("content", {}), is_sent=True)

    def _answer(self, where: str, old: _Schema, new: _Schema | None) -> Iterator[str]:
        if new is None:
            yield f"{where}: the answer is gone"
            return
        yield from (f"{where}: the header {name} is gone" for name in old.get("headers", {}) if name not in new.get("headers", {}))
        yield from self._content(where, old.get("content", {}), new.get("content", {}), is_sent=False)

    def _content(self, where: str, old: _Schema, new: _Schema, *, is_sent: bool) -> Iterator[str]:
        for kind, one in old.items():
            if kind not in new:
                yield f"{where}: {kind} is gone"
            elif "schema" in one:
                yield from self._schema(where, one["schema"], new[kind].get("schema", {}), is_sent=is_sent)

    def _schema(self, where: str, old: _Schema, new: _Schema, *, is_sent: bool) -> Iterator[str]:
        if "$ref" in old and "$ref" in new:
            key = (old["$ref"], new["$ref"], is_sent)
            if key not in self._found:
                self._found[key] = []
                self._found[key] = list(self._plain(where, old, new, is_sent=is_sent))
            yield from self._found[key]
        else:
            yield from self._plain(where, old, new, is_sent=is_sent)

    def _plain(self, where: str, old: _Schema, new: _Schema, *, is_sent: bool) -> Iterator[str]:
        """Compare two schemas by what they are, whatever they are called."""
        before, after = _alternatives(self.then, old), _alternatives(self.now, new)
        # What was sent must still be taken; what is answered must have been foreseen.
        narrow, wide = (before, after) if is_sent else (after, before)
        if not wide or {} in wide:
            return
        for one in narrow:
            matches = [other for other in wide if _type(other) == _type(one) or (_type(other), _type(one)) == ("number", "integer")]
            if not matches:
                yield f"{where}: {_type(one)} is {'no longer taken' if is_sent else 'answered now, which was not foreseen'}"
                continue
            tried = [list(self._shape(where, *((one, other) if is_sent else (other, one)), is_sent=is_sent)) for other in matches]
            yield from min(tried, key=len)

    def _shape(self, where: str, old: _Schema, new: _Schema, *, is_sent: bool) -> Iterator[str]:
        """Compare two schemas of one type."""
        if is_sent:
            yield from _narrowed(where, old, new)
        known, named = old.get("properties", {}), new.get("properties", {})
        for name, one in known.items():
            if name not in named:
                yield f"{where}: the field {name} is gone"
            else:
                yield from self._schema(f"{where}.{name}", one, named[name], is_sent=is_sent)
        less, more = (new, old) if is_sent else (old, new)
        verb = "is required now" if is_sent else "may be missing now"
        yield from (f"{where}: the field {name} {verb}" for name in less.get("required", []) if name not in more.get("required", []))
        if "items" in old:
            yield from self._schema(f"{where}[]", old["items"], new.get("items", {}), is_sent=is_sent)
        of_any = old.get("additionalProperties"), new.get("additionalProperties")
        if all(isinstance(one, dict) for one in of_any):
            yield from self._schema(f"{where}.*", *of_any, is_sent=is_sent)


def _narrowed(where: str, old: _Schema, new: _Schema) -> Iterator[str]:
    """Tell of a plain value that is sent what was taken and is not any more."""
    values = _values(new)
    if values is not None and not set(_values(old) or [object()]) <= set(values):
        yield f"{where}: of the values {_values(old) or 'of any kind'} only {values} are taken"
    for names, sign in ((_LOWER_LIMITS, 1), (_UPPER_LIMITS, -1)):
        for name in names:
            if name in new and (name not in old or sign * new[name] > sign * old[name]):
                yield f"{where}: {name} is {new[name]}, and was {old.get(name, 'not limited')}"
    if new.get("pattern") not in {None, old.get("pattern")}:
        yield f"{where}: the pattern is {new['pattern']}, and was {old.get('pattern', 'any')}"


def _values(schema: _Schema) -> list[object] | None:
    values: list[object] | None = [schema["const"]] if "const" in schema else schema.get("enum")
    return values


def _type(schema: _Schema) -> str:
    kind = schema.get("type")
    if isinstance(kind, str):
        return kind
    return "object" if "properties" in schema else "string" if _values(schema) else "any"


def _alternatives(document: _Schema, schema: _Schema) -> list[_Schema]:
    """Follow references, and return the plain schemas that a schema is a choice of."""
    if "$ref" in schema:
        return _alternatives(document, document["components"]["schemas"][schema["$ref"].rpartition("/")[2]])
    for name in ("anyOf", "oneOf"):
        if name in schema:
            return [one for choice in schema[name] for one in _alternatives(document, choice)]
    if isinstance(schema.get("type"), list):
        return [{**schema, "type": kind} for kind in schema["type"]]
    return [schema]
