"""The mission as it runs: time, orders, reports and records go to the planner, and what it wants goes to journal and gate."""

import asyncio
import time
from collections.abc import Callable, Collection, Mapping
from functools import partial

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.mission_orders import MissionAction, MissionAnswer, MissionOrder
from firmware_protocol.contract.records import EncounterRecord, MissionPhase, Mode, ModeRecord
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import MissionTable
from gateway.health import Health
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import Committed, JournalReader
from gateway.log import EventLog
from gateway.mission.candidates import USUAL_SHARE
from gateway.mission.choosing import Chooser, Note
from gateway.mission.chronicle import Chronicle
from gateway.mission.landmark_commands import OPERATOR, Handle, LandmarkCommander
from gateway.mission.orders import OrderMemory, answer_of, refusal_of
from gateway.mission.phases import COMMANDING
from gateway.mission.planner import MissionPlanner
from gateway.mission.states import restore_state
from gateway.mission.steps import Choose, FollowWalls, LetGo, MakeLandmark, MissionState, MissionStep, Tell
from gateway.mission.wall_walks import WallWalks
from gateway.mission.watch import LandmarkWatch, Suspicion, stands_by_command, threshold_of
from gateway.nodes import NodeBook

_log = EventLog(__name__)

_TICK_S = 0.1
_LOOK_S = 1.0
"""How often the landmarks' silence and batteries are looked at."""

_ON_DISK_S = 2.0
"""An order's answer waits so long for the disk."""

_RESTORED_ORDERS = 256
_STARTS = {StimulationAction.START, StimulationAction.FOLLOW_WALLS}


