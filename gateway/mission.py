"""The exploration protocol of [Dir16] IV: dispersion, landmark selection, exploration.

``MissionPlanner`` is pure: it is told what is so and returns what to do. ``Mission`` does it, through the stimulation gate.
"""

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import Cause, MissionPhase, MissionRecord, Mode, ModeRecord
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.messages import WireMode
from firmware_protocol.units import NS_PER_S, Nanoseconds, NodeId
from gateway.config import MissionTable
from gateway.health import Health
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import JournalReader, JournalWrite
from gateway.log import EventLog
from gateway.nodes import NodeBook
from gateway.stimulation import StimulationGate

_log = EventLog(__name__)

_TICK_S = 0.1
_OPERATOR = "mission"
_MAX_ATTEMPTS = 3
_MIN_FAILURES = 10
"""So many landmarks may fail before none is replaced any more, or as many as were wanted."""
_RESTORED_MODES = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class EnterPhase:
    """Begin a phase, and say so."""

    phase: MissionPhase
    landmarks: tuple[NodeId, ...] = ()
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeLandmark:
    """Command a biobot to stand still."""

    node: NodeId


MissionStep: TypeAlias = EnterPhase | MakeLandmark


@dataclass(slots=True, kw_only=True)
class MissionPlanner:
    """The mission's state machine.

    A landmark is confirmed when its biobot answers the stop, or reports that it stands by then; where it does neither, the
    next best takes its place. Exploration begins when nothing is awaited any more.
    """

    config: MissionTable
    phase: MissionPhase = MissionPhase.IDLE
    confirmed: set[NodeId] = field(default_factory=set)
    n_left_standing: int = 0
    """Biobots that an earlier mission stopped, and that still stand when this one begins."""
    _since_ns: int = 0
    _adjacency: dict[int, frozenset[NodeId]] | None = None
    _awaited: set[NodeId] = field(default_factory=set)
    _failed: set[NodeId] = field(default_factory=set)
    _n_wanted: int = 0

    def resume(self, phase: MissionPhase, *, since_ns: int, now_ns: int, standing: set[NodeId]) -> None:
        """Go on with a mission that an earlier process had begun; one that was done is done, and the next one begins.

        A selection that was under way is made again; it counts those biobots that already stand by command.

        Parameters
        ----------
        since_ns
            When the phase began.
        now_ns
            When this process began: a selection waits for neighbour reports from then, since those given before are gone.
        standing
            Biobots that stand by command.
        """
        if phase in {MissionPhase.IDLE, MissionPhase.DONE}:
            self.n_left_standing = len(standing)
            return
        self.phase, self._since_ns = phase, now_ns if phase is MissionPhase.LANDMARK_SELECTION else since_ns
        self.confirmed |= standing

    def tick(self, *, now_ns: int, known: set[NodeId], adjacency: Mapping[NodeId, frozenset[NodeId]]) -> list[MissionStep]:
        """Return what is to be done now.

        Parameters
        ----------
        known
            All biobots heard of; where there are none, no landmark is selected.
        adjacency
            Whom each biobot hears, of those that have reported it.
        """
        elapsed_s = (now_ns - self._since_ns) / NS_PER_S
        match self.phase:
            case MissionPhase.IDLE if known:
                reason = "the first biobot was heard"
                if self.n_left_standing:
                    reason += f"; {self.n_left_standing} biobots still stand by command"
                return [self._enter(MissionPhase.DISPERSION, now_ns=now_ns, reason=reason)]
            case MissionPhase.DISPERSION if elapsed_s >= self.config.dispersion_s:
                reason = f"dispersed for {self.config.dispersion_s:g} s"
                return [self._enter(MissionPhase.LANDMARK_SELECTION, now_ns=now_ns, reason=reason)]
            case MissionPhase.LANDMARK_SELECTION:
                return self._select(now_ns=now_ns, elapsed_s=elapsed_s, known=known, adjacency=adjacency)
            case MissionPhase.EXPLORATION if self.config.exploration_s and elapsed_s >= self.config.exploration_s:
                return [self._enter(MissionPhase.DONE, now_ns=now_ns, reason=f"explored for {self.config.exploration_s:g} s")]
            case _:
                return []

    def settle(self, node: NodeId, *, is_standing: bool) -> list[MissionStep]:
        """Take the outcome of a landmark's stop; return the command to its replacement, if it needs one."""
        self._awaited.discard(node)
        if is_standing:
            self.confirmed.add(node)
            return []
        self._failed.add(node)
        if len(self._failed) >= max(_MIN_FAILURES, self._n_wanted):
            # So many silent animals are a fault of ours: each replacement may be one more that stands without our knowing.
            return []
        replacement = self._next_best()
        if replacement is None:
            return []
        self._awaited.add(replacement)
        return [MakeLandmark(node=replacement)]

    def _select(
        self, *, now_ns: int, elapsed_s: float, known: set[NodeId], adjacency: Mapping[NodeId, frozenset[NodeId]]
    ) -> list[MissionStep]:
        if self._adjacency is None:
            is_patient = elapsed_s < self.config.selection_timeout_s
            if not known or (is_patient and not known <= adjacency.keys()):
                return []
            reported = adjacency or {node: frozenset[NodeId]() for node in known}
            self._adjacency = {int(node): heard for node, heard in reported.items()}
            wanted = self.config.n_landmarks or max(1, round(self.config.landmark_share * len(known)))
            self._n_wanted = wanted
            picks = [NodeId(node) for node in select_landmarks(self._adjacency, count=min(wanted, len(self._adjacency)))]
            missing = [node for node in picks if node not in self.confirmed][: max(0, wanted - len(self.confirmed))]
            self._awaited = set(missing)
            return [MakeLandmark(node=node) for node in missing]
        if self._awaited:
            return []
        reason = f"{len(self.confirmed)} landmarks stand"
        if self._failed:
            reason += f"; not reached: {', '.join(str(node) for node in sorted(self._failed))}"
        return [self._enter(MissionPhase.EXPLORATION, now_ns=now_ns, reason=reason)]

    def _next_best(self) -> NodeId | None:
        """Return the first pick that a longer selection without the failed ones adds to those standing or awaited."""
        candidates = {node: heard for node, heard in (self._adjacency or {}).items() if node not in self._failed}
        taken = self.confirmed | self._awaited
        for count in range(min(len(taken) + 1, len(candidates)), len(candidates) + 1):
            for node in select_landmarks(candidates, count=count):
                if node not in taken:
                    return NodeId(node)
        return None

    def _enter(self, phase: MissionPhase, *, now_ns: int, reason: str) -> EnterPhase:
        self.phase, self._since_ns = phase, now_ns
        return EnterPhase(phase=phase, landmarks=tuple(sorted(self.confirmed)), reason=reason)


