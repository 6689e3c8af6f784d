"""Opens a radio's port, time and again: with its dongle reset where that has fallen silent, and never beside an opening that hangs."""

from collections.abc import Awaitable, Callable

from gateway.config import LinkTable
from gateway.errors import TransportHangsError
from gateway.health import Health
from gateway.outage import Outage
from gateway.transports.interface import Transport

OpenPort = Callable[[], Awaitable[Transport]]


class PortOpening:
    """See the module.

    Parameters
    ----------
    reset_port
        Opens the port with its dongle reset; None where that cannot be done.
    config
        Says after how many silences in a row the dongle is reset; 0: never.
    """

    def __init__(self, *, open_port: OpenPort, reset_port: OpenPort | None, config: LinkTable, health: Health, outage: Outage) -> None:
        self.n_silences = 0
        """How many times in a row the dongle did not answer."""
        self._open_port = open_port
        self._reset_port = reset_port
        self._limit = config.silences_before_reset
        self._health = health
        self._outage = outage
        self._hanging: TransportHangsError | None = None

    async def open(self) -> Transport:
        """Open the port.

        Raises
        ------
        TransportError
            It cannot be opened now, or an earlier opening has not come back yet.
        """
        if self._hanging is not None and not self._hanging.is_over():
            raise self._hanging
        self._hanging = None
        try:
            if self._reset_port is not None and 0 < self._limit <= self.n_silences:
                self._outage.step("radio.line_reset", silences=self.n_silences)
                return await self._reset_port()
            return await self._open_port()
        except TransportHangsError as error:
            self._hanging = error
            self._health.count("radio.hanging_openings")
            raise
