"""Where a command's configuration comes from: the file named on the command line, the environment, the flags."""

import argparse
import os
from pathlib import Path
from typing import TypeVar

import msgspec

from firmware_protocol.configuration import load_configuration
from firmware_protocol.errors import ConfigurationError

ConfigT = TypeVar("ConfigT", bound=msgspec.Struct)

_ENVIRONMENT_PREFIX = "BIOBOT_SIM"
_MAX_BYTES = 1024 * 1024


def load_config(config_type: type[ConfigT], args: argparse.Namespace) -> ConfigT:
    """Build a command's configuration; a flag belongs to the field that its ``dest`` names, dotted within tables.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or some source has faults; all are told.
    """
    return load_configuration(
        config_type,
        toml_text=None if args.config is None else _read(args.config),
        toml_name=str(args.config),
        environment=os.environ,
        environment_prefix=_ENVIRONMENT_PREFIX,
        flags={name: value for name, value in vars(args).items() if name.split(".")[0] in config_type.__struct_fields__},
    )


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ConfigurationError([f"{path}: cannot be read: {error.strerror or error}"]) from error
    if len(content) > _MAX_BYTES:
        raise ConfigurationError([f"{path}: larger than {_MAX_BYTES} bytes; give a TOML file of settings"])
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise ConfigurationError([f"{path}: not UTF-8 text (byte {error.start}); give a TOML file"]) from error
