"""The sessions that a radio's dongle was opened for: their numbers, and whether they lasted."""

from firmware_protocol.units import NS_PER_S
from gateway.journal_file import SESSIONS_PER_START

STEADY_NS = 5 * NS_PER_S
"""A session that lasted so long was a good one: the next opening is tried at once, or after the first pause."""


class RadioSessions:
    """See the module.

    Parameters
    ----------
    first
        Number of the first session. It must not be one that an earlier process used of late: the dongle takes RESET of its running session
        for a repetition, keeps its counters, and both sides wait for ever (WIRE_FORMAT.md §3.2).
    """

    def __init__(self, *, first: int) -> None:
        self.was_steady = False
        """A session since this was last set to False was a good one."""
        self._first = first
        self._n_used = 0
        self._began_ns: int | None = None

    def next_number(self) -> int:
        """Return the number to open the dongle with."""
        # Only a session that opened is used up: while the dongle does not answer, numbers do not go round to its last one.
        return (self._first + self._n_used % SESSIONS_PER_START) % (1 << 16)

    def begin(self, *, now_ns: int) -> None:
        """Take note that the session is open."""
        self._began_ns = now_ns
        self._n_used += 1

    def end(self, *, now_ns: int) -> bool:
        """Take note that the session, if there was one, is over; return whether it was a good one."""
        is_steady = self._began_ns is not None and now_ns - self._began_ns >= STEADY_NS
        self.was_steady |= is_steady
        self._began_ns = None
        return is_steady
