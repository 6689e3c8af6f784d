"""A dongle on a serial port: the event loop watches its descriptor; opening and closing, which may hang, have a thread of their own."""

import asyncio
import contextlib
import fcntl
import os
import termios
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TypeVar

import serial
from serial.tools import list_ports

from gateway.errors import TransportClosedError, TransportHangsError, TransportOpenError, TransportSilentError
from gateway.transports.own_thread import OverdueError, call_in_own_thread

_ResultT = TypeVar("_ResultT")

_READ_SIZE = 4096
_WRITE_TIMEOUT_S = 5.0
_MAX_WAITING = 100
"""Bytes that may wait in the driver before the next frame is written: about one frame, of 40 to 90 bytes where it carries a payload."""

_OPEN_TIMEOUT_S = 10.0
_CLOSE_TIMEOUT_S = 5.0
_PULSE_S = 0.15
_BREAK_S = 0.25
_PTY_MAJORS = range(136, 144)  # Documentation/admin-guide/devices.txt: Unix98 pty slaves

_BITS_PER_BYTE = 10  # start bit, eight data bits, stop bit
_BY_ID = Path("/dev/serial/by-id")


class LineReset(Enum):
    """How a dongle is reset by its serial line, where it is wired so."""

    NONE = "none"
    RTS = "rts"
    """RTS pulls the reset pin while DTR, which chooses the boot loader, is left alone: CC2652 sticks behind a CP210x or CH340."""
    DTR = "dtr"
    """DTR pulls the reset pin, as on boards with an Arduino's circuit."""
    BREAK = "break"
    """A break of 250 ms, for firmware of one's own that takes it for a reset."""


