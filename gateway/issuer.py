"""Who a record is: names for new records, and the gateway's two clocks tied together."""

from dataclasses import dataclass, field

from firmware_protocol.units import BootId, Nanoseconds


@dataclass(slots=True, kw_only=True)
class RecordIssuer:
    """Hands out identities ``(boot, sequence)`` for new records of this start of the gateway.

    Parameters
    ----------
    wall_anchor_ns
        UTC minus monotonic clock, read once at start: all records of one start share it, so that they never contradict each
        other when the wall clock is set.
    earlier_anchors
        Anchors of earlier starts since the machine booted: their monotonic clock is this one, whatever was done to the wall
        clock in between. Instants of a start before that are placed by their UTC, and are wrong by as much as it was.
    """

    gateway: str
    journal: str
    boot: BootId
    wall_anchor_ns: Nanoseconds
    earlier_anchors: tuple[Nanoseconds, ...] = ()
    _next: int = field(default=0)

    def take_sequence(self) -> int:
        """Return a sequence number that no other record of this boot has."""
        sequence = self._next
        self._next += 1
        return sequence

    def to_wall_ns(self, monotonic_ns: int) -> Nanoseconds:
        """Return the UTC of an instant on the monotonic clock."""
        return Nanoseconds(monotonic_ns + self.wall_anchor_ns)

    def to_own_monotonic_ns(self, t_ns: int, *, anchor_ns: int) -> Nanoseconds:
        """Return an instant of another start's monotonic clock, whose anchor is given, on this start's."""
        if anchor_ns in self.earlier_anchors:
            return Nanoseconds(t_ns)
        return Nanoseconds(t_ns + anchor_ns - self.wall_anchor_ns)

    def to_recorded_wall_ns(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Return the span of UTC under which records of a time on the monotonic clock may be found: each start used its anchor."""
        anchors = (self.wall_anchor_ns, *self.earlier_anchors)
        return start_ns + min(anchors), end_ns + max(anchors)
