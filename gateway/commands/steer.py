"""``biobot-gateway steer``: moves one biobot by the keys of a terminal, or by a script, and stops it in the end."""

import argparse
import os
import sys
import uuid
from typing import Final

from firmware_protocol.contract.access import Role, parse_identity
from firmware_protocol.contract.keys import check_name
from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import EVERYBODY, NodeId
from gateway.commands.asking import add_bus_arguments, way_of
from gateway.commands.outcome import DONE, FAILED, complain
from gateway.config import GatewayConfig
from gateway.steering import parse_script
from gateway.tls_files import check_tls_files

_ROLES: Final = (Role.OPERATOR, Role.MAPPER)
_MAX_HOLD_S: Final = 3600.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``steer``."""
    parser.add_argument("node", type=int, metavar="NODE", help="number of the biobot")
    parser.add_argument("--script", metavar="STEPS", help="instead of keys: actions and seconds, such as 'left 4; start 5; stop'")
    parser.add_argument("--hold-s", type=float, default=10.0, metavar="S", help="a motion ends by itself after this (default: 10)")
    add_bus_arguments(parser, gateway_help="its name; needed where a site has several")
    parser.add_argument("--operator", default=os.environ.get("USER") or "operator", help="who commands; it is journaled")
    parser.add_argument("--commander", metavar="NAME", help="name of the liveliness token (default: the certificate's, or one made up)")


def steer(options: argparse.Namespace) -> int:
    """Move a biobot until the script or the operator ends, and stop it; exit status 0: it confirmed that, and each step of the script."""
    from gateway.bus_commander import CommanderSession  # noqa: PLC0415  # rich and Zenoh, 33 MB, which --help does not need
    from gateway.commands.helm import Helm, follow_keys, follow_script, signals_interrupt  # noqa: PLC0415  # same

    _check(options)
    steps = None if options.script is None else parse_script(options.script)
    way = way_of(options, roles=_ROLES)
    node = NodeId(options.node)
    name = _name_of(options, way)
    with signals_interrupt() as interrupted:
        session = CommanderSession.open(
            name=name, site=way.site, gateway=options.gateway, connect=way.connect, tls=way.tls, timing=way.zenoh
        )
        try:
            session.watch(node)
            helm = Helm(
                session, node=node, operator=options.operator, hold_s=options.hold_s, is_shown=steps is None, interrupted=interrupted
            )
            try:
                n_undone = 0
                if steps is None:
                    follow_keys(helm)
                else:
                    n_undone = follow_script(helm, steps)
            finally:
                helm.stop_finally()
        finally:
            session.close()
    if helm.steering.is_moving:
        return complain(f"biobot {node} has not confirmed that it stopped: look at the animal", status=FAILED)
    if steps is not None and n_undone:
        return complain(f"{n_undone} of {len(steps)} steps were not confirmed; their last stages say why", status=FAILED)
    return DONE


def _check(options: argparse.Namespace) -> None:
    problems = []
    if not 0 <= options.node < EVERYBODY:
        problems.append(f"steer: NODE is {options.node}, but a biobot's number is 0 to {EVERYBODY - 1}")
    if not 0.1 <= options.hold_s <= _MAX_HOLD_S:
        problems.append(f"steer: --hold-s is {options.hold_s:g}, but it must be 0.1 to {_MAX_HOLD_S:g}: no motion is without an end")
    if not 1 <= len(options.operator) <= 64:
        problems.append(f"steer: --operator has {len(options.operator)} characters, but a name has 1 to 64")
    if options.script is None and not (sys.stdin.isatty() and sys.stdout.isatty()):
        problems.append("steer: this is no terminal; give a --script, such as --script 'left 4; start 5; stop'")
    if problems:
        raise ConfigurationError(problems)


def _name_of(options: argparse.Namespace, way: GatewayConfig) -> str:
    """Return the commander's name: routers let nobody have a token but by the name in his certificate."""
    if options.commander:
        return check_name(options.commander, what="commander")
    facts = check_tls_files(way.tls, roles=_ROLES, site=way.site).facts
    return f"steer-{uuid.uuid4().hex[:12]}" if facts is None else parse_identity(facts.common_name).name