_PULSES: dict[LineReset, tuple[tuple[bool, bool], ...]] = {
    LineReset.RTS: ((False, False), (False, True), (False, False)),
    LineReset.DTR: ((False, False), (True, False), (False, False)),
}
"""DTR and RTS, each held for ``_PULSE_S``. The first of them: zigbee-herdsman does the same for CC2652 boards."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialPortInfo:
    """A serial port of this machine; ``by_id`` names it the same after unplugging."""

    device: str
    by_id: str | None
    vid: int | None
    pid: int | None
    serial_number: str | None
    description: str

    @property
    def spec(self) -> str:
        """How to name the port on the command line."""
        return f"serial:{self.by_id or self.device}"


class SerialTransport:
    """An open serial port; see ``open_serial``."""

    def __init__(self, *, name: str, port: serial.Serial) -> None:
        self._name = name
        self._port = port
        self._fd: int = port.fileno()
        self._is_closed = False
        self._unread = b""
        self._end: str | None = None
        """Why nothing more can be read."""
        self._is_watched = False
        self._awaited: asyncio.Future[None] | None = None
        self._n_may_wait = 0
        """Bytes that may still wait in the driver: what was written since it was last asked, and what it said then."""

    @property
    def name(self) -> str:
        """What the port is called."""
        return self._name

    async def read(self) -> bytes:
        """Return the next bytes; raise ``TransportClosedError`` when the device is unplugged."""
        while not self._unread:
            self._check_open()
            if self._end is not None:
                raise TransportClosedError(name=self._name, reason=self._end)
            loop = asyncio.get_running_loop()
            if not self._is_watched:
                loop.add_reader(self._fd, self._take)
                self._is_watched = True
            self._awaited = loop.create_future()
            await self._awaited
        chunk, self._unread = self._unread, b""
        return chunk

    async def write(self, data: bytes) -> None:
        """Send ``data`` when at most about one frame waits before it."""
        try:
            rest = self._write_at_once(data)
            if rest:
                async with asyncio.timeout(_WRITE_TIMEOUT_S):
                    await self._write_in_time(rest)
        except TimeoutError as error:
            raise TransportSilentError(name=self._name, reason=f"took nothing for {_WRITE_TIMEOUT_S:g} s") from error
        except OSError as error:
            raise TransportClosedError(name=self._name, reason=f"unplugged ({error.strerror})") from error

    def write_at_once(self, data: bytes) -> bytes:
        """Send what goes without waiting; see ``Transport``."""
        try:
            return self._write_at_once(data)
        except (OSError, TransportClosedError):
            return data

    async def aclose(self) -> None:
        """Close the port; bytes that the driver still holds are dropped. A closing that hangs is left to its thread after 5 s."""
        if self._is_closed:
            return
        self._is_closed = True
        self._stop_watching()
        asyncio.get_running_loop().remove_writer(self._fd)
        self._wake_reader()
        with contextlib.suppress(OverdueError):
            await call_in_own_thread(lambda: _close_blocking(self._port), name=f"close {self._name}", timeout_s=_CLOSE_TIMEOUT_S)

    def set_lines(self, *, dtr: bool, rts: bool) -> bool:
        """Assert or release DTR and RTS; False where the device has no such lines, as a pseudo-terminal."""
        try:
            self._port.dtr = dtr
            self._port.rts = rts
        except OSError:
            return False
        return True

    def _check_open(self) -> None:
        if self._is_closed:
            raise TransportClosedError(name=self._name, reason="closed by this side")

    def _take(self) -> None:
        """Read what there is. The descriptor stays watched, as long as somebody takes what comes: that costs less than watching it anew."""
        try:
            chunk = os.read(self._fd, _READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._end = f"unplugged ({error.strerror})"
        else:
            self._unread += chunk
            if not chunk:  # ready, but nothing to read: the line hung up
                self._end = "unplugged (hang-up)"
        if self._end is not None or len(self._unread) >= _READ_SIZE:
            self._stop_watching()
        self._wake_reader()

    def _stop_watching(self) -> None:
        if self._is_watched:
            self._is_watched = False
            asyncio.get_running_loop().remove_reader(self._fd)

    def _wake_reader(self) -> None:
        if self._awaited is not None and not self._awaited.done():
            self._awaited.set_result(None)

    def _write_at_once(self, data: bytes) -> bytes:
        """Write what goes without waiting; return the rest."""
        self._check_open()
        if self._n_may_wait > _MAX_WAITING:
            self._n_may_wait = self._n_waiting()
            if self._n_may_wait > _MAX_WAITING:
                return data
        try:
            n_written = os.write(self._fd, data)
        except BlockingIOError:
            return data
        self._n_may_wait += n_written
        return data[n_written:]

    async def _write_in_time(self, data: bytes) -> None:
        while (waiting := self._n_waiting()) > _MAX_WAITING:
            await asyncio.sleep((waiting - _MAX_WAITING) * _BITS_PER_BYTE / self._port.baudrate)
            self._check_open()
        self._n_may_wait = waiting + len(data)
        while data:
            self._check_open()
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:
                await self._writable()

    async def _writable(self) -> None:
        loop = asyncio.get_running_loop()
        ready = loop.create_future()
        loop.add_writer(self._fd, lambda: None if ready.done() else ready.set_result(None))
        try:
            await ready
        finally:
            if not self._is_closed:
                loop.remove_writer(self._fd)

    def _n_waiting(self) -> int:
        try:
            return self._port.out_waiting
        except OSError as error:
            if error.errno is not None and error.errno in {25, 22}:  # ENOTTY, EINVAL: the device does not tell
                return 0
            raise


async def open_serial(*, path: str, baud: int, reset: LineReset = LineReset.NONE, timeout_s: float = _OPEN_TIMEOUT_S) -> SerialTransport:
    """Open a serial port for this process alone: 8 data bits, no parity, one stop bit, no flow control.

    Parameters
    ----------
    reset
        How its dongle is reset before anything is said to it.

    Raises
    ------
    TransportOpenError
        There is no such port, it may not be opened, or somebody has it open.
    TransportHangsError
        The operating system has not opened it in time.
    """
    name = f"serial:{path}"
    try:
        port = await call_in_own_thread(
            lambda: _open_blocking(path, baud, reset), name=f"open {name}", timeout_s=timeout_s, dispose=_close_blocking
        )
    except OverdueError as error:
        raise TransportHangsError(name=name, timeout_s=timeout_s, is_over=error.is_over) from error
    except (OSError, ValueError, termios.error) as error:  # SerialException is an OSError; ptys raise the bare ones
        raise TransportOpenError(name=name, reason=_explain(error, path)) from error
    return SerialTransport(name=name, port=port)


@contextlib.contextmanager
def settings_kept(path: str) -> Iterator[None]:
    """Give a serial port's settings back at the end as they were; where they cannot be read, nothing is done."""
    try:
        saved = _with_terminal(path, termios.tcgetattr)
    except (OSError, termios.error):
        saved = None
    try:
        yield
    finally:
        if saved is not None:
            attributes = saved
            with contextlib.suppress(OSError, termios.error):  # unplugged meanwhile
                _with_terminal(path, lambda fd: termios.tcsetattr(fd, termios.TCSANOW, attributes))


