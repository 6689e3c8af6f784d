"""Asks backpacks for what the gateway lacks: who they are, and what their clock shows."""

import asyncio
import contextlib
import time
from collections import deque

from firmware_protocol.messages import HelloRequest, TimeSyncRequest
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, NodeId
from gateway.clocks import ClockBook
from gateway.downlink import DownlinkSender
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.nodes import Node, NodeBook
from gateway.radio import RadioOutcome

_POLL_S = 0.05
_CALM_POLL_S = 0.25
"""While nothing is lacking; what a backpack says that is not known wakes."""

_BREATH_S = 0.01
"""Between two looks at all biobots, however often one wakes."""

_FIRST_PAUSE_NS = NS_PER_S // 8
_LONGEST_PAUSE_NS = NS_PER_S
"""A time sync request to a backpack whose clock is not known well is repeated after twice the first, then four times, up to the longest.
What it reports is not taken before."""

_ROUSE_PAUSE_NS = 2 * NS_PER_S

_FATE_PATIENCE_NS = 50 * NS_PER_MS
"""After so long a radio is given the next of these requests, though it has not told what became of the one before."""

_HELLO_PAUSE_NS = 2 * NS_PER_S
_SILENT_AFTER_NS = 120 * NS_PER_S
"""A biobot that was not heard for so long is not asked: it is out of range, and asking costs air time."""

_MISSED_NS = 3 * NS_PER_S // 2
"""A biobot that was not heard for so long when its radio comes up may have said things to nobody, and waits longer and longer before it
says them again."""

_MAX_ROUSED = 3
"""So often is a biobot asked the time that an earlier process knew and this one has not heard yet."""

_NEVER = (-1, 0, 0)
_MAX_PENDING = 8
"""Nothing but the time of a clock that is not known is asked while so many payloads are under way at the radio, as many as acknowledgements
wait for."""


