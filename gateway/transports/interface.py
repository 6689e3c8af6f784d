"""What every device and socket offers: a stream of bytes in each direction."""

from typing import Protocol


class Transport(Protocol):
    """An open byte stream. One task reads, one task writes.

    Memory is bounded: some 8 KiB are taken from the operating system before they are asked for, and ``write`` returns only when at
    most about two frames of what was written still wait before the line, as far as the device lets that be known. Nothing is
    ever sent behind a long queue, so an urgent frame leaves soon.
    """

    @property
    def name(self) -> str:
        """What the port is called, for people."""
        ...

    async def read(self) -> bytes:
        """Return the next bytes, at least one.

        Raises
        ------
        TransportClosedError
            The other end or the device has gone; ``b""`` is never returned for that.
        """
        ...

    async def write(self, data: bytes) -> None:
        """Send all of ``data``.

        Raises
        ------
        TransportClosedError
            The device has gone, or takes nothing for too long.
        """
        ...

    def write_at_once(self, data: bytes) -> bytes:
        """Send of ``data`` what goes without waiting; return the rest, all of it where the port has a fault: ``write`` says which."""
        ...

    async def aclose(self) -> None:
        """Close; closing twice is no fault."""
        ...
