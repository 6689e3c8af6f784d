"""What would stand in the way of a gateway or router that were started now, though its configuration is well: it depends on the moment.

Places to listen at that another program has, a journal that another gateway writes, dongles that are not plugged in. None of it is a fault
of the configuration: the other program may be the very service whose file is checked, and a dongle may come later.
"""

import errno
import os
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

from firmware_protocol.contract.sessions import host_and_port
from gateway.config import GatewayConfig
from gateway.config_loading import read_address
from gateway.errors import TransportSpecError
from gateway.journal_file import is_in_use
from gateway.transports.can_spec import CanSpec
from gateway.transports.spec import SerialSpec, parse_port_spec

PLACEHOLDER = "ROUTER"
"""Stands for a router's address in what `certs issue` prints where the authority has no router's certificate yet."""

_NETWORK_INTERFACES = Path("/sys/class/net")


def gateway_obstacles(config: GatewayConfig) -> list[str]:
    """Return what a gateway of this configuration would meet, a sentence each; nothing is made, written or opened for it."""
    return [
        *listening_obstacles(config.listen),
        *connecting_obstacles(config.connect),
        *_monitor_obstacles(config.monitor.listen),
        *_journal_obstacles(Path(config.journal)),
        *(found for port in config.ports for found in _port_obstacles(port)),
    ]


def listening_obstacles(endpoints: Sequence[str]) -> Iterator[str]:
    """Yield which of these Zenoh endpoints cannot be listened on now."""
    for endpoint in endpoints:
        address = host_and_port(endpoint)
        if address is not None and (why := why_taken(*address)):
            yield f"listen: {endpoint}: {why}; {_what_listens(address[1])}, or name another port"


def connecting_obstacles(endpoints: Sequence[str]) -> Iterator[str]:
    """Yield which endpoints still have the word in them that stands for a router's address."""
    for endpoint in endpoints:
        if (address := host_and_port(endpoint)) is not None and address[0] == PLACEHOLDER:
            yield f"connect: {endpoint}: {PLACEHOLDER} stands for the router's address; put its name or address there, as its --host has it"


def why_taken(host: str, port: int) -> str:
    """Return why nothing can be listened on there now, or nothing. Port 0 takes a free one."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except OSError as error:
        return "another program has it" if error.errno == errno.EADDRINUSE else (error.strerror or str(error)).lower()
    return ""


def _what_listens(port: int) -> str:
    return f"end what listens there, if it is not this service itself (ss -ltnp 'sport = :{port}' names it)"


def _monitor_obstacles(address: str) -> Iterator[str]:
    if address:
        host, port = read_address(address)
        if why := why_taken(host, port):
            yield f"monitor.listen: {address}: {why}; {_what_listens(port)}, or name another port"


def _journal_obstacles(path: Path) -> Iterator[str]:
    if is_in_use(path):
        yield f"journal {path}: a gateway has it open; stop that one if it is not this service itself, or name another file"


def _port_obstacles(port: str) -> Iterator[str]:
    try:
        spec = parse_port_spec(port)
    except TransportSpecError:
        return  # that is a fault of the configuration, and told as one
    match spec:
        case SerialSpec(path=path) | CanSpec(interface="slcan", channel=path):
            if not os.path.exists(path):  # noqa: PTH110  # of a path with odd characters, pathlib raises
                yield f"port {spec.name}: {path} is not there; plug the dongle in: `biobot-gateway list-ports` shows what is"
            elif not os.access(path, os.R_OK | os.W_OK):
                yield f"port {spec.name}: {path} may not be opened by this user; join the group that owns it, often `dialout`"
        case CanSpec(interface="socketcan", channel=channel) if not (_NETWORK_INTERFACES / channel).exists():
            yield f"port {spec.name}: there is no network interface {channel}; plug the adapter in: `ip link` shows what is"
