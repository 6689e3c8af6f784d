"""Says which gateway's clock is wrong, when that begins and when it ends. Pure but for the log."""

from collections.abc import Iterable
from typing import Final

from mapper.gateway_clocks import SourceClock
from mapper.log import EventLog

_log = EventLog(__name__)

MAX_OFFSET_NS: Final = 2_000_000_000
"""Clocks set by NTP differ by less than a second (RFC 5905, 1); one that differs by more has not been set."""


def newest_clocks(clocks: Iterable[SourceClock]) -> dict[str, SourceClock]:
    """Choose the clock of each gateway's newest start: that of which records came to the store last."""
    newest: dict[str, SourceClock] = {}
    for clock in clocks:
        known = newest.get(clock.source.gateway)
        if known is None or (clock.last_row, clock.source) > (known.last_row, known.source):
            newest[clock.source.gateway] = clock
    return newest


def clock_shifts(clocks: Iterable[SourceClock]) -> dict[str, int]:
    """Return what is to be added to the clocks of the gateways that run with a wrong one now [ns]."""
    newest = newest_clocks(clocks)
    return {gateway: clock.offset_ns for gateway, clock in newest.items() if clock.is_corrected and clock.offset_ns is not None}


class ClockWatch:
    """Keeps in mind which gateways' clocks are wrong."""

    def __init__(self) -> None:
        self._faults: dict[str, str] = {}

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong, by gateway."""
        return tuple(self._faults.values())

    def look(self, clocks: Iterable[SourceClock]) -> None:
        """Compare with what is known now."""
        found: dict[str, str] = {}
        for gateway, clock in sorted(newest_clocks(clocks).items()):
            if clock.offset_ns is None or abs(clock.offset_ns) <= MAX_OFFSET_NS:
                continue
            found[gateway] = (
                f"the clock of gateway {gateway} differs by {-clock.offset_ns / 1e9:+.3f} s from that of {clock.reference.gateway}, by "
                f"{clock.n_votes} shared encounters; set the clocks of all machines. Until then what it records is put "
                f"{abs(clock.offset_ns) / 1e9:.3f} s {'later' if clock.offset_ns > 0 else 'earlier'}"
            )
            if gateway not in self._faults:
                _log.error(
                    "gateway.clock_wrong",
                    gateway=gateway,
                    offset_s=round(-clock.offset_ns / 1e9, 3),
                    bound_s=round(clock.bound_ns / 1e9, 3),
                    reference=clock.reference.gateway,
                    encounters=clock.n_votes,
                )
        for gateway in self._faults.keys() - found.keys():
            _log.warning("gateway.clock_right", gateway=gateway)
        self._faults = found
