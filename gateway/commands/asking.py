"""``biobot-gateway command``, and the flags that say which gateway is asked."""

import argparse
import json
import os
import time
import uuid

import msgspec

from firmware_protocol.contract.keys import check_name
from firmware_protocol.contract.records import Stage, StimulationAction, StimulationRequest
from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.commands.outcome import DONE, FAILED, complain

_COMMAND_TIMEOUT_S = 30.0
ENDPOINT = "tcp/127.0.0.1:7447"


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``status``, which those of ``command`` begin with."""
    parser.add_argument("--gateway", help="its name; needed where a site has several")
    parser.add_argument("--site", default="local", help="name of the site (default: local)")
    parser.add_argument("--connect", action="append", metavar="EP", help=f"Zenoh endpoint (default: {ENDPOINT})")


def add_command_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``command``."""
    parser.add_argument("node", type=int, metavar="NODE", help="number of the biobot")
    parser.add_argument("action", choices=[action.value for action in StimulationAction])
    add_bus_arguments(parser)
    parser.add_argument("--operator", default=os.environ.get("USER") or "operator", help="who commands; it is journaled")
    parser.add_argument("--hold-ms", type=int, default=0, metavar="MS", help="controlled motion ends by itself after this; 0: never")
    parser.add_argument("--ttl-ms", type=int, default=5000, metavar="MS", help="the command is void after this (default: 5000)")


def command(options: argparse.Namespace) -> int:
    """Command a biobot, and print each stage of the answer."""
    from gateway.bus import send_command  # noqa: PLC0415  # Zenoh loads 33 MB, which --help does not need

    check_name(options.site, what="site")
    try:
        request = msgspec.convert(
            {
                "command_id": f"cli-{uuid.uuid4().hex}",
                "node": NodeId(options.node),
                "action": options.action,
                "operator": options.operator,
                "issued_wall_ns": Nanoseconds(time.time_ns()),
                "ttl_ms": options.ttl_ms,
                "hold_ms": options.hold_ms,
            },
            StimulationRequest,
        )
    except msgspec.ValidationError as error:
        what, at, name = str(error).partition(" - at `$.")
        key = name.rstrip("`")
        told = (
            f"{'node' if key == 'node' else '--' + key.replace('_', '-')} is {getattr(options, key)!r}: {what}"
            if at and hasattr(options, key)
            else str(error)
        )
        raise ConfigurationError([f"command: {told}; biobot-gateway command --help tells more"]) from error
    outcome: Stage | None = None
    connect = options.connect or [ENDPOINT]
    for stage in send_command(request, site=options.site, gateway=options.gateway, connect=connect, timeout_s=_COMMAND_TIMEOUT_S):
        outcome = stage.stage
        print(json.dumps(msgspec.to_builtins(stage)), flush=True)
    if outcome is None:
        complain(f"no answer within {_COMMAND_TIMEOUT_S:g} s; whether the command was obeyed is not known")
    return DONE if outcome is Stage.BIOBOT_CONFIRMED else FAILED
