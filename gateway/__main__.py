"""Command line of the gateway."""

import argparse
import asyncio
import json
import os
import sys
import time
import uuid
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import msgspec

from firmware_protocol.contract.keys import check_name
from firmware_protocol.contract.records import Stage, StimulationAction, StimulationRequest
from firmware_protocol.errors import ConfigurationError, KeyExpressionError, ProtocolError
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.config import GatewayConfig, load_gateway_config
from gateway.errors import GatewayError, TransportSpecError
from gateway.log import set_up_logging
from gateway.transports.serial_port import list_serial_ports
from gateway.transports.spec import parse_port_spec

_DONE, _FAILED, _USAGE = 0, 1, 2
_COMMAND_TIMEOUT_S = 30.0
_STATUS_TIMEOUT_S = 5.0
_ENDPOINT = "tcp/127.0.0.1:7447"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        status = _COMMANDS[options.command](options)
        sys.stdout.flush()
    except ConfigurationError as error:
        return _complain(*error.problems, status=_USAGE)
    except (TransportSpecError, KeyExpressionError) as error:
        return _complain(str(error), status=_USAGE)
    except (GatewayError, ProtocolError) as error:
        return _complain(str(error), status=_FAILED)
    except BrokenPipeError:
        # Whoever read our output is gone; keep the interpreter from complaining about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _FAILED
    except KeyboardInterrupt:
        return _FAILED
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="biobot-gateway", description="Base station of a biobot network: radios in, Zenoh out.")
    parser.add_argument("--version", action="version", version=f"biobot-gateway {version('biobot-gateway')}")
    _add_config(parser, default=None)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    _add_run(commands.add_parser("run", help="run the gateway"))
    ports = commands.add_parser("list-ports", help="list the serial ports of this machine, those with a by-id link first")
    ports.add_argument("--json", action="store_true", help="as JSON")
    _add_command(commands.add_parser("command", help="command a biobot through a running gateway"))
    status = commands.add_parser("status", help="print what a running gateway says of itself; exit status 1 where none does")
    _add_bus(status)
    _add_configure(commands.add_parser("configure", help="set the network of a native or CAN coordinator whose port no gateway holds"))
    return parser


def _add_config(parser: argparse.ArgumentParser, *, default: object) -> None:
    help_text = "TOML file; BIOBOT_GATEWAY__... variables and flags win over it"
    parser.add_argument("--config", type=Path, metavar="FILE", default=default, help=help_text)
    help_text = "print the configuration that would be used, and leave"
    parser.add_argument("--check-config", action="store_true", default=default or False, help=help_text)


def _add_bus(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--gateway", help="its name; needed where a site has several")
    parser.add_argument("--site", default="local", help="name of the site (default: local)")
    parser.add_argument("--connect", action="append", metavar="EP", help=f"Zenoh endpoint (default: {_ENDPOINT})")


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--port",
        action="append",
        metavar="SPEC",
        help="a radio: serial:/dev/ttyACM0?baud=115200, tcp:HOST:PORT or can:slcan:/dev/ttyACM1?unit=1; repeatable",
    )
    parser.add_argument("--site", help="name of the site in every key (default: local)")
    parser.add_argument("--name", help="name of this gateway in every key (default: gateway1)")
    parser.add_argument("--journal", metavar="FILE", help="journal (default: biobot-gateway.sqlite)")
    parser.add_argument("--listen", action="append", metavar="EP", help="Zenoh endpoint to listen on (default: tcp/127.0.0.1:7447)")
    parser.add_argument("--connect", action="append", metavar="EP", help="Zenoh endpoint to connect to; repeatable")
    parser.add_argument("--mission", action="store_true", default=None, help="run the mission: dispersion, landmarks, exploration")
    parser.add_argument("--dispersion-s", type=float, metavar="S", help="how long all walk before landmarks are chosen (default: 60)")
    parser.add_argument("--landmarks", type=int, metavar="N", help="how many landmarks (default: a share of the biobots)")
    parser.add_argument("--landmark-share", type=float, metavar="X", help="that share (default: 0.15)")
    parser.add_argument("--exploration-s", type=float, metavar="S", help="how long exploration lasts (default: until stopped)")
    parser.add_argument("--log-level", choices=["DEBUG", "INFO", "WARNING", "ERROR"])
    # SUPPRESS: what was given before the word "run" stays when it is not given again after it.
    _add_config(parser, default=argparse.SUPPRESS)


