"""Read encounters and mode spells from CSV files, and say exactly what is wrong with a bad one.

Columns are found by their names, in any order; further columns that the header names are left alone. A byte order mark, CRLF, quoted
fields, blank lines and spaces around a value are accepted. Times are decimal seconds and become whole nanoseconds without passing through
a float.

Files of encounters are read by the compiled library where it is there and every row is plain. Everything else, and whatever is wrong, is
read here row by row: the same table, and the words for what is wrong.
"""

import codecs
import csv
import io
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.own_files import HEAD_BYTES, tell_own_file
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.errors import InputFileError
from mapper.kernels import find_library, read_rows
from mapper.types import EncounterTable, IntArray, KernelsKind, ModeSpell
from mapper.window import make_encounter_table

ENCOUNTER_COLUMNS = ("t_start_s", "t_end_s", "id1", "id2")
MODE_COLUMNS = ("t_start_s", "t_end_s", "id", "mode", "cause")
JOURNAL_MODE_COLUMNS = ("start_wall_ns", "end_wall_ns", "node", "mode", "cause")
"""What ``biobot-gateway journal export --kind modes`` writes."""
_HALTED = "is_halted"  # written too, but by older gateways

MAX_FILE_BYTES = 2**30
"""A file is read whole."""
_MAX_ID = 2**63 - 1
# Sums of two instants, and a whole span in half nanoseconds, must fit 63 bits. Wall clocks since 1970 are near 1.8e9 s.
_MIN_TIME_S, _MAX_TIME_S = -300_000_000, 4_000_000_000
_SHOWN_LENGTH = 40
_PIECE_BYTES = 2**20
_STANDARD_INPUT = Path("/dev/stdin")
_SIGNS_OF_AN_OPEN_QUOTE = ("field limit", "end of data")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?", re.ASCII)
_WHOLE = re.compile(r"[0-9]{1,40}", re.ASCII)

RowT = TypeVar("RowT")
EnumT = TypeVar("EnumT", bound=Enum)


@dataclass(slots=True, kw_only=True)
class _Faults:
    """Faults of one file: the first ones in words, the others counted."""

    limit: int = 10
    shown: list[str] = field(default_factory=list)
    count: int = 0

    def add(self, line: int, reason: str) -> None:
        self.count += 1
        if len(self.shown) < self.limit:
            self.shown.append(f"line {line}: {reason}")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Layout:
    """Where in a row each column that is read stands, counted from 0, and how many columns the header names."""

    place: Mapping[str, int]
    n_columns: int


class _FieldError(ValueError):
    """A value in a row is not what its column wants."""


def read_encounters(path: Path, *, kernels: KernelsKind | None = None) -> EncounterTable:
    """Read a file with the columns ``t_start_s,t_end_s,id1,id2``; the name ``-`` is standard input.

    Parameters
    ----------
    kernels
        Whether the compiled library reads plain files; None takes it where it is. The table is the same, and so is every error.

    Raises
    ------
    InputFileError
        The file cannot be read, is no such CSV, or has bad rows; up to ten are listed with line and reason, and the rest counted.
    ConfigurationError, KernelsError
        As for `mapper.kernels.choose_kernels`.
    """
    start, end, id1, id2 = _read_columns(path, kernels)
    return make_encounter_table(t_start_ns=start, t_end_ns=end, id1=id1, id2=id2)


