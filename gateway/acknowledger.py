"""Tells backpacks which of their messages are on disk, a few at a time and never in the way of commands."""

import asyncio
import time
from collections.abc import Callable

from firmware_protocol.messages import Acknowledge
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, NodeId
from gateway.downlink import DownlinkSender
from gateway.errors import RadioUnavailableError
from gateway.health import Health

_GATHER_NS = 20 * NS_PER_MS
"""An acknowledgement waits this long for others of its biobot: a backpack sends its messages in bursts."""

_MIN_PAUSE_NS = 100 * NS_PER_MS
"""Pause between two acknowledgements to one biobot; a backpack repeats after 1 s at the earliest (WIRE_FORMAT.md §5.1)."""

_MAX_PENDING = 8
"""Acknowledgements wait while this many payloads are under way at the radio; meanwhile they gather."""

_PACE_NS = 10 * NS_PER_MS
"""Pause between two acknowledgements over one radio, on average: a hundred a second are about what a radio of 250 kb/s and a line of
115,200 baud carry beside everything else. While many biobots report at once, each is told of more at a time."""

_BURST = 8
"""Acknowledgements that may go out together after a pause."""

_PATIENCE_NS = 400 * NS_PER_MS
"""After so long an acknowledgement goes out whatever the pace: before its biobot repeats anything."""

_POLL_S = 0.01


class Pace:
    """How many acknowledgements go out over each radio. Pure: time is an argument."""

    def __init__(self) -> None:
        self._free_ns: dict[str, int] = {}
        """When each radio is free for the next one."""

    def take(self, radio: str, *, due_ns: int, now_ns: int) -> bool:
        """Say whether an acknowledgement that was due at ``due_ns`` may go out now; if so, it is counted."""
        free_ns = max(self._free_ns.get(radio, 0), now_ns - _BURST * _PACE_NS)
        if free_ns > now_ns and now_ns < due_ns + _PATIENCE_NS:
            return False
        self._free_ns[radio] = free_ns + _PACE_NS
        return True


class Acknowledger:
    """Sends an Acknowledge to each biobot that has something new on disk; ``run`` is its task.

    Parameters
    ----------
    window_of
        Gives the newest boot of a biobot and, of that boot, ``next_sequence`` and ``bitmap`` of what is on disk.
    """

    def __init__(self, *, sender: DownlinkSender, window_of: Callable[[NodeId], tuple[BootId, int, int] | None], health: Health) -> None:
        self._sender = sender
        self._window_of = window_of
        self._health = health
        self._due_ns: dict[NodeId, int] = {}
        self._marked_ns: dict[NodeId, int] = {}
        self._sent_ns: dict[NodeId, int] = {}
        self._pace = Pace()
        self._wake = asyncio.Event()

    def mark(self, node: NodeId) -> None:
        """Have a biobot told soon; at most one mark of each biobot waits."""
        if node not in self._due_ns:
            now_ns = self._marked_ns[node] = time.monotonic_ns()
            self._due_ns[node] = max(now_ns + _GATHER_NS, self._sent_ns.get(node, 0) + _MIN_PAUSE_NS)
            self._wake.set()

    async def run(self) -> None:
        """Send what is due, until cancelled."""
        while True:
            if not self._due_ns:
                self._wake.clear()
                await self._wake.wait()
            now_ns = time.monotonic_ns()
            busy: set[str] = set()  # one that has no room for the first has none for those behind it
            for node, at_ns in [one for one in self._due_ns.items() if one[1] <= now_ns]:
                radio = self._sender.radio_of(node)
                if radio in busy:
                    continue
                if radio is not None and not self._may_go(node, radio=radio, due_ns=at_ns, now_ns=now_ns):
                    busy.add(radio)
                    continue
                del self._due_ns[node]
                self._tell(node)
            earliest_ns = min(self._due_ns.values(), default=now_ns)
            await asyncio.sleep(max(_POLL_S, (earliest_ns - now_ns) / NS_PER_S))

    def _may_go(self, node: NodeId, *, radio: str, due_ns: int, now_ns: int) -> bool:
        """Whether a biobot's radio has room for its acknowledgement, and its pace allows it."""
        return self._sender.n_pending(node) < _MAX_PENDING and self._pace.take(radio, due_ns=due_ns, now_ns=now_ns)

    def _tell(self, node: NodeId) -> None:
        marked_ns = self._marked_ns.pop(node)
        window = self._window_of(node)
        if window is None:
            return
        boot, next_sequence, bitmap = window
        try:
            self._sender.send(node, Acknowledge(boot=boot, next_sequence=next_sequence, bitmap=bitmap))
        except RadioUnavailableError:
            self._health.count("acknowledge.not_sent")  # the backpack repeats, and is told then
            return
        now_ns = self._sent_ns[node] = time.monotonic_ns()
        self._health.observe("acknowledge", (now_ns - marked_ns) / NS_PER_S)
        self._health.count("acknowledge.sent")
