"""What is said to systemd: ready, stopping, a line of status, and that the event loop is alive (sd_notify(3)).

The protocol is a datagram to the socket that ``NOTIFY_SOCKET`` names; a name that begins with ``@`` is in the abstract namespace. With
``WatchdogSec=`` in the unit, ``WATCHDOG_USEC`` says how soon a sign of life must follow the one before. Without a service manager
nothing is sent, and one that does not listen is no reason to stop.
"""

import asyncio
import contextlib
import os
import socket
from collections.abc import Mapping
from typing import Self

_SIGNS_IN_A_PERIOD = 3
"""sd_watchdog_enabled(3) advises two; with three, one may be late."""

_MAX_STATUS = 200


class ServiceManager:
    """The service manager that started this process, or none.

    Parameters
    ----------
    address
        Its socket, or None.
    watchdog_s
        How soon a sign of life must follow the one before [s]; None: it waits for none.
    """

    def __init__(self, *, address: str | None, watchdog_s: float | None = None) -> None:
        self._address = address
        self._watchdog_s = watchdog_s if address is not None else None
        self._status = ""
        self._socket = None if address is None else socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        if self._socket is not None:
            self._socket.settimeout(0)

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Self:
        """Return the one that the environment names. Numbers that are none, or meant for another process, count as not given."""
        address = environment.get("NOTIFY_SOCKET") or None
        if address is not None and address[0] not in "/@":
            address = None
        if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
            return cls(address=address)
        period_us = environment.get("WATCHDOG_USEC", "")
        is_period = period_us.isascii() and period_us.isdigit() and len(period_us) <= 18 and int(period_us) > 0
        return cls(address=address, watchdog_s=int(period_us) / 1e6 if is_period else None)

    def ready(self) -> None:
        """Say that the service serves."""
        self._send("READY=1")

    def stopping(self) -> None:
        """Say that the service winds down."""
        self._send("STOPPING=1")

    def tell(self, status: str) -> None:
        """Have ``systemctl status`` show a line; said only when it is another than before."""
        line = " ".join(status.split())[:_MAX_STATUS]
        if line != self._status and self._send(f"STATUS={line}"):
            self._status = line

    @property
    def sign_every_s(self) -> float | None:
        """How often to give a sign of life [s]; None: nobody waits for one."""
        return None if self._watchdog_s is None else self._watchdog_s / _SIGNS_IN_A_PERIOD

    def give_sign(self) -> None:
        """Give a sign of life; a process that gives none is started anew."""
        if self._watchdog_s is not None:
            self._send("WATCHDOG=1")

    async def watch(self) -> None:
        """Give signs of life from the event loop until cancelled; one that hangs gives none."""
        while self.sign_every_s is not None:
            self.give_sign()
            await asyncio.sleep(self.sign_every_s)

    def close(self) -> None:
        """Close the socket; nothing is said any more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, message: str) -> bool:
        if self._socket is None or self._address is None:
            return False
        name = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        with contextlib.suppress(OSError):
            return self._socket.sendto(message.encode(), name) > 0
        return False
