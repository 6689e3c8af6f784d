"""Wakes a task for a deadline that moves with everything that happens, mostly further away."""

import asyncio
import time
from collections.abc import Callable

from firmware_protocol.units import NS_PER_S


class WakeTimer:
    """Wakes at the deadline or before: where it moves away the timer stays, for making one costs more than waking early."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._handle: asyncio.TimerHandle | None = None
        self._at_ns = 0

    def aim(self, deadline_ns: int | None) -> None:
        """Wake by an instant on the monotonic clock [ns]; None: there is no need to."""
        if deadline_ns is None or (self._handle is not None and self._at_ns <= deadline_ns):
            return
        self.stop()
        self._at_ns = deadline_ns
        self._handle = asyncio.get_running_loop().call_later((deadline_ns - time.monotonic_ns()) / NS_PER_S, self._fire)

    def stop(self) -> None:
        """Wake no more."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _fire(self) -> None:
        self._handle = None
        self._wake()
