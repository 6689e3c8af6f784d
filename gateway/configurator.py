"""Sets the backpacks as the configuration's ``[backpacks]`` says, and tells when one will not be set (WIRE_FORMAT.md §6.9).

Each boot of each backpack that takes Configure is asked until its report has the values wanted: a few times, further and further apart. A
backpack that answers with another result, or other values, is told of once and left alone until it starts again.
"""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

from firmware_protocol.messages import (
    LEAVE_PERIOD,
    LEAVE_RSSI,
    Capability,
    ConfigurationReport,
    ConfigurationResult,
    Configure,
)
from firmware_protocol.units import NS_PER_S, BootId, NodeId, RssiDbm
from gateway.config import BackpackTable
from gateway.downlink import DownlinkSender
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.nodes import Node, NodeBook

_POLL_S = 0.25
_FIRST_WAIT_NS = 2 * NS_PER_S
_MAX_SENT = 5
"""Waits of 2, 4, 8, 16 and 32 s: about a minute in all."""

_SILENT_AFTER_NS = 120 * NS_PER_S
"""A biobot that was not heard for so long is not asked: it is out of range."""

_MAX_PENDING = 4
"""Nothing is asked while this many payloads are under way at the radio."""

_N_TOKENS = 1 << 16


@dataclass(slots=True, kw_only=True)
class _Talk:
    """What was asked of one boot of one backpack, and whether it is over."""

    boot: BootId
    tokens: set[int]
    next_ns: int = 0
    n_sent: int = 0
    is_over: bool = False


class Configurator:
    """See the module; ``run`` is its task.

    Parameters
    ----------
    wanted
        Values to be set; where all are None, nothing is ever sent.
    on_refused
        Told once of each boot of a backpack that is not as it should be, with the reason.
    first_token
        Where tokens begin: anywhere else than in an earlier process, whose reports may still come.
    """

    def __init__(
        self,
        *,
        sender: DownlinkSender,
        nodes: NodeBook,
        wanted: BackpackTable,
        health: Health,
        on_refused: Callable[[NodeId, str], None],
        first_token: int,
    ) -> None:
        self._sender = sender
        self._nodes = nodes
        self._wanted = {name: value for name in wanted.__struct_fields__ if (value := getattr(wanted, name)) is not None}
        self._health = health
        self._on_refused = on_refused
        self._next_token = first_token % _N_TOKENS
        self._talks: dict[NodeId, _Talk] = {}

    async def run(self) -> None:
        """Ask, until cancelled."""
        while True:
            self.poll(now_ns=time.monotonic_ns())
            await asyncio.sleep(_POLL_S)

    def poll(self, *, now_ns: int) -> None:
        """Send what is due."""
        if not self._wanted:
            return
        for node in self._nodes.all():
            if node.is_introduced and node.capabilities & Capability.CONFIGURE and node.last_heard_ns >= now_ns - _SILENT_AFTER_NS:
                self._ask(node, now_ns=now_ns)

    def on_report(self, node: NodeId, report: ConfigurationReport) -> None:
        """Take a backpack's report, after it is on disk; one that nobody asked for says nothing of what was asked."""
        talk = self._talks.get(node)
        if talk is None or talk.is_over or report.token not in talk.tokens:
            self._health.count("configuration.unexpected_reports")
            return
        wrong = [
            f"{name} is {getattr(report, name)}, wanted {value}" for name, value in self._wanted.items() if getattr(report, name) != value
        ]
        if report.result is not ConfigurationResult.DONE:
            self._refuse(node, talk, f"it answers {report.result.name.lower()} ({'; '.join(wrong) or 'all values are as wanted'})")
        elif wrong:
            self._refuse(node, talk, f"it says done, but {'; '.join(wrong)}")
        else:
            talk.is_over = True
            self._health.count("configuration.set")

    def _ask(self, node: Node, *, now_ns: int) -> None:
        talk = self._talks.get(node.node)
        if talk is None or talk.boot != node.boot:
            talk = self._talks[node.node] = _Talk(boot=node.boot, tokens=set())
        if talk.is_over or now_ns < talk.next_ns:
            return
        if talk.n_sent >= _MAX_SENT:
            self._refuse(node.node, talk, f"no report came of {_MAX_SENT} requests")
            return
        if self._sender.n_pending(node.node) >= _MAX_PENDING:
            return
        try:
            self._sender.send(node.node, self._message())
        except RadioUnavailableError:
            self._health.count("configuration.not_sent")
            return
        talk.tokens.add(self._next_token)
        self._next_token = (self._next_token + 1) % _N_TOKENS
        talk.next_ns = now_ns + (_FIRST_WAIT_NS << talk.n_sent)
        talk.n_sent += 1
        self._health.count("configuration.sent")

    def _message(self) -> Configure:
        wanted = self._wanted
        return Configure(
            token=self._next_token,
            beacon_period_ms=wanted.get("beacon_period_ms", LEAVE_PERIOD),
            rssi_enter_dbm=RssiDbm(wanted.get("rssi_enter_dbm", LEAVE_RSSI)),
            rssi_exit_dbm=RssiDbm(wanted.get("rssi_exit_dbm", LEAVE_RSSI)),
            gap_tolerance_ms=wanted.get("gap_tolerance_ms", LEAVE_PERIOD),
            report_period_ms=wanted.get("report_period_ms", LEAVE_PERIOD),
        )

    def _refuse(self, node: NodeId, talk: _Talk, reason: str) -> None:
        talk.is_over = True
        self._health.count("configuration.refused")
        self._on_refused(node, reason)
