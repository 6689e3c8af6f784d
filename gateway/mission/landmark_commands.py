"""Stops and starts that the mission gives through the stimulation gate, one at a time to each biobot, and what came of them."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from firmware_protocol.contract.commands import CommandStage, PulseRequest, Refusal, Stage, StimulationAction, StimulationRequest
from firmware_protocol.messages import WireCause, WireMode
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.health import Health
from gateway.journal import Journal
from gateway.log import EventLog
from gateway.nodes import NodeBook

_log = EventLog(__name__)

OPERATOR = "mission"

_MAX_STOPS = 3
"""While the disk takes nothing, answers do not come through, so a stop is given again."""

_MAX_STARTS = 20
_START_AGAIN_S = 3.0
_POLL_S = 0.1

_NEVER_SENT = {Refusal.GAP, Refusal.TRAINS, Refusal.ON_TIME, Refusal.TOO_MANY, Refusal.JOURNAL, Refusal.RADIO, Refusal.UNFIT_BIOBOT}
"""Refusals after which a start may be given again a little later: no train was given."""

Handle = Callable[[StimulationRequest, Callable[[CommandStage], None]], Awaitable[None]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of a command; ``is_done``: the biobot is as it was told. ``was_kept``: the mission was paused before it was given."""

    is_done: bool
    reason: str = ""
    was_kept: bool = False


class LandmarkCommander:
    """Gives the mission's commands; belongs to one event loop.

    Parameters
    ----------
    handle
        The gate.
    may_command
        Whether the mission may command anybody now; asked before each command.
    name
        Begins the names of the commands of this process.
    patience_s
        How long a biobot that was not heard since this process began is waited for before it is asked.
    """

    def __init__(
        self,
        *,
        handle: Handle,
        nodes: NodeBook,
        journal: Journal,
        health: Health,
        may_command: Callable[[], bool],
        name: str,
        patience_s: float,
        wall_clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self._handle = handle
        self._nodes = nodes
        self._journal = journal
        self._health = health
        self._may_command = may_command
        self._name = name
        self._patience_s = patience_s
        self._wall_clock = wall_clock
        self._n_given = 0
        self._busy: dict[NodeId, asyncio.Lock] = {}  # of 65,535 biobots at most

    async def stop(self, node: NodeId) -> Outcome:
        """Have a biobot stand still."""
        async with self._alone(node):
            await self._wait_until_heard(node)
            outcome = Outcome(is_done=False, reason="it was not asked")
            for _ in range(_MAX_STOPS):
                await self._wait_for_the_disk()
                if not self._may_command():
                    return Outcome(is_done=False, was_kept=True)
                last = await self._command(node, StimulationAction.STOP, command_id=self._next_id(node))
                outcome = Outcome(is_done=last.stage is Stage.BIOBOT_CONFIRMED or self._reports_standing(node), reason=last.reason)
                if outcome.is_done or self._journal.fault is None:
                    break
        self._health.count("mission.landmarks" if outcome.is_done else "mission.landmarks_failed")
        if not outcome.is_done:
            _log.warning("mission.landmark_failed", node=node, reason=outcome.reason)
        return outcome

    async def start(self, node: NodeId, *, name: str, is_wanted: Callable[[], bool]) -> Outcome:
        """Have a biobot walk, by a ``name`` that is for good: a start whose outcome is not known is not given again by a later process.

        ``is_wanted`` is asked before each attempt.
        """
        outcome = await self._give(node, StimulationAction.START, name=name, pulse=None, is_wanted=is_wanted)
        if outcome.was_kept:
            return outcome
        self._health.count("mission.released" if outcome.is_done else "mission.releases_failed")
        if not outcome.is_done:
            _log.warning("mission.not_released", node=node, reason=outcome.reason)
        return outcome

    async def walk(self, node: NodeId, action: StimulationAction, *, name: str, is_wanted: Callable[[], bool]) -> Outcome:
        """Have a walking biobot start anew or follow walls, without a train; ``name`` as of ``start``."""
        outcome = await self._give(node, action, name=name, pulse=PulseRequest(duration_ms=0), is_wanted=is_wanted)
        if not outcome.was_kept:
            self._health.count("mission.walls_told" if outcome.is_done else "mission.walls_failed")
        return outcome

    async def _give(
        self, node: NodeId, action: StimulationAction, *, name: str, pulse: PulseRequest | None, is_wanted: Callable[[], bool]
    ) -> Outcome:
        async with self._alone(node):
            outcome = Outcome(is_done=False, reason="it was not asked")
            for attempt in range(_MAX_STARTS):
                await self._wait_for_the_disk()
                if not is_wanted():
                    return Outcome(is_done=False, was_kept=True)
                last = await self._command(node, action, command_id=f"{name}-{attempt}", pulse=pulse)
                outcome = Outcome(is_done=last.stage is Stage.BIOBOT_CONFIRMED, reason=last.reason)
                if last.stage is not Stage.REFUSED or last.refusal not in _NEVER_SENT:
                    break
                await asyncio.sleep(_START_AGAIN_S)
        return outcome

    def _alone(self, node: NodeId) -> asyncio.Lock:
        """Return the biobot's lock: a start that overtook the stop before it would be undone by that stop's repetition."""
        return self._busy.setdefault(node, asyncio.Lock())

    def _next_id(self, node: NodeId) -> str:
        self._n_given += 1
        return f"{self._name}-{self._n_given}-{node}"

    async def _command(
        self, node: NodeId, action: StimulationAction, *, command_id: str, pulse: PulseRequest | None = None
    ) -> CommandStage:
        issued_wall_ns = Nanoseconds(self._wall_clock())
        request = StimulationRequest(
            command_id=command_id, node=node, action=action, operator=OPERATOR, issued_wall_ns=issued_wall_ns, pulse=pulse
        )
        stages: list[CommandStage] = []
        await self._handle(request, stages.append)
        return stages[-1]

    def _reports_standing(self, node: NodeId) -> bool:
        known = self._nodes.find(node)
        if known is None or known.status is None:
            return False
        return known.status.mode is WireMode.S and known.status.cause is WireCause.COMMAND

    async def _wait_until_heard(self, node: NodeId) -> None:
        """Wait for one that an earlier process had chosen: right after a start neither its radio nor its place is known to be right."""
        deadline_s = time.monotonic() + self._patience_s
        while time.monotonic() < deadline_s and self._may_command():  # a mission can wait; nothing else needs the event
            known = self._nodes.find(node)
            if known is not None and known.last_heard_ns:
                return
            await asyncio.sleep(_POLL_S)

    async def _wait_for_the_disk(self) -> None:
        while self._journal.fault is not None:  # noqa: ASYNC110  # a mission can wait; nothing else needs the event
            await asyncio.sleep(_POLL_S)
