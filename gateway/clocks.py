"""Offset and rate of every backpack's clock against the gateway's monotonic clock, with a bound of the error.

Each uplink message says when it was sent, so it bounds the offset from above (it cannot arrive before it is sent); each time
sync request bounds it from below (it cannot arrive before it is asked). ``clock_fit`` makes a line of these, and this module chooses which
of them it is made of: the tightest in each part of a sliding window. Pure: time is an argument.
"""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import InitVar, dataclass, field
from typing import NamedTuple, TypeAlias, cast

from msgspec import Struct

from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId
from gateway.clock_fit import ClockFit, Point, fit

ASSUMED_DELAY_NS = Nanoseconds(2 * NS_PER_S)
"""While no time sync has bounded it, the fastest message is taken to have needed at most this: the link's longest retransmission time
(WIRE_FORMAT.md §3.4), for on a line so bad that no time sync comes through, even the fastest may have been repeated. An assumption, not a
measurement."""

TYPICAL_DELAY_NS = Nanoseconds(10 * NS_PER_MS)
"""The fastest uplink message is taken to have needed at most this where the bounds leave more room: uplinks that found no
queue take a few milliseconds, while requests may wait in the dongle."""

SETTLED_ERROR_NS = 100 * NS_PER_MS
"""A clock known better than this is good enough to date what its backpack reports."""

ROUGH_ERROR_NS = NS_PER_S
"""A clock known better than this is good enough where no better is to be had for long: on lines so busy that requests wait."""

ROUGH_PATIENCE_NS = 5 * NS_PER_S
"""A backpack whose clock could not be settled for so long is believed once the clock is rough: on a line where everything waits, refusing
what is said makes it be said again, and everything wait longer. Its bounds hold however long messages wait, and its error says how wide."""

WIDE_PATIENCE_NS = 600 * NS_PER_S
"""The same where the clock is not even rough: its backpack hears, so a better bound will come, and its sides of encounters could not be
told from others of the pair."""

PATIENCE_NS = 60 * NS_PER_S
"""One that has no bound from below (it hears nothing) is believed only after so long, with an error that is assumed; until then it
keeps what it has. Where messages wait for seconds, five were too few: the campaign of faults found times 17 s from the truth with a bound
of 2 s (docs/campaign.md)."""

_OVER_PATIENCE_NS = 5 * NS_PER_S
"""The same for a life that is over: nobody can settle its clock, and nobody keeps its messages."""

_TICK_NS = NS_PER_MS
_N_PARTS = 16
"""Of the window; the tightest bound of each part is kept, so a fit looks at 16 times 16 pairs of points at most."""

_WORTH_NS = NS_PER_MS // 10
"""A message that tightens a bound by less than this is no reason to fit anew."""

_MAX_BOOTS = 2
_TOKEN_MODULUS = 1 << 16
_EXCHANGE_LIFETIME_NS = 30 * NS_PER_S


class ClockReading(NamedTuple):
    """An instant on the gateway's monotonic clock, and how wrong it may be."""

    t_ns: Nanoseconds
    error_ns: Nanoseconds


Span: TypeAlias = tuple[Nanoseconds, Nanoseconds, Nanoseconds]
"""Two instants on the gateway's monotonic clock, and how wrong either may be."""


class ClockMemory(Struct, frozen=True, kw_only=True):
    """What of a clock outlives the gateway's process: bounds of the offset at an instant of the backpack's clock [ns].

    Parameters
    ----------
    anchor_ns
        The process's ``wall_anchor_ns``: its monotonic clock goes on while the machine is not started anew.
    """

    anchor_ns: int
    at_ns: int
    upper_ns: int
    lower_ns: int


