"""The directory that results go to: all files at once, and never over somebody's own."""

import re
import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from simulator.errors import OutputError

# What run, serve and replay may write: a run of another kind must not leave some of it beside this one's.
_OF_A_RUN = re.compile(r"(encounters|encounters_true|observations|modes|reported)\.csv|truth\.npz|arena(_\d+)?\.geojson|run\.json")


class OutputDirectory:
    """A place held free for results; use it in a ``with`` statement, which clears away what was not committed.

    Parameters
    ----------
    path
        Where results go. A missing directory is made, and appears with all files in it.
    force
        Accept a directory that is not empty; only files of the names committed are replaced.

    Raises
    ------
    OutputError
        The path is no directory, holds something, or cannot be written.
    """

    __slots__ = ("_path", "_staging")

    def __init__(self, path: Path, *, force: bool = False) -> None:
        self._path = path
        try:
            if path.exists() and not path.is_dir():
                raise OutputError(path=path, problem="is not a directory; choose another name for the results")
            if path.is_dir() and any(path.iterdir()) and not force:
                raise OutputError(path=path, problem="is not empty; choose another directory, or give --force to replace an earlier run")
            place = path if path.is_dir() else path.absolute().parent
            place.mkdir(parents=True, exist_ok=True)
            self._staging = place / f".partial-{uuid.uuid4().hex}"
            self._staging.mkdir()
        except OSError as error:
            raise OutputError(path=path, problem=f"cannot be written: {error.strerror or error}") from error

    @property
    def path(self) -> Path:
        """Where results go."""
        return self._path

    @property
    def unfinished(self) -> Path:
        """A directory for files that grow during the run; it outlives the process only where that is killed."""
        return self._staging

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._staging, ignore_errors=True)

    def commit(self, files: Mapping[str, bytes]) -> None:
        """Write files and let them take their names; the last one is a mark that the others are whole and belong together.

        Parameters
        ----------
        files
            Name to content. In a directory that exists already, the last file is absent while the others are replaced, and files of an
        earlier run that this one has not are removed.

        Raises
        ------
        OutputError
            Writing failed, as on a full disk.
        """
        try:
            for name, content in files.items():
                (self._staging / name).write_bytes(content)
            if not self._path.exists():
                for unfinished in set(self._staging.iterdir()) - {self._staging / name for name in files}:
                    unfinished.unlink()
                self._staging.rename(self._path)
                return
            (self._path / list(files)[-1]).unlink(missing_ok=True)
            for earlier in self._path.iterdir():
                if _OF_A_RUN.fullmatch(earlier.name) and earlier.name not in files:
                    earlier.unlink()
            for name in files:
                (self._staging / name).replace(self._path / name)
        except OSError as error:
            raise OutputError(path=self._path, problem=f"cannot be written: {error.strerror or error}") from error


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that appears whole or not at all, in place of what it may hold. Raises OutputError."""
    fresh = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        fresh.write_bytes(content)
        fresh.replace(path)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        raise OutputError(path=path, problem=f"cannot be written: {error.strerror or error}") from error
