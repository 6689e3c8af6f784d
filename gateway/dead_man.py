"""The dead-man: whoever is under controlled motion is stopped when nobody is there to move it any more.

That is when its commander is gone (`gateway.commanders`), when its hold is over (its backpack stops by itself then, too), when this gateway
was restarted meanwhile, or when it ends. A stop that the biobot does not confirm is given again until it does, or somebody else moves it.
"""

import asyncio
import contextlib
import sqlite3
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol

import msgspec

from firmware_protocol.contract.commands import CommandStage, PulseRequest, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import decode_record
from firmware_protocol.errors import RecordError
from firmware_protocol.units import EVERYBODY, NS_PER_S, Nanoseconds, NodeId
from gateway.commanders import Commanders, Notes
from gateway.control_book import Control, ControlBook
from gateway.health import Health
from gateway.journal_file import AuditEntry
from gateway.log import EventLog

_log = EventLog(__name__)

OPERATOR: Final = "dead-man"

_AGAIN_S: Final = (1.0, 2.0, 5.0)
"""Pauses after stops that were not confirmed; the last one for all that follow."""

_PATIENT_ATTEMPTS: Final = 10
"""After so many a biobot is stopped again only once it has been heard."""

_WIND_DOWN_S: Final = 2.0
_STALL_NS: Final = NS_PER_S // 4
"""Where this process itself was held up for longer, beats may wait to be read: silence is judged a moment later."""

_MOMENT_S: Final = 0.1
_LOOK_NS: Final = NS_PER_S // 5
"""Pause between two looks whether a biobot can be reached again."""

OnShutdown = Literal["controlled", "all", "none"]


class Gate(Protocol):
    """What takes stops."""

    async def handle(self, request: StimulationRequest, listener: Callable[[CommandStage], None]) -> None:
        """Take a command; ``listener`` hears each stage, the last one final."""


@dataclass(slots=True, kw_only=True)
class _Owed:
    """A stop that a biobot is owed until it confirms one."""

    control: Control
    reason: str
    has_ended_itself: bool
    """Its backpack stopped it, as far as can be known: no train is given to make sure of it."""
    attempts: int = 0
    begun_ns: int = 0
    next_ns: int = 0
    is_under_way: bool = False


