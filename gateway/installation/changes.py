"""Changes to a tree of files: each says what it will do, is done at once or not at all, and can be taken back."""

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from gateway.errors import InstallationError


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeFolder:
    """A folder that is not there is made; what is above it is there."""

    path: PurePosixPath


@dataclass(frozen=True, slots=True, kw_only=True)
class WriteFile:
    """A file comes to hold something, whatever is there now."""

    path: PurePosixPath
    content: bytes
    why: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A symbolic link leads somewhere."""

    path: PurePosixPath
    target: PurePosixPath


@dataclass(frozen=True, slots=True, kw_only=True)
class Remove:
    """A file or link is removed, or a folder with all that is in it."""

    path: PurePosixPath


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoveIfEmpty:
    """A folder is removed if nothing is left in it."""

    path: PurePosixPath


Change = MakeFolder | WriteFile | Link | Remove | RemoveIfEmpty


def describe(change: Change) -> str:
    """Say in one line what a change does."""
    match change:
        case MakeFolder():
            return f"make folder {change.path}"
        case WriteFile():
            return f"write {change.path}{f' ({change.why})' if change.why else ''}"
        case Link():
            return f"link {change.path} to {change.target}"
        case Remove():
            return f"remove {change.path}"
        case RemoveIfEmpty():
            return f"remove {change.path} if it is empty"


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
                next_step = "nothing was changed; make room, or look at its rights, and try again"
                raise InstallationError(what=f"cannot {describe(change)}", reason=reason, next_step=next_step) from error

    def take_back(self) -> None:
        """Put back what was there before, the last change first."""
        while self._undo:
            path, before = self._undo.pop()
            with contextlib.suppress(OSError):
                if before is not None:
                    _put(path, before)
                elif path.is_dir() and not path.is_symlink():
                    path.rmdir()
                else:
                    path.unlink(missing_ok=True)

    def _apply(self, change: Change) -> None:
        path = self._root / change.path.relative_to("/")
        match change:
            case MakeFolder():
                path.mkdir()
                self._undo.append((path, None))
                path.chmod(0o755)  # whatever this process's umask: the services' user reads what is in it
            case WriteFile():
                self._replace(path, change.content)
            case Link():
                self._replace(path, Path(change.target))
            case Remove():
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    self._replace(path, None)
            case RemoveIfEmpty():
                with contextlib.suppress(OSError):
                    path.rmdir()

    def _replace(self, path: Path, fresh: bytes | Path | None) -> None:
        before = _read(path)
        if fresh is None:
            path.unlink(missing_ok=True)
        else:
            _put(path, fresh)
        self._undo.append((path, before))


def _read(path: Path) -> bytes | Path | None:
    if path.is_symlink():
        return path.readlink()
    return path.read_bytes() if path.exists() else None


def _put(path: Path, content: bytes | Path) -> None:
    """Have a file, for everybody to read, or a link that leads to a path; it is whole or not there."""
    with _beside(path) as fresh:
        if isinstance(content, Path):
            fresh.symlink_to(content)
        else:
            fresh.write_bytes(content)
            fresh.chmod(0o644)


@contextlib.contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """Yield a name beside a path: what is made there takes the path's place at the end, or goes where it could not be made whole.

    The name is always the same, so that what a process left that was killed here goes with the next attempt.
    """
    fresh = path.with_name(f".{path.name}.biobot-fresh")
    fresh.unlink(missing_ok=True)
    try:
        yield fresh
        fresh.replace(path)
    except BaseException:
        fresh.unlink(missing_ok=True)
        raise