class Inquirer:
    """Sends hello and time sync requests; ``run`` is its task.

    Those whose clock is not known well are asked in turn, one after the other at each radio, ahead of all acknowledgements: what they say
    is refused meanwhile and said again and again, and the more there is of that, the longer does everything wait that could end it.
    """

    def __init__(self, *, sender: DownlinkSender, nodes: NodeBook, clocks: ClockBook, sync_period_s: float, health: Health) -> None:
        self._sender = sender
        self._nodes = nodes
        self._clocks = clocks
        self._sync_period_ns = int(sync_period_s * NS_PER_S)
        self._health = health
        self._wake = asyncio.Event()
        self._refused: set[NodeId] = set()
        """Whose messages wait for a repetition because they were not taken, or may have been said to nobody."""
        self._radios_up: dict[str, bool] = {}
        self._asked_hello_ns: dict[NodeId, int] = {}
        self._asked_time: dict[NodeId, tuple[BootId, int, int]] = {}
        """Whom of each number the time was asked, when last, and how often in vain."""
        self._unsettled: dict[str, deque[NodeId]] = {}
        """Who of each radio is to be asked the time at once; those that wait longest come first."""
        self._under_way: dict[str, tuple[asyncio.Future[RadioOutcome], int]] = {}
        """The request that each radio was given last, and until when the next one waits for what becomes of it."""

    def note_refused(self, node: NodeId) -> None:
        """Have a biobot asked at once whose report was not taken because its clock is not known, and told to repeat when it is."""
        self._refused.add(node)
        self._wake.set()

    async def run(self) -> None:
        """Ask, until cancelled."""
        while True:
            lacks_nothing = self._look(time.monotonic_ns())
            self._wake.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_CALM_POLL_S if lacks_nothing else _POLL_S):
                    await self._wake.wait()
            await asyncio.sleep(_BREATH_S)

    def _look(self, now_ns: int) -> bool:
        """Ask whom there is to ask; return whether nothing is lacking."""
        lacks_nothing = True
        self._unsettled.clear()
        came_up = self._look_at_radios()
        for node in sorted(self._nodes.all(), key=lambda node: self._asked_time.get(node.node, _NEVER)[1]):
            is_settled = self._clocks.is_settled(node=node.node, boot=node.boot)
            lacks_nothing &= is_settled and node.is_introduced
            if node.last_heard_ns and node.last_heard_ns < now_ns - _SILENT_AFTER_NS:
                continue
            if node.radio in came_up and node.last_heard_ns < now_ns - _MISSED_NS:
                self._refused.add(node.node)
            if not is_settled and self._is_to_be_asked(node):
                self._unsettled.setdefault(node.radio, deque()).append(node.node)
            if node.address is not None and (node.last_heard_ns or is_settled) and self._sender.n_pending(node.node) < _MAX_PENDING:
                self._ask(node, now_ns, is_settled=is_settled)
        for radio in self._unsettled:
            self._ask_next(radio)
        return lacks_nothing

    def _look_at_radios(self) -> set[str]:
        """Return the radios that came up since the last look."""
        before = self._radios_up
        self._radios_up = {radio: self._sender.is_radio_up(radio) for radio in {node.radio for node in self._nodes.all()}}
        return {radio for radio, is_up in self._radios_up.items() if is_up and not before.get(radio, False)}

    def _is_to_be_asked(self, node: Node) -> bool:
        """Whether a biobot whose clock is not known can be asked; one of an earlier process some times, until it is heard."""
        return node.address is not None and (node.last_heard_ns > 0 or self._asked_time.get(node.node, _NEVER)[2] < _MAX_ROUSED)

    def _ask(self, node: Node, now_ns: int, *, is_settled: bool) -> None:
        """Ask what is not pressing: how a known clock goes on, who somebody is, and what was said before it could be taken."""
        if self._asked_hello_ns.get(node.node, 0) < now_ns - _HELLO_PAUSE_NS and self._is_hello_wanted(node, now_ns):
            try:
                self._sender.send(node.node, HelloRequest())
            except RadioUnavailableError:
                self._health.count("inquiry.not_sent")
                return
            self._refused.discard(node.node)
            self._asked_hello_ns[node.node] = now_ns
            self._health.count("inquiry.hello")
        elif is_settled and self._asked_time.get(node.node, _NEVER)[1] < now_ns - self._sync_period_ns:
            self._ask_time(node, now_ns)

    def _is_hello_wanted(self, node: Node, now_ns: int) -> bool:
        """Whether a biobot is to say who it is, or to repeat at once what it has to tell, as with a hello (WIRE_FORMAT.md §5.12)."""
        is_to_repeat = node.node in self._refused and self._clocks.is_believed(node=node.node, boot=node.boot, now_ns=now_ns)
        return is_to_repeat or not node.is_introduced

    def _ask_next(self, radio: str) -> None:
        """Ask the next one at a radio whose clock is not known, unless a request is under way there."""
        queue, now_ns = self._unsettled.get(radio), time.monotonic_ns()
        future, until_ns = self._under_way.get(radio, (None, 0))
        if future is not None and not future.done() and now_ns < until_ns:
            return
        while queue:
            node = self._nodes.find(queue.popleft())
            if node is None or node.radio != radio or self._clocks.is_settled(node=node.node, boot=node.boot):
                continue
            boot, asked_ns, n_asked = self._asked_time.get(node.node, _NEVER)
            pause_ns = min(_FIRST_PAUSE_NS << min(n_asked, 8), _LONGEST_PAUSE_NS) if node.last_heard_ns else _ROUSE_PAUSE_NS
            if boot == node.boot and now_ns < asked_ns + pause_ns:
                continue
            future = self._ask_time(node, now_ns)
            if future is not None:
                self._under_way[radio] = (future, now_ns + _FATE_PATIENCE_NS)
                future.add_done_callback(lambda _: self._ask_next(radio))
            return

    def _ask_time(self, node: Node, now_ns: int) -> asyncio.Future[RadioOutcome] | None:
        """Ask the time; None where the radio takes nothing."""

        def make(sent_ns: int) -> TimeSyncRequest:
            return TimeSyncRequest(token=self._clocks.begin_exchange(node=node.node, now_ns=sent_ns))

        try:
            future = self._sender.send_timed(node.node, make)
        except RadioUnavailableError:
            self._health.count("inquiry.not_sent")
            return None
        boot, _, n_asked = self._asked_time.get(node.node, _NEVER)
        is_unsettled = not self._clocks.is_settled(node=node.node, boot=node.boot)
        self._asked_time[node.node] = (node.boot, now_ns, (n_asked + 1 if boot == node.boot else 1) if is_unsettled else 0)
        self._health.count("inquiry.time")
        return future
