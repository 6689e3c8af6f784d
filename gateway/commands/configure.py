"""``biobot-gateway configure``: the network of a coordinator whose port no gateway holds."""

import argparse
import asyncio
import json

from gateway.commands.outcome import DONE, FAILED
from gateway.configuring import configuration_request, configure
from gateway.transports.spec import parse_port_spec

_RESULTS = {0: "done", 1: "bad parameter", 2: "not supported"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``configure``."""
    parser.add_argument("--port", required=True, metavar="SPEC", help="the radio, as for run")
    parser.add_argument("--pan-id", type=_whole_number, metavar="X", help="PAN id, 0x0000 to 0xFFFE (default: leave it)")
    parser.add_argument("--channel", type=int, metavar="N", help="radio channel, 11 to 26 (default: leave it)")
    parser.add_argument("--permit-join", type=int, metavar="S", help="let nodes join for S seconds; 0: no more, 254: for good")


def configure_coordinator(options: argparse.Namespace) -> int:
    """Set what is given and print what is in force."""
    request = configuration_request(pan_id=options.pan_id, channel=options.channel, permit_join_s=options.permit_join)
    answer = asyncio.run(configure(parse_port_spec(options.port), request))
    told = {"result": _RESULTS[answer.result], "pan_id": f"0x{answer.pan_id:04x}"}
    print(json.dumps({**told, "channel": answer.channel, "permit_join_s": answer.permit_join_s}))
    return DONE if answer.result == 0 else FAILED


def _whole_number(text: str) -> int:
    return int(text, 0)
