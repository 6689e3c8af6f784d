"""Write docs/reference.md: every flag of every command, every configuration key and further variable, from the code itself.

``python -m studies.reference > docs/reference.md``; a test compares what it finds with the file.
"""

import contextlib
import importlib
import io
import os
import sys
from collections.abc import Iterator
from enum import Enum

import msgspec

from firmware_protocol.configuration_text import configuration_keys, type_name
from firmware_protocol.errors import ConfigurationError
from gateway.config import GatewayConfig
from gateway.router_config import RouterConfig
from mapper.config import MapperConfig
from mapper.kernels import KERNELS_VARIABLE
from mapper.types import KernelsKind
from simulator.config import RunConfig
from simulator.pictures.render import RenderConfig
from simulator.replay_config import ReplayConfig
from simulator.serve_config import ServeConfig

COMMANDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "biobot-sim": ("simulator", ("run", "resume", "serve", "replay", "render", "scenarios")),
    "biobot-gateway": (
        "gateway",
        (
            "run",
            "list-ports",
            "probe",
            "check-radio",
            "journal",
            "command",
            "status",
            "router",
            "certs",
            "config",
            "install-service",
            "uninstall-service",
            "configure",
            "sniff",
            "record",
            "replay",
            "pcap",
        ),
    ),
    "biobot-mapper": ("mapper", ("run", "merge", "serve", "tokens", "feasibility", "warm-up", "config")),
}
CONFIGURATIONS: dict[str, type[msgspec.Struct]] = {
    "biobot-sim run": RunConfig,
    "biobot-sim serve": ServeConfig,
    "biobot-sim render": RenderConfig,
    "biobot-sim replay": ReplayConfig,
    "biobot-gateway run": GatewayConfig,
    "biobot-gateway router": RouterConfig,
    "biobot-mapper": MapperConfig,
}
# What stands in no configuration, because it is about how the program is installed here.
VARIABLES: dict[str, tuple[type[Enum], str]] = {
    KERNELS_VARIABLE: (
        KernelsKind,
        "kernels of `biobot-mapper`: compiled where they are there, compiled or none, or plain, slower with the same map; default `auto`",
    ),
}


def help_text(module: str, command: str | None) -> str:
    """Return what ``python -m module [command] --help`` prints."""
    main = importlib.import_module(f"{module}.__main__").main
    with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit), _plain_terminal():
        main([*([command] if command else []), "--help"])
    return text.getvalue()


@contextlib.contextmanager
def _plain_terminal() -> Iterator[None]:
    """Have argparse write for 110 columns without colours."""
    before = dict(os.environ)
    os.environ.update(COLUMNS="110", NO_COLOR="1", PYTHON_COLORS="0")
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def reference() -> str:
    """Return the whole document."""
    parts = [
        "# Reference: commands and configuration",
        "",
        "Made by `python -m studies.reference`. A configuration is built from its defaults, then `--config FILE.toml`, then variables",
        "such as `BIOBOT_GATEWAY__SITE` (`BIOBOT_SIM__`, `BIOBOT_MAPPER__`), then flags; a dot in a key is a table in TOML and `__` in a",
        "variable.",
    ]
    for program, (module, commands) in COMMANDS.items():
        for command in (None, *commands):
            parts += ["", f"## {program}{' ' + command if command else ''}", "", "```text", help_text(module, command).rstrip(), "```"]
    parts += ["", "## Configuration keys"]
    for title, config in CONFIGURATIONS.items():
        parts += ["", f"### {title}", "", "| key | type | default |", "|---|---|---|"]
        parts += [f"| `{key}` | {kind} | {default} |" for key, kind, default in configuration_keys(config)]
    parts += ["", "## Further environment variables", "", "| variable | value | meaning |", "|---|---|---|"]
    parts += [f"| `{name}` | {type_name(kind)} | {meaning} |" for name, (kind, meaning) in VARIABLES.items()]
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    try:
        sys.stdout.write(reference())
    except ConfigurationError as error:
        sys.exit(str(error))
