"""A real serial port with a cable to the gateway's: the loopback partner of a dongle's place."""

import asyncio
import os
import termios

import serial

from simulator.errors import LineError
from simulator.lines.line import Pacer, wait_ready
from simulator.log import EventLog

log = EventLog(__name__)

_CHUNK = 4096
_REOPEN_S = 0.5
_FULL_S = 0.005
_OPEN_ERRORS = (OSError, termios.error)  # SerialException is an OSError; an odd line setting comes as termios.error


class SerialPortEnd:
    """A real serial port, opened again when it was unplugged.

    Raises
    ------
    LineError
        The port cannot be opened at the start.
    """

    def __init__(self, device: str, *, baud: int) -> None:
        self._device = device
        self._baud = baud
        self._out = Pacer(baud)
        try:
            self._port: serial.Serial | None = self._open()
        except _OPEN_ERRORS as error:
            raise LineError(line=f"serial:{device}", problem=f"cannot be opened: {error}") from error

    @property
    def address(self) -> str:
        """Return ``serial:DEVICE``: our own device, whose partner the gateway opens."""
        return f"serial:{self._device}"

    @property
    def is_open(self) -> bool:
        """The port is plugged in, as far as we know."""
        return self._port is not None

    async def read(self) -> bytes:
        """See ``SerialEnd``."""
        loop = asyncio.get_running_loop()
        while True:
            if self._port is None:
                await asyncio.sleep(_REOPEN_S)
                self._reopen()
                continue
            # pyserial sets VMIN to 0: a read that gives nothing means hung up only where the port was said to be readable.
            await wait_ready(self._port.fileno(), loop.add_reader, loop.remove_reader)
            try:
                data = os.read(self._port.fileno(), _CHUNK)
            except BlockingIOError:
                continue
            except OSError as error:
                self._lose(str(error))
            else:
                if data:
                    return data
                self._lose("hung up")

    async def write(self, data: bytes) -> None:
        """See ``SerialEnd``."""
        at = 0
        while at < len(data) and self._port is not None:
            try:
                written = os.write(self._port.fileno(), data[at : at + self._out.chunk])
            except BlockingIOError:
                await asyncio.sleep(_FULL_S)  # not waited for: the reader may close the port in the meantime
            except OSError:
                return  # the reader notices it too
            else:
                at += written
                await self._out.pace(written)

    async def unplug(self) -> None:
        """See ``SerialEnd``: close the port, which drops DTR; what the gateway's end makes of that is its adapter's business."""
        if self._port is not None:
            self._port.close()
        self._port = None

    async def plug_in(self) -> None:
        """See ``SerialEnd``; a port that is not there yet is waited for in ``read``."""
        self._reopen()

    async def aclose(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()

    def _open(self) -> serial.Serial:
        port = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True)
        os.set_blocking(port.fileno(), False)
        return port

    def _reopen(self) -> None:
        try:
            self._port = self._open()
        except _OPEN_ERRORS:
            return  # still unplugged: that was logged when it began
        log.info("line.back", device=self._device)

    def _lose(self, reason: str) -> None:
        log.warning("line.lost", device=self._device, reason=reason)
        if self._port is not None:
            self._port.close()
        self._port = None