def read_modes(
    path: Path, *, number_of: Callable[[str], int | None] | None = None, time_of: Callable[[str, str], int] | None = None
) -> tuple[ModeSpell, ...]:
    """Read a file with the columns ``t_start_s,t_end_s,id,mode,cause``, or one that a gateway's journal was exported to.

    An empty end is a spell that lasts.

    Parameters
    ----------
    number_of
        Gives the number of an id where ids are names; spells of ids that have none are left out. None takes whole numbers alone.
    time_of
        Gives the time [ns] of the name of a column and its text, or a ValueError that says what is wrong. None takes seconds alone.

    Raises
    ------
    InputFileError
        As for `read_encounters`.
    """
    data = read_bytes(path)
    names = _header_names(data)
    if names.issuperset(JOURNAL_MODE_COLUMNS) and not names.issuperset(MODE_COLUMNS):
        columns = (*JOURNAL_MODE_COLUMNS, _HALTED) if _HALTED in names else JOURNAL_MODE_COLUMNS
        spells = _read_rows(path, data, columns=columns, parse=partial(_parse_journal_spell, number_of=number_of))
    else:
        spells = _read_rows(path, data, columns=MODE_COLUMNS, parse=partial(_parse_spell, number_of=number_of, time_of=time_of))
    return tuple(spell for spell in spells if spell is not None)


def read_bytes(path: Path) -> bytes:
    """Read a file whole; the name ``-`` is standard input.

    Raises
    ------
    InputFileError
        It cannot be read, or is longer than ``MAX_FILE_BYTES``.
    """
    try:
        with (_STANDARD_INPUT if path == Path("-") else path).open("rb") as file:
            status = os.fstat(file.fileno())
            is_regular = stat.S_ISREG(status.st_mode)
            is_too_long = is_regular and status.st_size > MAX_FILE_BYTES
            # A number of bytes to read takes room for all of them first, so it is given where the size is not known alone.
            data = b"" if is_too_long else file.read(-1 if is_regular else MAX_FILE_BYTES + 1)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        of_run = path / "encounters.csv"
        wanted = str(of_run) if isinstance(error, IsADirectoryError) and of_run.is_file() else "the path of a CSV file"
        raise InputFileError(path=str(path), faults=[f"cannot be read: {reason}; give {wanted}"]) from error
    except ValueError as error:
        raise InputFileError(path=repr(str(path)), faults=[f"cannot be read: {error}"]) from error
    if is_too_long or len(data) > MAX_FILE_BYTES:
        raise InputFileError(path=str(path), faults=[f"is longer than {MAX_FILE_BYTES} bytes; split it by time"])
    own = tell_own_file(data[:HEAD_BYTES])
    if own is not None and not own.is_table:
        raise InputFileError(path=str(path), faults=[f"is {own.what}: {own.use}; wanted is a table of contacts"])
    return data


def check_text(path: Path, data: bytes) -> None:
    """See that a file is UTF-8 without NUL.

    Raises
    ------
    InputFileError
        It is something else; the line is named.
    """
    if not _is_text(data):
        _decode(path, data)


def _read_columns(path: Path, kernels: KernelsKind | None) -> tuple[IntArray, ...]:
    data = read_bytes(path)
    columns = _read_plain_rows(path, data, kernels)
    if columns is None:
        rows = _read_rows(path, data, columns=ENCOUNTER_COLUMNS, parse=_parse_encounter)
        columns = tuple(np.array(rows, dtype=np.int64).reshape(-1, 4).T)
    return columns


def _read_plain_rows(path: Path, data: bytes, kernels: KernelsKind | None) -> tuple[IntArray, ...] | None:
    """Read start, end [ns] and ids by the compiled library; None where it is not there or anything is out of the ordinary."""
    library = find_library(kernels)
    begin = data.find(b"\n") + 1
    if library is None or begin == 0 or not _is_text(data):
        return None
    faults = _Faults()
    header = list(_records(data[:begin].decode("utf-8-sig"), faults))
    if faults.count or len(header) != 1:
        return None
    layout = _find_columns(path, header[0], columns=ENCOUNTER_COLUMNS, faults=faults)
    places = tuple(layout.place.values())
    return read_rows(library, data, begin=begin, places=places, n_columns=layout.n_columns, longest_field=csv.field_size_limit())


