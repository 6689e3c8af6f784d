"""Encode and decode MT frames with zigpy-znp: JSON in, JSON out.

Run by the tests with the Python of .venv-wire-peers (make wire-peers). Standard input is an object with "decode", a list of frames in
hexadecimal, and "encode", a list of [command, [value of each field]]; standard output has the same keys, with [command, [value, ...]]
for each frame and a frame for each command. Byte strings are written in hexadecimal.
zigpy-znp is under the GPL; nothing of the project imports it, and this program imports nothing of the project.
"""

import json
import sys

import zigpy_znp.commands as c
import zigpy_znp.types as t
from zigpy_znp.frames import TransportFrame


def main() -> None:
    """Do what standard input asks for."""
    asked = json.load(sys.stdin)
    decoded = [decode(bytes.fromhex(frame)) for frame in asked["decode"]]
    encoded = [encode(name, values) for name, values in asked["encode"]]
    json.dump({"decode": decoded, "encode": encoded}, sys.stdout)


def decode(frame: bytes) -> list[object]:
    """Return a command's name and fields."""
    transport, rest = TransportFrame.deserialize(frame)
    assert not rest
    kind = c.COMMANDS_BY_ID[transport.payload.header]
    command = kind.from_frame(transport.payload)
    return [kind.__qualname__, [plain(getattr(command, param.name)) for param in kind.schema]]


def encode(name: str, values: list[object]) -> str:
    """Return a command's frame."""
    kind: object = c
    for part in name.split("."):
        kind = getattr(kind, part)
    fields = {param.name: typed(param.type, value) for param, value in zip(kind.schema, values, strict=True)}
    return TransportFrame(kind(**fields).to_frame()).serialize().hex()


def plain(value: object) -> object:
    """Return a value that JSON knows."""
    if isinstance(value, t.EUI64):
        return bytes(value.serialize()).hex()
    if isinstance(value, bytes):
        return bytes(value).hex()
    if isinstance(value, list | tuple):
        return [int(one) for one in value]
    return None if value is None else int(value)


def typed(kind: type, value: object) -> object:
    """Return a value of the type that the command wants."""
    if isinstance(value, str):
        return kind(bytes.fromhex(value))
    if isinstance(value, list):
        return kind(value)
    return kind(value)


main()
