"""Read all encounters of a store at once: half a million in about a second, because only what a map needs of them is decoded."""

import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import msgspec
import msgspec.structs
import numpy as np

from firmware_protocol.contract.records import OwnSpan
from firmware_protocol.errors import RecordError
from mapper.log import EventLog
from mapper.own_spans import make_own_spans
from mapper.record_columns import EncounterOrigins, EncounterRows, is_fit_for_columns, limit_errors, limit_margins
from mapper.types import IntArray

_log = EventLog(__name__)

_CHUNK = 20_000
_RecordT = TypeVar("_RecordT")


class _Lean(msgspec.Struct, frozen=True, gc=False, tag="encounter"):
    """The fields of an `EncounterRecord` that a map is made of."""

    wall_anchor_ns: int
    t_start_ns: int
    t_end_ns: int
    node_a: int
    node_b: int
    is_void: bool = False
    error_ns: int = 0
    margin_ns: int = 0
    is_ongoing: bool = False


class _LeanSide(msgspec.Struct, frozen=True, gc=False):
    """The fields of an `EncounterSide` that tell what was told twice."""

    node: int
    t_start_ns: int
    error_ns: int | None = None
    own_clock: OwnSpan | msgspec.UnsetType = msgspec.UNSET


class _Sided(msgspec.Struct, frozen=True, gc=False, tag="encounter"):
    """The fields of an `EncounterRecord` that several gateways' records are joined by, beside those of `_Lean`."""

    wall_anchor_ns: int
    node_a: int
    node_b: int
    error_ns: int = 0
    sides: tuple[_LeanSide, ...] = ()


_decoder = msgspec.msgpack.Decoder(list[_Lean])
_sided_decoder = msgspec.msgpack.Decoder(list[_Sided])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoadedEncounters:
    """Encounters of a store, with the numbers of their rows' last changes, shape (m,)."""

    rows: EncounterRows
    changes: IntArray
    _gateways: Sequence[str]
    _records: Sequence[_Lean]
    _bodies: Sequence[bytes]

    def origins(self, *, number_source: Callable[[str, int], int]) -> EncounterOrigins:
        """Say where they come from; ``number_source`` gives the number of a gateway's start by its name and anchor [ns]."""
        starts = list(zip(self._gateways, [record.wall_anchor_ns for record in self._records], strict=True))
        numbers = {start: number_source(*start) for start in dict.fromkeys(starts)}
        sided = _decode(self._bodies, _sided_decoder)
        margin_ns, error_ns = ([getattr(record, name) for record in self._records] for name in ("margin_ns", "error_ns"))
        return EncounterOrigins(
            source=np.array([numbers[start] for start in starts], dtype=np.int64),
            margin_ns=limit_margins(margin_ns=margin_ns, error_ns=error_ns),
            error_ns=limit_errors(error_ns),
            is_final=~np.array([record.is_ongoing for record in self._records], dtype=np.bool_),
            own=make_own_spans(sided),
        )


def load_encounters(database: sqlite3.Connection, *, kind: int) -> Iterator[LoadedEncounters]:
    """Yield all encounters in pieces.

    Raises
    ------
    RecordError
        A body is no encounter.

    Notes
    -----
    Rows whose numbers fit no column are left out, and the log says how many: a store opens whatever an earlier version let into it.
    """
    query = "SELECT source.id, name FROM source JOIN gateway ON gateway.id = source.gateway"
    names: Mapping[int, str] = dict(database.execute(query).fetchall())
    cursor = database.execute("SELECT id, change, source, body FROM record WHERE +kind = ? ORDER BY id", (kind,))
    n_left_out = 0
    while chunk := cursor.fetchmany(_CHUNK):
        rows, changes, sources, bodies = (tuple(column) for column in zip(*chunk, strict=True))
        records = _decode(bodies, _decoder)
        try:
            encounters = _make_rows(rows, records)
        except OverflowError:
            placed = [(*place, _on_wall_clock(record)) for *place, record in zip(rows, changes, sources, bodies, records, strict=True)]
            fit = [(*place, record) for *place, record in placed if record is not None]
            n_left_out += len(placed) - len(fit)
            rows, changes, sources, bodies = (tuple(one[column] for one in fit) for column in range(4))
            records = [record for *_, record in fit]
            encounters = _make_rows(rows, records)
        yield LoadedEncounters(
            rows=encounters,
            changes=np.array(changes, dtype=np.int64),
            _gateways=[names[source] for source in sources],
            _records=records,
            _bodies=bodies,
        )
    if n_left_out:
        _log.warning("store.rows_left_out", encounters=n_left_out, reason="their numbers have more than 64 bits, or make no interval")


def _make_rows(rows: Sequence[int], records: Sequence[_Lean]) -> EncounterRows:
    anchor = np.array([record.wall_anchor_ns for record in records], dtype=np.int64)
    return EncounterRows(
        row=np.array(rows, dtype=np.int64),
        t_start_ns=anchor + np.array([record.t_start_ns for record in records], dtype=np.int64),
        t_end_ns=anchor + np.array([record.t_end_ns for record in records], dtype=np.int64),
        id1=np.array([record.node_a for record in records], dtype=np.uint64).view(np.int64),
        id2=np.array([record.node_b for record in records], dtype=np.uint64).view(np.int64),
        counts=~np.array([record.is_void for record in records], dtype=np.bool_),
    )


def _on_wall_clock(record: _Lean) -> _Lean | None:
    """Add the anchor without a limit of bits; None for what then stands in no column."""
    begin, end = record.t_start_ns + record.wall_anchor_ns, record.t_end_ns + record.wall_anchor_ns
    if not is_fit_for_columns(begin_ns=begin, end_ns=end, node_a=record.node_a, node_b=record.node_b):
        return None
    return msgspec.structs.replace(record, wall_anchor_ns=0, t_start_ns=begin, t_end_ns=end)


def _decode(bodies: Sequence[bytes], decoder: "msgspec.msgpack.Decoder[list[_RecordT]]") -> list[_RecordT]:
    # One MessagePack array of all of them (msgpack specification, "array 32"): a call for each would take twice as long.
    whole = b"\xdd" + len(bodies).to_bytes(4, "big") + b"".join(bodies)
    try:
        records = decoder.decode(whole)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordError(record="encounter", reason=str(error)) from error
    return records
