"""One way to build a frozen configuration: defaults, then TOML, then environment, then flags.

Pure: the caller reads the file and hands over its text. Unknown keys are errors, and all errors are reported together.
The configuration itself is a ``msgspec.Struct`` whose fields are scalars, tuples or further Structs.
"""

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from firmware_protocol.errors import ConfigurationError
from firmware_protocol.nearest_word import did_you_mean
from firmware_protocol.own_files import HEAD_BYTES, tell_own_file

ConfigT = TypeVar("ConfigT", bound=msgspec.Struct)

_SEPARATOR = "__"


@dataclass(frozen=True, slots=True, kw_only=True)
class Unfit:
    """What a value, or several together, cannot be though each has a fit type.

    Parameters
    ----------
    keys
        The dotted keys it is about; where one of them has an unfit value anyway, only that is told.
    reason
        One sentence that names value, limit and next step.
    """

    keys: tuple[str, ...]
    reason: str


def load_configuration(
    config_type: type[ConfigT],
    *,
    toml_text: str | None = None,
    toml_name: str = "configuration",
    environment: Mapping[str, str] | None = None,
    environment_prefix: str,
    flags: Mapping[str, object] | None = None,
    flag_names: Mapping[str, str] | None = None,
    check: Callable[[ConfigT], Iterable[Unfit]] | None = None,
) -> ConfigT:
    """Build a configuration from its four sources, later ones winning.

    Parameters
    ----------
    config_type
        A Struct type; every field has a default or must be given by a source.
    toml_text
        Content of the TOML file, or None where there is none.
    toml_name
        Name of that file, for messages.
    environment
        Environment variables. ``BIOBOT_GATEWAY__SERIAL__BAUD`` sets ``serial.baud`` under the prefix ``BIOBOT_GATEWAY``.
    environment_prefix
        Upper-case prefix, without separator.
    flags
        Dotted key to value, from the command line; None means "not given".
    flag_names
        Dotted key to the flag as it is typed, where that is not the key's last part.
    check
        Finds what types cannot say. It is asked even where some values are unfit, which then have their defaults.

    Raises
    ------
    ConfigurationError
        With one line for every unknown key and every unfit value of any source.
    """
    problems: list[str] = []
    merged: dict[str, Any] = {}
    origin: dict[str, str] = {}
    if toml_text is not None:
        try:
            _merge(merged, tomllib.loads(toml_text), origin=origin, source=toml_name)
        except tomllib.TOMLDecodeError as error:
            own = tell_own_file(toml_text[:HEAD_BYTES].encode())
            known = "" if own is None else f"; it is {own.what}: {own.use}"
            problems.append(f"{toml_name}: not valid TOML: {error}{known}")
            check = None  # what the file was to say is not known
    for name, text in sorted((environment or {}).items()):
        if name.startswith(environment_prefix + _SEPARATOR):
            path = name.removeprefix(environment_prefix + _SEPARATOR).lower().split(_SEPARATOR)
            _merge(merged, _nest(path, _Text(text)), origin=origin, source=name)
    for dotted, value in (flags or {}).items():
        if value is not None:
            flag = (flag_names or {}).get(dotted) or "--" + dotted.rsplit(".", 1)[-1].replace("_", "-")
            _merge(merged, _nest(dotted.split("."), value), origin=origin, source=flag)
    from_file = f"{toml_name}: " if toml_text is not None else ""
    unfit: set[str] = set()
    values = _convert_fields(config_type, merged, prefix="", origin=origin, problems=problems, unfit=unfit, where=from_file)
    try:
        config = config_type(**values)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(problems or [f"{from_file}{error}"]) from error
    for found in check(config) if check is not None else ():
        if not any(_is_within(key, unfit) for key in found.keys):
            source = next((origin[key] for key in found.keys if key in origin), None)
            problems.append(found.reason if source is None else f"{source}: {found.reason}")
    if problems:
        raise ConfigurationError(problems)
    return config


def _is_within(key: str, unfit: set[str]) -> bool:
    """Whether a key, or a table that it is in, has an unfit value."""
    parts = key.split(".")
    return any(".".join(parts[:n]) in unfit for n in range(1, len(parts) + 1))


