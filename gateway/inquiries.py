"""Asks backpacks for what the gateway lacks: who they are, and what their clock shows."""

import asyncio
import contextlib
import time

from firmware_protocol.messages import HelloRequest, TimeSyncRequest
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.clocks import ClockBook
from gateway.downlink import DownlinkSender
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.nodes import Node, NodeBook

_POLL_S = 0.05
_CALM_POLL_S = 0.25
"""While nothing is lacking; what a backpack says that is not known wakes."""

_URGENT_PAUSE_NS = NS_PER_S // 4
"""Pause between two time sync requests while a clock is not known well: its backpack's reports are not taken before."""

_HELLO_PAUSE_NS = 2 * NS_PER_S
_SILENT_AFTER_NS = 120 * NS_PER_S
"""A biobot that was not heard for so long is not asked: it is out of range, and asking costs air time."""

_MAX_ROUSED = 3
"""So often is a biobot asked that an earlier process knew and this one has not heard yet."""

_NEVER = (-1, 0)
_MAX_PENDING = 4
"""Nothing is asked while this many payloads are under way at the radio: a request that waits in a queue says less about the clock."""

_MAX_URGENT_PENDING = 12
"""The same where the clock is not known at all, and what its backpack reports waits for that: more than acknowledgements ever fill
(eight), or a radio that is busy with them would never ask, and its biobots would wait for ever."""


class Inquirer:
    """Sends hello and time sync requests; ``run`` is its task."""

    def __init__(self, *, sender: DownlinkSender, nodes: NodeBook, clocks: ClockBook, sync_period_s: float, health: Health) -> None:
        self._sender = sender
        self._nodes = nodes
        self._clocks = clocks
        self._sync_period_ns = int(sync_period_s * NS_PER_S)
        self._health = health
        self._asked_hello_ns: dict[NodeId, int] = {}
        self._wake = asyncio.Event()
        self._asked_time: dict[NodeId, tuple[int, int]] = {}
        self._roused: dict[NodeId, tuple[int, int]] = {}
        """How often, and when last, biobots were asked that were not heard since the gateway started."""

    def wake(self) -> None:
        """Look again at once: a backpack was heard whose clock is not known."""
        self._wake.set()

    async def run(self) -> None:
        """Ask, until cancelled."""
        while True:
            now_ns = time.monotonic_ns()
            # Those that wait longest come first, so that a crowd that starts together is asked in turn.
            lacks_nothing = True
            for node in sorted(self._nodes.all(), key=lambda node: self._asked_time.get(node.node, _NEVER)[1]):
                is_settled = self._clocks.is_settled(node=node.node, boot=node.boot)
                lacks_nothing &= is_settled and node.is_introduced
                if self._sender.n_pending(node.node) >= (_MAX_PENDING if is_settled else _MAX_URGENT_PENDING):
                    continue
                if not node.last_heard_ns:
                    self._rouse(node, now_ns)
                elif node.last_heard_ns >= now_ns - _SILENT_AFTER_NS:
                    self._ask(node, now_ns, is_settled=is_settled)
            self._wake.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_CALM_POLL_S if lacks_nothing else _POLL_S):
                    await self._wake.wait()

    def _rouse(self, node: Node, now_ns: int) -> None:
        """Ask a biobot of an earlier process for its hello: until it is heard, its address may be another's."""
        n_asked, asked_ns = self._roused.get(node.node, (0, 0))
        if node.address is None or n_asked >= _MAX_ROUSED or asked_ns > now_ns - _HELLO_PAUSE_NS:
            return
        with contextlib.suppress(RadioUnavailableError):  # its radio is not up yet, or no longer there
            self._sender.send(node.node, HelloRequest())
            self._roused[node.node] = (n_asked + 1, now_ns)
            self._health.count("inquiry.hello")

    def _ask(self, node: Node, now_ns: int, *, is_settled: bool) -> None:
        boot, asked_ns = self._asked_time.get(node.node, _NEVER)
        try:
            pause_ns = self._sync_period_ns if is_settled else _URGENT_PAUSE_NS
            if boot != node.boot or asked_ns < now_ns - pause_ns:
                token = self._clocks.begin_exchange(node=node.node, now_ns=time.monotonic_ns())
                self._sender.send(node.node, TimeSyncRequest(token=token))
                self._asked_time[node.node] = (node.boot, now_ns)
                self._health.count("inquiry.time")
            elif not node.is_introduced and self._asked_hello_ns.get(node.node, 0) < now_ns - _HELLO_PAUSE_NS:
                self._sender.send(node.node, HelloRequest())
                self._asked_hello_ns[node.node] = now_ns
                self._health.count("inquiry.hello")
        except RadioUnavailableError:
            self._health.count("inquiry.not_sent")
