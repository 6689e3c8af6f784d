"""Command line of the gateway."""

import argparse
import os
import sys
from collections.abc import Callable
from importlib.metadata import version

from firmware_protocol.errors import ConfigurationError, KeyExpressionError, ProtocolError
from firmware_protocol.nearest_word import CommandParser
from gateway.commands import (
    asking,
    audit,
    certs,
    check_radio,
    config,
    configure,
    journal,
    lines,
    mission,
    pcap,
    ports,
    router,
    run,
    services,
    status,
    steer,
    stop,
)
from gateway.commands.outcome import FAILED, USAGE, complain
from gateway.errors import GatewayError, TransportSpecError

AddArguments = Callable[[argparse.ArgumentParser], None]
Command = Callable[[argparse.Namespace], int]

_COMMANDS: dict[str, tuple[str, AddArguments, Command]] = {
    "run": ("run the gateway", run.add_arguments, run.run),
    "list-ports": ("list the serial ports of this machine", ports.add_list_arguments, ports.list_ports),
    "probe": ("tell which dialect, firmware and network answers there", ports.add_probe_arguments, ports.probe),
    "check-radio": ("check a radio, capability by capability", check_radio.add_arguments, check_radio.check),
    "journal": ("check or describe a journal, or export it as a table", journal.add_arguments, journal.journal),
    "audit": ("show who commanded what, and verify the log of it", audit.add_arguments, audit.audit),
    "command": ("command a biobot through a running gateway", asking.add_command_arguments, asking.command),
    "stop": ("stop biobots, or all, through every gateway of a site", stop.add_arguments, stop.stop),
    "steer": ("move a biobot by the arrow keys; it is stopped when you leave", steer.add_arguments, steer.steer),
    "mission": ("start, pause, resume or end a gateway's mission, or show how it stands", mission.add_arguments, mission.mission),
    "status": (
        "how the gateways of a site stand, live on a terminal; exit status 1 where none is heard",
        status.add_arguments,
        status.status,
    ),
    "config": ("print a configuration of all keys, or its schema", config.add_arguments, config.config),
    "router": ("carry messages between gateways, mappers and operators of several machines", router.add_arguments, router.router),
    "certs": ("make and look after the certificates of a site", certs.add_arguments, certs.certs),
    "install-service": (
        "install or upgrade services of this machine",
        services.add_install_arguments,
        services.install_service,
    ),
    "uninstall-service": ("remove those services", services.add_uninstall_arguments, services.uninstall_service),
    "configure": (
        "set the network of a native or CAN coordinator whose port no gateway holds",
        configure.add_arguments,
        configure.configure,
    ),
    "sniff": ("print what passes on a port, frame by frame; takes nothing from the gateway", lines.add_sniff_arguments, lines.sniff),
    "record": ("record what passes on a port", lines.add_record_arguments, lines.record),
    "replay": ("print a recording as `sniff` did, or offer it on a line", lines.add_replay_arguments, lines.replay),
    "pcap": ("turn a recording or a live port into a capture for Wireshark", pcap.add_arguments, pcap.pcap),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        command = run.check_alone if options.command is None else _COMMANDS[options.command][2]
        exit_status = command(options)
        sys.stdout.flush()
    except ConfigurationError as error:
        return complain(*error.problems, status=USAGE)
    except (TransportSpecError, KeyExpressionError) as error:
        return complain(str(error), status=USAGE)
    except (GatewayError, ProtocolError) as error:
        return complain(str(error), status=FAILED)
    except BrokenPipeError:
        # Whoever read our output is gone; keep the interpreter from complaining about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except KeyboardInterrupt:
        return complain("interrupted", status=FAILED)
    return exit_status


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(prog="biobot-gateway", description="Base station of a biobot network: radios in, Zenoh out.")
    parser.add_argument("--version", action="version", version=f"biobot-gateway {version('biobot-gateway')}")
    run.add_config(parser, default=None)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (help_text, add_arguments, _) in _COMMANDS.items():
        add_arguments(commands.add_parser(name, help=help_text))
    return parser


if __name__ == "__main__":
    sys.exit(main())