class _Text(str):
    """A value that came as text and may still become a number, a truth value or a list."""

    __slots__ = ()


def _nest(path: list[str], value: object) -> dict[str, Any]:
    nested: Any = value
    for key in reversed(path):
        nested = {key: nested}
    return nested  # type: ignore[no-any-return]  # the loop ran at least once: a path is never empty


def _merge(into: dict[str, Any], new: Mapping[str, Any], *, origin: dict[str, str], source: str, prefix: str = "") -> None:
    for key, value in new.items():
        dotted = f"{prefix}{key}"
        if isinstance(value, Mapping) and isinstance(into.get(key, {}), dict):
            _merge(into.setdefault(key, {}), value, origin=origin, source=source, prefix=f"{dotted}.")
        else:
            into[key] = value
        origin[dotted] = source


def _convert_fields(
    config_type: type[msgspec.Struct],
    given: Mapping[str, Any],
    *,
    prefix: str,
    origin: Mapping[str, str],
    problems: list[str],
    unfit: set[str],
    where: str,
) -> dict[str, Any]:
    """Return the values that are fit; those that are not go to ``problems``, and their keys to ``unfit``."""
    fields = {field.encode_name: field for field in msgspec.structs.fields(config_type)}
    known = ", ".join(sorted(fields))
    problems += [
        f"{origin.get(prefix + key, '?')}: unknown key {prefix + key!r}; known here: {known}{did_you_mean(key, fields)}"
        for key in sorted(given.keys() - fields.keys())
    ]
    values: dict[str, Any] = {}
    for key, field in fields.items():
        dotted = prefix + key
        if key not in given:
            if field.required:
                problems.append(f"{where}missing key {dotted!r}")
                unfit.add(dotted)
            continue
        value = given[key]
        label = f"{origin.get(dotted, '?')}: {dotted}"
        if not (isinstance(field.type, type) and issubclass(field.type, msgspec.Struct)):
            make = partial(_convert, value, field.type)
            _try(problems, f"{label} is {_shown(value)}", values, field.name, make, choices=_choices(field.type))
        elif isinstance(value, Mapping):
            before = len(problems)
            inner = _convert_fields(field.type, value, prefix=f"{dotted}.", origin=origin, problems=problems, unfit=unfit, where=where)
            # A table that has unfit values is made of the others, for what is still to be checked; nothing more is said of it.
            _try(problems if len(problems) == before else [], label, values, field.name, partial(field.type, **inner))
        else:
            problems.append(f"{label} is {value!r}, but must be a table")
        if field.name not in values:
            unfit.add(dotted)
    return values


def _convert(value: object, wanted: Any) -> object:
    if isinstance(value, _Text):
        try:
            return msgspec.convert(str(value), wanted, strict=False)
        except msgspec.ValidationError:
            if not _is_list(wanted):
                raise
            parts = [part.strip() for part in value.split(",") if part.strip()]
            return msgspec.convert(parts, wanted, strict=False)
    return msgspec.convert(value, wanted)


def _is_list(kind: Any) -> bool:
    """Whether a type is, or may be, a list: the parts of ``X | None`` and of ``Annotated`` count."""
    if get_origin(kind) in (tuple, list):
        return True
    return get_origin(kind) not in (None, Literal) and any(_is_list(part) for part in get_args(kind))


def _choices(kind: Any) -> list[str]:
    """List what a type allows where it is, or is a list of, one of some names; else nothing."""
    if get_origin(kind) is Literal:
        return [str(one) for one in get_args(kind)]
    if isinstance(kind, type) and issubclass(kind, Enum):
        return [str(one.value) for one in kind]
    return [name for part in get_args(kind) for name in _choices(part)]


def _shown(value: object) -> str:
    return repr(str(value)) if isinstance(value, _Text) else repr(value)


def _try(
    problems: list[str], label: str, values: dict[str, Any], name: str, make: Callable[[], object], *, choices: Sequence[str] = ()
) -> None:
    try:
        values[name] = make()
    except msgspec.ValidationError as error:
        wanted = f"; wanted {' or '.join(choices)}" if choices else ""
        problems.append(f"{label}: {error}{wanted}")
    except (TypeError, ValueError) as error:
        problems.append(f"{label}: {error}")
