"""Time: the wall's, a settable one behind the same interface, and a backpack's clock that drifts against both."""

import time
from dataclasses import dataclass
from typing import Protocol

from firmware_protocol.units import Milliseconds, Nanoseconds

_PPB = 1_000_000_000
_NS_PER_MS = 1_000_000


class Clock(Protocol):
    """What paces a run."""

    def monotonic_ns(self) -> Nanoseconds:
        """Return the present on a clock that never goes back [ns]."""

    def wall_ns(self) -> Nanoseconds:
        """Return the present as UTC since 1970 [ns]."""


class BackpackClock(Protocol):
    """A backpack's own clock, as a function of the time since the run began."""

    def read_ms(self, elapsed_ns: int) -> Milliseconds:
        """Return what the clock shows ``elapsed_ns`` [ns] into the run, rounded down."""

    def elapsed_ns(self, ms: int) -> int:
        """Return the first instant of the run [ns] at which the clock shows at least ``ms``."""


class WallClock:
    """The machine's own clocks."""

    __slots__ = ()

    def monotonic_ns(self) -> Nanoseconds:
        """Return the machine's monotonic clock [ns]."""
        return Nanoseconds(time.monotonic_ns())

    def wall_ns(self) -> Nanoseconds:
        """Return the machine's wall clock [ns]."""
        return Nanoseconds(time.time_ns())


@dataclass(slots=True, kw_only=True)
class SettableClock:
    """A clock that stands still until it is moved."""

    now_ns: int = 0
    wall_start_ns: int = 0

    def monotonic_ns(self) -> Nanoseconds:
        """Return where the clock was put [ns]."""
        return Nanoseconds(self.now_ns)

    def wall_ns(self) -> Nanoseconds:
        """Return the wall clock that goes with it [ns]."""
        return Nanoseconds(self.wall_start_ns + self.now_ns)

    def move(self, by_ns: int) -> None:
        """Let ``by_ns`` [ns, not negative] pass."""
        if by_ns < 0:
            msg = f"a monotonic clock cannot go back by {-by_ns} ns"
            raise ValueError(msg)
        self.now_ns += by_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftingClock:
    """A backpack's millisecond clock as a function of the time since the run began.

    Parameters
    ----------
    start_ms
        What it showed when the run began [ms since the backpack's boot].
    drift_ppb
        How much faster than true time it runs [parts in 10^9].
    """

    start_ms: int
    drift_ppb: int

    def read_ms(self, elapsed_ns: int) -> Milliseconds:
        """Return what the clock shows ``elapsed_ns`` [ns] into the run, rounded down."""
        return Milliseconds(self.start_ms + elapsed_ns * (_PPB + self.drift_ppb) // (_PPB * _NS_PER_MS))

    def elapsed_ns(self, ms: int) -> int:
        """Return the first instant of the run [ns] at which the clock shows at least ``ms``."""
        return -((self.start_ms - ms) * _PPB * _NS_PER_MS // (_PPB + self.drift_ppb))
