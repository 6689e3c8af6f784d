"""How a port is named: ``serial:/dev/ttyACM0?baud=115200&dialect=xbee``, ``tcp:HOST:PORT?dialect=znp`` or ``can:socketcan:can0?unit=1``.

``dialect=can`` and ``dialect=canfd`` on a serial or TCP port are a CAN bus as a line of records, one a frame (``framing/can_frame.py``), as
a simulator's line makes and a recording holds: no adapter for a bus speaks so. Those are ``can:slcan:...`` and ``can:socketcan:...``.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias
from urllib.parse import parse_qsl

from firmware_protocol.dialects.choice import CAN_DIALECTS, DEFAULT_DIALECT, DIALECTS, FORMING_DIALECTS
from firmware_protocol.dialects.interface import NetworkWish
from gateway.errors import TransportSpecError
from gateway.transports.can_port import CanBuses
from gateway.transports.can_spec import OPTIONS, CanSpec, read_can_spec
from gateway.transports.interface import Transport
from gateway.transports.serial_port import LineReset, open_serial
from gateway.transports.tcp import open_tcp

DEFAULT_BAUD = 115_200

_MAX_BAUD = 4_000_000
_BITS_PER_BYTE = 10  # start bit, eight data bits, stop bit
_MAX_HOST = 253  # RFC 1035, 2.3.4: 255 octets with the lengths of the labels, of at most 63 octets each
_MAX_LABEL = 63
_USUAL_RESETS = {"znp": LineReset.RTS}
"""Sticks that speak Z-Stack are mostly wired so; where the wires lead nowhere, nothing happens."""
_NETWORK_OPTIONS = {"pan_id": range(0xFFFF), "channel": range(11, 27), "permit_join_s": range(255)}


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialSpec:
    """A serial port, by path or by-id link; ``reset`` is how its line resets a dongle that has fallen silent."""

    path: str
    baud: int
    dialect: str = DEFAULT_DIALECT
    network: NetworkWish | None = None
    reset: LineReset = LineReset.NONE

    @property
    def name(self) -> str:
        """What the port is called, without its options."""
        return f"serial:{self.path}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TcpSpec:
    """A TCP port; ``baud`` is that of the serial line behind it."""

    host: str
    port: int
    baud: int = DEFAULT_BAUD
    dialect: str = DEFAULT_DIALECT
    network: NetworkWish | None = None

    @property
    def name(self) -> str:
        """What the port is called."""
        return f"tcp:{self.host}:{self.port}"


PortSpec: TypeAlias = SerialSpec | TcpSpec | CanSpec


def parse_port_spec(spec: str) -> PortSpec:
    """Return what a port's name means.

    Raises
    ------
    TransportSpecError
        It means nothing; the message says why and gives examples.
    """
    kind, colon, rest = spec.partition(":")
    if not colon or spec.startswith("/"):
        hint = f"; did you mean serial:{spec}?" if spec.startswith("/") else ""
        raise TransportSpecError(spec=spec, reason=f"names no kind of port: it must begin with serial:, tcp: or can:{hint}")
    if kind == "serial":
        return _parse_serial(spec, rest)
    if kind == "tcp":
        return _parse_tcp(spec, rest)
    if kind == "can":
        return read_can_spec(spec, *_split_options(spec, rest, allowed=OPTIONS))
    raise TransportSpecError(spec=spec, reason=f"unknown kind {kind!r}: it must be serial, tcp or can")


async def open_transport(spec: PortSpec, *, can_buses: CanBuses | None = None, is_reset: bool = False) -> Transport:
    """Open a port.

    Parameters
    ----------
    can_buses
        The buses that this process has open: coordinators of one bus share it. None: there is no other.
    is_reset
        Reset the dongle by its line, in the way that its port names.

    Raises
    ------
    TransportOpenError
        It cannot be opened now.
    """
    match spec:
        case SerialSpec(path=path, baud=baud):
            return await open_serial(path=path, baud=baud, reset=spec.reset if is_reset else LineReset.NONE)
        case TcpSpec(host=host, port=port):
            return await open_tcp(host=host, port=port)
        case CanSpec():
            return await (can_buses or CanBuses()).open(spec)


def port_problems(ports: Sequence[str]) -> list[str]:
    """Return what is wrong with a list of ports, a sentence each: one means nothing, is there twice, or is the same device as another.

    Devices are compared as they are plugged in now; one that comes later is refused when it is opened.
    """
    problems: list[str] = []
    named: dict[str, PortSpec] = {}
    buses: dict[str, CanSpec] = {}
    devices: dict[str, PortSpec] = {}
    for text in ports:
        try:
            port = parse_port_spec(text)
        except TransportSpecError as error:
            problems.append(str(error))
            continue
        if port.name in named:
            problems.append(f"port {port.name} is named twice; name each radio once")
            continue
        named[port.name] = port
        bus = buses.setdefault(port.bus_name, port) if isinstance(port, CanSpec) else None
        if bus is not None and isinstance(port, CanSpec) and port.bus_options != bus.bus_options:
            problems.append(
                f"port {port.name} has {port.bus_options}, but another unit of the same bus {bus.bus_options}: "
                "they are the same for all units of a bus"
            )
        device = _device_of(port)
        other = devices.setdefault(device, port) if device else port
        if other is not port and (bus is None or other is not bus):
            problems.append(f"port {port.name} is the same device as {other.name}, {device}: name it once")
    return problems


def _device_of(port: PortSpec) -> str:
    """Return the path of a port's device, as it is now, or nothing where it has none."""
    match port:
        case SerialSpec(path=path) | CanSpec(interface="slcan", channel=path):
            return str(Path(path).resolve())
        case _:
            return ""


