"""Carries bytes between one coordinator of a swarm and its line."""

import asyncio
from collections.abc import Callable
from pathlib import Path

from simulator.dongles.interface import Dongle
from simulator.lines.faults import FaultDraws
from simulator.lines.faulty_dongle import FaultyDongle
from simulator.lines.faulty_line import FaultyLine
from simulator.lines.line import LineSpec, SerialEnd
from simulator.lines.serial_port import SerialPortEnd
from simulator.lines.slcan_port import SlcanEnd
from simulator.lines.tcp_port import TcpEnd
from simulator.lines.virtual_serial import PtyEnd
from simulator.log import EventLog

log = EventLog(__name__)

_MAX_BACKLOG = 64 * 1024
"""Bytes that wait for a slow listener at most [B]; frames beyond that are lost, as in an overrun, and the link repeats them."""


class Carrier:
    """See the module.

    Parameters
    ----------
    feed
        Takes what comes from the gateway.
    faults
        What goes wrong on the line; None: nothing.
    options
        What a gateway must say behind the line's address, such as ``?dialect=xbee``.
    """

    def __init__(
        self, coordinator: Dongle, *, line: SerialEnd, feed: Callable[[bytes], None], faults: FaultDraws | None = None, options: str = ""
    ) -> None:
        self._coordinator = coordinator
        self._faulty_line = None if faults is None else FaultyLine(line, faults)
        self._line: SerialEnd = self._faulty_line or line
        self._feed = feed
        self._options = options
        self._backlog = bytearray()
        self._n_overruns = 0
        self._has_outgoing = asyncio.Event()
        self._was_open = False

    @property
    def address(self) -> str:
        """What a gateway is to open."""
        return self._line.address + self._options

    @property
    def is_open(self) -> bool:
        """A gateway is connected."""
        return self._coordinator.is_open

    @property
    def faults(self) -> dict[str, int]:
        """What came in and was of no use, and what had no room, by name."""
        faults = dict(self._coordinator.faults)
        return faults | {"overrun": self._n_overruns} if self._n_overruns else faults

    @property
    def injected(self) -> dict[str, int]:
        """What was done to the line and its coordinator on purpose, by kind."""
        on_line = {} if self._faulty_line is None else self._faulty_line.counts
        return on_line | (dict(self._coordinator.counts) if isinstance(self._coordinator, FaultyDongle) else {})

    async def misbehave(self) -> None:
        """Let the faults that take time happen to the line, until cancelled; end at once where there are none."""
        if self._faulty_line is not None:
            await self._faulty_line.play()

    async def receive(self) -> None:
        """Hand on what comes from the gateway, until cancelled."""
        while True:
            self._feed(await self._line.read())

    async def send(self) -> None:
        """Write what waits for the gateway, until cancelled."""
        while True:
            await self._has_outgoing.wait()
            self._has_outgoing.clear()
            data = bytes(self._backlog)
            self._backlog.clear()
            await self._line.write(data)

    def pump(self) -> None:
        """Take what the coordinator has to say; tell when a gateway comes or goes."""
        data = self._coordinator.take_bytes()
        if len(self._backlog) + len(data) > _MAX_BACKLOG:
            self._n_overruns += 1
        elif data:
            self._backlog += data
            self._has_outgoing.set()
        if self.is_open is not self._was_open:
            self._was_open = self.is_open
            log.info("gateway.connected" if self._was_open else "gateway.gone", line=self.address)


async def open_line(spec: LineSpec) -> SerialEnd:
    """Make the simulator's end of a line.

    Raises
    ------
    LineError
        The name, the port or the device cannot be had.
    """
    match spec.kind:
        case "pty":
            return PtyEnd(Path(spec.target), baud=spec.baud)
        case "tcp":
            return await TcpEnd.listen(spec.target, spec.port, baud=spec.baud)
        case "slcan":
            return SlcanEnd(Path(spec.target), dialect=spec.dialect)
        case _:
            return SerialPortEnd(spec.target, baud=spec.baud or 115_200)
