"""Commands to biobots: sent through the gateway that heard the biobot last, followed to the end, and remembered for a while."""

import asyncio
import time
import uuid
from collections import OrderedDict
from collections.abc import Callable
from contextlib import aclosing
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from firmware_protocol.contract.commands import CommandStage, StimulationAction, StimulationRequest
from firmware_protocol.units import Nanoseconds, NodeId
from mapper.bus import Bus
from mapper.changes import Changes, Topic
from mapper.errors import BiobotNotFoundError, CommandNotFoundError, CommandRefusedError, QueryError, TooManyError
from mapper.fleet import Fleet
from mapper.log import EventLog

_log = EventLog(__name__)

_KEPT: Final = 1000
_MAX_AT_ONCE: Final = 256
# Beyond its time to live a command may still wait for the biobot's confirmation, and a STOP is tried several times.
_PATIENCE_S: Final = 10.0


class Outcome(StrEnum):
    """How a command ended; the first four are the gateway's words (CONTRACT.md), the last means that it was not there."""

    BIOBOT_CONFIRMED = "biobot_confirmed"
    REFUSED = "refused"
    FAILED = "failed"
    UNKNOWN = "unknown"
    UNDELIVERED = "undelivered"


@dataclass(slots=True, kw_only=True)
class Command:
    """A command and what became of it so far; ``outcome`` is None while it is under way."""

    request: StimulationRequest
    gateway: str
    stages: list[CommandStage] = field(default_factory=list)
    outcome: Outcome | None = None
    reason: str = ""
    has_ended: asyncio.Event = field(default_factory=asyncio.Event)


class CommandDesk:
    """Sends commands and keeps the newest thousand."""

    def __init__(self, *, bus: Bus, fleet: Fleet, changes: Changes, wall_ns: Callable[[], int] = time.time_ns) -> None:
        self._bus = bus
        self._fleet = fleet
        self._changes = changes
        self._wall_ns = wall_ns
        self._commands: OrderedDict[str, Command] = OrderedDict()
        self._group: asyncio.TaskGroup | None = None
        self._n_under_way = 0

    async def run(self) -> None:
        """Follow commands until cancelled: one whose sender hung up is followed all the same."""
        async with asyncio.TaskGroup() as self._group:
            await asyncio.Event().wait()

    async def submit(
        self, *, node: NodeId, action: StimulationAction, operator: str, ttl_ms: int, hold_ms: int, command_id: str | None = None
    ) -> Command:
        """Send a command and wait for its end; the same id again means the same command, which is not sent twice.

        Raises
        ------
        BiobotNotFoundError
            No gateway has spoken of the biobot.
        CommandRefusedError
            The id is that of another command.
        TooManyError
            Too many commands are under way; a STOP is never held back for that.
        """
        known = self._commands.get(command_id) if command_id is not None else None
        if known is None:
            known = self._send(node=node, action=action, operator=operator, ttl_ms=ttl_ms, hold_ms=hold_ms, command_id=command_id)
        elif (known.request.node, known.request.action, known.request.operator) != (node, action, operator):
            raise CommandRefusedError(command_id=known.request.command_id, reason="its id was used for another command; choose a new id")
        await known.has_ended.wait()
        return known

    def get(self, command_id: str) -> Command:
        """Return a command by its id.

        Raises
        ------
        CommandNotFoundError
            It was not sent from here, or is forgotten.
        """
        if command_id not in self._commands:
            raise CommandNotFoundError(command_id=command_id, kept=_KEPT)
        return self._commands[command_id]

    def recent(self, *, limit: int) -> list[Command]:
        """List the newest commands, the newest first."""
        return list(self._commands.values())[::-1][:limit]

    def _send(
        self, *, node: NodeId, action: StimulationAction, operator: str, ttl_ms: int, hold_ms: int, command_id: str | None
    ) -> Command:
        gateway = self._fleet.gateway_of(node)
        if gateway is None:
            raise BiobotNotFoundError(biobot=node)
        if self._group is None or (self._n_under_way >= _MAX_AT_ONCE and action is not StimulationAction.STOP):
            raise TooManyError(what="commands are under way", limit=_MAX_AT_ONCE)
        request = StimulationRequest(
            command_id=command_id or uuid.uuid4().hex,
            node=node,
            action=action,
            operator=operator,
            issued_wall_ns=Nanoseconds(self._wall_ns()),
            ttl_ms=ttl_ms,
            hold_ms=hold_ms,
        )
        command = Command(request=request, gateway=gateway)
        self._remember(command)
        self._group.create_task(self._follow(command), name=f"command {request.command_id}")
        return command

    def _remember(self, command: Command) -> None:
        self._commands[command.request.command_id] = command
        while len(self._commands) > _KEPT:
            self._commands.popitem(last=False)

    async def _follow(self, command: Command) -> None:
        request = command.request
        _log.info("command.sent", id=request.command_id, biobot=request.node, action=request.action.value, operator=request.operator)
        self._n_under_way += 1
        try:
            timeout_s = request.ttl_ms / 1000 + _PATIENCE_S
            async with aclosing(self._bus.send_command(request, gateway=command.gateway, timeout_s=timeout_s)) as stages:
                async for stage in stages:
                    command.stages.append(stage)
                    self._changes.bump(Topic.COMMANDS)
                    if stage.is_final:
                        command.outcome, command.reason = Outcome(stage.stage.value), stage.reason
                        break
            if command.outcome is None:
                command.outcome = Outcome.UNKNOWN if command.stages else Outcome.UNDELIVERED
                command.reason = "the gateway's answer broke off" if command.stages else "the gateway is not on the bus"
        except QueryError as error:
            # A gateway that had begun to act is silent now: whether the biobot got the command, nobody here knows.
            command.outcome = Outcome.UNKNOWN if error.is_timeout or command.stages else Outcome.FAILED
            command.reason = str(error)
        finally:
            self._n_under_way -= 1
            if command.outcome is None:
                command.outcome, command.reason = Outcome.UNKNOWN, "the mapper was stopped"
            command.has_ended.set()
            self._changes.bump(Topic.COMMANDS)
            _log.info("command.ended", id=request.command_id, biobot=request.node, outcome=str(command.outcome), reason=command.reason)