def bytes_per_s(spec: PortSpec) -> float | None:
    """Return what the serial line of a port carries [bytes/s]; None where there is none."""
    return None if isinstance(spec, CanSpec) or spec.dialect in CAN_DIALECTS else spec.baud / _BITS_PER_BYTE


def can_reset(spec: PortSpec) -> bool:
    """Return whether a port says how its dongle is reset by its line."""
    return isinstance(spec, SerialSpec) and spec.reset is not LineReset.NONE


def _parse_serial(spec: str, rest: str) -> SerialSpec:
    path, options = _split_options(spec, rest, allowed=("baud", "dialect", "reset", *_NETWORK_OPTIONS))
    if not path:
        raise TransportSpecError(spec=spec, reason="names no device")
    if "\0" in path:
        raise TransportSpecError(spec=spec, reason="the device's path has a null character in it")
    dialect = _dialect(spec, options)
    return SerialSpec(
        path=path, baud=_baud(spec, options), dialect=dialect, network=_network(spec, options), reset=_reset(spec, options, dialect=dialect)
    )


def _parse_tcp(spec: str, rest: str) -> TcpSpec:
    place, options = _split_options(spec, rest, allowed=("baud", "dialect", *_NETWORK_OPTIONS))
    host, colon, port = place.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    if not colon or not host:
        raise TransportSpecError(spec=spec, reason="must be tcp:HOST:PORT")
    if why := _why_no_host(host):
        raise TransportSpecError(spec=spec, reason=f"the host {why}")
    if not 1 <= _read_number(port, with_hex=False) <= 65_535:
        raise TransportSpecError(spec=spec, reason=f"the port is {port!r}, but must be a number from 1 to 65535")
    return TcpSpec(host=host, port=int(port), baud=_baud(spec, options), dialect=_dialect(spec, options), network=_network(spec, options))


def _split_options(spec: str, rest: str, *, allowed: tuple[str, ...]) -> tuple[str, dict[str, str]]:
    """Return what stands before the question mark, and the options after it."""
    place, question, query = rest.partition("?")
    try:
        pairs = parse_qsl(query, strict_parsing=True) if question else []
    except ValueError as error:
        raise TransportSpecError(spec=spec, reason=f"options {query!r} are not of the form key=value") from error
    options: dict[str, str] = {}
    for key, value in pairs:
        if key not in allowed:
            raise TransportSpecError(spec=spec, reason=f"unknown option {key!r}; known here: {', '.join(allowed)}")
        if key in options:
            raise TransportSpecError(spec=spec, reason=f"option {key!r} is given twice")
        options[key] = value
    return place, options


def _baud(spec: str, options: dict[str, str]) -> int:
    baud = options.get("baud", str(DEFAULT_BAUD))
    if not 1 <= _read_number(baud, with_hex=False) <= _MAX_BAUD:
        raise TransportSpecError(spec=spec, reason=f"baud is {baud!r}, but must be a number from 1 to {_MAX_BAUD}")
    return int(baud)


def _dialect(spec: str, options: dict[str, str]) -> str:
    dialect = options.get("dialect", DEFAULT_DIALECT)
    if dialect not in DIALECTS:
        raise TransportSpecError(spec=spec, reason=f"unknown dialect {dialect!r}: it must be one of {', '.join(DIALECTS)}")
    return dialect


def _reset(spec: str, options: dict[str, str], *, dialect: str) -> LineReset:
    text = options.get("reset", _USUAL_RESETS.get(dialect, LineReset.NONE).value)
    try:
        return LineReset(text)
    except ValueError as error:
        known = ", ".join(one.value for one in LineReset)
        raise TransportSpecError(spec=spec, reason=f"reset is {text!r}, but must be one of {known}") from error


def _network(spec: str, options: dict[str, str]) -> NetworkWish | None:
    values: dict[str, int] = {}
    for key, allowed in _NETWORK_OPTIONS.items():
        if key not in options:
            continue
        if (dialect := _dialect(spec, options)) not in FORMING_DIALECTS:
            names = " or ".join(FORMING_DIALECTS)
            raise TransportSpecError(
                spec=spec, reason=f"{key} is for dialect {names}, not {dialect}; docs/dongles.md says how to set its network"
            )
        values[key] = _read_number(options[key])
        if values[key] not in allowed:
            reason = f"{key} is {options[key]!r}, but must be a number from {allowed[0]} to {allowed[-1]}"
            raise TransportSpecError(spec=spec, reason=reason)
    return NetworkWish(**values) if values else None


def _read_number(text: str, *, with_hex: bool = True) -> int:
    """Return what a plain decimal number says, or one with 0x; -1 for anything else."""
    if re.fullmatch(r"[0-9]{1,10}", text):
        return int(text)
    return int(text, 16) if with_hex and re.fullmatch(r"0[xX][0-9a-fA-F]{1,8}", text) else -1


def _why_no_host(host: str) -> str:
    """Return why a name or address can be no host's, or nothing."""
    if any(character.isspace() or not character.isprintable() for character in host):
        return f"is {host!r}, which has blanks or control characters in it"
    labels = host.removesuffix(".").split(".")
    if not all(labels):
        return f"is {host!r}, which has nothing between two dots, or before the first"
    try:
        encoded = host.encode("idna")
    except UnicodeError:
        return f"is {host!r}, which has a part of more than {_MAX_LABEL} characters, or some that no name can have"
    return "" if len(encoded) <= _MAX_HOST else f"has {len(encoded)} characters, but at most {_MAX_HOST} are allowed"
