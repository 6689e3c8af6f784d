"""Everything between a command on the bus and the gate, wired together: commanders, the account of whom they move, gate, dead-man."""

import asyncio
from collections.abc import Iterator
from typing import Self

from firmware_protocol.contract.commands import StimulationRequest
from gateway.audit_log import AuditLog
from gateway.begun import begin
from gateway.bus import Bus
from gateway.bus_commands import STOPS, CommandAnswer
from gateway.commanders import LATE_TOKEN_S, Commanders
from gateway.config import GatewayConfig
from gateway.control_book import ControlBook
from gateway.dead_man import DeadMan
from gateway.downlink import DownlinkSender
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import AuditEntry, JournalReader
from gateway.nodes import NodeBook
from gateway.stimulation import StimulationGate

_REMEMBERED_ROWS = 30_000
"""So many rows of the audit log are looked through at a start for biobots that were under control when the gateway ended."""


class Commanding:
    """Takes commands from the bus, and sees that nobody moves whom nobody steers any more. Belongs to one event loop."""

    def __init__(self, *, gate: StimulationGate, commanders: Commanders, dead_man: DeadMan) -> None:
        self.gate = gate
        self.commanders = commanders
        self.dead_man = dead_man
        self._tasks: set[asyncio.Task[None]] = set()
        self._has_ended = False

    @classmethod
    def wire(
        cls,
        *,
        config: GatewayConfig,
        journal: Journal,
        reader: JournalReader,
        nodes: NodeBook,
        sender: DownlinkSender,
        audit: AuditLog,
        bus: Bus,
        health: Health,
    ) -> Self:
        """Make all of them, with what the journal knows of the time before; stages and accounts are published."""
        book = ControlBook()
        commanders = Commanders(silence_s=config.stimulation.commander_silence_s, health=health, notes=audit)
        gate = StimulationGate(
            gateway=config.name,
            config=config.stimulation,
            sender=sender,
            nodes=nodes,
            journal=journal,
            reader=reader,
            health=health,
            instant_of=journal.identity.instant_of,
            radio_timeout_s=config.link.radio_timeout_s,
            is_commander_there=commanders.is_there,
            controlled=book.controlled.keys,
            controller_of=book.operator_of,
            on_repeated=audit.note_repeated,
        )
        dead_man = DeadMan(
            gate=gate,
            book=book,
            commanders=commanders,
            can_reach=sender.can_reach,
            last_heard_ns=nodes.last_heard_ns,
            notes=audit,
            health=health,
            boot=journal.boot,
        )
        dead_man.restore(_remembered(reader))
        gate.listen(dead_man.hear)
        gate.listen(lambda _request, stage: bus.publish_stage(stage))
        gate.listen_to_accounts(bus.publish_account)
        return cls(gate=gate, commanders=commanders, dead_man=dead_man)

    def take(self, tasks: asyncio.TaskGroup, request: StimulationRequest, answer: CommandAnswer) -> None:
        """Take a command from the bus; until the gateway has ended, for a stop may come while it does. A stop is sent at once."""
        if self._has_ended:
            return
        taking = self._take(request, answer)
        rest = begin(taking) if request.action in STOPS else taking
        if rest is None:
            return
        task = tasks.create_task(rest)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def wind_down(self, config: GatewayConfig) -> set[asyncio.Task[None]]:
        """Stop whom the configuration names, and give every command its last answer; return the tasks to cancel."""
        self.gate.begin_stopping()
        await self.dead_man.wind_down(config.stimulation.on_shutdown)
        self._has_ended = True
        self.gate.abandon()
        return set(self._tasks)

    async def _take(self, request: StimulationRequest, answer: CommandAnswer) -> None:
        if request.commander and request.action not in STOPS and not self.commanders.is_there(request.commander):
            # Its token may be on its way still; the gate refuses what comes without one.
            await self.commanders.wait_for(request.commander, timeout_s=min(LATE_TOKEN_S, request.ttl_ms / 1000))
        await self.gate.handle(request, answer.tell, came_ns=answer.came_ns)


def _remembered(reader: JournalReader) -> Iterator[AuditEntry]:
    """Read the newest rows when the first is wanted: whoever takes them knows what to do where they cannot be read."""
    yield from reader.read_newest_audit(limit=_REMEMBERED_ROWS)
