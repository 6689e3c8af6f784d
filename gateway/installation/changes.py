"""Changes to a tree of files: each knows what it will do, does it at once or not at all, and can be taken back."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from gateway.errors import InstallationError


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeFolder:
    """A folder that is not there is made; what is above it is there."""

    path: PurePosixPath

    def __str__(self) -> str:
        """Say what is done."""
        return f"make folder {self.path}"


@dataclass(frozen=True, slots=True, kw_only=True)
class WriteFile:
    """A file comes to hold something, whatever is there now."""

    path: PurePosixPath
    content: bytes
    why: str = ""

    def __str__(self) -> str:
        """Say what is done."""
        return f"write {self.path}{f' ({self.why})' if self.why else ''}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A symbolic link leads somewhere."""

    path: PurePosixPath
    target: PurePosixPath

    def __str__(self) -> str:
        """Say what is done."""
        return f"link {self.path} to {self.target}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Remove:
    """A file or link is removed, or a folder with all that is in it."""

    path: PurePosixPath

    def __str__(self) -> str:
        """Say what is done."""
        return f"remove {self.path}"


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoveIfEmpty:
    """A folder is removed if nothing is left in it."""

    path: PurePosixPath

    def __str__(self) -> str:
        """Say what is done."""
        return f"remove {self.path} if it is empty"


Change = MakeFolder | WriteFile | Link | Remove | RemoveIfEmpty


class AppliedChanges:
    """Changes that were made below ``root``; what they replaced is kept in memory, but for whole folders, which are gone.

    Raises
    ------
    InstallationError
        A change could not be made, as with a full disk; those before it are taken back.
    """

    def __init__(self, changes: Sequence[Change], *, root: Path) -> None:
        self._root = root
        self._undo: list[tuple[Path, bytes | Path | None]] = []
        for change in changes:
            try:
                self._apply(change)
            except OSError as error:
                self.take_back()
                reason = (error.strerror or str(error)).lower()
                raise InstallationError(
                    what=f"cannot {change}", reason=reason, next_step="nothing was changed; make room, or look at its rights, and try again"
                ) from error

    def take_back(self) -> None:
        """Put back what was there before, the last change first."""
        while self._undo:
            path, before = self._undo.pop()
            with contextlib.suppress(OSError):
                if isinstance(before, bytes):
                    _write(path, before)
                elif isinstance(before, Path):
                    _link(path, before)
                elif path.is_dir() and not path.is_symlink():
                    path.rmdir()
                else:
                    path.unlink(missing_ok=True)

    def _apply(self, change: Change) -> None:
        path = self._root / change.path.relative_to("/")
        match change:
            case MakeFolder():
                path.mkdir(mode=0o755)
                self._undo.append((path, None))
            case WriteFile():
                before = _read(path)
                _write(path, change.content)
                self._undo.append((path, before))
            case Link():
                before = _read(path)
                _link(path, Path(change.target))
                self._undo.append((path, before))
            case Remove():
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    before = _read(path)
                    path.unlink(missing_ok=True)
                    self._undo.append((path, before))
            case RemoveIfEmpty():
                with contextlib.suppress(OSError):
                    path.rmdir()


def _read(path: Path) -> bytes | Path | None:
    if path.is_symlink():
        return path.readlink()
    return path.read_bytes() if path.exists() else None


def _write(path: Path, content: bytes) -> None:
    """Write a file that is whole or not there, for everybody to read."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    fresh = Path(name)
    try:
        with open(handle, "wb") as file:  # noqa: PTH123  # a descriptor
            file.write(content)
        fresh.chmod(0o644)
        fresh.replace(path)
    except BaseException:
        fresh.unlink(missing_ok=True)
        raise


def _link(path: Path, target: Path) -> None:
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    fresh.symlink_to(target)
    try:
        fresh.replace(path)
    except BaseException:
        fresh.unlink(missing_ok=True)
        raise
