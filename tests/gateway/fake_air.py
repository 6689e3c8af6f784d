"""Radios and biobots behind a gate, for tests: what is sent is kept, and answered as the test says."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

from firmware_protocol.contract.commands import CommandStage, PulseRequest, StimulationAction, StimulationRequest
from firmware_protocol.messages import Stimulate, StimulateReply, StimulationResult, WireMode
from firmware_protocol.units import BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.config import StimulationTable
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.journal import Journal
from gateway.nodes import NodeBook, NodeMemory
from gateway.radio import Fate, RadioOutcome
from gateway.stimulation import StimulationGate
from tests.gateway.harness import a_request

QUICK = StimulationTable(min_gap_s=60.0, stop_retry_s=0.02, stop_attempts=3, reply_timeout_s=0.2, flight_s=0.1)
"""Soon out of patience: for what is not answered."""

PATIENT = StimulationTable(min_gap_s=60.0, stop_retry_s=0.05, stop_attempts=20, reply_timeout_s=20.0, flight_s=0.1)
"""For what is answered, on a machine that may be busy."""

RADIO_TIMEOUT_S = 0.3


@dataclass(slots=True, kw_only=True, eq=False)
class Frame:
    """One frame: to whom, what, how, and its fate."""

    node: NodeId | None
    message: Stimulate
    is_urgent: bool
    sending: "asyncio.Future[RadioOutcome]"
    radio: str = ""
    n_waiting: int = 0
    """Frames that were not urgent and waited when this one was given."""


@dataclass(slots=True, kw_only=True, eq=False)
class FakeAir:
    """A way to the biobots that implements what the gate needs. Where ``is_stuck``, frames wait unwritten; ``stuck``: on these radios."""

    frames: list[Frame] = field(default_factory=list)
    gate: StimulationGate | None = None
    n_elsewhere: int = 0
    n_radios: int = 1
    is_down: bool = False
    is_broken: bool = False
    is_stuck: bool = False
    stuck: set[str] = field(default_factory=set)
    fate: Fate = Fate.SENT
    result: StimulationResult = StimulationResult.DONE
    answers: Callable[[NodeId, int], bool] = lambda _node, _n_sent: True
    """Whether a biobot answers the frame that makes so many of its own."""

    def send(self, node: NodeId, message: Stimulate, *, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":
        if self.is_broken:
            raise ValueError("a fault nobody thought of")
        if self.is_down:
            raise RadioUnavailableError(radio="r", reason="it is not connected")
        return self._send(node, message, is_urgent=is_urgent)

    def send_elsewhere(self, node: NodeId, message: Stimulate) -> "list[asyncio.Future[RadioOutcome]]":
        return [] if self.is_down else [self._send(node, message, is_urgent=True) for _ in range(self.n_elsewhere)]

    def ways_to(self, node: NodeId) -> list[str]:
        return [f"r{(node + n) % self.n_radios}" for n in range(1 + self.n_elsewhere)]

    def send_over(self, radio: str, node: NodeId, message: Stimulate) -> "asyncio.Future[RadioOutcome]":
        if self.is_down:
            raise RadioUnavailableError(radio=radio, reason="it is not connected")
        return self._send(node, message, is_urgent=True, radio=radio)

    def send_to_all(self, message: Stimulate) -> "dict[str, asyncio.Future[RadioOutcome]]":
        return {} if self.is_down else {f"r{n}": self._send(None, message, is_urgent=True) for n in range(self.n_radios)}

    def withdraw(self, sending: "asyncio.Future[RadioOutcome]") -> bool:
        if not self.is_stuck or sending.done():
            return False
        sending.set_result(RadioOutcome(fate=Fate.NOT_SENT, reason="withdrawn before it was written"))
        return True

    def sent_to(self, node: int) -> list[Stimulate]:
        """Return what was sent to one biobot."""
        return [frame.message for frame in self.frames if frame.node == node]

    def reply(self, node: int, message: Stimulate) -> None:
        """Let a biobot answer."""
        assert self.gate is not None
        mode = WireMode.S if message.action.name == "STOP" else WireMode.CRW
        reply = StimulateReply(command=message.command, result=self.result, executed_ms=Milliseconds(1), mode=mode)
        self.gate.on_reply(NodeId(node), reply)

    def _send(self, node: NodeId | None, message: Stimulate, *, is_urgent: bool, radio: str = "") -> "asyncio.Future[RadioOutcome]":
        loop = asyncio.get_running_loop()
        n_waiting = sum(not one.is_urgent and not one.sending.done() for one in self.frames)
        frame = Frame(node=node, message=message, is_urgent=is_urgent, radio=radio, n_waiting=n_waiting, sending=loop.create_future())
        self.frames.append(frame)
        if not self.is_stuck and radio not in self.stuck:
            frame.sending.set_result(RadioOutcome(fate=self.fate))
            if node is not None and self.fate is Fate.SENT and self.answers(node, len(self.sent_to(node))):
                loop.call_soon(self.reply, node, message)
        return frame.sending


@dataclass(slots=True, kw_only=True, eq=False)
class Site:
    """A gate with all around it."""

    gate: StimulationGate
    air: FakeAir
    journal: Journal
    nodes: NodeBook
    health: Health

    async def stages(
        self,
        node: int,
        action: StimulationAction,
        *,
        command_id: str | None = None,
        pulse: PulseRequest | None = None,
        commander: str = "",
        hold_ms: int = 0,
    ) -> list[CommandStage]:
        """Give a command and return its stages."""
        stages: list[CommandStage] = []
        request = a_command(node, action, command_id=command_id, pulse=pulse, commander=commander, hold_ms=hold_ms)
        await self.gate.handle(request, stages.append)
        return stages


def remember(site: Site, *nodes: int, heard_ns: Mapping[NodeId, int] | None = None) -> None:
    """Let the gate know biobots of an earlier process, each heard just before the start, or at an instant."""
    memories = [
        NodeMemory(
            node=NodeId(node),
            boot=BootId(1),
            radio="r",
            address=ShortAddress(1000 + node),
            eui64=node,
            firmware=1,
            beacon_period_ms=0,
            capabilities=1,
            is_introduced=True,
        )
        for node in nodes
    ]
    site.nodes.restore(memories, heard_ns=heard_ns or {}, now_ns=time.monotonic_ns())


def a_command(
    node: int,
    action: StimulationAction,
    *,
    command_id: str | None = None,
    pulse: PulseRequest | None = None,
    commander: str = "",
    hold_ms: int = 0,
) -> StimulationRequest:
    plain = a_request(node, action, command_id=command_id)
    return StimulationRequest(
        command_id=plain.command_id,
        node=plain.node,
        action=plain.action,
        operator=plain.operator,
        issued_wall_ns=plain.issued_wall_ns,
        pulse=pulse,
        commander=commander,
        hold_ms=hold_ms,
    )


@asynccontextmanager
async def a_site(
    path: Path,
    *nodes: int,
    config: StimulationTable = PATIENT,
    now_ns: Callable[[], int] = time.monotonic_ns,
    wall_clock: Callable[[], int] = time.time_ns,
    is_commander_there: Callable[[str], bool] = lambda _: False,
    controlled: Callable[[], tuple[NodeId, ...]] = tuple,
    is_killed: bool = False,
) -> AsyncIterator[Site]:
    """Run a gate on a real journal; it is closed in good order at exit, or (``is_killed``) as SIGKILL does once all is on disk."""
    health = Health()
    journal = Journal.open(path, health=health)
    reader = journal.reader()
    air, book = FakeAir(), NodeBook(gateway="g")
    for node in nodes:
        book.heard(
            node=NodeId(node),
            boot=BootId(1),
            radio="r",
            address=ShortAddress(node),
            rssi_dbm=RssiDbm(-50),
            lqi=1,
            sent_ms=Milliseconds(0),
            now_ns=now_ns(),
            now_wall_ns=Nanoseconds(1),
        )
    gate = StimulationGate(
        gateway="g",
        config=config,
        sender=air,
        nodes=book,
        journal=journal,
        reader=reader,
        health=health,
        instant_of=journal.identity.instant_of,
        radio_timeout_s=RADIO_TIMEOUT_S,
        now_ns=now_ns,
        wall_clock=wall_clock,
        is_commander_there=is_commander_there,
        controlled=controlled,
    )
    air.gate = gate
    try:
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(journal.run())
            await journal.drain()
            yield Site(gate=gate, air=air, journal=journal, nodes=book, health=health)
            if not is_killed:
                gate.abandon()
            await journal.drain()
            running.cancel()
    finally:
        reader.close()
        journal.close()
