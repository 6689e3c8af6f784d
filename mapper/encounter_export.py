"""All encounters of a store for other programs, as CSV or Parquet, a piece at a time: however many there are, few are in memory.

The files are what ``biobot-mapper run`` reads. Each encounter that counts is there once, on the site's clock, in the order in which it
came; what changes while the file is written is in it as it was when its piece was.
"""

import asyncio
import importlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from mapper.encounter_csv import ENCOUNTER_COLUMNS
from mapper.errors import EngineMissingError, TooManyError
from mapper.record_columns import EncounterRows
from mapper.store import Store
from mapper.store_thread import StoreThread
from mapper.types import IntArray

PIECE_ROWS: Final = 16_384
MAX_EXPORTS: Final = 4
"""So many may be under way at a time."""
_NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Period:
    """Of which time encounters are wanted [ns since 1970]: not those over at ``since_ns`` or begun at ``until_ns`` and later; None: all."""

    since_ns: int | None = None
    until_ns: int | None = None


class Exports:
    """Writes encounters of a store for those who ask."""

    def __init__(self, records: StoreThread) -> None:
        self._records = records
        self._n_under_way = 0

    def csv(self, period: Period) -> AsyncIterator[bytes]:
        """Write encounters as CSV: begin and end in seconds since 1970 to the nanosecond, and the two ids.

        Raises
        ------
        TooManyError
            Others are being written.
        """
        self._check()
        return self._write(period, head=(",".join(ENCOUNTER_COLUMNS) + "\n").encode(), write=write_csv, finish=lambda: b"")

    def parquet(self, period: Period) -> AsyncIterator[bytes]:
        """Write encounters as Parquet: the same columns, instants as timestamps [ns, UTC] and ids unsigned.

        Raises
        ------
        TooManyError
            Others are being written.
        EngineMissingError
            pyarrow is not installed.
        """
        self._check()
        table = ParquetPieces()
        return self._write(period, head=b"", write=table.write, finish=table.finish)

    def _check(self) -> None:
        if self._n_under_way >= MAX_EXPORTS:
            raise TooManyError(what="files being written", limit=MAX_EXPORTS)

    async def _write(
        self, period: Period, *, head: bytes, write: Callable[[EncounterRows], bytes], finish: Callable[[], bytes]
    ) -> AsyncIterator[bytes]:
        self._n_under_way += 1
        try:
            yield head
            first: int | None = 0
            while first is not None:
                rows, first = await self._records.call(Store.rows, first=first, limit=PIECE_ROWS)
                yield await asyncio.to_thread(write, select_period(rows, period))
            yield await asyncio.to_thread(finish)
        finally:
            self._n_under_way -= 1


def select_period(rows: EncounterRows, period: Period) -> EncounterRows:
    """Leave out what was over when a period began, or began when it was over."""
    chosen = np.ones(len(rows), dtype=np.bool_)
    if period.since_ns is not None:
        chosen &= rows.t_end_ns > period.since_ns
    if period.until_ns is not None:
        chosen &= rows.t_start_ns < period.until_ns
    return EncounterRows(
        row=rows.row[chosen],
        t_start_ns=rows.t_start_ns[chosen],
        t_end_ns=rows.t_end_ns[chosen],
        id1=rows.id1[chosen],
        id2=rows.id2[chosen],
        counts=rows.counts[chosen],
    )


def write_csv(rows: EncounterRows) -> bytes:
    """Write encounters as lines of CSV, without a header."""
    columns = (rows.t_start_ns.tolist(), rows.t_end_ns.tolist(), _unsigned(rows.id1).tolist(), _unsigned(rows.id2).tolist())
    return "".join(
        f"{begin // _NS_PER_S}.{begin % _NS_PER_S:09d},{end // _NS_PER_S}.{end % _NS_PER_S:09d},{first},{second}\n"
        for begin, end, first, second in zip(*columns, strict=True)
    ).encode()


class ParquetPieces:
    """A Parquet file whose bytes are taken away as they come; it is complete with what `finish` returns.

    Raises
    ------
    EngineMissingError
        pyarrow is not installed.
    """

    def __init__(self) -> None:
        try:
            self._arrow: Any = importlib.import_module("pyarrow")
            parquet: Any = importlib.import_module("pyarrow.parquet")
        except ImportError as error:
            next_step = "pip install 'biobot-gateway[parquet]', or ask for encounters.csv"
            raise EngineMissingError(library="pyarrow", needed_for="writing Parquet", next_step=next_step) from error
        instant = self._arrow.timestamp("ns", tz="UTC")
        fields = zip(ENCOUNTER_COLUMNS, (instant, instant, self._arrow.uint64(), self._arrow.uint64()), strict=True)
        self._schema = self._arrow.schema(list(fields))
        self._sink = _Sink()
        self._writer = parquet.ParquetWriter(self._arrow.PythonFile(self._sink, mode="w"), self._schema)

    def write(self, rows: EncounterRows) -> bytes:
        """Write encounters as a group of rows, and return what is new of the file."""
        if len(rows):
            columns = (rows.t_start_ns, rows.t_end_ns, _unsigned(rows.id1), _unsigned(rows.id2))
            arrays = [self._arrow.array(values, type=kind) for values, kind in zip(columns, self._schema.types, strict=True)]
            self._writer.write_table(self._arrow.Table.from_arrays(arrays, schema=self._schema))
        return self._sink.take()

    def finish(self) -> bytes:
        """Write the end of the file, and return it."""
        self._writer.close()
        return self._sink.take()


class _Sink:
    """A file that can be written to alone; what was written is taken away."""

    closed = False

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self._place = 0

    def write(self, data: Any) -> int:
        piece = bytes(data)
        self._pieces.append(piece)
        self._place += len(piece)
        return len(piece)

    def tell(self) -> int:
        return self._place

    def flush(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True

    def take(self) -> bytes:
        taken = b"".join(self._pieces)
        self._pieces.clear()
        return taken


def _unsigned(ids: IntArray) -> "np.ndarray[tuple[int], np.dtype[np.uint64]]":
    return ids.view(np.uint64)
