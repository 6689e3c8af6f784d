"""``biobot-gateway config``: what a configuration file may say."""

import argparse
import json

import msgspec

from firmware_protocol.configuration_text import default_toml
from gateway.commands.outcome import DONE
from gateway.config import GatewayConfig

_TITLE = (
    "Configuration of biobot-gateway: every key with its default. Variables such as BIOBOT_GATEWAY__LOG_LEVEL win over this file, "
    "flags over both. Keep what you change; `biobot-gateway run --config FILE --check-config` tells all that is wrong with it."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what can be asked for."""
    parser.add_argument(
        "what",
        choices=["print-default", "schema"],
        help="print-default: a TOML file of all keys, commented; schema: the same as JSON Schema, for editors",
    )


def config(options: argparse.Namespace) -> int:
    """Print it."""
    if options.what == "schema":
        print(json.dumps(msgspec.json.schema(GatewayConfig), indent=2))
    else:
        print(default_toml(GatewayConfig, title=_TITLE), end="")
    return DONE