@dataclass(slots=True, kw_only=True)
class NodeClock:
    """The clock of one life (boot) of one backpack.

    Notes
    -----
    Where the bounds contradict each other a clock has jumped (a suspended host), and only the newest message is believed.
    """

    window_ns: int
    first_ns: int = 0
    """When its first message came, or the first after a jump."""
    n_jumps: int = 0
    _upper: dict[int, Point] = field(default_factory=dict)
    """Of each part of the window, by its number, the tightest bound from above: when it was sent, and the offset; ``_lower`` likewise."""
    _lower: dict[int, Point] = field(default_factory=dict)
    _newest: Point = (0, 0)
    """Sending instant and offset of the message that was taken last."""
    _latest_ns: int = 0
    """Largest sending instant."""
    _fit: ClockFit | None = None
    _is_stale: bool = False
    # The fit once more, in the form in which it is read.
    _at_ns: int = 0
    _offset_ns: int = 0
    _error_ns: int = 0
    _rate: float = 0.0
    _rate_error: float = 0.0
    _upper_ns: int = 0
    _lower_ns: int = 0

    @property
    def is_settled(self) -> bool:
        """Whether a time sync has bounded it well: before that, a message that waited in a queue may pass for a quick one."""
        return self._is_known_within(SETTLED_ERROR_NS)

    @property
    def is_rough(self) -> bool:
        """Whether a time sync has bounded it at all well: what it dates is then as wrong as its ``error_ns`` says and no more."""
        return self._is_known_within(ROUGH_ERROR_NS)

    def is_believed(self, *, now_ns: int, goes_on: bool = True) -> bool:
        """Whether it may date what is reported now; ``goes_on``: its life does."""
        if self.is_settled:
            return True
        if not goes_on:
            patience_ns = _OVER_PATIENCE_NS
        elif self._lower:
            patience_ns = ROUGH_PATIENCE_NS if self.is_rough else WIDE_PATIENCE_NS
        else:
            patience_ns = PATIENCE_NS
        return now_ns - self.first_ns >= patience_ns

    @property
    def fitted(self) -> ClockFit | None:
        """What is known of offset and rate; None before the first message."""
        if self._is_stale:
            self._refit()
        return self._fit

    def observe(self, *, sent_ms: Milliseconds, received_ns: int) -> None:
        """Take the sending and receiving instants of any uplink message."""
        sent_ns = sent_ms * NS_PER_MS
        offset_ns = received_ns - sent_ns
        self._newest = (sent_ns, offset_ns)
        if self._fit is None:
            self._restart()
            return
        self._latest_ns = max(self._latest_ns, sent_ns)
        age_ns = sent_ns - self._at_ns
        drift_ns, slack_ns = age_ns * self._rate, abs(age_ns) * self._rate_error
        part = sent_ns * _N_PARTS // self.window_ns
        known = self._upper.get(part)
        if known is None or offset_ns - known[1] < (sent_ns - known[0]) * self._rate:
            self._upper[part] = (sent_ns, offset_ns)
            if known is None:
                _drop_old(self._upper, newest=self._latest_ns * _N_PARTS // self.window_ns)
        if offset_ns < self._lower_ns + drift_ns - slack_ns:
            self._refit()
        elif offset_ns < self._upper_ns + drift_ns + slack_ns - _WORTH_NS:
            self._is_stale = True

    def bound_below(self, *, requested_ns: int, arrived_ms: Milliseconds) -> None:
        """Take the instants of a time sync request: when it was handed to the radio, and the tick at which it came."""
        arrived_ns = arrived_ms * NS_PER_MS + _TICK_NS  # the tick is rounded down
        offset_ns = requested_ns - arrived_ns
        part = arrived_ns * _N_PARTS // self.window_ns
        known = self._lower.get(part)
        if known is None or offset_ns - known[1] > (arrived_ns - known[0]) * self._rate:
            self._lower[part] = (arrived_ns, offset_ns)
            _drop_old(self._lower, newest=self._latest_ns * _N_PARTS // self.window_ns)
        if self._fit is not None:
            self._refit(newest_lower=(arrived_ns, offset_ns))

    def read(self, ms: Milliseconds) -> ClockReading:
        """Return when the backpack's clock showed ``ms``; ``observe`` must have been called before."""
        t_ns, _, error_ns = self.read_span(ms, ms)
        return ClockReading(t_ns, error_ns)

    def read_span(self, start_ms: int, end_ms: int) -> Span:
        """Return when the backpack's clock showed two instants, and how wrong either may be [ns]."""
        (span,) = self.read_spans([(start_ms, end_ms)])
        return span

    def read_spans(self, spans_ms: Iterable[tuple[int, int]]) -> list[Span]:
        """Do as ``read_span`` for several, none of which ends before it begins: what a message tells of is dated together."""
        if self._is_stale:
            self._refit()
        at_ns, offset_ns, rate, error_ns, rate_error = self._at_ns, self._offset_ns, self._rate, self._error_ns, self._rate_error
        read = []
        for start_ms, end_ms in spans_ms:
            start_ns, end_ns = start_ms * NS_PER_MS, end_ms * NS_PER_MS
            before, after = start_ns - at_ns, end_ns - at_ns
            furthest = -before if before + after < 0 else after
            t_start_ns, t_end_ns = start_ns + offset_ns + int(before * rate), end_ns + offset_ns + int(after * rate)
            read.append((t_start_ns, t_end_ns, error_ns + int(furthest * rate_error)))
        return cast("list[Span]", read)  # once for all of them: a NewType costs a call each

    def memory(self, *, anchor_ns: int) -> ClockMemory | None:
        """Return what is to be kept of it over a restart of the gateway; None where it is not settled."""
        if not self.is_settled:
            return None
        return ClockMemory(anchor_ns=anchor_ns, at_ns=self._at_ns, upper_ns=self._upper_ns, lower_ns=self._lower_ns)

    def restore(self, memory: ClockMemory, *, now_ns: int) -> None:
        """Begin with what an earlier process knew; what is heard since then is added to it, or contradicts it."""
        part = memory.at_ns * _N_PARTS // self.window_ns
        upper, lower = (memory.at_ns, memory.upper_ns), (memory.at_ns, memory.lower_ns)
        found = fit([upper], [lower], at_ns=memory.at_ns, assumed_delay_ns=ASSUMED_DELAY_NS)
        if found is not None:
            self.first_ns, self._newest, self._latest_ns = now_ns, upper, memory.at_ns
            self._upper, self._lower = {part: upper}, {part: lower}
            self._use(found)

    def _is_known_within(self, limit_ns: int) -> bool:
        if not self._lower:
            return False
        if self._is_stale:
            self._refit()
        return self._upper_ns - self._lower_ns <= limit_ns

    def _refit(self, *, newest_lower: Point | None = None) -> None:
        found = fit(list(self._upper.values()), list(self._lower.values()), at_ns=self._latest_ns, assumed_delay_ns=ASSUMED_DELAY_NS)
        if found is None:
            self.n_jumps += 1
            self._restart(newest_lower)
        else:
            self._use(found)

    def _restart(self, newest_lower: Point | None = None) -> None:
        """Believe only what came last."""
        sent_ns, offset_ns = self._newest
        self.first_ns = sent_ns + offset_ns
        self._latest_ns = sent_ns
        self._upper = {sent_ns * _N_PARTS // self.window_ns: self._newest}
        self._lower = {} if newest_lower is None else {newest_lower[0] * _N_PARTS // self.window_ns: newest_lower}
        found = fit([self._newest], list(self._lower.values()), at_ns=sent_ns, assumed_delay_ns=ASSUMED_DELAY_NS)
        if found is None:  # the two of them contradict each other: the message is the newer one
            self._lower = {}
            found = fit([self._newest], (), at_ns=sent_ns, assumed_delay_ns=ASSUMED_DELAY_NS)
        assert found is not None, "one point contradicts nothing"
        self._use(found)

    def _use(self, found: ClockFit) -> None:
        self._fit, self._is_stale = found, False
        self._at_ns, self._rate, self._rate_error = found.at_ns, found.rate, found.rate_error
        self._upper_ns, self._lower_ns = found.upper_ns, found.lower_ns
        offset_ns = max((found.upper_ns + found.lower_ns) // 2, found.upper_ns - TYPICAL_DELAY_NS)
        self._offset_ns = offset_ns
        self._error_ns = max(found.upper_ns - offset_ns, offset_ns - found.lower_ns) + _TICK_NS


@dataclass(slots=True, kw_only=True)
class ClockBook:
    """The clocks of all backpacks, and the time sync exchanges under way. Keeps the last two boots of each.

    Parameters
    ----------
    first_token
        Where the numbers of exchanges begin: anywhere else than in an earlier process, whose late replies must not pass for others.
    """

    window_ns: int
    first_token: InitVar[int] = 0
    _clocks: dict[NodeId, OrderedDict[BootId, NodeClock]] = field(default_factory=dict)
    _exchanges: OrderedDict[int, tuple[NodeId, int]] = field(default_factory=OrderedDict)
    _next_token: int = field(init=False)

    def __post_init__(self, first_token: int) -> None:
        self._next_token = first_token % _TOKEN_MODULUS

    def observe(self, *, node: NodeId, boot: BootId, sent_ms: Milliseconds, received_ns: int) -> NodeClock:
        """Take the instants of an uplink message and return the clock it belongs to."""
        boots = self._clocks.get(node)
        if boots is None:
            boots = self._clocks[node] = OrderedDict()
        clock = boots.get(boot)
        if clock is None:
            clock = boots[boot] = NodeClock(window_ns=self.window_ns)
            while len(boots) > _MAX_BOOTS:
                boots.popitem(last=False)
        clock.observe(sent_ms=sent_ms, received_ns=received_ns)
        return clock

    def restore(self, memory: ClockMemory, *, node: NodeId, boot: BootId, now_ns: int) -> None:
        """Know a backpack's clock again, before anything is heard from it."""
        clock = self._clocks.setdefault(node, OrderedDict()).setdefault(boot, NodeClock(window_ns=self.window_ns))
        clock.restore(memory, now_ns=now_ns)

    def is_settled(self, *, node: NodeId, boot: BootId) -> bool:
        """Whether a backpack's clock is known well enough to date what it reports."""
        clock = self._clocks.get(node, OrderedDict()).get(boot)
        return clock is not None and clock.is_settled

    def is_believed(self, *, node: NodeId, boot: BootId, now_ns: int) -> bool:
        """Whether what a backpack reports now is taken."""
        clock = self._clocks.get(node, OrderedDict()).get(boot)
        return clock is not None and clock.is_believed(now_ns=now_ns)

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


def _drop_old(bounds: dict[int, Point], *, newest: int) -> None:
    """Keep the parts of the window up to ``newest``, and the last one in any case; of those ahead of it no more than there is room for."""
    last = max(bounds)
    for part in [part for part in bounds if part <= newest - _N_PARTS and part != last]:
        del bounds[part]
    if len(bounds) > 2 * _N_PARTS:
        del bounds[last]
