"""Which was meant last: a stop of a biobot, or what moves it. Pure.

Commands take ways of different length: by another session, another queue, or after a wait for a commander's token. A start or a turn that
was issued before a stop, or came in before it, must not move the animal after it.

Wall clocks of commanders differ. A stop counts as issued no later than it came by the gateway's own clock, so that one of a clock that is
ahead refuses nobody for longer. Whose clock is behind is refused until it has passed the stop, for ``KEPT_NS`` at most.
"""

from dataclasses import dataclass, field

from firmware_protocol.contract.commands import StimulationRequest
from firmware_protocol.units import EVERYBODY, NS_PER_S, NodeId

KEPT_NS = 62 * NS_PER_S
"""Longer than any command lives (``ttl_ms``): what was issued before a stop that came so long ago is stale anyway."""


@dataclass(slots=True)
class _Stopped:
    """The newest stop: when it was issued (wall clock), and when it came (monotonic)."""

    issued_wall_ns: int
    came_ns: int


@dataclass(slots=True)
class Precedence:
    """Remembers, of each biobot and of everybody, the newest stop and the newest motion."""

    _stopped: dict[NodeId, _Stopped] = field(default_factory=dict)
    _moved_ns: dict[NodeId, int] = field(default_factory=dict)

    def stopped(self, request: StimulationRequest, *, came_ns: int, came_wall_ns: int) -> None:
        """Take note of a stop, of one or of all."""
        issued_wall_ns = min(request.issued_wall_ns, came_wall_ns)
        known = self._stopped.get(request.node)
        if known is None or came_ns - known.came_ns > KEPT_NS:
            self._stopped[request.node] = _Stopped(issued_wall_ns, came_ns)
        else:
            known.issued_wall_ns, known.came_ns = max(known.issued_wall_ns, issued_wall_ns), max(known.came_ns, came_ns)

    def moved(self, node: NodeId, *, now_ns: int) -> None:
        """Take note that a start or a turn was sent."""
        self._moved_ns[node] = self._moved_ns[EVERYBODY] = now_ns

    def is_overtaken(self, request: StimulationRequest, *, came_ns: int, now_ns: int) -> bool:
        """Whether a stop of its biobot was issued, or came in, after a start or a turn; issued in the same nanosecond, it was before."""
        for node in (request.node, EVERYBODY):
            stop = self._stopped.get(node)
            if stop is None or now_ns - stop.came_ns > KEPT_NS:
                continue
            if request.issued_wall_ns < stop.issued_wall_ns or came_ns < stop.came_ns:
                return True
        return False

    def has_moved(self, node: NodeId, *, since_ns: int) -> bool:
        """Whether a biobot (or with ``EVERYBODY`` any) was given a start or a turn since an instant."""
        return self._moved_ns.get(node, since_ns) > since_ns
