"""Offset of every backpack's clock to the gateway's monotonic clock, with a bound of its error.

Each uplink message says when it was sent, so it bounds the offset from above (it cannot arrive before it is sent); each time
sync request bounds it from below (it cannot arrive before it is asked). The tightest bounds of a sliding window hold, relaxed
by the largest drift for their age: delay in queues loosens a bound but never falsifies one. Pure: time is an argument.
"""

from collections import OrderedDict, deque
from dataclasses import dataclass, field

from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId

MAX_DRIFT_PPM = 100
"""Largest difference in rate of the two clocks: a backpack's crystal (40 ppm for IEEE 802.15.4) and the host's, with margin."""

ASSUMED_DELAY_NS = Nanoseconds(2 * NS_PER_S)
"""While no time sync has bounded it, the fastest message is taken to have needed at most this: the link's longest retransmission time
(WIRE_FORMAT.md §3.4), for on a line so bad that no time sync comes through, even the fastest may have been repeated. An assumption, not a
measurement."""

TYPICAL_DELAY_NS = Nanoseconds(10 * NS_PER_MS)
"""The fastest uplink message is taken to have needed at most this where the bounds leave more room: uplinks that found no
queue take a few milliseconds, while requests may wait in the dongle."""

SETTLED_ERROR_NS = 100 * NS_PER_MS
"""A clock known better than this is good enough to date what its backpack reports."""

_TICK_NS = NS_PER_MS
_MAX_BOOTS = 2
_TOKEN_MODULUS = 1 << 16
_EXCHANGE_LIFETIME_NS = 30 * NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockReading:
    """An instant on the gateway's monotonic clock, and how wrong it may be."""

    t_ns: Nanoseconds
    error_ns: Nanoseconds


