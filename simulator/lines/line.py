"""What every serial line to a gateway has in common: how it is named, what it does, how it is paced and waited for.

A line behaves as a wire does: what is written while nobody listens is lost, and a listener may come, go and come back. It may be
paced to a baud rate; a pty or TCP port is as fast as it can be otherwise.
"""

import asyncio
import errno
import os
import select
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from simulator.dongles.choice import DEFAULT_DIALECT, DONGLES, host_dialect
from simulator.errors import ParameterError

_CHUNK = 4096
_PACED_CHUNK = 64
_BITS_PER_BYTE = 10  # 8N1: start bit, eight data bits, stop bit
_MAX_UNIT = 31
EXAMPLES = "pty:/tmp/dongle, tcp:127.0.0.1:7000, serial:/dev/ttyUSB0?baud=115200 or slcan:/tmp/can?unit=1"


class SerialEnd(Protocol):
    """The simulator's end of a line."""

    @property
    def address(self) -> str:
        """Return what a gateway is to open, in the same form as the specification."""

    async def read(self) -> bytes:
        """Wait for bytes from the gateway, for ever where none come; never empty."""

    async def write(self, data: bytes) -> None:
        """Send bytes to the gateway; where none listens they are lost. Waits while a listener is slow."""

    async def unplug(self) -> None:
        """Pull the cable: the gateway loses the line, and does not find it again until ``plug_in``; nobody may read or write till then."""

    async def plug_in(self) -> None:
        """Put the cable back, under the same address.

        Raises
        ------
        LineError
            Somebody else has taken the line's place.
        """

    async def aclose(self) -> None:
        """Hang up, plugged in or not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSpec:
    """What ``--link`` asks for."""

    kind: str
    target: str
    port: int = 0
    baud: int | None = None
    dialect: str = DEFAULT_DIALECT

    @property
    def gateway_options(self) -> str:
        """What a gateway must say behind the line's address, so that it speaks the dialect; an slcan adapter's address says it already."""
        spoken = host_dialect(self.dialect)
        return "" if self.kind == "slcan" or spoken == DEFAULT_DIALECT else f"?dialect={spoken}"


def parse_line(text: str) -> LineSpec:
    """Read ``pty:PATH``, ``tcp:HOST:PORT`` or ``serial:DEVICE`` with ``?baud=N&dialect=NAME`` if wanted, or ``slcan:PATH?unit=N&fd=1``.

    Raises
    ------
    ParameterError
        The text is none of these.
    """
    wrong = ParameterError(name="link", got=text, wanted=f"a line such as {EXAMPLES}")
    kind, colon, rest = text.partition(":")
    target, question, query = rest.partition("?")
    if not colon or not target:
        raise wrong
    if kind == "slcan":
        return LineSpec(kind=kind, target=target, dialect=_parse_can_options(text, query))
    options = _parse_options(text, query) if question else {}
    baud = int(options["baud"]) if "baud" in options else None
    dialect = options.get("dialect", DEFAULT_DIALECT)
    if kind in {"pty", "serial"}:
        return LineSpec(kind=kind, target=target, baud=baud, dialect=dialect)
    if kind == "tcp":
        host, _, port = target.rpartition(":")
        if host and port.isascii() and port.isdigit() and int(port) <= 0xFFFF:
            return LineSpec(kind=kind, target=host.strip("[]"), port=int(port), baud=baud, dialect=dialect)
    raise wrong


def _parse_options(text: str, query: str) -> dict[str, str]:
    wanted = f"?baud= with 50 to 12000000, dialect= with one of {', '.join(DONGLES)}, joined by &, and nothing else after the line's name"
    options: dict[str, str] = {}
    for option in query.split("&"):
        key, _, value = option.partition("=")
        is_baud = key == "baud" and value.isascii() and value.isdigit() and 50 <= int(value) <= 12_000_000
        if key in options or not (is_baud or (key == "dialect" and value in DONGLES)):
            raise ParameterError(name="link", got=text, wanted=wanted)
        options[key] = value
    return options


def _parse_can_options(text: str, query: str) -> str:
    """Return the dialect of a coordinator behind an slcan adapter."""
    options = {"unit": "1", "fd": "0"} | dict(option.partition("=")[::2] for option in query.split("&") if option)
    unit, is_fd = options["unit"], options["fd"]
    is_unit = unit.isascii() and unit.isdigit() and int(unit) <= _MAX_UNIT
    if len(options) > 2 or not is_unit or is_fd not in {"0", "1"}:
        raise ParameterError(name="link", got=text, wanted=f"?unit= with 0 to {_MAX_UNIT}, fd= with 0 or 1, joined by &, and nothing else")
    return f"{'canfd' if is_fd == '1' else 'can'}:{int(unit)}"


class Pacer:
    """Makes bytes take the time that a line of some speed needs for them."""

    def __init__(self, baud: int | None) -> None:
        self._s_per_byte = _BITS_PER_BYTE / baud if baud else 0.0
        self._free_at_s = 0.0
        self.chunk = _PACED_CHUNK if baud else _CHUNK

    async def pace(self, n_bytes: int) -> None:
        """Wait until the line has carried ``n_bytes`` more."""
        if self._s_per_byte:
            now_s = asyncio.get_running_loop().time()
            self._free_at_s = max(self._free_at_s, now_s) + n_bytes * self._s_per_byte
            await asyncio.sleep(self._free_at_s - now_s)


async def write_all(fd: int, data: bytes, *, pacer: Pacer) -> None:
    """Write to the master side of a terminal; where nobody has the other side open, the rest is lost."""
    loop = asyncio.get_running_loop()
    at = 0
    while at < len(data):
        try:
            written = os.write(fd, data[at : at + pacer.chunk])
        except BlockingIOError:
            if _is_hung_up(fd):  # a terminal whose buffer was full when its reader left stays full, and says so instead of EIO
                return
            await wait_ready(fd, loop.add_writer, loop.remove_writer)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            return
        else:
            at += written
            await pacer.pace(written)


async def wait_ready(fd: int, add: Callable[..., None], remove: Callable[[int], bool]) -> None:
    """Wait until a descriptor is ready for what ``add`` and ``remove`` of the event loop watch."""
    ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def wake() -> None:
        if not ready.done():
            ready.set_result(None)

    add(fd, wake)
    try:
        await ready
    finally:
        remove(fd)


def _is_hung_up(fd: int) -> bool:
    poll = select.poll()
    poll.register(fd, 0)
    return any(events & select.POLLHUP for _, events in poll.poll(0))
