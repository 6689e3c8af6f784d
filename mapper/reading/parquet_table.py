"""Parquet files to contacts, where pyarrow is installed: only the columns wanted are read, a group of rows at a time."""

import importlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isnan
from typing import Any

import numpy as np

from firmware_protocol.units import NS_PER_S
from mapper.errors import EngineMissingError, InputFileError
from mapper.reading.column_names import Layout, UnknownColumnsError, find_layout
from mapper.reading.node_names import NodeTable
from mapper.reading.options import ReadingOptions, Role, TimeUnit
from mapper.reading.raw_log import Faults, Pieces, RawLog
from mapper.reading.values import MAX_TIME_NS, MIN_TIME_NS, TimeReader, shown
from mapper.types import IntArray

MAGIC = b"PAR1"
_ROWS_A_PIECE = 2**17


def read_parquet_table(path: str, data: bytes, options: ReadingOptions) -> RawLog:
    """Read a Parquet file.

    Raises
    ------
    EngineMissingError
        pyarrow is not installed.
    InputFileError
        It is damaged, its columns cannot be told, or rows are wrong; rows are counted from 1.
    """
    try:
        arrow: Any = importlib.import_module("pyarrow")
        parquet: Any = importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        next_step = "pip install 'biobot-gateway[parquet]', or give the log as CSV"
        raise EngineMissingError(library="pyarrow", needed_for="reading Parquet", next_step=next_step) from error
    try:
        file = parquet.ParquetFile(io.BytesIO(data))
        layout = find_layout(file.schema_arrow.names, options)
        layout = replace(layout, unit=_units(path, layout, file.schema_arrow, options))
        return _Reading(path, layout, arrow).read(file)
    except UnknownColumnsError as error:
        raise InputFileError(path=path, faults=[f"schema: {error}"]) from error
    except (arrow.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise InputFileError(path=path, faults=[f"not a Parquet file that can be read: {reason}; write it again"]) from error


def _units(path: str, layout: Layout, schema: Any, options: ReadingOptions) -> dict[Role, TimeUnit]:
    units = {}
    for role in (Role.START, Role.END, Role.INSTANT, Role.DURATION):
        if role not in layout.place:
            continue
        kind = schema.field(layout.name[role]).type
        stated = layout.unit.get(role)
        if str(kind).startswith(("timestamp", "duration", "date")):
            stated = TimeUnit.NANOSECONDS  # they are cast to it
        elif stated is not None and options.time_unit not in {None, stated} and role is not Role.DURATION:
            reason = f"column {layout.name[role]} states {stated}, but --time-unit {options.time_unit} was given; leave it out"
            raise InputFileError(path=path, faults=[f"schema: {reason}"])
        units[role] = stated or options.time_unit or TimeUnit.SECONDS
    return units


class _Reading:
    """One file being read; what is wrong with rows is told as of a text."""

    def __init__(self, path: str, layout: Layout, arrow: Any) -> None:
        self._path, self._layout, self._arrow = path, layout, arrow
        self._nodes1 = NodeTable()
        self._nodes2 = NodeTable() if layout.is_place else self._nodes1
        self._texts = {
            role: TimeReader(layout.name[role], unit=unit, takes_comma=False, is_duration=role is Role.DURATION)
            for role, unit in layout.unit.items()
        }
        self._faults, self._pieces = Faults(), Pieces()
        self._n_selves = 0
        self._self_line: int | None = None
        self._has_dates = self._lacks_zone = False

    def read(self, file: Any) -> RawLog:
        n_before = 0
        names = list(dict.fromkeys(self._layout.name.values()))
        for batch in file.iter_batches(batch_size=_ROWS_A_PIECE, columns=names):
            self._take({role: batch.column(name) for role, name in self._layout.name.items()}, n_before)
            n_before += batch.num_rows
        if self._faults.count:
            raise InputFileError(path=self._path, faults=self._faults.shown, n_faults=self._faults.count)
        start, end, code1, code2 = self._pieces.join()
        instants = [reader for role, reader in self._texts.items() if role is not Role.DURATION]
        has_dates = self._has_dates or any(reader.has_dates for reader in instants)
        return RawLog(
            kind="Parquet",
            layout=self._layout,
            start_ns=start,
            end_ns=end,
            code1=code1,
            code2=code2,
            texts1=self._nodes1.texts,
            texts2=self._nodes2.texts,
            n_selves=self._n_selves,
            self_line=self._self_line,
            notes=("dates by ISO 8601, counted from 1970 UTC",) if has_dates else (),
            lacks_zone=self._lacks_zone or any(reader.lacks_zone for reader in instants),
        )

    def _take(self, columns: Mapping[Role, Any], n_before: int) -> None:
        wrong: dict[int, str] = {}
        read = {role: self._times(role, columns[role], wrong) for role in self._layout.unit}
        start = read.get(Role.START, read.get(Role.INSTANT))
        assert start is not None  # a layout has times
        end = start + read[Role.DURATION] if Role.DURATION in read else read.get(Role.END, start)
        code1, code2 = (self._codes(columns[role], table) for table, role in ((self._nodes1, Role.ID1), (self._nodes2, Role.ID2)))
        for role, code in ((Role.ID1, code1), (Role.ID2, code2)):
            for place in np.flatnonzero(code < 0).tolist():
                wrong.setdefault(place, f"{self._layout.name[role]} is empty; wanted an id")
        for place in np.flatnonzero(end < start).tolist():
            if Role.DURATION in read:
                reason = f"{self._layout.name[Role.DURATION]} is below 0; wanted 0 or more"
            else:
                reason = f"{self._layout.name[Role.END]} is before {self._layout.name[Role.START]}"
            wrong.setdefault(place, reason)
        selves = np.flatnonzero((code1 == code2) & (code1 >= 0)) if not self._layout.is_place else np.zeros(0, dtype=np.int64)
        if self._layout.is_own:
            for place in selves.tolist():
                wrong.setdefault(place, "id1 and id2 are the same; an encounter has two biobots")
        elif len(selves):
            self._n_selves += len(selves)
            self._self_line = self._self_line or n_before + int(selves[0]) + 1
        for place in sorted(wrong):
            self._faults.add(n_before + place + 1, wrong[place], what="row")
        if not self._faults.count:
            kept = np.delete(np.arange(len(start)), selves)
            self._pieces.add(start[kept], end[kept], code1[kept], code2[kept])

    def _times(self, role: Role, column: Any, wrong: dict[int, str]) -> IntArray:
        """Return times [ns]; whole numbers and instants exactly, floats to the nearest."""
        types, kind, name = self._arrow.types, column.type, self._layout.name[role]
        if types.is_dictionary(kind):
            column = column.dictionary_decode()
            kind = column.type
        if types.is_string(kind) or types.is_large_string(kind) or types.is_decimal(kind):
            texts = ["" if value is None else str(value) for value in column.to_pylist()]
            values, faults = self._texts[role].read(texts)
            wrong.update({place: reason for place, reason in faults.items() if place not in wrong})
            return values
        is_missing = np.asarray(column.is_null())
        unit_ns = self._layout.unit[role].nanoseconds
        if types.is_timestamp(kind) or types.is_date(kind):
            self._has_dates = True
            self._lacks_zone = self._lacks_zone or not types.is_timestamp(kind) or kind.tz is None
            column = column.cast(self._arrow.timestamp("ns"), safe=False).cast(self._arrow.int64())
        elif types.is_duration(kind):
            column = column.cast(self._arrow.duration("ns"), safe=False).cast(self._arrow.int64())
        elif not (types.is_integer(kind) or types.is_floating(kind)):
            raise InputFileError(path=self._path, faults=[f"schema: {name} is of type {kind}; wanted numbers, timestamps, or text"])
        filled = column.fill_null(0).to_numpy(zero_copy_only=False)
        seconds = filled.astype(np.float64) * (unit_ns / NS_PER_S)
        is_wrong = is_missing | ~(np.abs(seconds) <= MAX_TIME_NS / NS_PER_S) | (seconds < MIN_TIME_NS / NS_PER_S)
        for place in np.flatnonzero(is_wrong).tolist():
            text = "empty" if is_missing[place] else f"{shown(str(filled[place]))} {self._layout.unit[role]}"
            limits = f"{MIN_TIME_NS // NS_PER_S} to {MAX_TIME_NS // NS_PER_S}"
            wrong.setdefault(place, f"{name} is {text}; wanted seconds from {limits}; if the unit is another: --time-unit ms")
        filled = np.where(is_wrong, filled.dtype.type(0), filled)
        if filled.dtype.kind in "iu":
            return np.asarray(filled.astype(np.int64) * unit_ns, dtype=np.int64)
        # The decimal number that the float stands for: 0.1 s is 100,000,000 ns.
        return np.asarray(np.rint(filled.astype(np.float64) * unit_ns), dtype=np.int64)

    def _codes(self, column: Any, table: NodeTable) -> IntArray:
        encoded = column if self._arrow.types.is_dictionary(column.type) else column.dictionary_encode()
        codes = np.array(table.codes(_texts_of(encoded.dictionary.to_pylist())), dtype=np.int64)
        places = encoded.indices.fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int64)
        # A place of -1 reads the last: the code that is appended, of an empty id.
        return np.asarray(np.append(codes, -1)[places], dtype=np.int64)


def _texts_of(values: Sequence[object]) -> list[str]:
    """Write ids; a float that is whole, as tables make of numbers with gaps, is the number. What is missing is empty."""
    texts = []
    for value in values:
        if isinstance(value, float):
            texts.append("" if isnan(value) else str(int(value)) if value.is_integer() else str(value))
        else:
            texts.append("" if value is None else str(value))
    return texts
