"""``biobot-gateway command``, and the flags that say which gateway is asked."""

import argparse
import json
import os
import time
import uuid
from collections.abc import Sequence
from pathlib import Path

import msgspec

from firmware_protocol.contract.access import Role
from firmware_protocol.contract.commands import Stage, StimulationAction, StimulationRequest, WaveformName
from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.commands.outcome import DONE, FAILED, complain
from gateway.config import GatewayConfig
from gateway.config_loading import load_gateway_config

_COMMAND_TIMEOUT_S = 30.0
_TRAIN = (
    ("--frequency-hz", "HZ", "pulses a second"),
    ("--amplitude-mv", "MV", "of the first phase"),
    ("--pulse-width-us", "US", "of one phase"),
    ("--duration-ms", "MS", "of the whole train"),
    ("--channel", "N", "of the electrodes; 255: the action's own"),
)
_PULSE = ("frequency_hz", "amplitude_mv", "pulse_width_us", "duration_ms", "channel", "waveform")
ENDPOINT = "tcp/127.0.0.1:7447"
_COMMANDERS = (Role.OPERATOR, Role.MAPPER)


def add_bus_arguments(parser: argparse.ArgumentParser, *, gateway_help: str) -> None:
    """Add the flags of ``status``, which those of ``command`` begin with."""
    parser.add_argument("--gateway", metavar="NAME", help=gateway_help)
    parser.add_argument("--site", help="name of the site (default: local)")
    parser.add_argument("--connect", action="append", metavar="EP", help=f"Zenoh endpoint (default: {ENDPOINT})")
    # SUPPRESS: what was given before the command stays when it is not given again after it.
    help_text = "TOML file with site, connect, [tls] and [zenoh]; flags win over it"
    parser.add_argument("--config", type=Path, metavar="FILE", default=argparse.SUPPRESS, help=help_text)
    parser.add_argument("--tls-ca", metavar="FILE", help="certificate of the authority, for tls/ endpoints")
    parser.add_argument("--tls-certificate", metavar="FILE", help="what is shown of oneself")
    parser.add_argument("--tls-key", metavar="FILE", help="private key to it")


def add_command_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``command``."""
    parser.add_argument("node", type=int, metavar="NODE", help="number of the biobot")
    parser.add_argument("action", choices=[action.value for action in StimulationAction if action is not StimulationAction.STOP_ALL])
    add_bus_arguments(parser, gateway_help="its name; needed where a site has several")
    parser.add_argument("--operator", default=os.environ.get("USER") or "operator", help="who commands; it is journaled")
    parser.add_argument("--hold-ms", type=int, default=0, metavar="MS", help="controlled motion ends by itself after this; 0: never")
    parser.add_argument("--ttl-ms", type=int, default=5000, metavar="MS", help="the command is void after this (default: 5000)")
    train = parser.add_argument_group("the train, within the gateway's and the backpack's limits (default: as the gateway is configured)")
    for flag, unit, help_text in _TRAIN:
        train.add_argument(flag, type=int, metavar=unit, help=help_text)
    train.add_argument("--waveform", choices=[waveform.value for waveform in WaveformName])


def command(options: argparse.Namespace) -> int:
    """Command a biobot, and print each stage of the answer."""
    from gateway.bus_client import send_command  # noqa: PLC0415  # Zenoh loads 33 MB, which --help does not need

    way = way_of(options, roles=_COMMANDERS)
    pulse = {key: value for key in _PULSE if (value := getattr(options, key)) is not None}
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
                "pulse": pulse or None,
            },
            StimulationRequest,
        )
    except msgspec.ValidationError as error:
        what, at, name = str(error).partition(" - at `$.")
        key = name.rstrip("`").removeprefix("pulse.")
        told = (
            f"{'node' if key == 'node' else '--' + key.replace('_', '-')} is {getattr(options, key)!r}: {what}"
            if at and hasattr(options, key)
            else str(error)
        )
        raise ConfigurationError([f"command: {told}; biobot-gateway command --help tells more"]) from error
    outcome: Stage | None = None
    stages = send_command(
        request,
        site=way.site,
        gateway=options.gateway,
        connect=way.connect,
        tls=way.tls,
        timing=way.zenoh,
        timeout_s=_COMMAND_TIMEOUT_S,
    )
    for stage in stages:
        outcome = stage.stage
        print(json.dumps(msgspec.to_builtins(stage)), flush=True)
    if outcome is None:
        complain(f"no answer within {_COMMAND_TIMEOUT_S:g} s; whether the command was obeyed is not known")
    return DONE if outcome is Stage.BIOBOT_CONFIRMED else FAILED


def way_of(options: argparse.Namespace, *, roles: Sequence[Role]) -> GatewayConfig:
    """Return the site, the endpoints and the TLS table to ask with; all else in it is of no concern here."""
    path: Path | None = getattr(options, "config", None)
    config = load_gateway_config(
        toml_path=path,
        flags={
            "site": options.site,
            "connect": options.connect,
            "listen": [],
            "tls.ca": options.tls_ca,
            "tls.certificate": options.tls_certificate,
            "tls.key": options.tls_key,
        },
        needs_radio=False,
        roles=roles,
    )
    return config if config.connect else msgspec.structs.replace(config, connect=(ENDPOINT,))