class Mission:
    """Runs the planner's steps; ``run`` is its task. Belongs to one event loop.

    Parameters
    ----------
    handle
        The stimulation gate's way in.
    note
        The audit log's.
    on_event
        Told what an operator may want to know: level, kind and facts.
    controlled
        Who is under controlled motion: nobody of them is told to follow walls.
    """

    def __init__(
        self,
        *,
        config: MissionTable,
        issuer: RecordIssuer,
        journal: Journal,
        reader: JournalReader,
        nodes: NodeBook,
        handle: Handle,
        health: Health,
        note: Note,
        on_event: Callable[[str, str, Mapping[str, str]], None],
        controlled: Callable[[], Collection[NodeId]] = tuple,
        wall_clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self._config = config
        self._planner = MissionPlanner(config=config)
        self._issuer = issuer
        self._journal = journal
        self._nodes = nodes
        self._note = note
        self._on_event = on_event
        self._wall_clock = wall_clock
        now_ns = time.monotonic_ns()
        self._watch = LandmarkWatch(gap_ns=int(config.contradiction_gap_s * NS_PER_S), armed_ns=now_ns)
        self._commander = LandmarkCommander(
            handle=handle,
            nodes=nodes,
            journal=journal,
            health=health,
            may_command=self._may_command,
            name=f"mission-{issuer.boot}",
            patience_s=config.selection_timeout_s,
            wall_clock=wall_clock,
        )
        self._walls = WallWalks(
            config=config,
            commander=self._commander,
            planner=self._planner,
            nodes=nodes,
            ran_ns=lambda: journal.ran_ns,
            may_command=self._may_command,
            controlled=controlled,
            proceed=self._proceed,
        )
        self._orders = OrderMemory(gateway=issuer.gateway)
        self._chronicle = Chronicle(issuer=issuer, journal=journal)
        self._restored_until_ns = 0
        self._started_ns = self._looked_ns = now_ns
        self._held_since_ns = now_ns
        """Since when landmarks' silence is judged: at a pause and before this process nobody listened."""
        self._waiting: list[MissionStep] = []
        self._ordered: list[tuple[MissionOrder, Callable[[MissionAnswer], None]]] = []
        self._chooser = Chooser(config=config, nodes=nodes, planner=self._planner, note=note, on_event=on_event)
        self._stopped: set[NodeId] = set()
        """Whom others have stopped since this process began, and nobody has started since."""
        self._wake = asyncio.Event()
        self._resume(reader, now_ns=now_ns)
        if not config.n_landmarks and not USUAL_SHARE[0] <= config.landmark_share <= USUAL_SHARE[1]:
            _log.warning("mission.share", share=config.landmark_share, advice="the method takes 0.1 to 0.2 of the biobots")

    @property
    def state(self) -> MissionState:
        """How the mission stands."""
        return self._planner.state

    async def run(self) -> None:
        """Go through the phases, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._walls.run())
            while True:
                now_ns = time.monotonic_ns()
                self._chronicle.write()
                ordered, self._ordered = self._ordered, []
                for order, tell in ordered:
                    tasks.create_task(self._answer_order(order, tell))
                self._take_waiting(tasks)
                self._look(now_ns=now_ns)
                known = self._known(now_ns=now_ns) if self._needs_to_know() else set()
                is_graph_known = bool(known) and known <= self._nodes.adjacency().keys()
                pick, followers = partial(self._chooser.pick, now_ns=now_ns), partial(self._walls.followers, now_ns=now_ns)
                self._waiting += self._planner.tick(
                    now_ns=self._journal.ran_ns, n_known=len(known), is_graph_known=is_graph_known, pick=pick, followers=followers
                )
                self._take_waiting(tasks)
                self._watch.set_landmarks(self.state.landmarks, now_ns=now_ns)
                self._wake.clear()
                if not self._waiting and not self._ordered:
                    try:
                        async with asyncio.timeout(_TICK_S):
                            await self._wake.wait()
                    except TimeoutError:
                        pass

    async def handle_order(self, order: MissionOrder) -> MissionAnswer:
        """Take an operator's order, and answer when what it changes is on disk."""
        known = self._orders.recall(order)
        if known is not None:
            return known
        refusal = refusal_of(order, now_wall_ns=self._wall_clock(), journal_fault=self._journal.fault)
        steps: list[MissionStep] = []
        if refusal is None:
            refusal, steps = self._planner.order(
                order.action,
                operator=order.operator,
                order_id=order.order_id,
                now_ns=self._journal.ran_ns,
                standing=self._standing() if order.action is MissionAction.START else (),
            )
        answer = answer_of(
            order,
            self.state,
            gateway=self._issuer.gateway,
            refusal=refusal,
            remaining_ns=self._planner.remaining_ns(self._journal.ran_ns),
            possible=self._planner.possible(),
        )
        self._orders.note(order, answer)
        if order.action is not MissionAction.SHOW:
            facts = {"order": order.order_id, "action": order.action.value, "taken": refusal is None, "reason": refusal or ""}
            self._note("mission.order", facts=facts, operator=order.operator)
            _log.info("mission.order", operator=order.operator, action=order.action.value, refusal=refusal or "")
        if self._proceed(steps) and self._chronicle.on_disk is not None:
            await asyncio.wait({self._chronicle.on_disk}, timeout=_ON_DISK_S)
        return answer

    def take_order(self, order: MissionOrder, tell: Callable[[MissionAnswer], None]) -> None:
        """Have the task take an order, and tell its answer; orders that wait when it ends are not answered."""
        self._ordered.append((order, tell))
        self._wake.set()

    def on_stage(self, request: StimulationRequest, stage: CommandStage) -> None:
        """Hear of every command's stages: a stop of all pauses the mission, and who starts a landmark takes it away."""
        if stage.stage is not Stage.ACCEPTED:
            return
        now_ns = self._journal.ran_ns
        self._note_stops(request, is_part=bool(stage.part_of))
        if request.action is StimulationAction.STOP_ALL:
            walking = [node.node for node in self._nodes.all() if node.mode is None or node.mode.mode is Mode.CRW]
            self._proceed(self._planner.stop_all(operator=request.operator, walking=walking, now_ns=now_ns))
        elif request.action in _STARTS and request.operator != OPERATOR and request.node in self.state.landmarks:
            self._lose(request.node, reason=f"{request.operator} let it walk", is_let_go=False)
        if request.operator != OPERATOR and request.node in self.state.following:
            self._proceed(self._planner.leave_walls(request.node))

    def _note_stops(self, request: StimulationRequest, *, is_part: bool) -> None:
        """Remember who was stopped by others, for what a backpack reports of itself comes later; whom they stop is let go no more.

        ``is_part``: of a stop of all, which is not undone but by the order to resume.
        """
        if request.action is StimulationAction.STOP_ALL:
            self._stopped |= {node.node for node in self._nodes.all()}
        elif request.action is StimulationAction.STOP and request.operator != OPERATOR:
            self._stopped.add(request.node)
            if not is_part:
                self._planner.released(request.node)
        elif request.action is not StimulationAction.STOP:
            self._stopped.discard(request.node)

    def _standing(self) -> set[NodeId]:
        """Return who stands by a stop, as far as is known from reports of any process and from commands of this one."""
        return self._stopped | {node.node for node in self._nodes.all() if node.mode is not None and stands_by_command(node.mode)}

    def take_records(self, committed: Committed) -> None:
        """Judge the landmarks by what has come to lie on disk."""
        if self.state.choice is None or self.state.phase not in COMMANDING:
            return
        landmarks, failed = self.state.landmarks, self.state.choice.failed
        for record in committed.records:
            if isinstance(record, EncounterRecord) and record.node_a in landmarks and record.node_b in landmarks:
                both = map(self._nodes.find, (record.node_a, record.node_b))
                suspicion = self._watch.take_encounter(
                    record,
                    t_start_ns=self._issuer.to_own_monotonic_ns(record.t_start_ns, anchor_ns=record.wall_anchor_ns),
                    t_end_ns=self._issuer.to_own_monotonic_ns(record.t_end_ns, anchor_ns=record.wall_anchor_ns),
                    enter_dbm=threshold_of(*(one.configuration for one in both if one is not None)),
                    now_ns=time.monotonic_ns(),
                )
            elif isinstance(record, ModeRecord) and record.node in landmarks:
                t_start_ns = self._issuer.to_own_monotonic_ns(record.t_start_ns, anchor_ns=record.wall_anchor_ns)
                suspicion = self._watch.take_mode(record, t_start_ns=t_start_ns)
            elif isinstance(record, ModeRecord) and record.node in failed and stands_by_command(record):
                self._proceed(self._planner.stands_after_all(record.node, now_ns=self._journal.ran_ns))
                continue
            else:
                continue
            if suspicion is not None:
                self._suspect(suspicion)

    def _resume(self, reader: JournalReader, *, now_ns: int) -> None:
        records = reader.read_recent_missions(limit=_RESTORED_ORDERS)
        self._orders.restore(records)
        if not records:
            return
        self._chronicle.resume(records[-1])
        state = restore_state(records[-1], issuer=self._issuer, now_ns=now_ns, now_ran_ns=self._journal.ran_ns)
        self._waiting = self._planner.resume(state, now_ns=self._journal.ran_ns)
        self._restored_until_ns = now_ns + int(self._config.selection_timeout_s * NS_PER_S)
        self._watch.armed_ns = now_ns + self._watch.gap_ns
        _log.info("mission.resumed", phase=state.phase.value, landmarks=len(state.landmarks), round=state.round)

    def _needs_to_know(self) -> bool:
        """Whether it matters now who is there; with thousands of biobots it costs something to find out."""
        state = self.state
        if state.phase is MissionPhase.IDLE:
            return self._config.is_enabled
        is_short = state.choice is None or len(state.landmarks | state.awaited) < state.choice.n_wanted
        return is_short and state.phase in {MissionPhase.LANDMARK_SELECTION, MissionPhase.EXPLORATION}

    def _known(self, *, now_ns: int) -> set[NodeId]:
        # Those of the journal are waited for: the first one that speaks after a restart is not all there are.
        oldest_ns = now_ns - int(self._config.candidate_silence_s * NS_PER_S)
        nodes = self._nodes.all()
        return {one.node for one in nodes if (one.last_heard_ns >= oldest_ns if one.last_heard_ns else now_ns < self._restored_until_ns)}

    def _may_command(self) -> bool:
        return self.state.phase in COMMANDING

    def _proceed(self, steps: list[MissionStep]) -> bool:
        """Write down at once what is to be written, and leave the rest to the task; return whether anything was written."""
        told = [step for step in steps if isinstance(step, Tell)]
        for step in told:
            self._tell(step)
        self._waiting += [step for step in steps if not isinstance(step, Tell)]
        self._wake.set()
        return bool(told)

    def _take_waiting(self, tasks: asyncio.TaskGroup) -> None:
        steps, self._waiting = self._waiting, []
        for step in steps:
            match step:
                case Tell():
                    self._tell(step)
                case Choose(turn=turn):
                    tasks.create_task(self._choose(turn))
                case MakeLandmark(node=node, is_again=is_again):
                    tasks.create_task(self._make_landmark(node, on_disk=self._chronicle.on_disk, is_again=is_again))
                case FollowWalls():
                    self._walls.take(step, self._chronicle.on_disk)
                case LetGo(node=node, decided_ns=decided_ns):
                    tasks.create_task(self._let_go(node, on_disk=self._chronicle.on_disk, decided_ns=decided_ns))

    async def _choose(self, turn: int) -> None:
        self._proceed(self._planner.take_choice(await self._chooser.choose(turn), now_ns=self._journal.ran_ns))

    async def _make_landmark(self, node: NodeId, *, on_disk: "asyncio.Future[None] | None", is_again: bool) -> None:
        await _wait_for(on_disk)
        outcome = await self._commander.stop(node)
        if outcome.was_kept:
            return
        self._note("landmark.asked", facts={"stands": outcome.is_done, "reason": outcome.reason, "again": is_again}, node=node)
        steps = self._planner.settle(
            node, is_standing=outcome.is_done, reason=outcome.reason, now_ns=self._journal.ran_ns, wall_ns=self._wall_clock()
        )
        self._proceed(steps)

    async def _let_go(self, node: NodeId, *, on_disk: "asyncio.Future[None] | None", decided_ns: int) -> None:
        await _wait_for(on_disk)
        name = f"mission-start-{node}-{decided_ns}"
        outcome = await self._commander.start(node, name=name, is_wanted=lambda: self._may_command() and node in self.state.releasing)
        if outcome.was_kept:
            return
        self._note("landmark.let_go", facts={"walks": outcome.is_done, "reason": outcome.reason}, node=node)
        if not outcome.is_done:
            self._on_event("warning", "mission.not_released", {"node": str(node), "reason": outcome.reason})
        self._planner.released(node)
        self._wake.set()

    def _look(self, *, now_ns: int) -> None:
        """See whether landmarks are still heard, and what their batteries say."""
        if self.state.phase is not MissionPhase.EXPLORATION:
            self._held_since_ns = now_ns
            return
        if now_ns - self._looked_ns < _LOOK_S * NS_PER_S:
            return
        self._looked_ns = now_ns
        silence_ns = int(self._config.landmark_silence_s * NS_PER_S)
        for landmark in sorted(self.state.landmarks):
            node = self._nodes.find(landmark)
            heard_ns = max(0 if node is None else node.last_heard_ns, self._held_since_ns)
            if now_ns - heard_ns >= silence_ns:
                self._lose(landmark, reason=f"it was not heard for {self._config.landmark_silence_s:g} s", is_let_go=False)
            elif node is not None and node.status is not None and node.status.battery_mv < self._config.min_battery_mv:
                reason = f"its battery has {node.status.battery_mv} mV, less than {self._config.min_battery_mv}"
                self._lose(landmark, reason=reason, is_let_go=False)

    def _suspect(self, suspicion: Suspicion) -> None:
        if not suspicion.is_told:
            self._lose(suspicion.node, reason=suspicion.reason, is_let_go=True)
            return
        steps = self._planner.is_walking(suspicion.node, reason=suspicion.reason, now_ns=self._journal.ran_ns, wall_ns=self._wall_clock())
        if steps:
            self._note("landmark.doubt", facts={"reason": suspicion.reason}, node=suspicion.node)
        self._tell_loss(suspicion.node, reason=suspicion.reason)
        self._proceed(steps)

    def _lose(self, node: NodeId, *, reason: str, is_let_go: bool) -> None:
        steps = self._planner.lose(node, reason=reason, is_let_go=is_let_go, now_ns=self._journal.ran_ns, wall_ns=self._wall_clock())
        self._tell_loss(node, reason=reason)
        self._proceed(steps)

    def _tell_loss(self, node: NodeId, *, reason: str) -> None:
        changes = self.state.changes
        if node in self.state.landmarks or not changes or changes[-1].node != node:
            return
        _log.warning("mission.landmark_lost", node=node, reason=reason)
        self._note("landmark.lost", facts={"reason": reason}, node=node)
        self._on_event("warning", "mission.landmark_lost", {"node": str(node), "reason": reason})

    def _tell(self, step: Tell) -> None:
        state = step.state
        if step.is_revision:
            if not self._chronicle.revise(state):
                return
            if state.phase is MissionPhase.LANDMARK_SELECTION:
                self._note("mission.waits", facts={"reason": state.reason})
                _log.warning("mission.waits", reason=state.reason)
            else:  # a wall phase has begun or is over
                self._note(
                    "mission.walls", facts={"number": state.wall_phase, "following": sorted(state.following), "reason": state.reason}
                )
                _log.info("mission.walls", number=state.wall_phase, following=len(state.following), reason=state.reason)
            return
        self._chronicle.begin(state)
        self._chooser.begin_phase()
        facts = {"phase": state.phase.value, "round": state.round, "landmarks": sorted(state.landmarks), "reason": state.reason}
        self._note("mission.phase", facts=facts, operator=state.operator)
        _log.info("mission.phase", phase=state.phase.value, landmarks=len(state.landmarks), round=state.round, reason=state.reason)

    async def _answer_order(self, order: MissionOrder, tell: Callable[[MissionAnswer], None]) -> None:
        tell(await self.handle_order(order))


async def _wait_for(on_disk: "asyncio.Future[None] | None") -> None:
    if on_disk is not None:
        await asyncio.wait({on_disk})
