"""The file of tokens: read whole, changed under a lock, and replaced whole, so that neither a kill nor a full disk leaves half of one.

It is JSON, for its owner alone. The command line and the service may change it at the same time: who changes it holds the lock of its
folder, reads it anew, and puts the new one in its place.
"""

import fcntl
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from firmware_protocol.own_files import HEAD_BYTES, TOKENS, tell_own_file
from mapper.access.errors import TokenFileError
from mapper.access.tokens import TokenRecord

MAX_BYTES: Final = 4 * 2**20
MAX_VALID: Final = 1000
_MAX_REVOKED: Final = 1000

_ResultT = TypeVar("_ResultT")
Records = tuple[TokenRecord, ...]


class _Document(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    format: int
    tokens: Records


_FORMAT: Final = 1
_decoder = msgspec.json.Decoder(_Document)


def read_tokens(path: Path) -> Records | None:
    """Read the tokens; None: there is no such file.

    Raises
    ------
    TokenFileError
        It cannot be read, others may read it, or it is damaged.
    """
    try:
        with path.open("rb") as file:
            facts = os.fstat(file.fileno())
            if not stat.S_ISREG(facts.st_mode):
                raise TokenFileError(path=str(path), reason="is no file", next_step="name one in serve.tokens")
            content = file.read(MAX_BYTES + 1)
            own = tell_own_file(content[:HEAD_BYTES])
            if own is not None and own is not TOKENS:
                raise TokenFileError(path=str(path), reason=f"is {own.what}: {own.use}", next_step="name another file")
            if mode := stat.S_IMODE(facts.st_mode) & 0o077:
                allowed = f"others than its owner may use it (mode {stat.S_IMODE(facts.st_mode):04o}, {mode:03o} too much)"
                raise TokenFileError(path=str(path), reason=allowed, next_step=f"chmod 600 {path}, and revoke tokens that you do not know")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise TokenFileError(path=str(path), reason=_told(error), next_step="let the user of the service read it") from error
    return _decode(path, content)


def change_tokens(path: Path, change: Callable[[Records], tuple[Records, _ResultT]]) -> _ResultT:
    """Change the tokens: nobody else does meanwhile. A file that is not there has none. Where nothing changes, nothing is written.

    Raises
    ------
    TokenFileError
        It cannot be read or written; it is as it was then.
    """
    with _locked(path):
        before = read_tokens(path)
        after, result = change(before or ())
        if after != before:
            _write(path, msgspec.json.format(msgspec.json.encode(_Document(format=_FORMAT, tokens=_bounded(after))), indent=1) + b"\n")
    return result


def write_secret(path: Path, text: str) -> None:
    """Write a token where its holder will find it: for the owner alone, whole or not at all.

    Raises
    ------
    TokenFileError
        It cannot be written.
    """
    _write(path, text.encode() + b"\n")


def _decode(path: Path, content: bytes) -> Records:
    try:
        document = _decoder.decode(content)
        problem = f"is of format {document.format}, but this version reads {_FORMAT}" if document.format != _FORMAT else ""
        if not problem and len({record.id for record in document.tokens}) < len(document.tokens):
            problem = "has two tokens of one id"
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        problem = f"is damaged: {error}"
    if problem:
        raise TokenFileError(path=str(path), reason=problem, next_step="restore it from a copy, or move it away and make new tokens")
    return document.tokens


def _bounded(records: Records) -> Records:
    """Leave out the revoked ones that were made first, beyond a thousand."""
    n_over = sum(not record.is_valid for record in records) - _MAX_REVOKED
    kept = []
    for record in records:
        if n_over > 0 and not record.is_valid:
            n_over -= 1
        else:
            kept.append(record)
    return tuple(kept)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of the file's folder: it needs no file of its own, which could belong to somebody else."""
    try:
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise TokenFileError(path=str(path), reason=f"its folder: {_told(error)}", next_step="make the folder first") from error
    try:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
        except OSError as error:
            raise TokenFileError(
                path=str(path), reason=f"its folder: {_told(error)}", next_step="keep it on a disk of this machine"
            ) from error
        yield
    finally:
        os.close(folder)


def _write(path: Path, content: bytes) -> None:
    partial = path.with_name(f".{path.name}.part")
    try:
        try:
            partial.unlink(missing_ok=True)  # of one that was killed
            # Not through a link that somebody put there, and never open to others, not for a moment.
            descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
            with os.fdopen(descriptor, "wb") as file:
                _keep_owner(file.fileno(), path)
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
            _sync_folder(path.parent)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise TokenFileError(
            path=str(path), reason=f"cannot be written: {_told(error)}", next_step="make room, or name another place"
        ) from error


def _keep_owner(descriptor: int, path: Path) -> None:
    """Have a file that root writes belong to whom the old one belonged to, or the folder: the service must read it."""
    if os.geteuid() != 0:
        return
    facts = path.stat() if path.exists() else path.parent.stat()
    os.fchown(descriptor, facts.st_uid, facts.st_gid)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _told(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
