"""A configuration's keys in words, from the Struct that it is: their types, limits, defaults and meanings.

Meanings are taken from the section ``Keys`` of each Struct's docstring: names on a line, comma-separated, and below them, indented, what
they mean. A key that it does not name is an error of ours.
"""

import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from textwrap import wrap
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import msgspec

_LIMITS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
_WIDTH = 120


def default_toml(config: type[msgspec.Struct], *, title: str) -> str:
    """Return a TOML file with every key: its meaning and type as a comment, and its default.

    A key without a default, or whose default is that it is not given, stands there as a comment. Loading the file gives the defaults.

    Raises
    ------
    ValueError
        A Struct's docstring says nothing of one of its keys.
    """
    return "\n".join([*_comment(title), *_table(config, name="")]).rstrip() + "\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """A key in words: its dotted name, its type with limits, its default, and what it means."""

    name: str
    kind: str
    default: str
    meaning: str
    """Of several that are meant together, the first has the text, and the others name it."""


def configuration_keys(config: type[msgspec.Struct], prefix: str = "") -> Iterator[Key]:
    """Yield every key of a configuration; raises ``ValueError`` where a Struct's docstring says nothing of one of its keys."""
    known = meanings(config)
    for one in msgspec.structs.fields(config):
        name = prefix + one.encode_name
        if _is_table(one.type):
            yield from configuration_keys(one.type, f"{name}.")
            continue
        group, meaning = _meaning_of(one.encode_name, known, config=config)
        default = "required" if one.required else f"`{msgspec.json.encode(_default(one), enc_hook=str).decode()}`"
        if len(group) > 1:
            meaning = f"{', '.join(group)}: {meaning}" if one.encode_name == group[0] else f"With `{group[0]}`."
        yield Key(name=name, kind=type_name(one.type), default=default, meaning=meaning)


def type_name(annotation: Any) -> str:
    """Return a type as people read it, with its limits."""
    origin = get_origin(annotation)
    if origin is Annotated:
        base, *notes = get_args(annotation)
        limits = [
            f"{sign} {getattr(note, name):g}" for note in notes for name, sign in _LIMITS.items() if getattr(note, name, None) is not None
        ]
        return " ".join([type_name(base), ", ".join(limits)]).rstrip()
    if origin in {Union, UnionType}:
        return " or ".join(type_name(one) for one in get_args(annotation))
    if origin is Literal:
        return " or ".join(f"`{one}`" for one in get_args(annotation))
    if origin is tuple:
        return f"list of {type_name(get_args(annotation)[0])}"
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " or ".join(f"`{one.value}`" for one in annotation)
    return "none" if annotation is type(None) else str(getattr(annotation, "__name__", annotation))


def meanings(config: type[msgspec.Struct]) -> dict[str, tuple[tuple[str, ...], str]]:
    """Return, for each key that a Struct's docstring or a base's names, all keys named with it and what they mean; names may take lines."""
    found: dict[str, tuple[tuple[str, ...], str]] = {}
    for one in reversed(config.__mro__):
        section = re.search(r"^Keys\n-+\n(.*)", inspect.cleandoc(one.__doc__ or ""), re.DOTALL | re.MULTILINE)
        for names, text in re.findall(r"^((?:\S.*\n)+)((?:(?: .*)?(?:\n|\Z))+)", section[1] if section else "", re.MULTILINE):
            keys = tuple(re.split(r",\s*", names.strip()))
            found.update(dict.fromkeys(keys, (keys, " ".join(text.split()))))
    return found


def _meaning_of(key: str, known: dict[str, tuple[tuple[str, ...], str]], *, config: type[msgspec.Struct]) -> tuple[tuple[str, ...], str]:
    if key not in known:
        raise ValueError(f"{config.__name__}: the section Keys of its docstring says nothing of {key}")
    return known[key]


def _table(config: type[msgspec.Struct], *, name: str) -> list[str]:
    lines: list[str] = []
    if name:
        lines += ["", f"[{name}]", *_comment((inspect.getdoc(config) or "").split("\n\n")[0])]
    fields = msgspec.structs.fields(config)
    known = meanings(config)
    told: tuple[str, ...] = ()
    for one in fields:
        if _is_table(one.type):
            continue
        group, meaning = _meaning_of(one.encode_name, known, config=config)
        if group != told:
            about = f"{', '.join(group)}: " if len(group) > 1 else ""
            lines += ["", *_comment(f"{about}{meaning}")]
            told = group
        lines += _key(one)
    for one in fields:
        if _is_table(one.type):
            lines += _table(one.type, name=f"{name}.{one.encode_name}" if name else one.encode_name)
    return lines


def _key(one: msgspec.structs.FieldInfo) -> list[str]:
    kind = type_name(one.type).replace("`", "")
    if one.required:
        return [f"# {one.encode_name} =   # {kind}; must be given"]
    default = msgspec.to_builtins(_default(one))
    if default is None:
        return [f"# {one.encode_name} =   # {kind.removesuffix(' or none')}; not given by default"]
    return [f"{one.encode_name} = {_toml(default)}  # {kind}"]


def _toml(value: object) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)
        case list() | tuple():
            return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(str(value))  # TOML's basic strings have JSON's escapes


def _comment(text: str) -> list[str]:
    plain = " ".join(text.replace("``", "`").split())
    return [f"# {line}" for line in wrap(plain, _WIDTH - 2, break_on_hyphens=False, break_long_words=False)]


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _default(one: msgspec.structs.FieldInfo) -> object:
    return one.default if one.default is not msgspec.NODEFAULT else one.default_factory()
