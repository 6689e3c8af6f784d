"""What an installation has put where, so that the next one and the removal know it."""

from pathlib import Path

import msgspec

from firmware_protocol.first_use import prepare
from gateway.errors import InstallationError
from gateway.installation.layout import RECORD


class Record(msgspec.Struct, frozen=True, kw_only=True):
    """What was installed.

    Attributes
    ----------
    version, programs
        Of the program that the units start.
    previous
        The folder of programs before that; None: there was none.
    services
        Names of the services.
    files
        SHA-256 of what the program's own files hold, by their paths.
    defaults
        SHA-256 of the default configuration that was last offered, by its path.
    made
        SHA-256 of the configuration that was made where there was none, by its path, if it was a default too.
    links
        Symbolic links that were made.
    folders
        Folders that were made, the outer ones first.
    """

    version: str
    programs: str
    previous: str | None = None
    services: tuple[str, ...] = ()
    files: dict[str, str] = {}
    defaults: dict[str, str] = {}
    made: dict[str, str] = {}
    links: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()


prepare(Record)


def read_record(root: Path) -> Record | None:
    """Return what is installed below ``root``; None: nothing.

    Raises
    ------
    InstallationError
        The record is damaged.
    """
    path = root / RECORD.relative_to("/")
    try:
        return msgspec.json.decode(path.read_bytes(), type=Record)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
        next_step = "remove it, and install again: files and configurations that are there are then taken as somebody's own"
        raise InstallationError(what=str(path), reason=f"cannot be read: {error}", next_step=next_step) from error


def encode_record(record: Record) -> bytes:
    """Return the record as it stands on the disk."""
    return msgspec.json.format(msgspec.json.encode(record, order="deterministic"), indent=2) + b"\n"
