"""Read all encounters of a store at once: half a million in about a second, because only what a map needs of them is decoded."""

import sqlite3
from collections.abc import Iterator

import msgspec
import numpy as np

from firmware_protocol.errors import RecordError
from mapper.record_columns import EncounterRows
from mapper.types import IntArray

_CHUNK = 20_000


class _Lean(msgspec.Struct, frozen=True, gc=False, tag="encounter"):
    """The fields of an `EncounterRecord` that a map is made of."""

    wall_anchor_ns: int
    t_start_ns: int
    t_end_ns: int
    node_a: int
    node_b: int
    is_void: bool = False


_decoder = msgspec.msgpack.Decoder(list[_Lean])


def load_encounters(database: sqlite3.Connection, *, kind: int) -> Iterator[tuple[EncounterRows, IntArray]]:
    """Yield all encounters in pieces, each with the numbers of its rows' last changes, shape (m,).

    Raises
    ------
    RecordError
        A body is no encounter.
    """
    cursor = database.execute("SELECT id, change, body FROM record WHERE +kind = ? ORDER BY id", (kind,))
    while chunk := cursor.fetchmany(_CHUNK):
        rows, changes, bodies = zip(*chunk, strict=True)
        records = _decode(bodies)
        anchor = np.array([record.wall_anchor_ns for record in records], dtype=np.int64)
        encounters = EncounterRows(
            row=np.array(rows, dtype=np.int64),
            t_start_ns=anchor + np.array([record.t_start_ns for record in records], dtype=np.int64),
            t_end_ns=anchor + np.array([record.t_end_ns for record in records], dtype=np.int64),
            id1=np.array([record.node_a for record in records], dtype=np.uint64).view(np.int64),
            id2=np.array([record.node_b for record in records], dtype=np.uint64).view(np.int64),
            counts=~np.array([record.is_void for record in records], dtype=np.bool_),
        )
        yield encounters, np.array(changes, dtype=np.int64)


def _decode(bodies: tuple[bytes, ...]) -> list[_Lean]:
    # One MessagePack array of all of them (msgpack specification, "array 32"): a call for each would take twice as long.
    whole = b"\xdd" + len(bodies).to_bytes(4, "big") + b"".join(bodies)
    try:
        records = _decoder.decode(whole)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordError(record="encounter", reason=str(error)) from error
    return records