@dataclass(slots=True, kw_only=True)
class NodeClock:
    """The clock of one life (boot) of one backpack.

    Notes
    -----
    ``_upper`` holds ``(t, offset - drift * t)`` with growing second members, the usual queue for a sliding minimum; ``_lower``
    likewise ``(t, offset + drift * t)`` with falling ones. Where the bounds contradict each other a clock has jumped (a
    suspended host), and only the newest message is believed.
    """

    window_ns: int
    _upper: deque[tuple[int, int]] = field(default_factory=deque)
    _lower: deque[tuple[int, int]] = field(default_factory=deque)
    _latest_ns: int = 0
    _first_ns: int | None = None
    _known_bounds: tuple[int, int] | None = None
    n_jumps: int = 0

    @property
    def first_ns(self) -> int:
        """When its first message came."""
        return self._first_ns or 0

    @property
    def is_settled(self) -> bool:
        """Whether a time sync has bounded it well: before that, a message that waited in a queue may pass for a quick one."""
        if not self._lower:
            return False
        upper_ns, lower_ns = self._bounds()
        return upper_ns - lower_ns <= SETTLED_ERROR_NS

    def observe(self, *, sent_ms: Milliseconds, received_ns: int) -> None:
        """Take the sending and receiving instants of any uplink message."""
        self._known_bounds = None
        if self._first_ns is None:
            self._first_ns = received_ns
        value = received_ns - sent_ms * NS_PER_MS - _drift_ns(received_ns)
        while self._upper and self._upper[-1][1] >= value:
            self._upper.pop()
        self._upper.append((received_ns, value))
        self._latest_ns = max(self._latest_ns, received_ns)
        self._drop_old(self._upper)
        self._drop_old(self._lower)
        self._check(sent_ms=sent_ms, received_ns=received_ns)

    def bound_below(self, *, requested_ns: int, arrived_ms: Milliseconds) -> None:
        """Take the instants of a time sync request: when it was handed to the radio, and the tick at which it came."""
        offset_ns = requested_ns - arrived_ms * NS_PER_MS - _TICK_NS  # the tick is rounded down
        value = offset_ns + _drift_ns(requested_ns)
        while self._lower and self._lower[-1][1] <= value:
            self._lower.pop()
        self._lower.append((requested_ns, value))
        self._known_bounds = None

    def read(self, ms: Milliseconds) -> ClockReading:
        """Return when the backpack's clock showed ``ms``; ``observe`` must have been called before."""
        if self._known_bounds is None:
            self._known_bounds = self._bounds()
        upper_ns, lower_ns = self._known_bounds
        offset_ns = max((upper_ns + lower_ns) // 2, upper_ns - TYPICAL_DELAY_NS)
        t_ns = ms * NS_PER_MS + offset_ns
        age_ns = abs(self._latest_ns - t_ns)
        error_ns = max(upper_ns - offset_ns, offset_ns - lower_ns) + _drift_ns(age_ns) + _TICK_NS
        return ClockReading(t_ns=Nanoseconds(t_ns), error_ns=Nanoseconds(error_ns))

    def _bounds(self) -> tuple[int, int]:
        relaxed_ns = _drift_ns(self._latest_ns)
        upper_ns = self._upper[0][1] + relaxed_ns
        if not self._lower:
            return upper_ns, upper_ns - ASSUMED_DELAY_NS
        return upper_ns, self._lower[0][1] - relaxed_ns

    def _check(self, *, sent_ms: Milliseconds, received_ns: int) -> None:
        upper_ns, lower_ns = self._bounds()
        if lower_ns > upper_ns:
            self.n_jumps += 1
            self._lower.clear()
            self._upper.clear()
            self._upper.append((received_ns, received_ns - sent_ms * NS_PER_MS - _drift_ns(received_ns)))
            self._latest_ns = received_ns

    def _drop_old(self, bounds: deque[tuple[int, int]]) -> None:
        while len(bounds) > 1 and bounds[0][0] < self._latest_ns - self.window_ns:
            bounds.popleft()


@dataclass(slots=True, kw_only=True)
class ClockBook:
    """The clocks of all backpacks, and the time sync exchanges under way. Keeps the last two boots of each."""

    window_ns: int
    _clocks: dict[NodeId, OrderedDict[BootId, NodeClock]] = field(default_factory=dict)
    _exchanges: OrderedDict[int, tuple[NodeId, int]] = field(default_factory=OrderedDict)
    _next_token: int = 1

    def observe(self, *, node: NodeId, boot: BootId, sent_ms: Milliseconds, received_ns: int) -> NodeClock:
        """Take the instants of an uplink message and return the clock it belongs to."""
        boots = self._clocks.setdefault(node, OrderedDict())
        clock = boots.get(boot)
        if clock is None:
            clock = boots[boot] = NodeClock(window_ns=self.window_ns)
            while len(boots) > _MAX_BOOTS:
                boots.popitem(last=False)
        clock.observe(sent_ms=sent_ms, received_ns=received_ns)
        return clock

    def is_settled(self, *, node: NodeId, boot: BootId) -> bool:
        """Whether a backpack's clock is known well enough to date what it reports."""
        clock = self._clocks.get(node, OrderedDict()).get(boot)
        return clock is not None and clock.is_settled

    def begin_exchange(self, *, node: NodeId, now_ns: int) -> int:
        """Return the token for a time sync request that is sent now."""
        while self._exchanges and next(iter(self._exchanges.values()))[1] < now_ns - _EXCHANGE_LIFETIME_NS:
            self._exchanges.popitem(last=False)
        token = self._next_token
        self._next_token = (token + 1) % _TOKEN_MODULUS
        self._exchanges[token] = (node, now_ns)
        return token

    def end_exchange(self, *, node: NodeId, boot: BootId, token: int, arrived_ms: Milliseconds) -> bool:
        """Take a time sync reply; False where it answers nothing that was asked of this biobot."""
        known = self._exchanges.get(token)
        clock = self._clocks.get(node, OrderedDict()).get(boot)
        if known is None or known[0] != node or clock is None:
            return False
        del self._exchanges[token]
        clock.bound_below(requested_ns=known[1], arrived_ms=arrived_ms)
        return True


def _drift_ns(duration_ns: int) -> int:
    return duration_ns * MAX_DRIFT_PPM // 1_000_000
