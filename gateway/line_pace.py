"""When a line has room for the next frame, by how fast it is: what is urgent then never stands behind much (docs/stop.md).

Asking the driver is not enough. A pseudo-terminal, a USB bridge and a serial server behind TCP say that nothing waits while they hold
hundreds of bytes for the wire. So the gateway counts what it has written, and hands over the next frame only when the line is about to be
free; until then the frame stays where an urgent one overtakes it and where it can be withdrawn.
"""

from firmware_protocol.units import NS_PER_MS, NS_PER_S

_AHEAD_BYTES = 32
_AHEAD_NS = 2 * NS_PER_MS
"""How much of what was written may be left when the next frame is handed over, the longer of the two: an event loop is late by a
millisecond or two, and the line need not wait for it."""


class LinePace:
    """See the module. Time is an argument.

    Parameters
    ----------
    bytes_per_s
        What the line carries; None: its driver takes no more than it can send, as a CAN controller.
    """

    def __init__(self, *, bytes_per_s: float | None) -> None:
        self._ns_per_byte = 0.0 if bytes_per_s is None else NS_PER_S / bytes_per_s
        self._ahead_ns = max(_AHEAD_NS, int(_AHEAD_BYTES * self._ns_per_byte))
        self._empty_at_ns = 0

    @property
    def free_at_ns(self) -> int:
        """From when on the next frame may be handed over [ns, monotonic]."""
        return self._empty_at_ns - self._ahead_ns

    def note(self, n_bytes: int, *, now_ns: int) -> None:
        """Take note of what was written."""
        self._empty_at_ns = max(self._empty_at_ns, now_ns) + int(n_bytes * self._ns_per_byte)

    def start_anew(self) -> None:
        """Forget what was written: the port was opened anew, and what it held is gone."""
        self._empty_at_ns = 0
