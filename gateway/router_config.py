"""The router's configuration."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec

from firmware_protocol.configuration import load_configuration
from firmware_protocol.contract.access import Role
from firmware_protocol.contract.sessions import TlsTable, ZenohTable, endpoint_problem, tls_problems
from firmware_protocol.errors import ConfigurationError
from gateway.tls_files import check_tls_files, read_roster

ENVIRONMENT_PREFIX = "BIOBOT_ROUTER"


class RouterConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a router listens on, whom it heeds, and which routers of other machines it joins.

    Keys
    ----
    listen, connect
        Zenoh endpoints, such as ``tls/0.0.0.0:7447``.
    roster
        Whom it heeds: the ``roster.txt`` of `biobot-gateway certs`. It is read again at SIGHUP. None: whoever connects, which is for
        a network that nobody else is on.
    log_level
        DEBUG, INFO, WARNING or ERROR.
    tls, zenoh
        Tables of their own.
    """

    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    connect: tuple[str, ...] = ()
    roster: str | None = None
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = "INFO"
    tls: TlsTable = TlsTable()
    zenoh: ZenohTable = ZenohTable()


def load_router_config(*, toml_path: Path | None, environment: Mapping[str, str], flags: Mapping[str, object]) -> RouterConfig:
    """Build the configuration and check it, files included.

    Raises
    ------
    ConfigurationError
        With one line for each fault.
    """
    text = None
    if toml_path is not None:
        try:
            text = toml_path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigurationError([f"{toml_path}: cannot be read: {error}"]) from error
    config = load_configuration(
        RouterConfig,
        toml_text=text,
        toml_name=str(toml_path),
        environment=environment,
        environment_prefix=ENVIRONMENT_PREFIX,
        flags=flags,
    )
    problems = [
        f"{key}: {reason}"
        for key, endpoints in (("listen", config.listen), ("connect", config.connect))
        for endpoint in endpoints
        if (reason := endpoint_problem(endpoint, listens=key == "listen"))
    ]
    problems += [*tls_problems(config.tls, listen=config.listen, connect=config.connect)]
    problems += check_tls_files(config.tls, roles=(Role.ROUTER,)).problems
    if not config.listen:
        problems.append("listen is empty: nobody could connect; give an endpoint such as tls/0.0.0.0:7447")
    if config.tls.certificate is not None and config.roster is None:
        problems.append(
            "tls is given, but roster is not: every certificate of the authority might do everything; name the authority's roster.txt"
        )
    if config.roster is not None:
        problems += read_roster(config.roster)[1]
        if config.tls.certificate is None:
            problems.append("roster is given, but tls is not: without certificates nobody can be told from anybody; give [tls] too")
    if problems:
        raise ConfigurationError(problems)
    return config
