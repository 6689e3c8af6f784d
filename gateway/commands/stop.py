"""``biobot-gateway stop``: stops biobots, or all, through every gateway of a site at once."""

import argparse
import json
import os
import sys
import time
import uuid
from typing import Final

import msgspec

from firmware_protocol.contract.access import Role
from firmware_protocol.contract.commands import CommandStage, Refusal, Stage, StimulationAction, StimulationRequest
from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import EVERYBODY, Nanoseconds, NodeId
from gateway.commands.asking import add_bus_arguments, way_of
from gateway.commands.outcome import DONE, FAILED, complain

_TIMEOUT_S: Final = 15.0
_MAX_NODE: Final = EVERYBODY - 1
_MAX_NAME: Final = 64
"""Characters of an operator's name; who gives a stop is no reason to refuse it, so a longer one is cut."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``stop``."""
    parser.add_argument("nodes", type=_node, nargs="*", metavar="NODE", help="numbers of the biobots")
    parser.add_argument("--all", action="store_true", help="every biobot that the gateways reach, whoever else is named; also: stop all")
    add_bus_arguments(parser, gateway_help="only through this one (default: through all of the site)")
    parser.add_argument("--operator", default=os.environ.get("USER") or "operator", help="who commands; it is journaled")
    parser.add_argument("--json", action="store_true", help="one JSON object a line for each stage, as when stdout is no terminal")


def stop(options: argparse.Namespace) -> int:
    """Stop biobots and print each stage; the exit status is 0 only where all is confirmed."""
    from gateway.bus_stop import stop_everywhere  # noqa: PLC0415  # Zenoh loads 33 MB, which --help does not need

    options.all = options.all or None in options.nodes
    requests = {request.command_id: request for request in _requests(options)}
    way = way_of(options, roles=(Role.OPERATOR, Role.MAPPER))
    ends: dict[str, list[CommandStage]] = {command_id: [] for command_id in requests}
    gateways: set[str] = set()
    is_json = options.json or not sys.stdout.isatty()
    for stage in stop_everywhere(
        list(requests.values()),
        site=way.site,
        gateway=options.gateway,
        connect=way.connect,
        timeout_s=_TIMEOUT_S,
        tls=way.tls,
        timing=way.zenoh,
        on_gateway=gateways.add,
    ):
        print(json.dumps(msgspec.to_builtins(stage)) if is_json else line_of(stage), flush=True)
        if stage.is_final and stage.command_id in ends:
            ends[stage.command_id].append(stage)
    if options.all:
        complain(f"asked: {', '.join(sorted(gateways))}; who hangs or is cut off is not on the bus, and was not asked")
    problems = [problem for command_id, request in requests.items() if (problem := _why_unsure(request, ends[command_id], gateways))]
    complain(*problems)
    return FAILED if problems else DONE


def line_of(stage: CommandStage) -> str:
    """Return a stage as a line for people."""
    who = "all biobots" if stage.node == EVERYBODY else f"biobot {stage.node}"
    reason = f": {stage.reason}" if stage.reason else ""
    return f"{stage.gateway:<16} {who:<14} {stage.action.value:<10} {stage.stage.value}{reason}"


def _node(text: str) -> int | None:
    """Return a biobot's number, or None for all of them."""
    if text == "all":
        return None
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no biobot's number; give numbers, or --all for every biobot") from None


def _requests(options: argparse.Namespace) -> list[StimulationRequest]:
    # Who names some and all wants all: no stop is refused because too much was asked.
    nodes = [] if options.all else options.nodes
    problems = [f"stop: NODE is {node}, but a biobot's number is 0 to {_MAX_NODE}" for node in nodes if not 0 <= node <= _MAX_NODE]
    if not nodes and not options.all:
        problems.append("stop: give numbers of biobots, or --all; biobot-gateway stop --help tells more")
    if problems:
        raise ConfigurationError(problems)
    action = StimulationAction.STOP_ALL if options.all else StimulationAction.STOP
    return [
        StimulationRequest(
            command_id=f"cli-{uuid.uuid4().hex}",
            node=NodeId(node),
            action=action,
            operator=options.operator[:_MAX_NAME] or "unknown",
            issued_wall_ns=Nanoseconds(time.time_ns()),
        )
        for node in (dict.fromkeys(nodes) or [EVERYBODY])
    ]


def _why_unsure(request: StimulationRequest, ends: list[CommandStage], gateways: set[str]) -> str | None:
    """Return what is not certain about a stop, or None.

    One biobot is reached by some gateways and unknown to others: one confirmation is enough. A stop of all is confirmed by each gateway.
    """
    confirmed = {stage.gateway for stage in ends if stage.stage is Stage.BIOBOT_CONFIRMED}
    if request.action is StimulationAction.STOP_ALL:
        others = sorted(gateways - confirmed)
        return (
            f"not confirmed by gateway {', '.join(others) or '(none answered)'}: look at the animals" if others or not confirmed else None
        )
    if confirmed:
        return None
    if ends and all(stage.refusal is Refusal.UNKNOWN_BIOBOT for stage in ends):
        return f"biobot {request.node} is known to no gateway that answered ({', '.join(sorted(gateways))})"
    return f"biobot {request.node} has not confirmed that it stopped: look at the animal"
