"""The router's configuration."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import msgspec

from firmware_protocol.configuration import Unfit, load_configuration
from firmware_protocol.contract.access import Role
from firmware_protocol.contract.sessions import TlsTable, ZenohTable, endpoint_problem, tls_problems
from gateway.config_file import read_config_file
from gateway.tls_files import check_tls_files, read_roster

ENVIRONMENT_PREFIX = "BIOBOT_ROUTER"

_TLS = ("tls.ca", "tls.certificate", "tls.key")
_FLAG_NAMES = {key: f"--{key.replace('.', '-')}" for key in _TLS}


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
    return load_configuration(
        RouterConfig,
        toml_text=read_config_file(toml_path),
        toml_name=str(toml_path),
        environment=environment,
        environment_prefix=ENVIRONMENT_PREFIX,
        flags=flags,
        flag_names=_FLAG_NAMES,
        check=_problems,
    )


def _problems(config: RouterConfig) -> Iterator[Unfit]:
    for key, endpoints in (("listen", config.listen), ("connect", config.connect)):
        for endpoint in endpoints:
            if reason := endpoint_problem(endpoint, listens=key == "listen"):
                yield Unfit(keys=(key,), reason=f"{key}: {reason}")
    if not config.listen:
        yield Unfit(keys=("listen",), reason="listen is empty: nobody could connect; give an endpoint such as tls/0.0.0.0:7447")
    for reason in tls_problems(config.tls, listen=config.listen, connect=config.connect):
        yield Unfit(keys=(*_TLS, "listen", "connect"), reason=reason)
    for reason in check_tls_files(config.tls, roles=(Role.ROUTER,)).problems:
        yield Unfit(keys=_TLS, reason=reason)
    if config.tls.certificate is not None and config.roster is None:
        why = "every certificate of the authority might do everything; name the authority's roster.txt"
        yield Unfit(keys=("tls.certificate", "roster"), reason=f"tls is given, but roster is not: {why}")
    if config.roster is not None:
        for reason in read_roster(config.roster)[1]:
            yield Unfit(keys=("roster",), reason=reason)
        if config.tls.certificate is None:
            why = "without certificates nobody can be told from anybody; give [tls] too"
            yield Unfit(keys=("roster", "tls.certificate"), reason=f"roster is given, but tls is not: {why}")
