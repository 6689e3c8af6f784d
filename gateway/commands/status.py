"""``biobot-gateway status``: how the gateways of a site stand, live on a terminal, once, or as JSON."""

import argparse
import json
import sys

import msgspec

from firmware_protocol.contract.access import Role
from gateway.commands.asking import add_bus_arguments, way_of
from gateway.commands.outcome import DONE, FAILED, complain
from gateway.config import GatewayConfig

_TIMEOUT_S = 5.0
_VIEWERS = (Role.OPERATOR, Role.MAPPER, Role.VIEWER)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``status``."""
    add_bus_arguments(parser, gateway_help="show this one alone (default: all of the site; with --json the first that speaks)")
    parser.add_argument("--once", action="store_true", help="draw it once, and leave; exit status 1 where no gateway is heard")
    parser.add_argument("--json", action="store_true", help="print the next status of a gateway as JSON, as without a terminal")


def status(options: argparse.Namespace) -> int:
    """Tell how the gateways stand."""
    way = way_of(options, roles=_VIEWERS)
    if options.json or not (options.once or sys.stdout.isatty()):
        return _print_json(way, gateway=options.gateway)
    from gateway.commands.screen import show  # noqa: PLC0415  # rich and Zenoh, 33 MB, which --help does not need

    return show(way, gateway=options.gateway, is_once=options.once)


def _print_json(way: GatewayConfig, *, gateway: str | None) -> int:
    from gateway.bus_client import read_status  # noqa: PLC0415  # same

    found = read_status(site=way.site, gateway=gateway, connect=way.connect, tls=way.tls, timing=way.zenoh, timeout_s=_TIMEOUT_S)
    if found is None:
        who = f"gateway {gateway!r}" if gateway else "no gateway"
        verb = "has not" if gateway else "has"
        question = "is it running, and on the router's roster?"
        complain(f"connected, but {who} of site {way.site!r} {verb} told its status within {_TIMEOUT_S:g} s: {question}")
        return FAILED
    print(json.dumps(msgspec.to_builtins(found), indent=2))
    return DONE
