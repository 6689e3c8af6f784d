"""A listening TCP port that a gateway connects to as if it were a dongle behind a serial server."""

import asyncio
import socket

from simulator.errors import LineError
from simulator.lines.line import Pacer
from simulator.log import EventLog

log = EventLog(__name__)


class TcpEnd:
    """One gateway at a time may be connected; see ``listen``."""

    def __init__(self, *, baud: int | None = None) -> None:
        self._in, self._out = Pacer(baud), Pacer(baud)
        self._host, self._port = "", 0
        self._server: asyncio.Server | None = None
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._connected = asyncio.Event()

    @classmethod
    async def listen(cls, host: str, port: int, *, baud: int | None = None) -> "TcpEnd":
        """Open the port; 0 chooses a free one.

        Raises
        ------
        LineError
            The address is not ours, or the port is taken.
        """
        end = cls(baud=baud)
        end._host, end._port = host, port
        await end.plug_in()
        return end

    @property
    def address(self) -> str:
        """Return ``tcp:HOST:PORT`` with the port that was chosen."""
        return f"tcp:{self._host}:{self._port}"

    @property
    def is_connected(self) -> bool:
        """A gateway is connected, as far as we know."""
        return self._writer is not None

    async def read(self) -> bytes:
        """See ``SerialEnd``."""
        while True:
            await self._connected.wait()
            reader = self._reader
            assert reader is not None
            try:
                data = await reader.read(self._in.chunk)
            except OSError:
                data = b""
            if data:
                await self._in.pace(len(data))
                return data
            self._forget(reader)

    async def write(self, data: bytes) -> None:
        """See ``SerialEnd``."""
        for at in range(0, len(data), self._out.chunk):
            writer, piece = self._writer, data[at : at + self._out.chunk]
            if writer is None:
                return
            try:
                writer.write(piece)
                await writer.drain()
            except OSError:
                return  # the reader notices it too, and forgets the connection
            await self._out.pace(len(piece))

    async def unplug(self) -> None:
        """See ``SerialEnd``: drop the connection, and refuse others."""
        if self._reader is not None:
            self._forget(self._reader)
        if self._server is not None:
            self._server.close()
        self._server = None

    async def plug_in(self) -> None:
        """See ``SerialEnd``: listen on the port."""
        try:
            self._server = await asyncio.start_server(self._accept, self._host, self._port)
        except OSError as error:
            raise LineError(line=self.address, problem=f"cannot listen: {error.strerror or error}; choose another port") from error
        self._host, self._port = self._server.sockets[0].getsockname()[:2]

    async def aclose(self) -> None:
        """Close the connection and the port."""
        await self.unplug()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = writer.get_extra_info("peername")
        if self._writer is not None:
            log.warning("line.refused", peer=peer, reason="another gateway is connected")
            writer.close()
            return
        _watch_connection(writer.get_extra_info("socket"))
        self._reader, self._writer = reader, writer
        self._connected.set()
        log.info("line.connected", peer=peer)

    def _forget(self, reader: asyncio.StreamReader) -> None:
        if self._reader is reader and self._writer is not None:
            self._connected.clear()
            # Not close(): that would wait for a peer that does not read, and so would whoever is in drain().
            self._writer.transport.abort()
            self._reader = self._writer = None
            log.info("line.disconnected")


def _watch_connection(connection: socket.socket) -> None:
    """Send at once, and notice within about 10 s that a gateway's machine is gone, so that its place is free again."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 4)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 2)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 10_000)
