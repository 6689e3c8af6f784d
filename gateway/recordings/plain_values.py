"""Messages and envelopes as plain values, as JSON has them: names for enumerations, hexadecimal for bytes and 64-bit addresses."""

from dataclasses import fields, is_dataclass
from enum import Enum, Flag

import msgspec


def fields_of(value: object) -> dict[str, object]:
    """Return the fields of a message or an envelope by name."""
    if isinstance(value, msgspec.Struct):
        return {name: _plain_field(name, getattr(value, name)) for name in value.__struct_fields__}
    if is_dataclass(value):
        return {one.name: _plain_field(one.name, getattr(value, one.name)) for one in fields(value)}
    return {}


def plain(value: object) -> object:
    """Return a value as JSON has it."""
    if isinstance(value, Flag):
        return [one.name.lower() if one.name else one.value for one in value]
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if is_dataclass(value) or isinstance(value, msgspec.Struct):
        return fields_of(value)
    return value


def _plain_field(name: str, value: object) -> object:
    return f"{value:016x}" if name.endswith("64") and isinstance(value, int) else plain(value)  # as labels have them
