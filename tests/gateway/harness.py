"""A running gateway and a Zenoh peer that listens to it, for end-to-end tests."""

import asyncio
import json
import threading
import time
import uuid
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import TypeVar

import zenoh

from firmware_protocol.contract.announcements import GatewayEvent, NeighbourReport
from firmware_protocol.contract.commands import CommandStage, StimulationAction, StimulationRequest
from firmware_protocol.contract.keys import ANY, Stream, build_key
from firmware_protocol.contract.records import (
    GatewayStatus,
    HistoryRequest,
    JournalRecord,
    NodeStatus,
    RecordBatch,
    Struct,
    decode_record,
    encode_record,
)
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.config import BackpackTable, GatewayConfig, LinkTable, MissionTable, StimulationTable
from gateway.service import Service
from studies.ports import free_port
from tests.gateway.fake_radio import until

_StructT = TypeVar("_StructT", bound=Struct)


def a_config(
    tmp_path: Path,
    *ports: str,
    stimulation: StimulationTable | None = None,
    mission: MissionTable | None = None,
    backpacks: BackpackTable | None = None,
) -> GatewayConfig:
    return GatewayConfig(
        site="test",
        name="base1",
        ports=ports,
        journal=str(tmp_path / "journal.sqlite"),
        listen=(f"tcp/127.0.0.1:{free_port()}",),
        link=LinkTable(first_backoff_s=0.05, max_backoff_s=0.2),
        stimulation=stimulation or StimulationTable(reply_timeout_s=20.0, stop_retry_s=0.3),
        mission=mission or MissionTable(),
        backpacks=backpacks or BackpackTable(),
    )


@asynccontextmanager
async def running(config: GatewayConfig) -> AsyncIterator[Service]:
    """Run a gateway; it is stopped in good order at exit."""
    service = Service(config)
    ready = asyncio.Event()
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(service.run(on_ready=ready.set))
        waiting = asyncio.ensure_future(ready.wait())
        await asyncio.wait({task, waiting}, return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        try:
            yield service
        finally:
            service.stop()


class Listener:
    """All that a peer hears; callbacks come on Zenoh's threads."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self._lock = threading.Lock()
        self._records: list[JournalRecord] = []
        self.node_statuses: list[NodeStatus] = []
        self.gateway_statuses: list[GatewayStatus] = []
        self.neighbours: list[NeighbourReport] = []
        self.events: list[GatewayEvent] = []
        self._subscribers = [
            session.declare_subscriber(build_key(site="test", stream=stream, gateway=ANY), self._take_batch)
            for stream in (Stream.ENCOUNTERS, Stream.MODES, Stream.MISSION)
        ]
        self._subscribe(build_key(site="test", stream=Stream.STATUS, gateway=ANY, node=ANY), self.node_statuses, NodeStatus)
        self._subscribe(build_key(site="test", stream=Stream.NEIGHBOURS, gateway=ANY, node=ANY), self.neighbours, NeighbourReport)
        self._subscribe(build_key(site="test", stream=Stream.STATUS, gateway=ANY), self.gateway_statuses, GatewayStatus)
        self._subscribe(build_key(site="test", stream=Stream.EVENTS, gateway=ANY), self.events, GatewayEvent)

    @property
    def records(self) -> list[JournalRecord]:
        with self._lock:
            return list(self._records)

    async def hear(self) -> None:
        """Wait until the gateway that runs now is heard."""
        self.gateway_statuses.clear()
        await until(lambda: bool(self.gateway_statuses), what="the peer hears the gateway")

    def of(self, kind: type[_StructT]) -> list[_StructT]:
        return [record for record in self.records if isinstance(record, kind)]

    def _subscribe(self, key: str, kept: list[_StructT], kind: type[_StructT]) -> None:
        def take(sample: zenoh.Sample) -> None:
            kept.append(decode_record(sample.payload.to_bytes(), kind))

        self._subscribers.append(self.session.declare_subscriber(key, take))

    def _take_batch(self, sample: zenoh.Sample) -> None:
        batch = decode_record(sample.payload.to_bytes(), RecordBatch)
        with self._lock:
            self._records += batch.records


@contextmanager
def listening(config: GatewayConfig) -> Iterator[Listener]:
    """Connect a peer to the gateway, before or after it starts."""
    with zenoh.open(peer_config(config.listen[0])) as session:
        yield Listener(session)


def peer_config(endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in {
        "mode": '"peer"',
        "scouting/multicast/enabled": "false",
        "listen/endpoints": "[]",
        "connect/endpoints": json.dumps([endpoint]),
        "connect/timeout_ms": "-1",
        "connect/exit_on_failure": "false",
        "connect/retry": "{period_init_ms: 50, period_max_ms: 100, period_increase_factor: 1}",
    }.items():
        config.insert_json5(key, value)
    return config


def a_request(node: int, action: StimulationAction, *, command_id: str | None = None, age_s: float = 0.0) -> StimulationRequest:
    return StimulationRequest(
        command_id=command_id or uuid.uuid4().hex,
        node=NodeId(node),
        action=action,
        operator="tester",
        issued_wall_ns=Nanoseconds(time.time_ns() - int(age_s * 1e9)),
    )


async def command(listener: Listener, request: StimulationRequest) -> list[CommandStage]:
    """Send a command over Zenoh and return its stages."""
    key = build_key(site="test", stream=Stream.COMMAND, gateway="base1")

    def ask() -> list[CommandStage]:
        replies = listener.session.get(key, payload=encode_record(request), timeout=60.0, consolidation=zenoh.ConsolidationMode.NONE)
        return [decode_record(reply.ok.payload.to_bytes(), CommandStage) for reply in replies if reply.ok is not None]

    return await asyncio.to_thread(ask)


async def history(listener: Listener, request: HistoryRequest) -> list[RecordBatch]:
    key = build_key(site="test", stream=Stream.HISTORY, gateway="base1")

    def ask() -> list[RecordBatch]:
        replies = listener.session.get(key, payload=encode_record(request), timeout=60.0, consolidation=zenoh.ConsolidationMode.NONE)
        return [decode_record(reply.ok.payload.to_bytes(), RecordBatch) for reply in replies if reply.ok is not None]

    return await asyncio.to_thread(ask)
