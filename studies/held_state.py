"""How much an object holds: bytes, and things in containers, through all that it refers to."""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType

_ATOMS = (int, float, bool, type(None), type, Enum, FunctionType, BuiltinFunctionType, MethodType, ModuleType)


@dataclass(frozen=True, slots=True)
class Held:
    """Bytes in byte strings and texts, and members of containers."""

    n_bytes: int
    n_members: int


def measure_held(root: object) -> Held:
    """Follow attributes, slots and containers from ``root``; functions, classes and modules are not followed."""
    n_bytes = n_members = 0
    seen: set[int] = set()
    waiting = [root]
    while waiting:
        one = waiting.pop()
        if isinstance(one, _ATOMS) or id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, bytes | bytearray | str):
            n_bytes += len(one)
        elif isinstance(one, Mapping):
            n_members += len(one)
            waiting += one.values()
            waiting += one.keys()
        elif isinstance(one, list | tuple | set | frozenset | deque):
            n_members += len(one)
            waiting += one
        else:
            waiting += _attributes(one)
    return Held(n_bytes, n_members)


def _attributes(one: object) -> Iterator[object]:
    yield from getattr(one, "__dict__", {}).values()
    for cls in type(one).__mro__:
        for name in getattr(cls, "__slots__", ()):
            if hasattr(one, name):
                yield getattr(one, name)
