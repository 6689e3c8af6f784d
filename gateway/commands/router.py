"""``biobot-gateway router``."""

import argparse
import json
import os

import msgspec

from gateway.commands.outcome import DONE, warn
from gateway.commands.run import add_config
from gateway.log import set_up_logging
from gateway.obstacles import connecting_obstacles, listening_obstacles
from gateway.router_config import ENVIRONMENT_PREFIX, load_router_config


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``router``."""
    parser.add_argument(
        "--listen", action="append", metavar="EP", help="Zenoh endpoint to listen on (default: tcp/127.0.0.1:7447); repeatable"
    )
    parser.add_argument("--connect", action="append", metavar="EP", help="another router to join; repeatable")
    parser.add_argument("--roster", metavar="FILE", help="whom it heeds, the roster.txt of `certs`; read again at SIGHUP")
    parser.add_argument("--tls-ca", metavar="FILE", help="certificate of the authority")
    parser.add_argument("--tls-certificate", metavar="FILE", help="certificate of this router")
    parser.add_argument("--tls-key", metavar="FILE", help="private key to it")
    parser.add_argument("--ping", action="store_true", help="only ask the one that runs with this configuration; status 1: no answer")
    parser.add_argument("--log-level", choices=["DEBUG", "INFO", "WARNING", "ERROR"])
    # SUPPRESS: what was given before the word "router" stays when it is not given again after it.
    add_config(parser, default=argparse.SUPPRESS, prefix=ENVIRONMENT_PREFIX)


def router(options: argparse.Namespace) -> int:
    """Run a router until it is told to stop, or ask the one that runs."""
    config = load_router_config(
        toml_path=options.config,
        environment=os.environ,
        flags={
            "listen": options.listen,
            "connect": options.connect,
            "roster": options.roster,
            "log_level": options.log_level,
            "tls.ca": options.tls_ca,
            "tls.certificate": options.tls_certificate,
            "tls.key": options.tls_key,
        },
    )
    if options.check_config:
        warn([*listening_obstacles(config.listen), *connecting_obstacles(config.connect)])
        print(json.dumps(msgspec.to_builtins(config), indent=2))
        return DONE
    from gateway.router import ping_router, run_router  # noqa: PLC0415  # Zenoh loads 33 MB, which --help and --check-config do not need

    if options.ping:
        ping_router(config)
        return DONE
    set_up_logging(level=config.log_level)
    run_router(config)
    return DONE
