"""``biobot-gateway run``, and the configuration it would run with."""

import argparse
import asyncio
import json
import os
from pathlib import Path

import msgspec

from firmware_protocol.errors import ConfigurationError
from gateway.commands.outcome import DONE, FAILED, warn
from gateway.config import GatewayConfig
from gateway.config_loading import ENVIRONMENT_PREFIX, load_gateway_config
from gateway.errors import GatewayError
from gateway.log import EventLog, describe, set_up_logging
from gateway.obstacles import gateway_obstacles

_log = EventLog(__name__)

_FLAG_NAMES = {
    "ports": "--port",
    "recording.directory": "--record",
    "mission.is_enabled": "--mission",
    "mission.n_landmarks": "--landmarks",
    "monitor.listen": "--monitor",
}


def add_config(parser: argparse.ArgumentParser, *, default: object, prefix: str = ENVIRONMENT_PREFIX) -> None:
    """Add ``--config`` and ``--check-config``, which may stand before the command and after it; ``prefix`` is that of its variables."""
    help_text = f"TOML file; {prefix}__... variables and flags win over it"
    parser.add_argument("--config", type=Path, metavar="FILE", default=default, help=help_text)
    help_text = "print the configuration that would be used, and what would be in its way now, and leave"
    parser.add_argument("--check-config", action="store_true", default=default or False, help=help_text)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``run``."""
    parser.add_argument(
        "--port",
        action="append",
        metavar="SPEC",
        help="a radio: serial:/dev/ttyACM0?baud=115200&dialect=xbee, tcp:HOST:PORT or can:slcan:/dev/ttyACM1?unit=1; repeatable",
    )
    parser.add_argument("--site", help="name of the site in every key (default: local)")
    parser.add_argument("--name", help="name of this gateway in every key (default: gateway1)")
    parser.add_argument("--journal", metavar="FILE", help="journal (default: biobot-gateway.sqlite)")
    parser.add_argument("--record", metavar="DIR", help="record the bytes on every radio's line into files here, the oldest go")
    parser.add_argument("--listen", action="append", metavar="EP", help="Zenoh endpoint to listen on (default: tcp/127.0.0.1:7447)")
    parser.add_argument("--connect", action="append", metavar="EP", help="Zenoh endpoint to connect to; repeatable")
    parser.add_argument("--mission", action="store_true", default=None, help="run the mission: dispersion, landmarks, exploration")
    parser.add_argument("--dispersion-s", type=float, metavar="S", help="how long all walk before landmarks are chosen (default: 60)")
    parser.add_argument("--landmarks", type=int, metavar="N", help="how many landmarks (default: a share of the biobots)")
    parser.add_argument("--landmark-share", type=float, metavar="X", help="that share (default: 0.15)")
    parser.add_argument("--exploration-s", type=float, metavar="S", help="how long exploration lasts (default: until stopped)")
    parser.add_argument("--redisperse-every-s", type=float, metavar="S", help="then all walk, and others become landmarks (default: never)")
    parser.add_argument("--monitor", metavar="HOST:PORT", help="answer /metrics, /healthz and /readyz over HTTP here (default: nowhere)")
    parser.add_argument("--log-level", choices=["DEBUG", "INFO", "WARNING", "ERROR"])
    parser.add_argument("--log-format", choices=["auto", "text", "json"], help="auto: text on a terminal, else JSON (default: auto)")
    # SUPPRESS: what was given before the word "run" stays when it is not given again after it.
    add_config(parser, default=argparse.SUPPRESS)


def check_alone(options: argparse.Namespace) -> int:
    """Print the configuration without a command, or say that a command is missing."""
    if not options.check_config:
        raise ConfigurationError(["no command: give run, list-ports, probe or another; biobot-gateway --help lists all"])
    config = load_gateway_config(toml_path=options.config, environment=os.environ, needs_radio=False, tries_places=True)
    return _show(config)


def _show(config: GatewayConfig) -> int:
    warn(gateway_obstacles(config))
    print(json.dumps(msgspec.to_builtins(config), indent=2))
    return DONE


def run(options: argparse.Namespace) -> int:
    """Run the gateway until it is told to stop."""
    config = load_gateway_config(
        toml_path=options.config,
        environment=os.environ,
        flags={
            "ports": options.port,
            "site": options.site,
            "name": options.name,
            "journal": options.journal,
            "recording.directory": options.record,
            "listen": options.listen,
            "connect": options.connect,
            "log_level": options.log_level,
            "log_format": options.log_format,
            "monitor.listen": options.monitor,
            "mission.is_enabled": options.mission,
            "mission.dispersion_s": options.dispersion_s,
            "mission.n_landmarks": options.landmarks,
            "mission.landmark_share": options.landmark_share,
            "mission.exploration_s": options.exploration_s,
            "mission.redisperse_every_s": options.redisperse_every_s,
        },
        flag_names=_FLAG_NAMES,
        tries_places=options.check_config,
    )
    if options.check_config:
        return _show(config)
    set_up_logging(level=config.log_level, log_format=config.log_format)
    try:
        from gateway.service import run_gateway  # noqa: PLC0415  # Zenoh loads 33 MB, which --help and --check-config do not need

        asyncio.run(run_gateway(config))
    except GatewayError:
        raise
    except Exception as error:  # noqa: BLE001  # whatever ended the gateway is one event for those who watch its log
        _log.error("gateway.crashed", **describe(error))
        return FAILED
    return DONE