class Mission:
    """Runs the planner's steps; ``run`` is its task."""

    def __init__(
        self,
        *,
        config: MissionTable,
        issuer: RecordIssuer,
        journal: Journal,
        reader: JournalReader,
        nodes: NodeBook,
        gate: StimulationGate,
        health: Health,
        wall_clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self._config = config
        self._planner = MissionPlanner(config=config)
        self._issuer = issuer
        self._journal = journal
        self._nodes = nodes
        self._gate = gate
        self._health = health
        self._wall_clock = wall_clock
        self._restored_until_ns = 0
        self._resume(reader, now_ns=time.monotonic_ns())

    def _resume(self, reader: JournalReader, *, now_ns: int) -> None:
        last = reader.read_last_mission()
        if last is None:
            return
        standing = set(last.landmarks)
        if last.phase in {MissionPhase.LANDMARK_SELECTION, MissionPhase.DONE}:
            standing_now = _standing_by_command(reader)
            standing = standing_now if last.phase is MissionPhase.DONE else standing | standing_now
        since_ns = self._issuer.to_own_monotonic_ns(last.t_start_ns, anchor_ns=last.wall_anchor_ns)
        self._planner.resume(last.phase, since_ns=since_ns, now_ns=now_ns, standing=standing)
        if self._planner.phase is not MissionPhase.IDLE:
            self._restored_until_ns = now_ns + int(self._config.selection_timeout_s * NS_PER_S)
            _log.info("mission.resumed", phase=last.phase.value, landmarks=len(standing))

    async def run(self) -> None:
        """Go through the phases, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            while True:
                now_ns = time.monotonic_ns()
                # Those of the journal are waited for: the first one that speaks after a restart is not all there are.
                known = {node.node for node in self._nodes.all() if node.last_heard_ns or now_ns < self._restored_until_ns}
                adjacency = {node: others for node, others in self._nodes.adjacency().items() if node in known}
                self._take(self._planner.tick(now_ns=now_ns, known=known, adjacency=adjacency), tasks)
                await asyncio.sleep(_TICK_S)

    def _take(self, steps: list[MissionStep], tasks: asyncio.TaskGroup) -> None:
        for step in steps:
            match step:
                case EnterPhase():
                    self._record(step)
                case MakeLandmark(node=node):
                    tasks.create_task(self._make_landmark(node, tasks))

    async def _make_landmark(self, node: NodeId, tasks: asyncio.TaskGroup) -> None:
        """Stop a biobot and settle what came of it; while the disk takes nothing, answers do not come through, so it is asked again."""
        attempt = 0
        while True:
            await self._wait_for_the_disk()
            attempt += 1
            outcome = await self._stop(node, attempt=attempt)
            is_standing = outcome.stage is Stage.BIOBOT_CONFIRMED or self._reports_standing(node)
            if is_standing or self._journal.fault is None or attempt >= _MAX_ATTEMPTS:
                break
        self._health.count("mission.landmarks" if is_standing else "mission.landmarks_failed")
        if not is_standing:
            _log.warning("mission.landmark_failed", node=node, outcome=outcome.stage.value, reason=outcome.reason)
        self._take(self._planner.settle(node, is_standing=is_standing), tasks)

    async def _wait_for_the_disk(self) -> None:
        while self._journal.fault is not None:  # noqa: ASYNC110  # a mission can wait; nothing else needs the event
            await asyncio.sleep(_TICK_S)

    async def _stop(self, node: NodeId, *, attempt: int) -> CommandStage:
        request = StimulationRequest(
            command_id=f"mission-{self._issuer.boot}-{node}-{attempt}",
            node=node,
            action=StimulationAction.STOP,
            operator=_OPERATOR,
            issued_wall_ns=Nanoseconds(self._wall_clock()),
        )
        stages: list[CommandStage] = []
        await self._gate.handle(request, stages.append)
        return stages[-1]

    def _reports_standing(self, node: NodeId) -> bool:
        known = self._nodes.find(node)
        return known is not None and known.status is not None and known.status.mode is WireMode.S

    def _record(self, step: EnterPhase) -> None:
        _log.info("mission.phase", phase=step.phase.value, landmarks=len(step.landmarks), reason=step.reason)
        record = MissionRecord(
            gateway=self._issuer.gateway,
            journal=self._issuer.journal,
            offset=1,
            boot=self._issuer.boot,
            sequence=self._issuer.take_sequence(),
            revision=0,
            wall_anchor_ns=self._issuer.wall_anchor_ns,
            phase=step.phase,
            t_start_ns=Nanoseconds(time.monotonic_ns()),
            landmarks=step.landmarks,
            reason=step.reason,
        )
        self._journal.append(JournalWrite(records=(record,)))


def _standing_by_command(reader: JournalReader) -> set[NodeId]:
    """Return the biobots whose last spell is one of standing still by command."""
    newest: dict[NodeId, dict[tuple[int, int], ModeRecord]] = {}
    for record in reader.read_recent_modes(limit=_RESTORED_MODES):
        newest.setdefault(record.node, {})[record.boot, record.sequence] = record
    last = [max(spells.values(), key=lambda spell: spell.t_start_ns + spell.wall_anchor_ns) for spells in newest.values()]
    return {spell.node for spell in last if spell.mode is Mode.S and spell.cause is Cause.COMMAND}
