"""Rows into a file: CSV, lines of JSON, or Parquet where pyarrow is installed; whole, or not at all."""

import contextlib
import csv
import importlib
import itertools
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from gateway.errors import ExportError
from gateway.journal_export.rows import Value

_ROWS_A_GROUP = 65_536


def write_csv(path: Path, columns: Mapping[str, type], rows: Iterable[tuple[Value, ...]]) -> int:
    """Write a CSV file with a head line; return the number of rows. Truth is ``true`` or ``false``; not known is empty.

    Raises
    ------
    ExportError
        The file cannot be written; what was there before is there still.
    """
    n_rows = 0
    with _whole(path) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for row in rows:
            writer.writerow([str(value).lower() if isinstance(value, bool) else value for value in row])
            n_rows += 1
    return n_rows


def write_json_lines(path: Path, rows: Iterable[Mapping[str, object]]) -> int:
    """Write one JSON object a line; return the number of rows. Raises as ``write_csv``."""
    n_rows = 0
    with _whole(path) as partial, partial.open("w", encoding="utf-8") as stream:
        for row in rows:
            stream.write(json.dumps(row) + "\n")
            n_rows += 1
    return n_rows


def write_parquet(path: Path, columns: Mapping[str, type], rows: Iterable[tuple[Value, ...]]) -> int:
    """Write a Parquet file, a group of rows at a time; return the number of rows.

    Raises
    ------
    ExportError
        pyarrow is not installed, or as ``write_csv``.
    """
    try:
        arrow: Any = importlib.import_module("pyarrow")
        parquet: Any = importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        reason = "pyarrow is not installed; `pip install 'biobot[parquet]'`, or write --csv"
        raise ExportError(path=str(path), reason=reason) from error
    types = {int: arrow.int64(), bool: arrow.bool_(), str: arrow.string()}
    schema = arrow.schema([(name, types[kind]) for name, kind in columns.items()])
    n_rows = 0
    source = iter(rows)
    with _whole(path) as partial, parquet.ParquetWriter(str(partial), schema, compression="zstd") as writer:
        while chunk := list(itertools.islice(source, _ROWS_A_GROUP)):
            arrays = [arrow.array(column, field.type) for column, field in zip(zip(*chunk, strict=True), schema, strict=True)]
            writer.write_table(arrow.Table.from_arrays(arrays, schema=schema))
            n_rows += len(chunk)
    return n_rows


@contextlib.contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Yield where to write; what was written there comes to ``path`` in one step if all went well, else it is gone."""
    partial = path.with_name(f".{path.name}.partial")
    if not path.parent.is_dir():
        reason = f"cannot be written: there is no directory {path.parent}; make it, or name another file"
        raise ExportError(path=str(path), reason=reason)
    try:
        yield partial
        with partial.open("rb") as written:
            os.fsync(written.fileno())
        partial.replace(path)
    except OSError as error:
        reason = f"cannot be written: {(error.strerror or str(error)).lower()}; make room, or name another file"
        raise ExportError(path=str(path), reason=reason) from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()
