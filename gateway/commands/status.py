"""``biobot-gateway status``: how the gateways of a site stand, live on a terminal, once, or as JSON."""

import argparse
import json
import sys

import msgspec

from firmware_protocol.contract.keys import check_name
from gateway.commands.asking import ENDPOINT, add_bus_arguments
from gateway.commands.outcome import DONE, FAILED, complain

_TIMEOUT_S = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``status``."""
    add_bus_arguments(parser)
    parser.add_argument("--once", action="store_true", help="draw it once, and leave; exit status 1 where no gateway is heard")
    parser.add_argument("--json", action="store_true", help="print the next status of a gateway as JSON, as without a terminal")


def status(options: argparse.Namespace) -> int:
    """Tell how the gateways stand."""
    check_name(options.site, what="site")
    if options.json or not (options.once or sys.stdout.isatty()):
        return _print_json(options)
    from gateway.commands.screen import show  # noqa: PLC0415  # rich and Zenoh, 33 MB, which --help does not need

    return show(site=options.site, gateway=options.gateway, connect=options.connect or [ENDPOINT], is_once=options.once)


def _print_json(options: argparse.Namespace) -> int:
    from gateway.bus import read_status  # noqa: PLC0415  # same

    found = read_status(site=options.site, gateway=options.gateway, connect=options.connect or [ENDPOINT], timeout_s=_TIMEOUT_S)
    if found is None:
        complain(f"no gateway has told its status within {_TIMEOUT_S:g} s; is it running, and are --site and --connect its own?")
        return FAILED
    print(json.dumps(msgspec.to_builtins(found), indent=2))
    return DONE