def _add_command(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("node", type=int, metavar="NODE", help="number of the biobot")
    parser.add_argument("action", choices=[action.value for action in StimulationAction])
    _add_bus(parser)
    parser.add_argument("--operator", default=os.environ.get("USER") or "operator", help="who commands; it is journaled")
    parser.add_argument("--hold-ms", type=int, default=0, metavar="MS", help="controlled motion ends by itself after this; 0: never")
    parser.add_argument("--ttl-ms", type=int, default=5000, metavar="MS", help="the command is void after this (default: 5000)")


def _add_configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--port", required=True, metavar="SPEC", help="the radio, as for run")
    parser.add_argument("--pan-id", type=_whole_number, metavar="X", help="PAN id, 0x0000 to 0xFFFE (default: leave it)")
    parser.add_argument("--channel", type=int, metavar="N", help="radio channel, 11 to 26 (default: leave it)")
    parser.add_argument("--permit-join", type=int, metavar="S", help="let nodes join for S seconds; 0: no more, 254: for good")


def _whole_number(text: str) -> int:
    return int(text, 0)


def _configure(options: argparse.Namespace) -> int:
    from gateway.configuring import configuration_request, configure  # noqa: PLC0415  # not needed by --help

    request = configuration_request(pan_id=options.pan_id, channel=options.channel, permit_join_s=options.permit_join)
    answer = asyncio.run(configure(parse_port_spec(options.port), request))
    result = {0: "done", 1: "bad parameter", 2: "not supported"}[answer.result]
    print(
        json.dumps({"result": result, "pan_id": f"0x{answer.pan_id:04x}", "channel": answer.channel, "permit_join_s": answer.permit_join_s})
    )
    return _DONE if answer.result == 0 else _FAILED


def _check_alone(options: argparse.Namespace) -> int:
    if not options.check_config:
        raise ConfigurationError(["no command: give run, list-ports, command, status or configure; see biobot-gateway --help"])
    config = load_gateway_config(toml_path=options.config, environment=os.environ, flags={})
    print(json.dumps(msgspec.to_builtins(config), indent=2))
    return _DONE


def _status(options: argparse.Namespace) -> int:
    from gateway.bus import read_status  # noqa: PLC0415  # Zenoh loads 33 MB, which --help does not need

    check_name(options.site, what="site")
    status = read_status(site=options.site, gateway=options.gateway, connect=options.connect or [_ENDPOINT], timeout_s=_STATUS_TIMEOUT_S)
    if status is None:
        _complain(f"no gateway has told its status within {_STATUS_TIMEOUT_S:g} s; is it running, and are --site and --connect its own?")
        return _FAILED
    print(json.dumps(msgspec.to_builtins(status), indent=2))
    return _DONE


def _run(options: argparse.Namespace) -> int:
    config = load_gateway_config(
        toml_path=options.config,
        environment=os.environ,
        flags={
            "ports": options.port,
            "site": options.site,
            "name": options.name,
            "journal": options.journal,
            "listen": options.listen,
            "connect": options.connect,
            "log_level": options.log_level,
            "mission.is_enabled": options.mission,
            "mission.dispersion_s": options.dispersion_s,
            "mission.n_landmarks": options.landmarks,
            "mission.landmark_share": options.landmark_share,
            "mission.exploration_s": options.exploration_s,
        },
    )
    _check_ports(config)
    if options.check_config:
        print(json.dumps(msgspec.to_builtins(config), indent=2))
        return _DONE
    set_up_logging(level=config.log_level)
    from gateway.service import run_gateway  # noqa: PLC0415  # Zenoh loads 33 MB, which --help and --check-config do not need

    asyncio.run(run_gateway(config))
    return _DONE


def _check_ports(config: GatewayConfig) -> None:
    problems = []
    names: set[str] = set()
    for spec in config.ports:
        try:
            name = parse_port_spec(spec).name
            if name in names:
                problems.append(f"port {name} is named twice")
            names.add(name)
        except TransportSpecError as error:
            problems.append(str(error))
    if not config.ports:
        problems.append(
            "no radio: name at least one with --port, such as --port serial:/dev/ttyACM0; `biobot-gateway list-ports` shows them"
        )
    if problems:
        raise ConfigurationError(problems)


def _list_ports(options: argparse.Namespace) -> int:
    ports = list_serial_ports()
    if options.json:
        print(json.dumps([asdict(port) | {"spec": port.spec} for port in ports], indent=2))
        return _DONE
    for port in ports:
        usb = f"{port.vid:04x}:{port.pid:04x}" if port.vid is not None and port.pid is not None else "-"
        print(f"{port.spec}  {port.device}  {usb}  {port.description}")
    if not ports:
        _complain("no serial port found")
    return _DONE


def _command(options: argparse.Namespace) -> int:
    from gateway.bus import send_command  # noqa: PLC0415  # same as above

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
        raise ConfigurationError([f"command: {error}"]) from error
    outcome: Stage | None = None
    connect = options.connect or [_ENDPOINT]
    for stage in send_command(request, site=options.site, gateway=options.gateway, connect=connect, timeout_s=_COMMAND_TIMEOUT_S):
        outcome = stage.stage
        print(json.dumps(msgspec.to_builtins(stage)), flush=True)
    if outcome is None:
        _complain(f"no answer within {_COMMAND_TIMEOUT_S:g} s; whether the command was obeyed is not known")
    return _DONE if outcome is Stage.BIOBOT_CONFIRMED else _FAILED


def _complain(*lines: str, status: int = _DONE) -> int:
    for line in lines:
        print(f"biobot-gateway: {line}", file=sys.stderr)
    return status


_COMMANDS: dict[str | None, Callable[[argparse.Namespace], int]] = {
    None: _check_alone,
    "run": _run,
    "list-ports": _list_ports,
    "command": _command,
    "status": _status,
    "configure": _configure,
}


if __name__ == "__main__":
    sys.exit(main())
