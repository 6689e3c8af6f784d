"""The journal of a study: one JSON line for every case done, on disk before the next is taken in hand.

The first line says whose journal it is. A later line for the same case takes the place of an earlier one. A line cut short by a crash can
only be the last; it is removed when the journal is opened again.
"""

import fcntl
import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from studies.errors import JournalBusyError, JournalError

_KIND = "biobot cases 1"
# What msgspec raises of bytes that are no such JSON, are no UTF-8, or are nested too deep.
_UNREADABLE = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)


class Failure(msgspec.Struct, frozen=True, kw_only=True):
    """Why a case has no result: name and text of the exception, and where it was raised."""

    kind: str
    message: str
    traceback: str


class Entry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What is known of one case.

    Parameters
    ----------
    digest, key
        By what the case is known, short and in full.
    program
        Fingerprint of the program that computed it.
    seconds
        How long that took [s].
    result, failure
        One of them; a result as ``Study.pack`` wrote it.
    """

    digest: str
    program: str
    seconds: float
    key: Any = None
    result: Any = None
    failure: Failure | None = None


class _Header(msgspec.Struct, frozen=True):
    journal: str
    study: str


class Journal:
    """A journal on disk, or one that is kept nowhere. Use it as a context manager; only one process can have it open.

    Parameters
    ----------
    path
        The file, made where there is none; None keeps nothing.
    study
        Name of the study.

    Raises
    ------
    JournalError
        The file cannot be read or written, is no file or no journal, belongs to another study, or is damaged elsewhere than at its end.
    JournalBusyError
        Another process has it open.
    """

    def __init__(self, path: Path | None, *, study: str) -> None:
        self.path = path
        self.entries: dict[str, Entry] = {}
        self.has_torn_line = False
        self._file = None if path is None else _open_alone(path)
        if path is None or self._file is None:
            return
        try:
            self._take_up(path, study)
        except OSError as error:
            self._file.close()
            raise JournalError(path=path, problem=f"cannot be read: {error.strerror or error}") from error
        except BaseException:
            self._file.close()
            raise

    def append(self, entry: Entry) -> None:
        """Write a line down for good.

        Raises
        ------
        JournalError
            The disk is full or gone.
        """
        self.entries[entry.digest] = entry
        self._write(msgspec.json.encode(entry))

    def close(self) -> None:
        """Let others have it."""
        if self._file is not None:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def _take_up(self, path: Path, study: str) -> None:
        assert self._file is not None
        self._file.seek(0)
        content = self._file.read()
        header = msgspec.json.encode(_Header(_KIND, study))
        if header.startswith(content):  # new, or killed while it was begun
            self._truncate(0)
            self._write(header)
            _sync_directory(path.parent)
            return
        first, _, rest = content.partition(b"\n")
        _check_header(first, path=path, study=study)
        good = len(first) + 1
        *whole, _ = rest.split(b"\n")  # what follows the last line feed is nothing, or a line that was cut short
        for number, line in enumerate(whole, start=1):
            try:
                entry = msgspec.json.decode(line, type=Entry)
            except _UNREADABLE as error:
                if number < len(whole):
                    raise JournalError(path=path, problem=f"line {number + 1} is damaged ({error})") from error
                break
            self.entries[entry.digest] = entry
            good += len(line) + 1
        self.has_torn_line = good < len(content)
        if self.has_torn_line:
            self._truncate(good)

    def _truncate(self, size: int) -> None:
        assert self._file is not None
        self._file.truncate(size)
        os.fsync(self._file.fileno())

    def _write(self, line: bytes) -> None:
        if self._file is None or self.path is None:
            return
        try:
            left = memoryview(line + b"\n")
            while left:
                left = left[self._file.write(left) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            raise JournalError(path=self.path, problem=f"cannot be written: {error.strerror or error}") from error


def _open_alone(path: Path) -> Any:
    if path.exists() and not path.is_file():
        raise JournalError(path=path, problem="is no file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("a+b", buffering=0)
    except OSError as error:
        raise JournalError(path=path, problem=f"cannot be opened: {error.strerror or error}") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise JournalBusyError(path=path) from error
    return file


def _check_header(line: bytes, *, path: Path, study: str) -> None:
    try:
        found = msgspec.json.decode(line, type=_Header)
    except _UNREADABLE as error:
        raise JournalError(path=path, problem="is no journal of cases") from error
    if found.journal != _KIND:
        raise JournalError(path=path, problem=f"is of the kind {found.journal!r}, wanted {_KIND!r}")
    if found.study != study:
        raise JournalError(path=path, problem=f"belongs to the study {json.dumps(found.study)}, wanted {json.dumps(study)}")


def _sync_directory(path: Path) -> None:
    """Make a new file's name last, too."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
