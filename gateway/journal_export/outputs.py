"""Where an export may be written: nowhere that a journal, or another database, would be lost."""

import os
from pathlib import Path

from gateway.errors import ExportError

_DATABASE = b"SQLite format 3\0"
_BESIDE = ("-wal", "-shm", "-journal", ".lock")
"""Endings of the files that belong to a journal, beside it."""


def expect_output(path: Path, *, journal: Path) -> None:
    """See that an export to ``path`` writes over no journal, before anything is written.

    Raises
    ------
    ExportError
        It is the journal that is read, or a file that belongs to it, by whatever name; or it is a database.
    """
    for ending in ("", *_BESIDE):
        if _is_same(path, journal.with_name(journal.name + ending)):
            what = "is the journal itself" if not ending else f"belongs to the journal {journal}"
            raise ExportError(path=str(path), reason=f"{what}, which would be lost; name another file")
    if path.is_file() and _begins_as_database(path):
        raise ExportError(path=str(path), reason="is a database, maybe a journal, which would be lost; name another file, or remove it")


def _begins_as_database(path: Path) -> bool:
    try:
        with path.open("rb") as there:
            return there.read(len(_DATABASE)) == _DATABASE
    except OSError:
        return False  # what cannot be read is told when it cannot be written


def _is_same(one: Path, other: Path) -> bool:
    """Whether two names lead to one file, or to one place where none is yet."""
    try:
        return one.samefile(other)
    except OSError:
        return os.path.realpath(one) == os.path.realpath(other)
