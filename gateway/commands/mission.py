"""``biobot-gateway mission``: order what the mission of a running gateway does, or show how it stands."""

import argparse
import json
import os
import sys
import time
import uuid

import msgspec

from firmware_protocol.contract.access import Role
from firmware_protocol.contract.mission_orders import MissionAction, MissionAnswer, MissionOrder
from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import Nanoseconds
from gateway.commands.asking import add_bus_arguments, way_of
from gateway.commands.outcome import DONE, FAILED, complain

_TIMEOUT_S = 10.0
_COMMANDERS = (Role.OPERATOR, Role.MAPPER)
_ACTIONS = {
    MissionAction.START: "begin with dispersion",
    MissionAction.PAUSE: "command nobody until it is resumed",
    MissionAction.RESUME: "go on where it was paused",
    MissionAction.SELECT: "end dispersion now, and choose the landmarks",
    MissionAction.REDISPERSE: "let the landmarks walk, and choose others after a dispersion",
    MissionAction.FINISH: "end it; landmarks stay where they are",
    MissionAction.SHOW: "tell how it stands, and change nothing",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``mission``."""
    told = "; ".join(f"{action.value}: {what}" for action, what in _ACTIONS.items())
    parser.add_argument("action", choices=[action.value for action in _ACTIONS], metavar="ACTION", help=told)
    add_bus_arguments(parser, gateway_help="its name; needed where a site has several")
    parser.add_argument("--operator", default=os.environ.get("USER") or "operator", help="who orders; it is put on record")
    parser.add_argument("--order-id", metavar="ID", help="one that was given before is answered again, not obeyed again")
    parser.add_argument("--json", action="store_true", help="print the answer as JSON, as when stdout is no terminal")


def mission(options: argparse.Namespace) -> int:
    """Give an order, and print the answer."""
    from gateway.bus_client import send_order  # noqa: PLC0415  # Zenoh loads 33 MB, which --help does not need

    way = way_of(options, roles=_COMMANDERS)
    given = {
        "order_id": options.order_id if options.order_id is not None else f"cli-{uuid.uuid4().hex}",
        "action": options.action,
        "operator": options.operator,
        "issued_wall_ns": Nanoseconds(time.time_ns()),
    }
    try:
        order = msgspec.convert(given, MissionOrder)
    except msgspec.ValidationError as error:
        raise ConfigurationError([f"mission: {error}; biobot-gateway mission --help tells more"]) from error
    answer = send_order(
        order, site=way.site, gateway=options.gateway, connect=way.connect, tls=way.tls, timing=way.zenoh, timeout_s=_TIMEOUT_S
    )
    if answer is None:
        return complain(f"no answer within {_TIMEOUT_S:g} s; `biobot-gateway mission show` tells whether it was taken", status=FAILED)
    if options.json or not sys.stdout.isatty():
        print(json.dumps(msgspec.to_builtins(answer)))
    else:
        print("\n".join(lines_of(answer)))
    return DONE if answer.is_taken else FAILED


def lines_of(answer: MissionAnswer) -> list[str]:
    """Say how a mission stands, for people."""
    lines = [] if answer.is_taken else [f"not taken: {answer.reason}"]
    lines.append(f"gateway {answer.gateway}: {answer.phase.value.replace('_', ' ')}, round {answer.round}")
    if answer.is_taken and answer.reason:
        lines.append(f"because: {answer.reason}")
    if answer.remaining_s is not None:
        lines.append(f"remaining: {answer.remaining_s:.0f} s")
    if answer.landmarks:
        lines.append(f"landmarks ({len(answer.landmarks)}): {' '.join(map(str, answer.landmarks))}")
    lines.append(f"possible: {', '.join(action.value for action in answer.possible)}")
    return lines
