"""``biobot-gateway list-ports`` and ``probe``: what there is to open, and what answers there."""

import argparse
import asyncio
import json
from dataclasses import asdict

from firmware_protocol.errors import ConfigurationError
from gateway.commands.outcome import DONE, FAILED, complain, progress
from gateway.probing.findings import Finding, Verdict
from gateway.probing.probe import probe_port
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


def add_probe_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``probe``."""
    parser.add_argument(
        "ports", nargs="*", metavar="PORT", help="a device's path, or as --port of `run` has it; with baud= that speed alone is tried"
    )
    parser.add_argument("--all", action="store_true", help="all serial ports of this machine")
    parser.add_argument(
        "--intrusive",
        action="store_true",
        help="also toggle reset lines, restart boot loaders, and try +++ (an XBee in transparent mode sends over the air what it gets)",
    )
    parser.add_argument("--json", action="store_true", help="as JSON, one object a port")


def probe(options: argparse.Namespace) -> int:
    """Print what answers at each port; done only where all do."""
    ports = list(options.ports)
    if options.all:
        ports += [port.spec for port in list_serial_ports()]
    if not ports:
        if options.all:
            return complain("no serial port found", status=FAILED)
        raise ConfigurationError(["probe: no port is named; name some, such as /dev/ttyACM0, or give --all"])
    is_each_fit = True
    for port in ports:
        with progress() as tell:
            finding = asyncio.run(probe_port(port, is_intrusive=options.intrusive, on_try=tell))
        is_each_fit = is_each_fit and finding.verdict is Verdict.ANSWERS
        print(json.dumps(asdict(finding) | {"verdict": finding.verdict.value}) if options.json else _describe(finding), flush=True)
    return DONE if is_each_fit else FAILED


def _describe(finding: Finding) -> str:
    speed = f" at {finding.baud} baud" if finding.baud is not None else ""
    family = f": {finding.family}{speed}" if finding.family else ""
    told = [finding.firmware, *(f"{key.replace('_', ' ')} {value}" for key, value in finding.facts.items())]
    lines = [f"{finding.port}: {finding.verdict.value.replace('_', ' ')}{family}"]
    lines += ["  " + ", ".join(word for word in told if word)] if any(told) else []
    lines += [f"  note: {finding.advice}"] if finding.advice else []
    lines += [f"  use: --port '{finding.spec}'"] if finding.spec else []
    return "\n".join(lines)
