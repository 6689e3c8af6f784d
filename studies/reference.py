"""Write docs/reference.md from the code itself: every command with its flags, every configuration key, variable, request and metric.

``python -m studies.reference > docs/reference.md``; a test compares what it finds with the file.
"""

import contextlib
import importlib
import io
import os
import re
import sys
from collections.abc import Iterator

import msgspec

from firmware_protocol.configuration_text import configuration_keys
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
from studies.reference_tables import code_tables, table_row

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
            "journal check",
            "journal info",
            "journal export",
            "audit",
            "audit verify",
            "audit show",
            "audit export",
            "audit stats",
            "command",
            "stop",
            "steer",
            "mission",
            "status",
            "config",
            "router",
            "certs",
            "certs init",
            "certs issue",
            "certs show",
            "certs check",
            "install-service",
            "uninstall-service",
            "configure",
            "sniff",
            "record",
            "replay",
            "pcap",
        ),
    ),
    "biobot-mapper": ("mapper", ("run", "route", "merge", "serve", "tokens", "feasibility", "warm-up", "config")),
}
"""Each program's package and commands; ``list_commands`` finds the same in their own help."""
CONFIGURATIONS: dict[str, type[msgspec.Struct]] = {
    "biobot-sim run": RunConfig,
    "biobot-sim serve": ServeConfig,
    "biobot-sim render": RenderConfig,
    "biobot-sim replay": ReplayConfig,
    "biobot-gateway run": GatewayConfig,
    "biobot-gateway router": RouterConfig,
    "biobot-mapper": MapperConfig,
}
KERNELS: tuple[type[KernelsKind], str] = (
    KernelsKind,
    "kernels of `biobot-mapper`: compiled where they are there, compiled or none, or plain, slower with the same map; default `auto`",
)
# What stands in no configuration: it is about how the program is installed here, or the system gives it.
VARIABLES: dict[str, tuple[str, str]] = {
    KERNELS_VARIABLE: (" or ".join(f"`{one.value}`" for one in KERNELS[0]), KERNELS[1]),
    "CC": (
        "a program",
        "compiler of kernels and engine at installation, and of the tools of the C side; default: cc, gcc or clang, whichever is there",
    ),
    "USER": ("a name", "who commands, where `--operator` does not say; default `operator`"),
    "PATH": ("folders", "where programs of the system are looked for: `systemctl`, `udevadm` and their like by `install-service`"),
    "NO_COLOR": ("anything", "no colours in the terminal"),
    "TERM": ("a name", "`dumb`: nothing is drawn in the terminal"),
    "NOTIFY_SOCKET": ("set by systemd", "where a service says that it is ready and alive"),
    "WATCHDOG_USEC": ("set by systemd", "how often it must say so"),
    "WATCHDOG_PID": ("set by systemd", "who must"),
    "JOURNAL_STREAM": ("set by systemd", "the log goes to the journal, with priorities"),
}


def help_text(module: str, command: str | None) -> str:
    """Return what ``python -m module [command] --help`` prints."""
    main = importlib.import_module(f"{module}.__main__").main
    with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit), _plain_terminal():
        main([*(command or "").split(), "--help"])
    return text.getvalue()


def list_commands(module: str, command: str = "") -> Iterator[str]:
    """Yield every command of a program that its help names, and theirs."""
    named = help_text(module, command).partition("positional arguments:\n")[2].partition("\noptions:")[0]
    for name in re.findall(r"^    ([a-z][a-z-]*)(?:  +\S|$)", named, re.MULTILINE):
        whole = f"{command} {name}".strip()
        yield whole
        yield from list_commands(module, whole)


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
        "# Reference: commands, configuration, REST, metrics",
        "",
        "Made by `python -m studies.reference`: commands, [keys](#configuration-keys), [variables](#further-environment-variables),",
        "[requests](#rest), [refusals](#refusals-of-commands), [metrics](#metrics-of-the-gateway).",
        "",
        "A configuration is built from its defaults, then `--config FILE.toml`, then variables such as `BIOBOT_GATEWAY__SITE`",
        "(`BIOBOT_SIM__`, `BIOBOT_MAPPER__`, and `BIOBOT_ROUTER__` of `biobot-gateway router`), then flags; a dot in a key is a table in",
        "TOML and `__` in a variable.",
        "",
        "Exit status of every command: 0 it is done, 1 it failed or found what it looks for wrong, 2 the request or the configuration is",
        "wrong. Data go to standard output, the log to standard error.",
    ]
    for program, (module, commands) in COMMANDS.items():
        for command in (None, *commands):
            parts += ["", f"## {program}{' ' + command if command else ''}", "", "```text", help_text(module, command).rstrip(), "```"]
    return "\n".join([*parts, "", *configuration_tables(), "", *code_tables()]) + "\n"


def configuration_tables() -> list[str]:
    """Return the lines of the tables of keys and variables."""
    lines = ["## Configuration keys"]
    for title, config in CONFIGURATIONS.items():
        lines += ["", f"### {title}", "", "| key | type | default | |", "|---|---|---|---|"]
        lines += [table_row(f"`{one.name}`", one.kind, one.default, one.meaning) for one in configuration_keys(config)]
    lines += ["", "## Further environment variables", "", "| variable | value | |", "|---|---|---|"]
    return lines + [table_row(f"`{name}`", value, meaning) for name, (value, meaning) in VARIABLES.items()]


if __name__ == "__main__":
    try:
        sys.stdout.write(reference())
    except ConfigurationError as error:
        sys.exit(str(error))