class DeadMan:
    """Keeps account of controlled motion in ``book``, and ends it; belongs to one event loop."""

    def __init__(
        self,
        *,
        gate: Gate,
        book: ControlBook,
        commanders: Commanders,
        can_reach: Callable[[NodeId], bool],
        last_heard_ns: Callable[[NodeId], int],
        notes: Notes,
        health: Health,
        boot: int,
        again_s: Sequence[float] = _AGAIN_S,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wall_clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self._gate = gate
        self._commanders = commanders
        self._can_reach = can_reach
        self._last_heard_ns = last_heard_ns
        self._notes = notes
        self._health = health
        self._boot = boot
        self._again_s = tuple(again_s)
        self._clock_ns = clock_ns
        self._wall_clock = wall_clock
        self._book = book
        self._owed: dict[NodeId, _Owed] = {}
        self._wake = asyncio.Event()
        self._runs = asyncio.Event()
        self._tasks: asyncio.TaskGroup | None = None
        self._n_stops = 0
        commanders.listen(self._on_gone)

    def controlled(self) -> Mapping[NodeId, Control]:
        """Return who is under controlled motion now."""
        return self._book.controlled

    def hear(self, request: StimulationRequest, stage: CommandStage) -> None:
        """Take a stage of any command."""
        takeover = self._book.note(request, stage, now_ns=self._clock_ns())
        if takeover is not None:
            facts = {"event": "took_over", "commander": takeover.after.commander, "before": takeover.before.commander}
            _log.info("commander.took_over", node=request.node, commander=takeover.after.commander, before=takeover.before.commander)
            self._notes.note("commander", facts=facts, operator=request.operator, node=request.node)
        control = self._book.controlled.get(request.node)
        if control is not None and control.commander and not self._commanders.is_there(control.commander):
            # While the command was taken; or while another had taken it over, whose command then never reached the biobot.
            self._owe(control, "its commander went while a command was under way")
        self._wake.set()

    def restore(self, entries: Iterable[AuditEntry]) -> None:
        """Take what the journal knows, in order: whoever was moved when the process before this one ended is owed a stop.

        What is behind a damage is not known; the log says so, and what to do.
        """
        try:
            for entry in entries:
                self._remember(entry)
        except (sqlite3.Error, msgspec.ValidationError) as error:
            advice = "biobots that were moved before the gateway ended may be moving: stop all (`biobot-gateway stop --all`)"
            _log.error("dead_man.unread_journal", reason=str(error), advice=advice)
        for control in list(self._book.controlled.values()):
            self._owe(control, "the gateway was restarted while it was under control")

    def _remember(self, entry: AuditEntry) -> None:
        try:
            request, stage = decode_record(entry.request, StimulationRequest), decode_record(entry.body, CommandStage)
        except RecordError:
            self._health.count("dead_man.unread_entries")
            return
        if entry.stage == stage.stage.value:  # else it is no stage of its own: a frame of a stop that was sent again
            self._book.note(request, stage, now_ns=self._clock_ns())

    async def run(self) -> None:
        """End controlled motion whenever it is to end, until cancelled."""
        async with asyncio.TaskGroup() as self._tasks:
            self._runs.set()
            wanted_ns = self._clock_ns()
            while True:
                now_ns = self._clock_ns()
                was_stalled = now_ns - wanted_ns > _STALL_NS
                self._look(now_ns, may_judge=not was_stalled)
                pause_s = _MOMENT_S if was_stalled else self._pause_s()
                wanted_ns = now_ns + int(pause_s * NS_PER_S)
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(pause_s):
                        await self._wake.wait()
                        wanted_ns = self._clock_ns()
                self._wake.clear()

    async def wind_down(self, whom: OnShutdown, *, timeout_s: float = _WIND_DOWN_S) -> None:
        """Stop whom the gateway may not leave moving, now that it ends, and wait for their confirmation; ``run`` runs meanwhile."""
        await self._runs.wait()
        assert self._tasks is not None
        controls = list(self._book.controlled.values())
        if whom == "none" or (whom == "controlled" and not controls):
            if controls:
                _log.warning("dead_man.left_moving", nodes=[control.node for control in controls], on_shutdown=whom)
                self._notes.note("dead_man", facts={"event": "left_moving", "nodes": [int(control.node) for control in controls]})
            return
        nodes = [EVERYBODY] if whom == "all" else [control.node for control in controls]
        action = StimulationAction.STOP_ALL if whom == "all" else StimulationAction.STOP
        stops = {node: self._tasks.create_task(self._stop(self._request(node, action))) for node in nodes}
        await asyncio.wait(stops.values(), timeout=timeout_s)
        confirmed = [node for node, stop in stops.items() if stop.done() and stop.result()]
        others = [node for node in nodes if node not in confirmed]
        say = _log.error if others else _log.info
        say("dead_man.wound_down", confirmed=confirmed, unconfirmed=others)
        facts = {"event": "wound_down", "confirmed": [int(node) for node in confirmed], "unconfirmed": [int(node) for node in others]}
        self._notes.note("dead_man", facts=facts, operator=OPERATOR)

    def _on_gone(self, commander: str, reason: str) -> None:
        for control in self._book.of_commander(commander):
            self._owe(control, f"its commander {commander} is gone: {reason}")

    def _look(self, now_ns: int, *, may_judge: bool) -> None:
        if may_judge:
            self._commanders.judge(self._book.moving(), now_ns=now_ns)
        for control in self._book.overdue(now_ns=now_ns):
            self._owe(control, "its hold is over", has_ended_itself=True)
        for node, owed in list(self._owed.items()):
            if self._is_settled(owed):
                del self._owed[node]
            elif not owed.is_under_way and owed.next_ns <= now_ns:
                is_heard = owed.attempts < _PATIENT_ATTEMPTS or self._last_heard_ns(node) > owed.begun_ns
                if self._can_reach(node) and is_heard:
                    self._begin(owed)
                else:
                    owed.next_ns = now_ns + _LOOK_NS
        self._health.set_level("commanders.controlled", len(self._book.controlled))

    def _pause_s(self) -> float:
        moving = self._book.moving()
        deadlines = [owed.next_ns for owed in self._owed.values() if not owed.is_under_way]
        ends = [
            control.until_ns for node, control in self._book.controlled.items() if control.until_ns is not None and node not in self._owed
        ]
        deadlines += ends
        if (silent_ns := self._commanders.next_judgement_ns(moving)) is not None:
            deadlines.append(silent_ns)
        if not deadlines:
            return 3600.0
        return max(0.001, (min(deadlines) - self._clock_ns()) / NS_PER_S)

    def _owe(self, control: Control, reason: str, *, has_ended_itself: bool = False) -> None:
        owed = self._owed.get(control.node)
        if owed is not None and owed.control == control:
            return
        self._owed[control.node] = owed = _Owed(control=control, reason=reason, has_ended_itself=has_ended_itself)
        self._health.count("dead_man.stops")
        _log.warning("dead_man.stop", node=control.node, commander=control.commander, operator=control.operator, reason=reason)
        facts = {"event": "stop", "reason": reason, "commander": control.commander, "command": control.command_id}
        self._notes.note("dead_man", facts=facts, operator=control.operator, node=control.node)
        if self._tasks is not None:
            self._begin(owed)
        self._wake.set()

    def _begin(self, owed: _Owed) -> None:
        assert self._tasks is not None
        owed.is_under_way, owed.begun_ns = True, self._clock_ns()
        owed.attempts += 1
        self._tasks.create_task(self._give(owed))

    async def _give(self, owed: _Owed) -> None:
        pulse = PulseRequest(duration_ms=0) if owed.has_ended_itself else None
        await self._stop(self._request(owed.control.node, StimulationAction.STOP, pulse=pulse))
        owed.is_under_way = False
        owed.next_ns = self._clock_ns() + int(self._again_s[min(owed.attempts, len(self._again_s)) - 1] * NS_PER_S)
        self._wake.set()

    def _is_settled(self, owed: _Owed) -> bool:
        return self._book.controlled.get(owed.control.node) != owed.control

    async def _stop(self, request: StimulationRequest) -> bool:
        """Return whether the biobot confirmed."""
        stages: list[CommandStage] = []
        await self._gate.handle(request, stages.append)
        return bool(stages) and stages[-1].stage is Stage.BIOBOT_CONFIRMED

    def _request(self, node: NodeId, action: StimulationAction, *, pulse: PulseRequest | None = None) -> StimulationRequest:
        self._n_stops += 1
        return StimulationRequest(
            command_id=f"dead-man-{self._boot}-{self._n_stops}",
            node=node,
            action=action,
            operator=OPERATOR,
            issued_wall_ns=Nanoseconds(self._wall_clock()),
            pulse=pulse,
        )