def _is_text(data: bytes) -> bool:
    """Say whether a file is UTF-8 without NUL, with no copy of all of it."""
    if b"\0" in data:
        return False
    if data.isascii():
        return True
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        for begin in range(0, len(data), _PIECE_BYTES):
            decoder.decode(data[begin : begin + _PIECE_BYTES])
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return False
    return True


def _read_rows(path: Path, data: bytes, *, columns: Sequence[str], parse: Callable[[Mapping[str, str]], RowT]) -> list[RowT]:
    faults = _Faults()
    parsed: list[RowT] = []
    records = _records(_decode(path, data), faults)
    layout = _find_columns(path, next(records, None), columns=columns, faults=faults)
    for line, record in records:
        try:
            parsed.append(parse(_pick_fields(record, layout)))
        except _FieldError as error:
            faults.add(line, str(error))
    if faults.count:
        raise InputFileError(path=str(path), faults=faults.shown, n_faults=faults.count)
    return parsed


def _decode(path: Path, data: bytes) -> str:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        remedy = "is this a CSV file?"
        if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            remedy = "it begins as UTF-16 does: iconv -f UTF-16 -t UTF-8"
        elif b"\0" not in data:
            remedy += " If so, save it as UTF-8: iconv -f LATIN1 -t UTF-8"
        reason = f"line {line}: byte 0x{data[error.start]:02x} is not UTF-8 text; {remedy}"
        raise InputFileError(path=str(path), faults=[reason]) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputFileError(path=str(path), faults=[f"line {line}: a NUL byte; is this a CSV file?"])
    return text


def _records(text: str, faults: _Faults) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and fields of every row that is not blank; a row that is no CSV ends the file with a fault."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    while True:
        line = reader.line_num + 1
        try:
            record = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            hint = "; is a quote not closed?" if any(sign in str(error) for sign in _SIGNS_OF_AN_OPEN_QUOTE) else ""
            faults.add(line, f"not a CSV row: {error}{hint}")
            return
        if len(record) > 1 or (record and record[0].strip()):
            yield line, record


def _find_columns(path: Path, header: tuple[int, list[str]] | None, *, columns: Sequence[str], faults: _Faults) -> _Layout:
    wanted = ",".join(columns)
    if header is None:
        reason = faults.shown[0] if faults.count else f"line 1: the file is empty; wanted the header {wanted}"
        raise InputFileError(path=str(path), faults=[reason])
    line, record = header
    names = [name.strip() for name in record]
    missing = [name for name in columns if name not in names]
    repeated = [name for name in columns if names.count(name) > 1]
    if missing:
        raise InputFileError(
            path=str(path), faults=[f"line {line}: the header {_shown(','.join(names))} lacks {', '.join(missing)}; wanted {wanted}"]
        )
    if repeated:
        raise InputFileError(path=str(path), faults=[f"line {line}: the header names {', '.join(repeated)} twice; wanted {wanted}"])
    return _Layout(place={name: names.index(name) for name in columns}, n_columns=len(names))


def _pick_fields(record: Sequence[str], layout: _Layout) -> dict[str, str]:
    missing = [name for name, index in layout.place.items() if index >= len(record)]
    if missing:
        raise _FieldError(f"{len(record)} fields, so {', '.join(missing)} is missing; wanted {','.join(layout.place)}")
    if len(record) > layout.n_columns:
        raise _FieldError(f"{len(record)} fields, but the header names {layout.n_columns}; is the decimal sign a comma?")
    return {name: record[index].strip() for name, index in layout.place.items()}


def _parse_encounter(row: Mapping[str, str]) -> tuple[int, int, int, int]:
    start, end = _time_ns(row, "t_start_s"), _time_ns(row, "t_end_s")
    first, second = _node(row, "id1"), _node(row, "id2")
    if end < start:
        raise _FieldError(f"t_end_s {row['t_end_s']} is before t_start_s {row['t_start_s']}")
    if first == second:
        raise _FieldError(f"id1 and id2 are both {first}; an encounter has two biobots")
    return start, end, first, second


