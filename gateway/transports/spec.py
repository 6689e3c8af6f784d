"""How a port is named: ``serial:/dev/ttyACM0?baud=115200`` or ``tcp:HOST:PORT``."""

from dataclasses import dataclass
from typing import TypeAlias
from urllib.parse import parse_qsl

from gateway.errors import TransportSpecError
from gateway.transports.interface import Transport
from gateway.transports.serial_port import open_serial
from gateway.transports.tcp import open_tcp

DEFAULT_BAUD = 115_200

_MAX_BAUD = 4_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialSpec:
    """A serial port, by path or by-id link."""

    path: str
    baud: int

    @property
    def name(self) -> str:
        """What the port is called, without its options."""
        return f"serial:{self.path}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TcpSpec:
    """A TCP port."""

    host: str
    port: int

    @property
    def name(self) -> str:
        """What the port is called."""
        return f"tcp:{self.host}:{self.port}"


PortSpec: TypeAlias = SerialSpec | TcpSpec


def parse_port_spec(spec: str) -> PortSpec:
    """Return what a port's name means.

    Raises
    ------
    TransportSpecError
        It means nothing; the message says why and gives examples.
    """
    kind, colon, rest = spec.partition(":")
    if not colon:
        raise TransportSpecError(spec=spec, reason="names no kind of port: it must begin with serial: or tcp:")
    if kind == "serial":
        return _parse_serial(spec, rest)
    if kind == "tcp":
        return _parse_tcp(spec, rest)
    if kind == "can":
        raise TransportSpecError(spec=spec, reason="CAN is not in this version")
    raise TransportSpecError(spec=spec, reason=f"unknown kind {kind!r}: it must be serial or tcp")


async def open_transport(spec: PortSpec) -> Transport:
    """Open a port.

    Raises
    ------
    TransportOpenError
        It cannot be opened now.
    """
    match spec:
        case SerialSpec(path=path, baud=baud):
            return await open_serial(path=path, baud=baud)
        case TcpSpec(host=host, port=port):
            return await open_tcp(host=host, port=port)


def _parse_serial(spec: str, rest: str) -> SerialSpec:
    path, question, query = rest.partition("?")
    if not path:
        raise TransportSpecError(spec=spec, reason="names no device")
    baud = DEFAULT_BAUD
    try:
        options = parse_qsl(query, strict_parsing=True) if question else []
    except ValueError as error:
        raise TransportSpecError(spec=spec, reason=f"options {query!r} are not of the form key=value") from error
    for key, value in options:
        if key != "baud":
            raise TransportSpecError(spec=spec, reason=f"unknown option {key!r}: the only one is baud")
        if not value.isascii() or not value.isdigit() or not 1 <= int(value) <= _MAX_BAUD:
            raise TransportSpecError(spec=spec, reason=f"baud is {value!r}, but must be a number from 1 to {_MAX_BAUD}")
        baud = int(value)
    return SerialSpec(path=path, baud=baud)


def _parse_tcp(spec: str, rest: str) -> TcpSpec:
    host, colon, port = rest.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    if not colon or not host:
        raise TransportSpecError(spec=spec, reason="must be tcp:HOST:PORT")
    if not port.isascii() or not port.isdigit() or not 1 <= int(port) <= 65_535:
        raise TransportSpecError(spec=spec, reason=f"the port is {port!r}, but must be a number from 1 to 65535")
    return TcpSpec(host=host, port=int(port))
