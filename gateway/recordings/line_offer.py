"""Offers a recorded dongle on a pseudo-terminal or a TCP port, so that another program hears it as it was heard then.

It only speaks: what the other program writes is read and dropped, so a base station that waits for answers of its own finds no dongle.
"""

import asyncio
import contextlib
import errno
import os
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

from gateway.errors import TransportOpenError, TransportSpecError

_POLL_S = 0.02
"""How often a terminal that nobody has open, or that is full, is looked at."""


class Offer(Protocol):
    """A line that somebody may open."""

    async def wait_for_reader(self) -> None:
        """Return when somebody has opened the line."""
        ...

    async def write(self, data: bytes) -> bool:
        """Send all of ``data``; False where the reader has gone."""
        ...

    async def wait_for_end(self) -> None:
        """Return when the reader has gone."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class OfferSpec:
    """``pty:PATH`` or ``tcp:HOST:PORT``."""

    path: Path | None = None
    host: str = ""
    port: int = 0


def parse_offer(text: str) -> OfferSpec:
    """Read ``pty:PATH`` or ``tcp:HOST:PORT``; port 0 is any that is free.

    Raises
    ------
    TransportSpecError
        The text is neither.
    """
    kind, _, rest = text.partition(":")
    host, _, port = rest.rpartition(":")
    if kind == "pty" and rest:
        return OfferSpec(path=Path(rest))
    if kind == "tcp" and host and port.isascii() and port.isdigit() and int(port) <= 0xFFFF:
        return OfferSpec(host=host.strip("[]"), port=int(port))
    raise TransportSpecError(spec=text, reason="a recording is offered as pty:PATH or tcp:HOST:PORT")


@asynccontextmanager
async def offered(spec: OfferSpec) -> AsyncIterator[tuple[Offer, str]]:
    """Offer a line while the context lasts; yields it and what to open.

    Raises
    ------
    TransportOpenError
        The path or the port cannot be had.
    """
    if spec.path is not None:
        with _PtyOffer(spec.path) as pty:
            yield pty, f"serial:{spec.path}"
        return
    tcp = _TcpOffer()
    try:
        server = await asyncio.start_server(tcp.accept, spec.host, spec.port)
    except OSError as error:
        reason = f"cannot listen: {error.strerror or error}; choose another port"
        raise TransportOpenError(name=f"tcp:{spec.host}:{spec.port}", reason=reason) from error
    try:
        host, port = server.sockets[0].getsockname()[:2]
        yield tcp, f"tcp:{host}:{port}"
    finally:
        tcp.hang_up()
        server.close()


class _PtyOffer:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self._name = os.ttyname(slave)
        os.close(slave)  # held open by us, a reader's hang-up could not be noticed

    def __enter__(self) -> Self:
        try:
            if self._path.is_symlink() and str(self._path.readlink()).startswith("/dev/pts/"):
                self._path.unlink()
            self._path.symlink_to(self._name)
        except OSError as error:
            os.close(self._master)
            reason = f"cannot be made: {error.strerror}; choose another path, or remove it"
            raise TransportOpenError(name=f"pty:{self._path}", reason=reason) from error
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            if str(self._path.readlink()) == self._name:
                self._path.unlink()
        os.close(self._master)

    async def wait_for_reader(self) -> None:
        while not self._is_there():  # noqa: ASYNC110  # a terminal that nobody has open is readable all the time
            await asyncio.sleep(_POLL_S)

    async def write(self, data: bytes) -> bool:
        while data:
            if not self._is_there():
                return False
            try:
                data = data[os.write(self._master, data) :]
            except BlockingIOError:
                await asyncio.sleep(_POLL_S)
            except OSError:
                return False
        return True

    async def wait_for_end(self) -> None:
        while self._is_there():  # noqa: ASYNC110  # same
            await asyncio.sleep(_POLL_S)

    def _is_there(self) -> bool:
        """Tell whether somebody has the terminal open; what they wrote is dropped on the way."""
        try:
            while os.read(self._master, 4096):
                pass
        except BlockingIOError:
            return True
        except OSError as error:
            if error.errno != errno.EIO:
                raise
        return False


class _TcpOffer:
    def __init__(self) -> None:
        self._writer: asyncio.StreamWriter | None = None
        self._has_reader = asyncio.Event()
        self._is_over = asyncio.Event()

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._writer is not None:
            writer.close()
            return
        self._writer = writer
        self._has_reader.set()
        with contextlib.suppress(OSError):
            while await reader.read(4096):
                pass
        self._is_over.set()
        writer.close()

    async def wait_for_reader(self) -> None:
        await self._has_reader.wait()

    async def write(self, data: bytes) -> bool:
        assert self._writer is not None
        try:
            self._writer.write(data)
            await self._writer.drain()
        except OSError:
            return False
        return not self._is_over.is_set()

    async def wait_for_end(self) -> None:
        with contextlib.suppress(OSError):
            if self._writer is not None and self._writer.can_write_eof():
                self._writer.write_eof()
        await self._is_over.wait()

    def hang_up(self) -> None:
        if self._writer is not None:
            self._writer.transport.abort()
