"""Copies of the services' data, made before a version that writes them in a newer form, so that the one before can be put back."""

import contextlib
import os
import shutil
import subprocess
import tomllib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from gateway.errors import InstallationError
from gateway.installation.checks import MIN_FREE_BYTES
from gateway.installation.layout import SERVICES
from gateway.journal_file.schema import SCHEMA_VERSION

_PARTS = ("", "-wal", "-shm")
"""Files of a database of SQLite beside each other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DataCopy:
    """A database that the new version writes in a newer form."""

    path: Path
    from_schema: int
    to_schema: int

    @property
    def kept(self) -> Path:
        """Where the copy is."""
        return self.path.with_name(f"{self.path.name}.schema-{self.from_schema}")

    def make(self) -> None:
        """Copy it; whoever writes to it was stopped.

        Raises
        ------
        InstallationError
            There is no room.
        """
        size = sum(part.stat().st_size for part in map(self._part, _PARTS) if part.exists())
        free = shutil.disk_usage(self.path.parent).free
        if free < size + MIN_FREE_BYTES:
            raise InstallationError(
                what=str(self.path),
                reason=f"the new version writes it in a newer form; to go back a copy of {size / 1e6:.0f} MB is kept meanwhile, "
                f"and {free / 1e6:.0f} MB are free",
                next_step="make room",
            )
        for suffix in _PARTS:
            if self._part(suffix).exists():
                status = self._part(suffix).stat()
                copy = shutil.copy2(self._part(suffix), f"{self.kept}{suffix}")
                os.chown(copy, status.st_uid, status.st_gid)

    def put_back(self) -> None:
        """Have the data as they were."""
        for suffix in _PARTS:
            self._part(suffix).unlink(missing_ok=True)
            with contextlib.suppress(FileNotFoundError):
                Path(f"{self.kept}{suffix}").replace(self._part(suffix))

    def forget(self) -> None:
        """Remove the copy."""
        for suffix in _PARTS:
            Path(f"{self.kept}{suffix}").unlink(missing_ok=True)

    def _part(self, suffix: str) -> Path:
        return Path(f"{self.path}{suffix}")


def outdated_data(services: tuple[str, ...], *, programs: PurePosixPath) -> list[DataCopy]:
    """Return the databases there are that the new programs will write in a newer form."""
    found = []
    if "gateway" in services:
        found.append((_database("gateway", ("journal",), default="biobot-gateway.sqlite"), SCHEMA_VERSION))
    if "mapper" in services:
        found.append((_database("mapper", ("serve", "store"), default=""), _mapper_schema(programs)))
    copies = []
    for path, to_schema in found:
        from_schema = _schema_of(path) if path is not None else 0
        if path is not None and 0 < from_schema < to_schema:
            copies.append(DataCopy(path=path, from_schema=from_schema, to_schema=to_schema))
    return copies


def _database(name: str, keys: tuple[str, ...], *, default: str) -> Path | None:
    """Return the file that a service's configuration names; relative to its folder."""
    value: object = {}
    with contextlib.suppress(OSError, ValueError):
        value = tomllib.loads(Path(SERVICES[name].configuration).read_text(encoding="utf-8"))
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    text = value if isinstance(value, str) else default
    return Path(SERVICES[name].data) / text if text else None


def _schema_of(path: Path) -> int:
    """Return the version that the file's header tells; 0 where there is none."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        header = file.read(64)
        # https://www.sqlite.org/fileformat.html: the user version, big-endian, at offset 60.
        return int.from_bytes(header[60:64], "big") if header.startswith(b"SQLite format 3\0") else 0
    return 0


def _mapper_schema(programs: PurePosixPath) -> int:
    """Ask the mapper's program, which this one does not know."""
    asked = "from mapper.store_file import SCHEMA_VERSION; print(SCHEMA_VERSION)"
    done = subprocess.run([str(programs / "bin" / "python"), "-c", asked], capture_output=True, text=True, check=False, cwd="/")
    return int(done.stdout) if done.returncode == 0 else 0
