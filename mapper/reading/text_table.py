"""Rows of a text to contacts: quickly by the compiled library where all is plain, else piece by piece, with words for what is wrong."""

import csv
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from operator import itemgetter

import numpy as np

from mapper.errors import InputFileError
from mapper.kernels import find_library, read_rows
from mapper.reading.column_names import Layout
from mapper.reading.node_names import NodeTable
from mapper.reading.options import ReadingOptions, Role, TimeUnit
from mapper.reading.raw_log import Faults, Pieces, RawLog
from mapper.reading.table_shape import NoRowError, Record, TableShape, find_shape, iterate_rows
from mapper.reading.values import TimeReader, shown
from mapper.types import IntArray, KernelsKind

_ROWS_A_PIECE = 50_000
_KINDS = {",": "CSV", ";": "CSV with semicolons", "\t": "TSV", "|": "table with bars", None: "table with blanks"}


def read_text_table(path: str, data: bytes, options: ReadingOptions, *, kernels: KernelsKind | None) -> RawLog:
    """Read a text, which is UTF-8 without NUL.

    Raises
    ------
    InputFileError
        Its columns cannot be told, or rows are wrong; up to ten are listed with line and reason, and the rest counted.
    ConfigurationError, KernelsError
        As for `mapper.kernels.choose_kernels`.
    """
    shape = find_shape(path, data, options)
    shape = replace(shape, layout=replace(shape.layout, unit=_units(path, shape, options)))
    quick = _read_plainly(data, shape, kernels)
    return quick if quick is not None else _Reading(path, shape).read(data)


def _units(path: str, shape: TableShape, options: ReadingOptions) -> dict[Role, TimeUnit]:
    """Say in what every time is: what its name states, else what was said, else seconds."""
    units: dict[Role, TimeUnit] = {}
    for role in (Role.START, Role.END, Role.INSTANT, Role.DURATION):
        if role not in shape.layout.place:
            continue
        stated = shape.layout.unit.get(role)
        if stated is not None and options.time_unit not in {None, stated} and role is not Role.DURATION:
            reason = f"column {shape.layout.name[role]} states {stated}, but --time-unit {options.time_unit} was given; leave it out"
            raise InputFileError(path=path, faults=[f"line {shape.first_line - 1}: {reason}"])
        units[role] = stated or options.time_unit or TimeUnit.SECONDS
    return units


def _read_plainly(data: bytes, shape: TableShape, kernels: KernelsKind | None) -> RawLog | None:
    """Read rows of seconds and whole numbers by the compiled library; None where it is not there or anything is out of the ordinary."""
    layout = shape.layout
    library = find_library(kernels)
    if library is None or Role.DURATION in layout.place or layout.is_place or set(layout.unit.values()) != {TimeUnit.SECONDS}:
        return None
    delimiter = " " if shape.delimiter is None else shape.delimiter
    begin = shape.begin
    if delimiter != ",":
        if b"," in data or b'"' in data or (shape.delimiter is None and b"\t" in data):
            return None
        data = data[begin:].translate(bytes.maketrans(delimiter.encode(), b","))
        begin = 0
    start = layout.place.get(Role.START, layout.place.get(Role.INSTANT, 0))
    places = (start, layout.place.get(Role.END, start), layout.place[Role.ID1], layout.place[Role.ID2])
    rows = read_rows(library, data, begin=begin, places=places, n_columns=layout.n_columns, longest_field=csv.field_size_limit())
    if rows is None:
        return None
    t_start_ns, t_end_ns, id1, id2 = rows
    return RawLog(kind=_KINDS[shape.delimiter], layout=layout, start_ns=t_start_ns, end_ns=t_end_ns, code1=id1, code2=id2)


