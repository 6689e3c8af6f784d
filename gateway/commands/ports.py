"""``biobot-gateway list-ports``: what there is to open."""

import argparse
import json
from dataclasses import asdict

from gateway.commands.outcome import DONE, complain
from gateway.transports.serial_port import list_serial_ports


def add_list_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``list-ports``."""
    parser.add_argument("--json", action="store_true", help="as JSON")


def list_ports(options: argparse.Namespace) -> int:
    """Print the serial ports of this machine."""
    ports = list_serial_ports()
    if options.json:
        print(json.dumps([asdict(port) | {"spec": port.spec} for port in ports], indent=2))
        return DONE
    for port in ports:
        usb = f"{port.vid:04x}:{port.pid:04x}" if port.vid is not None and port.pid is not None else "-"
        print(f"{port.spec}  {port.device}  {usb}  {port.description}")
    if not ports:
        complain("no serial port found")
    return DONE
