"""A radio behind a TCP port: a serial server, a network dongle, a simulator."""

import asyncio
import socket
from functools import partial

from gateway.errors import TransportClosedError, TransportHangsError, TransportOpenError, TransportSilentError
from gateway.transports.own_thread import OverdueError, call_in_own_thread

_READ_SIZE = 4096
_OPEN_TIMEOUT_S = 5.0
_NAME_TIMEOUT_S = 5.0
_WRITE_TIMEOUT_S = 5.0
_KEEPALIVE_IDLE_S = 15
_KEEPALIVE_INTERVAL_S = 5
_KEEPALIVE_PROBES = 3
_NOT_SENT_LIMIT = 512
"""Bytes that may wait unsent in the kernel: two frames of at most 253 bytes and their delimiters."""


class TcpTransport:
    """A connected TCP socket; see ``open_tcp``."""

    def __init__(self, *, name: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._name = name
        self._reader = reader
        self._writer = writer

    @property
    def name(self) -> str:
        """What the port is called."""
        return self._name

    async def read(self) -> bytes:
        """Return the next bytes; raise ``TransportClosedError`` when the other end has gone."""
        try:
            chunk = await self._reader.read(_READ_SIZE)
        except OSError as error:
            raise TransportClosedError(name=self._name, reason=str(error)) from error
        if not chunk:
            raise TransportClosedError(name=self._name, reason="the other end closed the connection")
        return chunk

    async def write(self, data: bytes) -> None:
        """Send ``data``; return when the kernel has it."""
        try:
            self._writer.write(data)
            transport = self._writer.transport
            if not transport.get_write_buffer_size() and not transport.is_closing():
                return  # the kernel has all of it
            async with asyncio.timeout(_WRITE_TIMEOUT_S):
                await self._writer.drain()
        except TimeoutError as error:
            raise TransportSilentError(name=self._name, reason=f"took nothing for {_WRITE_TIMEOUT_S:g} s") from error
        except OSError as error:
            raise TransportClosedError(name=self._name, reason=str(error)) from error

    def write_at_once(self, data: bytes) -> bytes:
        """Send all of ``data`` where nothing waits to be sent, else nothing; see ``Transport``."""
        transport = self._writer.transport
        if transport.is_closing() or transport.get_write_buffer_size():
            return data
        self._writer.write(data)  # what the kernel does not take waits there
        return b""

    async def aclose(self) -> None:
        """Close at once; unsent bytes are dropped."""
        self._writer.transport.abort()


async def open_tcp(*, host: str, port: int) -> TcpTransport:
    """Connect to ``host:port``.

    Raises
    ------
    TransportOpenError
        No connection within 5 s.
    TransportHangsError
        The host's name was not resolved within 5 s.
    """
    name = f"tcp:{host}:{port}"
    try:
        places = await _resolve(host, port)
        async with asyncio.timeout(_OPEN_TIMEOUT_S):
            reader, writer = await asyncio.open_connection(sock=await _connect(places), limit=2 * _READ_SIZE)
    except OverdueError as error:
        raise TransportHangsError(name=name, timeout_s=_NAME_TIMEOUT_S, is_over=error.is_over) from error
    except TimeoutError as error:
        reason = f"no answer within {_OPEN_TIMEOUT_S:g} s; is the address right, and the device on this network?"
        raise TransportOpenError(name=name, reason=reason) from error
    except ConnectionRefusedError as error:
        reason = f"{host} is there, but nothing listens on port {port}; is the port right, does the serial server or simulator run?"
        raise TransportOpenError(name=name, reason=reason) from error
    except (OSError, ValueError) as error:  # ValueError: a host's name that cannot be asked for, as one with an empty label
        raise TransportOpenError(name=name, reason=str(error)) from error
    writer.transport.set_write_buffer_limits(high=0)
    connection = writer.get_extra_info("socket")
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (
        ("TCP_KEEPIDLE", _KEEPALIVE_IDLE_S),
        ("TCP_KEEPINTVL", _KEEPALIVE_INTERVAL_S),
        ("TCP_KEEPCNT", _KEEPALIVE_PROBES),
        ("TCP_NOTSENT_LOWAT", _NOT_SENT_LIMIT),
    ):
        if hasattr(socket, option):  # they are Linux's names; elsewhere the system's defaults hold
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    return TcpTransport(name=name, reader=reader, writer=writer)


_Place = tuple[socket.AddressFamily, tuple[str, int] | tuple[str, int, int, int] | tuple[int, bytes]]


async def _resolve(host: str, port: int) -> list[_Place]:
    """Return where a host is. A name server may hang, so a name is asked for in a thread of its own; a numeric address asks nobody."""
    ask = partial(socket.getaddrinfo, host, port, type=socket.SOCK_STREAM)
    try:
        found = ask(flags=socket.AI_NUMERICHOST)
    except socket.gaierror:
        found = await call_in_own_thread(ask, name=f"resolve {host}", timeout_s=_NAME_TIMEOUT_S)
    return [(family, place) for family, _, _, _, place in found]


async def _connect(places: list[_Place]) -> socket.socket:
    """Return a socket that is connected to the first place that takes it, or raise what the last one said."""
    failure: OSError = OSError("the name has no address")
    for family, place in places:
        connection = socket.socket(family, socket.SOCK_STREAM)
        try:
            connection.settimeout(0)
            await asyncio.get_running_loop().sock_connect(connection, place)
        except OSError as error:
            connection.close()
            failure = error
        except BaseException:
            connection.close()
            raise
        else:
            return connection
    raise failure
