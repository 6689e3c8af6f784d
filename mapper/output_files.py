"""Where results go: files that appear whole or not at all, pipes and devices, and standard output.

A file is written beside the one it replaces and renamed when it is complete, so a full disk or a crash leaves the old one as it was. Where
the directory cannot be written to, but a file in it can, that file is written in place.
"""

import os
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from secrets import token_hex

from mapper.errors import OutputFileError

_DATABASE = b"SQLite format 3\0"

STANDARD = Path("-")
"""This name means standard output for a result, and standard input for a file that is read."""


def is_standard_output(path: Path) -> bool:
    """Say whether a result of this name goes where standard output does: ``-``, ``/dev/stdout``, or the file that it is redirected to."""
    if path == STANDARD:
        return True
    try:
        return os.path.samestat(path.stat(), os.fstat(1))
    except (OSError, ValueError):
        return False


def check_outputs(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """See that results can be written, before any is computed.

    Raises
    ------
    OutputFileError
        A result would replace an input or another result, or its directory is missing or cannot be written to.
    """
    read = {_real(path) for path in inputs if path != STANDARD}
    for number, path in enumerate(outputs):
        earlier = outputs[:number]
        if is_standard_output(path):
            if any(map(is_standard_output, earlier)):
                raise OutputFileError(path=str(path), reason="standard output is named for two outputs")
            continue
        if _real(path) in read or any(_is_same_file(path, one) for one in read):
            raise OutputFileError(path=str(path), reason="is also an input; it would be overwritten")
        if path.is_file() and _begins_as_database(path):
            raise OutputFileError(path=str(path), reason="is a database, maybe a store or a journal, which would be lost")
        if any(_real(path) == _real(other) for other in earlier if other != STANDARD):
            raise OutputFileError(path=str(path), reason="is named for two outputs")
        _check_place(path)


def write_output(path: Path, content: bytes) -> None:
    """Write a result where `check_outputs` found that it can be.

    Raises
    ------
    OutputFileError
        It cannot be after all; a file that was there is as it was.
    """
    if is_standard_output(path):
        sys.stdout.flush()
        sys.stdout.buffer.write(content)
        return
    try:
        if _is_replaced(path):
            _replace(_real(path), content)
        else:
            path.write_bytes(content)
    except (OSError, ValueError) as error:
        raise OutputFileError(path=str(path), reason=_reason(error)) from error


def _check_place(path: Path) -> None:
    try:
        folder = _real(path).parent
        if path.is_dir():
            raise OutputFileError(path=str(path), reason="is a directory")
        if _real(path).is_symlink():
            raise OutputFileError(path=str(path), reason="its links lead in a circle")
        if not path.exists() and not folder.is_dir():
            raise OutputFileError(path=str(path), reason=f"there is no directory {folder}")
        # A pipe is not opened before there is something to write: that would wait for its reader.
        if not _is_replaced(path) and not os.access(path, os.W_OK):
            raise OutputFileError(path=str(path), reason=f"it, or the directory {folder}, cannot be written to")
    except (OSError, ValueError) as error:
        raise OutputFileError(path=str(path), reason=_reason(error)) from error


def _is_same_file(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)  # a hard link leads to it, too
    except OSError:
        return False


def _begins_as_database(path: Path) -> bool:
    try:
        with path.open("rb") as there:
            return there.read(len(_DATABASE)) == _DATABASE
    except OSError:
        return False  # one that may not be read may be replaced


def _is_replaced(path: Path) -> bool:
    """Say whether a name is of a file, or of nothing yet, and can be replaced; those of open files under /dev and /proc cannot."""
    if path.absolute().parts[:2] in {(os.sep, "dev"), (os.sep, "proc")} or (path.exists() and not path.is_file()):
        return False
    return os.access(_real(path).parent, os.W_OK | os.X_OK)


def _replace(path: Path, content: bytes) -> None:
    fresh = path.with_name(f".biobot-{token_hex(8)}.part")
    try:
        with fresh.open("xb") as file:
            file.write(content)
            if path.exists():
                os.fchmod(file.fileno(), stat.S_IMODE(path.stat().st_mode))
            os.fsync(file.fileno())
        fresh.replace(path)
    except BaseException:
        fresh.unlink(missing_ok=True)
        raise


def _real(path: Path) -> Path:
    """Return what a name leads to, links followed: they stay when the file is replaced. Links in a circle are no error here."""
    return Path(os.path.realpath(path))


def _reason(error: OSError | ValueError) -> str:
    return (error.strerror or str(error)).lower() if isinstance(error, OSError) else str(error)
