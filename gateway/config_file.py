"""The text of a configuration file, or why there is none."""

from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from firmware_protocol.own_files import HEAD_BYTES, tell_own_file


def read_config_file(path: Path | None) -> str | None:
    """Return what a file says; None where none is given.

    Raises
    ------
    ConfigurationError
        It cannot be read, or is no text.
    """
    if path is None:
        return None
    try:
        content = path.read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ConfigurationError([f"{path}: cannot be read: {reason}; give the path of a TOML file"]) from error
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        own = tell_own_file(content[:HEAD_BYTES])
        told = f"is no text: {error}" if own is None else f"is {own.what}: {own.use}"
        raise ConfigurationError([f"{path}: {told}; give the path of a TOML file"]) from error