class _Reading:
    """One text being read."""

    def __init__(self, path: str, shape: TableShape) -> None:
        self._path, self._shape, self._layout = path, shape, shape.layout
        layout = shape.layout
        takes_comma = shape.delimiter != ","
        self._times = {
            role: TimeReader(layout.name[role], unit=unit, takes_comma=takes_comma, is_duration=role is Role.DURATION)
            for role, unit in layout.unit.items()
        }
        self._nodes1 = NodeTable()
        self._nodes2 = NodeTable() if layout.is_place else self._nodes1
        self._faults, self._pieces = Faults(), Pieces()
        self._n_selves = 0
        self._self_line: int | None = None
        self._pick = itemgetter(*layout.place.values())
        self._n_needed = max(layout.place.values()) + 1

    def read(self, data: bytes) -> RawLog:
        rows = iterate_rows(data, self._shape)
        try:
            while piece := list(islice(rows, _ROWS_A_PIECE)):
                self._take(piece)
        except NoRowError as fault:
            self._faults.add(fault.line, str(fault))
        if self._faults.count:
            raise InputFileError(path=self._path, faults=self._faults.shown, n_faults=self._faults.count)
        start, end, code1, code2 = self._pieces.join()
        instants = [times for role, times in self._times.items() if role is not Role.DURATION]
        if any(times.has_zone for times in instants) and any(times.lacks_zone for times in instants):
            reason = "some dates have a time zone and others have none, so how they lie to each other is not known; give all of them one"
            raise InputFileError(path=self._path, faults=[reason])
        return RawLog(
            kind=_KINDS[self._shape.delimiter],
            layout=self._layout,
            start_ns=start,
            end_ns=end,
            code1=code1,
            code2=code2,
            texts1=self._nodes1.texts,
            texts2=self._nodes2.texts,
            n_selves=self._n_selves,
            self_line=self._self_line,
            notes=self._notes(instants),
            lacks_zone=any(times.lacks_zone for times in instants),
        )

    def _take(self, piece: Sequence[Record]) -> None:
        rows, wrong = self._whole_rows(piece)
        if rows:
            lines = [line for line, _ in rows]
            columns = dict(zip(self._layout.place, zip(*(self._pick(record) for _, record in rows), strict=True), strict=True))
            start, end = self._read_times(columns, lines, wrong)
            code1, code2 = (
                np.array(table.codes(columns[role]), dtype=np.int64) for table, role in ((self._nodes1, Role.ID1), (self._nodes2, Role.ID2))
            )
            self._judge(columns, lines, (start, end, code1, code2), wrong)
        for line in sorted(wrong):
            self._faults.add(line, wrong[line])

    def _whole_rows(self, piece: Sequence[Record]) -> tuple[Sequence[Record], dict[int, str]]:
        n_columns = self._layout.n_columns
        wrong: dict[int, str] = {}
        if all(self._n_needed <= len(record) <= n_columns for _, record in piece):
            return piece, wrong
        whole = []
        for line, record in piece:
            if len(record) > n_columns:
                wrong[line] = f"{len(record)} fields, but the header names {n_columns}; is the decimal sign a comma?"
                if not self._shape.has_header:
                    wrong[line] = f"{len(record)} fields, but the first row has {n_columns}; wanted as many in every row"
            elif len(record) < self._n_needed:
                missing = [name for role, name in self._layout.name.items() if self._layout.place[role] >= len(record)]
                wrong[line] = f"{len(record)} fields, so {', '.join(missing)} is missing; wanted {','.join(self._layout.name.values())}"
            else:
                whole.append((line, record))
        return whole, wrong

    def _read_times(self, columns: dict[Role, tuple[str, ...]], lines: Sequence[int], wrong: dict[int, str]) -> tuple[IntArray, IntArray]:
        read = {}
        for role, reader in self._times.items():
            values, faults = reader.read(columns[role])
            read[role] = values
            for place, reason in faults.items():
                wrong.setdefault(lines[place], reason)
        start = read.get(Role.START, read.get(Role.INSTANT, np.zeros(0, dtype=np.int64)))
        if Role.DURATION in read:
            return start, start + read[Role.DURATION]
        return start, read.get(Role.END, start)

    def _judge(self, columns: dict[Role, tuple[str, ...]], lines: Sequence[int], read: tuple[IntArray, ...], wrong: dict[int, str]) -> None:
        """Note what is wrong with each row, and keep those that are good."""
        start, end, code1, code2 = read
        name = self._layout.name
        for place in np.flatnonzero(end < start).tolist():
            if Role.DURATION in columns:
                reason = f"{name[Role.DURATION]} is {shown(columns[Role.DURATION][place])}; wanted 0 or more"
            else:
                begun, ended = (columns[role][place].strip() for role in (Role.START, Role.END))
                reason = f"{name[Role.END]} {ended} is before {name[Role.START]} {begun}"
            wrong.setdefault(lines[place], reason)
        for role, code in ((Role.ID1, code1), (Role.ID2, code2)):
            for place in np.flatnonzero(code < 0).tolist():
                wrong.setdefault(lines[place], f"{name[role]} is empty; wanted an id")
        is_kept = np.ones(len(start), dtype=np.bool_)
        if not self._layout.is_place:
            selves = np.flatnonzero((code1 == code2) & (code1 >= 0))
            if self._layout.is_own:
                for place in selves.tolist():
                    reason = f"id1 and id2 are both {columns[Role.ID1][place].strip()}; an encounter has two biobots"
                    wrong.setdefault(lines[place], reason)
            elif len(selves):
                self._n_selves += len(selves)
                self._self_line = self._self_line or lines[int(selves[0])]
                is_kept[selves] = False
        if not self._faults.count and not wrong:
            self._pieces.add(start[is_kept], end[is_kept], code1[is_kept], code2[is_kept])

    def _notes(self, instants: Sequence[TimeReader]) -> tuple[str, ...]:
        notes = []
        if any(times.has_dates for times in instants):
            notes.append("dates by ISO 8601, counted from 1970 UTC")
        if any(times.has_comma for times in self._times.values()):
            notes.append("commas as decimal signs")
        return tuple(notes)


def describe_layout(layout: Layout) -> str:
    """Say which columns were taken for what."""
    units = {role: f" [{unit}]" for role, unit in layout.unit.items()}
    return ", ".join(f"{role} = {layout.name[role]}{units.get(role, '')}" for role in layout.place)
