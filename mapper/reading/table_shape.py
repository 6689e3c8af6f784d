"""How a text is parted into rows and fields: its delimiter, its comments, and whether it has a header."""

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from mapper.errors import InputFileError
from mapper.reading.column_names import Layout, UnknownColumnsError, find_layout, number_layout
from mapper.reading.options import ReadingOptions, Role

_DELIMITERS = (",", ";", "\t", "|", None)
"""None: blanks, any number of them."""
_MARKS_OF_COMMENTS = (b"#", b"%")
_SAMPLED_ROWS = 1_000
# Instants, two ids, and perhaps a word on each: as SocioPatterns publishes its contacts.
_WIDTHS_OF_INSTANTS = (3, 5)
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?", re.ASCII)
_LINE_END = re.compile(rb"\r\n?|\n")
_SIGNS_OF_AN_OPEN_QUOTE = ("field limit", "end of data")

Record = tuple[int, list[str]]
"""Number of the line at which a row begins, counted from 1, and its fields."""


class NoRowError(ValueError):
    """The text is no table from here on; ``line`` says where."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line = line


@dataclass(frozen=True, slots=True, kw_only=True)
class TableShape:
    """``begin``: the byte at which the rows begin; ``first_line``: the number of its line."""

    delimiter: str | None
    layout: Layout
    begin: int
    first_line: int
    has_header: bool


def find_shape(path: str, data: bytes, options: ReadingOptions) -> TableShape:
    """Tell how a text is parted.

    Raises
    ------
    InputFileError
        It is empty, or its columns cannot be told.
    """
    begin, line, comment = _skip_comments(data)
    if comment is not None and (from_comment := _header_in(comment, options)) is not None:
        delimiter, layout = from_comment
        return TableShape(delimiter=delimiter, layout=layout, begin=begin, first_line=line, has_header=True)
    firsts = {delimiter: _first_record(data, begin, line, delimiter) for delimiter in _DELIMITERS}
    if firsts[","] is None:
        raise InputFileError(path=path, faults=["line 1: the file is empty; wanted a header, as t_start_s,t_end_s,id1,id2, and rows"])
    problems: list[tuple[int, str]] = []
    for delimiter, first in firsts.items():
        if isinstance(first, NoRowError) or first is None:
            problems.append((-1, str(first)))
            continue
        names, n_bytes, n_lines = first
        try:
            layout = number_layout(names, options.columns) if _are_numbers(options) else find_layout(names, options)
            if _are_numbers(options) and _begins_with_times(names, layout):
                return TableShape(delimiter=delimiter, layout=layout, begin=begin, first_line=line, has_header=False)
            return TableShape(delimiter=delimiter, layout=layout, begin=begin + n_bytes, first_line=line + n_lines, has_header=True)
        except UnknownColumnsError as error:
            problems.append((len(names), str(error)))
            if (layout_of_instants := _instants_without_header(data, begin, delimiter, names, options)) is not None:
                return TableShape(delimiter=delimiter, layout=layout_of_instants, begin=begin, first_line=line, has_header=False)
    width, problem = max(problems, key=lambda each: each[0])
    at = next((first.line for first in firsts.values() if isinstance(first, NoRowError)), line) if width < 0 else line
    raise InputFileError(path=path, faults=[f"line {at}: {problem}"])


def iterate_rows(data: bytes, shape: TableShape) -> Iterator[Record]:
    """Yield the rows that are not blank.

    Raises
    ------
    NoRowError
        A row is no CSV.
    """
    return _records(data, shape.begin, shape.first_line, shape.delimiter)


def _records(data: bytes, begin: int, first_line: int, delimiter: str | None) -> Iterator[Record]:
    stream = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", newline="")
    stream.seek(begin)
    if delimiter is None:
        for number, text in enumerate(stream, start=first_line):
            if fields := text.split():
                yield number, fields
        return
    reader = csv.reader(stream, delimiter=delimiter, strict=True)
    while True:
        line = first_line + reader.line_num
        try:
            record = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            hint = "; is a quote not closed?" if any(sign in str(error) for sign in _SIGNS_OF_AN_OPEN_QUOTE) else ""
            raise NoRowError(line, f"not a CSV row: {error}{hint}") from error
        if len(record) > 1 or (record and record[0].strip()):
            yield line, record


def _skip_comments(data: bytes) -> tuple[int, int, str | None]:
    """Return where the first line that is neither blank nor a comment begins, its number, and the last comment before it."""
    begin, line, comment = (3 if data.startswith(b"\xef\xbb\xbf") else 0), 1, None
    while begin < len(data):
        end = _line_end(data, begin)
        text = data[begin:end].strip()
        if text and not text.startswith(_MARKS_OF_COMMENTS):
            break
        comment = text.decode().lstrip("#% \t") if text else comment
        begin, line = end, line + 1
    return begin, line, comment


def _header_in(comment: str, options: ReadingOptions) -> tuple[str | None, Layout] | None:
    for delimiter in _DELIMITERS:
        names = comment.split(delimiter)
        try:
            return delimiter, find_layout(names, options)
        except UnknownColumnsError:
            continue
    return None


def _first_record(data: bytes, begin: int, line: int, delimiter: str | None) -> tuple[list[str], int, int] | NoRowError | None:
    """Return the first row, and how many bytes and lines it takes."""
    try:
        record = next(_records(data, begin, line, delimiter), None)
    except NoRowError as fault:
        return fault
    if record is None:
        return None
    # A quoted name may hold line ends: the row takes as many lines more.
    n_lines = record[0] - line + 1 + sum(field.count("\n") for field in record[1])
    end = begin
    for _ in range(n_lines):
        end = _line_end(data, end)
    return record[1], end - begin, n_lines


def _line_end(data: bytes, begin: int) -> int:
    match = _LINE_END.search(data, begin)
    return len(data) if match is None else match.end()


def _are_numbers(options: ReadingOptions) -> bool:
    return bool(options.columns) and all(column.isascii() and column.isdigit() for column in options.columns.values())


def _begins_with_times(first: Sequence[str], layout: Layout) -> bool:
    """Say whether the first row is one of data: its times begin with digits, or a sign."""
    place = layout.place.get(Role.START, layout.place.get(Role.INSTANT, 0))
    return first[place].strip()[:1] in set("0123456789+-.")


def _instants_without_header(
    data: bytes, begin: int, delimiter: str | None, names: Sequence[str], options: ReadingOptions
) -> Layout | None:
    """Tell rows ``t i j`` in the order of time: all three are numbers, the first never falls, and the third does."""
    if options.columns or len(names) not in _WIDTHS_OF_INSTANTS or not all(_NUMBER.fullmatch(name.strip()) for name in names[:3]):
        return None
    firsts, thirds = [], []
    try:
        for _, record in _records(data, begin, 1, delimiter):
            if len(record) != len(names) or not all(_NUMBER.fullmatch(field.strip()) for field in record[:3]):
                return None
            firsts.append(float(record[0]))
            thirds.append(float(record[2]))
            if len(firsts) == _SAMPLED_ROWS:
                break
    except NoRowError:
        return None
    never_falls = all(one <= other for one, other in pairwise(firsts))
    falls = any(one > other for one, other in pairwise(thirds))
    if not never_falls or not falls:
        return None
    return number_layout(names, {Role.INSTANT: "1", Role.ID1: "2", Role.ID2: "3"})
