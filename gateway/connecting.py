"""Why nobody is connected: each endpoint is tried once by hand, because Zenoh tells only that it could not connect."""

import errno
import socket
import ssl
import time
from collections.abc import Sequence

from firmware_protocol.contract.handshakes import Handshake, explain, no_such_host
from firmware_protocol.contract.sessions import SECURE_PREFIXES, TlsTable, endpoint_problem, host_and_port
from gateway.tls_files import client_context

_CONNECT_S = 2.0
_ALERT_S = 0.7
"""A server that refuses the client's certificate says so within this after the handshake."""

_ACCEPTED = "it accepts the connection, but no Zenoh session came about; does a router or gateway listen there?"


def diagnose(endpoint: str, tls: TlsTable) -> str:
    """Return why a session with an endpoint does not come about; takes up to 3 s and never raises."""
    address = host_and_port(endpoint)
    if address is None:
        return endpoint_problem(endpoint, listens=False) or "only tcp/ and tls/ endpoints can be tried by hand; see the other side's log"
    host, port = address
    try:
        with socket.create_connection((host, port), timeout=_CONNECT_S) as line:
            if not endpoint.startswith(SECURE_PREFIXES):
                return _ACCEPTED
            return _shake_hands(line, host=host, tls=tls)
    except ConnectionRefusedError:
        return "nobody listens there; is the gateway or router running, and the port right?"
    except TimeoutError:
        return f"no answer within {_CONNECT_S:g} s; is the machine on, and the network there?"
    except ssl.SSLError as error:
        return explain(error)
    except socket.gaierror:
        return no_such_host(host)
    except OSError as error:
        return f"cannot be reached: {(error.strerror or str(error)).lower()}"


def diagnose_all(endpoints: Sequence[str], tls: TlsTable) -> dict[str, str]:
    """Return the reason for each endpoint."""
    return {endpoint: diagnose(endpoint, tls) for endpoint in endpoints}


def why_not_listening(endpoint: str) -> str | None:
    """Return why an endpoint that Zenoh could not listen on cannot be, or None where that is not plain."""
    address = host_and_port(endpoint)
    if address is None:
        return endpoint_problem(endpoint, listens=True)
    host, port = address
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        with socket.socket(family, kind, protocol) as line:
            line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as Zenoh does: a port that was just left is free
            line.bind(place)
            line.listen(1)
    except socket.gaierror:
        return no_such_host(host)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return "another program has that port; is a gateway or router running already? Stop it, or give another --listen"
        if error.errno == errno.EADDRNOTAVAIL:
            return f"{host} is no address of this machine; give one of its own, or 0.0.0.0 for all"
        return f"{(error.strerror or str(error)).lower()}; give another --listen"
    return None


def _shake_hands(line: socket.socket, *, host: str, tls: TlsTable) -> str:
    handshake = Handshake(client_context(tls), host=host)
    received = b""
    deadline_s = time.monotonic() + _CONNECT_S
    while time.monotonic() < deadline_s:
        line.sendall(handshake.step(received))
        line.settimeout(_ALERT_S if handshake.is_done else _CONNECT_S)
        try:
            received = line.recv(65_536)
        except TimeoutError:
            return _ACCEPTED if handshake.is_done else "it does not answer to TLS; is it tcp/ there?"
        if not received:
            return "the other side hung up after the handshake" if handshake.is_done else "the other side hung up; is it tcp/ there?"
    return _ACCEPTED
