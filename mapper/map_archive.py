"""Maps of the past in the store: the facts of each, and its documents, compressed."""

import sqlite3
import zlib
from typing import Final

import msgspec

from firmware_protocol.first_use import prepare
from mapper.errors import StoreError
from mapper.store import Store

_LEVEL: Final = 4  # of 586 kB: 117 kB in 15 ms; level 6: 111 kB in 58 ms (a map of two obstacles with 231 points, x86-64, 2026-11)


class PastMap(msgspec.Struct, frozen=True, kw_only=True):
    """What is told of a map of the past without opening it. ``n_bytes``: of its compressed documents; ``betti_numbers`` are b0 and b1."""

    version: int
    wall_ns: int
    """When it was done."""
    begun_wall_ns: int
    made_by: str
    tag: str
    """Of its entity, as it was first served."""
    betti_numbers: tuple[int, int]
    hole_probability: float | None
    """That there are as many holes in truth; None: not known."""
    is_enough: bool | None
    n_encounters: int
    n_bytes: int


prepare(PastMap)


def read_past_maps(store: Store) -> list[PastMap]:
    """Return the facts of all, the newest last; what cannot be read is left out.

    Raises
    ------
    StoreError
        The file cannot be read.
    """

    def read(database: sqlite3.Connection) -> list[bytes]:
        return [body for (body,) in database.execute("SELECT facts FROM past_map ORDER BY version").fetchall()]

    return [facts for body in store.read(read) if (facts := _decode(body)) is not None]


def read_documents(store: Store, version: int) -> bytes | None:
    """Return the compressed documents of one; None: it is not there. Raises what `read_past_maps` raises."""

    def read(database: sqlite3.Connection) -> bytes | None:
        row = database.execute("SELECT documents FROM past_map WHERE version = ?", (version,)).fetchone()
        return None if row is None else bytes(row[0])

    return store.read(read)


def change_past_maps(store: Store, *, add: list[tuple[PastMap, bytes]], drop: list[int]) -> None:
    """Put some in and take some out.

    Raises
    ------
    StoreError
        The file cannot be written; nothing of it was done.
    """
    with store.transaction() as database:
        rows = [(facts.version, msgspec.msgpack.encode(facts), documents) for facts, documents in add]
        database.executemany("INSERT OR REPLACE INTO past_map (version, facts, documents) VALUES (?, ?, ?)", rows)
        database.executemany("DELETE FROM past_map WHERE version = ?", [(version,) for version in drop])


def pack_documents(map_json: bytes, diagram_json: bytes) -> bytes:
    """Compress the documents of a map."""
    return zlib.compress(msgspec.msgpack.encode((map_json, diagram_json)), _LEVEL)


def unpack_documents(packed: bytes) -> tuple[bytes, bytes]:
    """Invert `pack_documents`.

    Raises
    ------
    StoreError
        They are something else.
    """
    try:
        return msgspec.msgpack.decode(zlib.decompress(packed), type=tuple[bytes, bytes])
    except (zlib.error, msgspec.DecodeError, UnicodeDecodeError) as error:
        reason = f"holds a map of the past that cannot be read: {error}"
        raise StoreError(path="the store", reason=reason, next_step="ask for another version") from error


def _decode(body: bytes) -> PastMap | None:
    try:
        return msgspec.msgpack.decode(body, type=PastMap)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
