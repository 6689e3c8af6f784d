"""Laws of the gate, on a real journal and with a radio that answers at once."""

import asyncio
import sqlite3
from collections.abc import Awaitable, Callable
from pathlib import Path

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction
from firmware_protocol.messages import Downlink, Stimulate, StimulateReply, StimulationResult, WireMode
from firmware_protocol.units import BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.config import StimulationTable
from gateway.downlink import DownlinkSender
from gateway.health import Health
from gateway.journal import Journal
from gateway.nodes import NodeBook, NodeMemory
from gateway.radio import Fate, RadioOutcome
from gateway.stimulation import StimulationGate
from tests.gateway.harness import a_request

_CONFIG = StimulationTable(stop_retry_s=0.02, stop_attempts=3, reply_timeout_s=0.2)


class _Air(DownlinkSender):
    """Takes every message; the biobot answers a STOP from frame ``answers_from`` on."""

    def __init__(self, nodes: NodeBook) -> None:
        super().__init__(coordinators={}, nodes=nodes)
        self.nodes = nodes
        self.n_radios = 1
        self.gate: StimulationGate | None = None
        self.answers_from = 1
        self.is_broken = False
        self.n_sent = 0

    def send(self, node: NodeId, message: Downlink, *, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":  # noqa: ARG002  # the sender's own signature
        if self.is_broken:
            raise ValueError("a fault nobody thought of")
        assert isinstance(message, Stimulate)
        self.n_sent += 1
        loop = asyncio.get_running_loop()
        future: asyncio.Future[RadioOutcome] = loop.create_future()
        future.set_result(RadioOutcome(fate=Fate.SENT))
        if self.n_sent >= self.answers_from and self.gate is not None:
            reply = StimulateReply(command=message.command, result=StimulationResult.DONE, executed_ms=Milliseconds(1), mode=WireMode.S)
            loop.call_soon(self.gate.on_reply, node, reply)
        return future

    def send_everywhere(self, node: NodeId, message: Downlink) -> "list[asyncio.Future[RadioOutcome]]":
        return [self.send(node, message, is_urgent=True) for _ in range(self.n_radios)]


def _with_gate(path: Path, story: Callable[[StimulationGate, _Air, Journal], Awaitable[None]]) -> None:
    async def run() -> None:
        health = Health()
        journal = Journal.open(path, health=health)
        nodes = NodeBook(gateway="g")
        nodes.heard(
            node=NodeId(5),
            boot=BootId(1),
            radio="r",
            address=ShortAddress(1),
            rssi_dbm=RssiDbm(-50),
            lqi=1,
            sent_ms=Milliseconds(0),
            now_ns=1,
            now_wall_ns=Nanoseconds(1),
        )
        air, reader = _Air(nodes), journal.reader()
        gate = StimulationGate(gateway="g", config=_CONFIG, sender=air, nodes=nodes, journal=journal, reader=reader, health=health)
        air.gate = gate
        try:
            async with asyncio.TaskGroup() as tasks:
                running = tasks.create_task(journal.run())
                await story(gate, air, journal)
                await journal.drain()
                running.cancel()
        finally:
            reader.close()
            journal.close()

    asyncio.run(run())


async def _outcome(gate: StimulationGate, node: int, action: StimulationAction, *, command_id: str | None = None) -> CommandStage:
    stages: list[CommandStage] = []
    await gate.handle(a_request(node, action, command_id=command_id), stages.append)
    return stages[-1]


def test_a_command_for_a_number_no_biobot_can_have_is_refused_and_harms_nobody(tmp_path: Path) -> None:
    async def story(gate: StimulationGate, air: _Air, _: Journal) -> None:
        for node in (0xFFFF, 1 << 63, (1 << 64) - 1):
            for action in (StimulationAction.START, StimulationAction.STOP):
                stage = await _outcome(gate, node, action)
                assert stage.stage is Stage.REFUSED
                assert "not known" in stage.reason
        assert (await _outcome(gate, 5, StimulationAction.STOP)).stage is Stage.BIOBOT_CONFIRMED
        assert air.n_sent == 1

    _with_gate(tmp_path / "j", story)


def test_every_frame_of_a_stop_counts_as_a_train_also_after_a_restart(tmp_path: Path) -> None:
    async def stop(gate: StimulationGate, air: _Air, _: Journal) -> None:
        air.answers_from = 3
        assert (await _outcome(gate, 5, StimulationAction.STOP, command_id="stop")).stage is Stage.BIOBOT_CONFIRMED
        stage = await _outcome(gate, 5, StimulationAction.START)
        assert stage.stage is Stage.REFUSED
        assert "pause" in stage.reason
        assert (await _outcome(gate, 5, StimulationAction.STOP)).stage is Stage.BIOBOT_CONFIRMED, "a stop is never refused"

    async def ask_again(gate: StimulationGate, air: _Air, _: Journal) -> None:
        assert (await _outcome(gate, 5, StimulationAction.START)).stage is Stage.REFUSED
        stages: list[CommandStage] = []
        await gate.handle(a_request(5, StimulationAction.STOP, command_id="stop"), stages.append)
        assert [stage.stage for stage in stages] == [Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED]
        assert air.n_sent == 0

    _with_gate(tmp_path / "j", stop)
    _with_gate(tmp_path / "j", ask_again)
    with sqlite3.connect(tmp_path / "j") as database:
        trains = [ms for (ms,) in database.execute("SELECT train_ms FROM audit WHERE train_ms > 0")]
    database.close()
    assert trains == [_CONFIG.duration_ms] * 4


def test_a_stop_is_sent_where_the_journal_cannot_be_read_and_nothing_else_is(tmp_path: Path) -> None:
    async def story(gate: StimulationGate, air: _Air, _: Journal) -> None:
        gate._reader.close()
        stage = await _outcome(gate, 5, StimulationAction.TURN_LEFT)
        assert stage.stage is Stage.REFUSED
        assert "cannot be read" in stage.reason
        assert air.n_sent == 0
        assert (await _outcome(gate, 5, StimulationAction.STOP)).stage is Stage.BIOBOT_CONFIRMED
        assert air.n_sent == 1

    _with_gate(tmp_path / "j", story)


def test_a_fault_in_one_command_ends_that_command_alone(tmp_path: Path) -> None:
    async def story(gate: StimulationGate, air: _Air, _: Journal) -> None:
        air.is_broken = True
        stage = await _outcome(gate, 5, StimulationAction.STOP)
        assert stage.stage is Stage.UNKNOWN
        assert "nobody thought of" in stage.reason
        air.is_broken = False
        assert (await _outcome(gate, 5, StimulationAction.STOP)).stage is Stage.BIOBOT_CONFIRMED

    _with_gate(tmp_path / "j", story)


def test_a_finished_command_keeps_no_listeners(tmp_path: Path) -> None:
    async def story(gate: StimulationGate, _air: _Air, _journal: Journal) -> None:
        for _ in range(3):
            assert (await _outcome(gate, 5, StimulationAction.STOP, command_id="one")).stage is Stage.BIOBOT_CONFIRMED
        assert gate._finished["one"].listeners == []

    _with_gate(tmp_path / "j", story)


def test_a_biobot_not_heard_since_the_start_is_stopped_and_never_stimulated(tmp_path: Path) -> None:
    async def story(gate: StimulationGate, air: _Air, _: Journal) -> None:
        air.nodes.restore(
            [
                NodeMemory(
                    node=NodeId(6),
                    boot=BootId(1),
                    radio="r",
                    address=ShortAddress(2),
                    eui64=6,
                    firmware=1,
                    beacon_period_ms=0,
                    capabilities=1,
                    is_introduced=True,
                )
            ]
        )
        for action in (StimulationAction.START, StimulationAction.TURN_LEFT, StimulationAction.TURN_RIGHT):
            refused = await _outcome(gate, 6, action)
            assert refused.stage is Stage.REFUSED
            assert "not heard since the gateway started" in refused.reason
        assert air.n_sent == 0
        assert (await _outcome(gate, 6, StimulationAction.STOP)).stage is Stage.BIOBOT_CONFIRMED

    _with_gate(tmp_path / "j", story)


def test_a_stop_over_two_radios_counts_as_two_trains_also_after_a_restart(tmp_path: Path) -> None:
    async def stop(gate: StimulationGate, air: _Air, _: Journal) -> None:
        air.n_radios = 2
        assert (await _outcome(gate, 5, StimulationAction.STOP)).stage is Stage.BIOBOT_CONFIRMED
        assert air.n_sent == 2

    async def count(gate: StimulationGate, air: _Air, journal: Journal) -> None:
        reader = journal.reader()
        trains_ms = [entry.train_ms for entry in reader.read_audit_since(0) if entry.train_ms]
        reader.close()
        assert trains_ms == [_CONFIG.duration_ms] * 2

    _with_gate(tmp_path / "j", stop)
    _with_gate(tmp_path / "j", count)