def _parse_spell(
    row: Mapping[str, str], *, number_of: Callable[[str], int | None] | None, time_of: Callable[[str, str], int] | None
) -> ModeSpell | None:
    start = _time_ns(row, "t_start_s", time_of)
    end = _time_ns(row, "t_end_s", time_of) if row["t_end_s"] else None
    if end is not None and end < start:
        raise _FieldError(f"t_end_s {row['t_end_s']} is before t_start_s {row['t_start_s']}")
    node = _node(row, "id") if number_of is None else number_of(row["id"])
    mode, cause = _member(row, "mode", Mode), _member(row, "cause", Cause)
    if node is None:
        return None
    return ModeSpell(node=NodeId(node), t_start_ns=start, t_end_ns=end, mode=mode, cause=cause)


def _parse_journal_spell(row: Mapping[str, str], *, number_of: Callable[[str], int | None] | None) -> ModeSpell | None:
    times = {name: row[name] if name != "end_wall_ns" or row[name] else row["start_wall_ns"] for name in ("start_wall_ns", "end_wall_ns")}
    for name, text in times.items():
        if not _WHOLE.fullmatch(text) or int(text) > _MAX_TIME_S * NS_PER_S:
            raise _FieldError(f"{name} is {_shown(text)}; wanted nanoseconds since 1970")
    start, end = (int(text) for text in times.values())
    if end < start:
        raise _FieldError(f"end_wall_ns {end} is before start_wall_ns {start}")
    node = _node(row, "node") if number_of is None else number_of(row["node"])
    mode, cause = _member(row, "mode", Mode), _member(row, "cause", Cause)
    halted = row.get(_HALTED, "false")
    if halted not in {"true", "false"}:
        raise _FieldError(f"{_HALTED} is {_shown(halted)}; wanted true or false")
    if node is None:
        return None
    # As in `mapper.mode_spells`: who stands because all were stopped is no landmark.
    cause = Cause.NATURAL if halted == "true" and mode is Mode.S else cause
    return ModeSpell(node=NodeId(node), t_start_ns=start, t_end_ns=end if row["end_wall_ns"] else None, mode=mode, cause=cause)


def _header_names(data: bytes) -> set[str]:
    header = data.partition(b"\n")[0].decode("utf-8-sig", errors="replace")
    return {name.strip().strip('"') for name in header.split(",")}


def _time_ns(row: Mapping[str, str], name: str, time_of: Callable[[str, str], int] | None = None) -> int:
    text = row[name]
    if time_of is not None:
        try:
            return time_of(name, text)
        except ValueError as error:
            raise _FieldError(str(error)) from error
    if not text:
        raise _FieldError(f"{name} is empty; wanted seconds, as 12.5")
    if not _DECIMAL.fullmatch(text):
        raise _FieldError(f"{name} is {_shown(text)}; wanted a finite number of seconds, as 12.5")
    seconds = Decimal(text)
    if not _MIN_TIME_S <= seconds <= _MAX_TIME_S:
        raise _FieldError(f"{name} is {_shown(text)}; wanted seconds from {_MIN_TIME_S} to {_MAX_TIME_S}; is the unit milliseconds?")
    return round(seconds * NS_PER_S)


def _node(row: Mapping[str, str], name: str) -> int:
    text = row[name]
    if not _WHOLE.fullmatch(text) or int(text) > _MAX_ID:
        raise _FieldError(f"{name} is {_shown(text)}; wanted a whole number from 0 to 2^63-1")
    return int(text)


def _member(row: Mapping[str, str], name: str, kind: type[EnumT]) -> EnumT:
    try:
        return kind(row[name])
    except ValueError as error:
        raise _FieldError(f"{name} is {_shown(row[name])}; wanted {' or '.join(str(member.value) for member in kind)}") from error


def _shown(text: str) -> str:
    return repr(text if len(text) <= _SHOWN_LENGTH else text[: _SHOWN_LENGTH - 3] + "...")