def list_serial_ports() -> list[SerialPortInfo]:
    """Return the serial ports of this machine, those with a by-id link first."""
    by_id = {str(link.resolve()): str(link) for link in sorted(_BY_ID.iterdir())} if _BY_ID.is_dir() else {}
    ports = [
        SerialPortInfo(
            device=port.device,
            by_id=by_id.get(str(Path(port.device).resolve())),
            vid=port.vid,
            pid=port.pid,
            serial_number=port.serial_number,
            description=port.description,
        )
        for port in list_ports.comports()
    ]
    return sorted(ports, key=lambda port: (port.by_id is None, port.vid is None, port.device))


def _with_terminal(path: str, do: Callable[[int], _ResultT]) -> _ResultT:
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        return do(fd)
    finally:
        os.close(fd)


def _open_blocking(path: str, baud: int, reset: LineReset) -> serial.Serial:
    port = serial.Serial(port=path, baudrate=baud, timeout=0, write_timeout=0, exclusive=True)
    try:
        if os.major(os.fstat(port.fileno()).st_rdev) not in _PTY_MAJORS:
            # Also for programs that know no locks. A pty would keep it beyond its closing, for as long as its other end lives.
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        _reset_line(port, reset)
    except BaseException:
        _close_blocking(port)
        raise
    return port


def _close_blocking(port: serial.Serial) -> None:
    # An unplugged device raises here; its buffers are gone with it.
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(port.fileno(), termios.TCIOFLUSH)  # else closing would wait for a line that is stalled
    with contextlib.suppress(OSError, termios.error):
        port.close()


def _reset_line(port: serial.Serial, reset: LineReset) -> None:
    """Reset the dongle; a device that has no such lines, as a pseudo-terminal, is left as it is."""
    with contextlib.suppress(OSError, termios.error):
        for dtr, rts in _PULSES.get(reset, ()):
            port.dtr = dtr
            port.rts = rts
            time.sleep(_PULSE_S)
        if reset is LineReset.BREAK:
            port.send_break(_BREAK_S)
        if reset is not LineReset.NONE:
            port.reset_input_buffer()  # what it had said before it was reset


def _is_ours(path: str) -> bool:
    """Return whether this process has the device open already."""
    with contextlib.suppress(OSError):
        wanted = Path(path).stat().st_rdev
        for entry in Path("/proc/self/fd").iterdir():
            with contextlib.suppress(OSError):  # the descriptor of the listing itself
                if entry.stat().st_rdev == wanted:
                    return True
    return False


def _explain(error: Exception, path: str) -> str:
    number = getattr(error, "errno", None)
    if number is None:  # pyserial keeps the number of some in what it was raised from
        cause = error if isinstance(error, termios.error) else error.__context__
        number = cause.args[0] if isinstance(cause, termios.error) and cause.args else None
    if number == 2:
        return f"there is no {path}; `biobot-gateway list-ports` shows what there is"
    if number == 13:
        return f"{path} may not be opened by this user; join the group that owns it, often `dialout`"
    if number in {11, 16}:
        if _is_ours(path):
            return f"{path} is in use by this gateway already, as another of its ports: two of them name one device; take one away"
        return f"{path} is in use by another process; `fuser {path}` names it"
    if number in {21, 25}:  # a directory; something that knows no settings of a line, as a file
        return f"{path} is no serial port; `biobot-gateway list-ports` shows what there is"
    return str(error)
