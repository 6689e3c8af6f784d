"""Laws of orders to the mission, and of its running: real journal and gate, a radio that is up for nobody."""

import asyncio
import time
from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.contract.announcements import NeighbourEntry
from firmware_protocol.contract.commands import CommandStage, PulseRequest, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.mission_orders import MissionAction, MissionAnswer, MissionOrder
from firmware_protocol.contract.records import Cause, EncounterRecord, MissionPhase, MissionRecord, Mode, ModeRecord
from firmware_protocol.messages import Capability, Hello, Status, WireCause, WireMode
from firmware_protocol.units import NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.config import MissionTable
from gateway.health import Health
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import JournalWrite
from gateway.mission import Mission
from gateway.nodes import NodeBook
from tests.gateway.fake_radio import until

_ROW = {node: tuple(other for other in (node - 1, node + 1) if 1 <= other <= 6) for node in range(1, 7)}


@dataclass(kw_only=True)
class Obeying:
    """A gate whose biobots do as they are told, but for the deaf ones; and all that was noted and told."""

    deaf: set[int] = field(default_factory=set)
    given: list[StimulationRequest] = field(default_factory=list)
    events: list[tuple[str, Mapping[str, str]]] = field(default_factory=list)
    notes: list[tuple[str, str, int | None]] = field(default_factory=list)

    async def handle(self, request: StimulationRequest, listener: object) -> None:
        self.given.append(request)
        stage = Stage.UNKNOWN if request.node in self.deaf else Stage.BIOBOT_CONFIRMED
        listener(stage_of(request, stage))  # type: ignore[operator]

    def note(self, kind: str, *, facts: Mapping[str, object], operator: str = "", node: NodeId | None = None) -> None:
        assert isinstance(facts, Mapping)
        self.notes.append((kind, operator, node))

    def told(self, action: StimulationAction) -> set[int]:
        return {request.node for request in self.given if request.action is action}


def stage_of(request: StimulationRequest, stage: Stage) -> CommandStage:
    return CommandStage(
        command_id=request.command_id, gateway="g", node=request.node, action=request.action, stage=stage, wall_ns=Nanoseconds(0)
    )


def an_order(action: MissionAction, *, order_id: str | None = None, age_s: float = 0.0) -> MissionOrder:
    issued_ns = time.time_ns() - int(age_s * NS_PER_S)
    return MissionOrder(order_id=order_id or f"{action.value}-1", action=action, operator="ann", issued_wall_ns=Nanoseconds(issued_ns))


def say(nodes: NodeBook, node: int, *, mode: WireMode = WireMode.CRW, battery_mv: int = 3000) -> None:
    """Have a biobot be heard now, with a status and its neighbours in the row."""
    now_ns = time.monotonic_ns()
    known, _ = nodes.heard(
        node=NodeId(node), boot=BootId(1), radio="r", address=ShortAddress(node), rssi_dbm=RssiDbm(-60), lqi=200,
        sent_ms=Milliseconds(now_ns // 1_000_000), now_ns=now_ns, now_wall_ns=Nanoseconds(time.time_ns()),
    )  # fmt: skip
    known.status = Status(
        mode=mode, cause=WireCause.COMMAND if mode is WireMode.S else WireCause.NATURAL, mode_since_ms=Milliseconds(0),
        battery_mv=battery_mv, buffered=0, dropped=0,
    )  # fmt: skip
    known.neighbours_ns = now_ns
    known.neighbours = tuple(NeighbourEntry(node=NodeId(other), rssi_dbm=RssiDbm(-60)) for other in _ROW[node])


@asynccontextmanager
async def a_mission(
    path: Path, gate: Obeying, *, controlled: Collection[NodeId] = (), **config: object
) -> AsyncIterator[tuple[Mission, NodeBook, Journal]]:
    """Run a mission on a journal; it is killed at exit, and what waits for the disk is lost."""
    health, nodes = Health(), NodeBook(gateway="g")
    journal = Journal.open(path, health=health)
    reader = journal.reader()
    issuer = RecordIssuer(gateway="g", journal=journal.journal_id, boot=journal.boot, wall_anchor_ns=journal.identity.wall_anchor_ns)
    for node in _ROW:
        say(nodes, node)
    mission = Mission(
        config=MissionTable(**config),  # type: ignore[arg-type]
        issuer=issuer,
        journal=journal,
        reader=reader,
        nodes=nodes,
        handle=gate.handle,
        health=health,
        note=gate.note,
        on_event=lambda _level, kind, facts: gate.events.append((kind, facts)),
        controlled=lambda: controlled,
    )
    journal.listen(mission.take_records)
    running = [asyncio.ensure_future(journal.run()), asyncio.ensure_future(mission.run())]
    try:
        yield mission, nodes, journal
    finally:
        for task in running:
            task.cancel()
        await asyncio.wait(running)
        reader.close()
        journal.close()


def test_an_order_is_obeyed_once_also_over_a_restart(tmp_path: Path) -> None:
    async def story() -> None:
        gate = Obeying()
        start = an_order(MissionAction.START)
        async with a_mission(tmp_path / "j", gate) as (mission, _, _):
            first = await mission.handle_order(start)
            assert (first.is_taken, first.phase) == (True, MissionPhase.DISPERSION)
            assert await mission.handle_order(start) == first
            other = await mission.handle_order(an_order(MissionAction.PAUSE, order_id=start.order_id))
            assert not other.is_taken
            assert "used for the order 'start'" in other.reason
            assert (await mission.handle_order(an_order(MissionAction.FINISH))).phase is MissionPhase.DONE
        async with a_mission(tmp_path / "j", gate) as (mission, _, _):
            assert mission.state.phase is MissionPhase.DONE
            again = await mission.handle_order(start)
            assert again.is_taken
            assert mission.state.phase is MissionPhase.DONE, "a known order starts nothing"

    asyncio.run(story())


@pytest.mark.parametrize("age_s", [6.0, -3.0])
def test_an_order_that_is_stale_or_from_the_future_is_refused_but_a_pause_never(tmp_path: Path, age_s: float) -> None:
    async def story() -> None:
        async with a_mission(tmp_path / "j", Obeying()) as (mission, _, _):
            stale = await mission.handle_order(an_order(MissionAction.START, age_s=age_s))
            assert not stale.is_taken
            assert ("stale" if age_s > 0 else "future") in stale.reason
            assert (await mission.handle_order(an_order(MissionAction.START, order_id="fresh"))).is_taken
            assert (await mission.handle_order(an_order(MissionAction.PAUSE, age_s=age_s))).phase is MissionPhase.PAUSED

    asyncio.run(story())


def test_what_is_not_possible_is_refused_and_says_what_is(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_mission(tmp_path / "j", Obeying()) as (mission, _, _):
            answer = await mission.handle_order(an_order(MissionAction.SELECT))
            assert not answer.is_taken
            assert answer.reason == "the mission is idle, where 'select' is not possible; possible is: start, show"
            assert answer.possible == (MissionAction.START, MissionAction.SHOW)
            shown = await mission.handle_order(an_order(MissionAction.SHOW))
            assert (shown.is_taken, shown.phase) == (True, MissionPhase.IDLE)

    asyncio.run(story())


def test_a_mission_by_order_selects_loses_replaces_and_redisperses(tmp_path: Path) -> None:
    async def story() -> None:
        gate = Obeying()
        answers: list[MissionAnswer] = []
        async with a_mission(tmp_path / "j", gate, n_landmarks=2, landmark_silence_s=3600, min_battery_mv=2500) as (
            mission,
            nodes,
            journal,
        ):
            await mission.handle_order(an_order(MissionAction.START))
            mission.take_order(an_order(MissionAction.SELECT), answers.append)
            await until(lambda: mission.state.phase is MissionPhase.EXPLORATION, what="landmarks stand")
            assert answers[0].is_taken
            landmarks = mission.state.landmarks
            assert len(landmarks) == 2
            flat = min(landmarks)
            say(nodes, flat, mode=WireMode.S, battery_mv=2400)
            await until(lambda: flat not in mission.state.landmarks and len(mission.state.landmarks) == 2, what="it is replaced")
            assert ("mission.landmark_lost", {"node": str(flat), "reason": "its battery has 2400 mV, less than 2500"}) in gate.events
            standing = mission.state.landmarks
            assert (await mission.handle_order(an_order(MissionAction.REDISPERSE))).round == 2
            await until(lambda: gate.told(StimulationAction.START) == standing, what="those that stand are let go")
            await until(lambda: not mission.state.releasing, what="all have answered")
            await journal.drain()
            reader = journal.reader()
            records = [one for one in reader.read_records(from_offset=1, limit=99)[0] if isinstance(one, MissionRecord)]
            reader.close()
        newest = {record.identity: record for record in records}
        exploration = next(record for record in newest.values() if record.phase is MissionPhase.EXPLORATION)
        assert exploration.landmarks == tuple(sorted(standing))
        assert exploration.changes[-1].node == flat
        assert exploration.changes[-1].replacement in standing
        kinds = {kind for kind, _, _ in gate.notes}
        assert {"mission.order", "mission.phase", "landmark.choice", "landmark.lost", "landmark.replacement"} <= kinds
        assert ("mission.order", "ann", None) in gate.notes
        assert ("landmark.lost", "", flat) in gate.notes

    asyncio.run(story())


def test_a_stop_of_all_pauses_and_nobody_is_commanded_until_it_is_resumed(tmp_path: Path) -> None:
    async def story() -> None:
        gate = Obeying()
        async with a_mission(tmp_path / "j", gate, is_enabled=True, dispersion_s=0, n_landmarks=2) as (mission, _, journal):
            await until(lambda: mission.state.phase is MissionPhase.EXPLORATION, what="landmarks stand")
            landmarks, n_given = mission.state.landmarks, len(gate.given)
            stop = StimulationRequest(
                command_id="s", node=NodeId(0), action=StimulationAction.STOP_ALL, operator="bob", issued_wall_ns=Nanoseconds(0)
            )
            mission.on_stage(stop, stage_of(stop, Stage.ACCEPTED))
            assert (mission.state.phase, mission.state.operator) == (MissionPhase.PAUSED, "bob")
            await mission.handle_order(an_order(MissionAction.SHOW))
            assert len(gate.given) == n_given
            await journal.drain()
        async with a_mission(tmp_path / "j", gate, is_enabled=True, n_landmarks=2) as (mission, _, _):
            assert mission.state.phase is MissionPhase.PAUSED
            assert (await mission.handle_order(an_order(MissionAction.RESUME))).phase is MissionPhase.EXPLORATION
            await until(lambda: gate.told(StimulationAction.START) == set(_ROW) - landmarks, what="the others walk again")
            assert mission.state.landmarks == landmarks

    asyncio.run(story())


@pytest.mark.parametrize("is_told_by_the_journal", [False, True])
def test_a_mission_that_is_ordered_lets_those_walk_whom_others_had_stopped_and_nobody_whom_they_stop_later(
    tmp_path: Path, is_told_by_the_journal: bool
) -> None:
    def a_stop(node: int, action: StimulationAction = StimulationAction.STOP) -> StimulationRequest:
        return StimulationRequest(command_id="s", node=NodeId(node), action=action, operator="ann", issued_wall_ns=Nanoseconds(0))

    async def story() -> None:
        gate = Obeying()
        async with a_mission(tmp_path / "j", gate, dispersion_s=0, n_landmarks=2) as (mission, nodes, _):
            for node in _ROW:
                say(nodes, node, mode=WireMode.S)
                if is_told_by_the_journal:
                    known = nodes.find(NodeId(node))
                    assert known is not None
                    known.mode = a_spell(node, mode=Mode.S, cause=Cause.COMMAND)
            if not is_told_by_the_journal:
                whole = a_stop(0, StimulationAction.STOP_ALL)
                mission.on_stage(whole, stage_of(whole, Stage.ACCEPTED))
            assert (await mission.handle_order(an_order(MissionAction.START))).is_taken
            later = a_stop(3)
            mission.on_stage(later, stage_of(later, Stage.ACCEPTED))
            await until(lambda: not mission.state.releasing, what="they were told to walk")
            assert gate.told(StimulationAction.START) == set(_ROW) - {3}
            await until(lambda: "stand by another command (start them)" in mission.state.reason, what="it is told what is waited for")
            shown = await mission.handle_order(an_order(MissionAction.SHOW))
            assert "waits: 0 can be chosen, and 2 landmarks are wanted; of the others 6 stand by another command" in shown.reason
            for node in (1, 2, 4, 5, 6):
                say(nodes, node)
            await until(lambda: mission.state.phase is MissionPhase.EXPLORATION, what="landmarks stand")
            assert 3 not in mission.state.landmarks
            assert len(mission.state.landmarks) == 2
            await mission.handle_order(an_order(MissionAction.FINISH))
            for node in _ROW:
                say(nodes, node, mode=WireMode.S)
            await mission.handle_order(an_order(MissionAction.START, order_id="again"))
            await until(lambda: sum(kind == "mission.no_candidates" for kind, _ in gate.events) == 2, what="it is told again")

    asyncio.run(story())


def test_a_landmark_that_an_operator_lets_walk_is_replaced(tmp_path: Path) -> None:
    async def story() -> None:
        gate = Obeying()
        async with a_mission(tmp_path / "j", gate, is_enabled=True, dispersion_s=0, n_landmarks=2) as (mission, _, _):
            await until(lambda: mission.state.phase is MissionPhase.EXPLORATION, what="landmarks stand")
            node = max(mission.state.landmarks)
            start = StimulationRequest(
                command_id="s", node=node, action=StimulationAction.START, operator="bob", issued_wall_ns=Nanoseconds(0)
            )
            mission.on_stage(start, stage_of(start, Stage.ACCEPTED))
            await until(lambda: len(mission.state.landmarks - {node}) == 2, what="another one stands for it")
            assert mission.state.changes[-1].reason == "bob let it walk"

    asyncio.run(story())


def _meeting(journal: Journal, one: int, other: int, *, sequence: int) -> EncounterRecord:
    """A meeting of two that begins when both have stood for 40 s."""
    t_ns = Nanoseconds(time.monotonic_ns() + 40 * NS_PER_S)
    return EncounterRecord(
        gateway="g", journal=journal.journal_id, offset=1, boot=journal.boot, sequence=sequence, revision=0,
        wall_anchor_ns=journal.identity.wall_anchor_ns, node_a=NodeId(min(one, other)), node_b=NodeId(max(one, other)),
        t_start_ns=t_ns, t_end_ns=t_ns, error_ns=Nanoseconds(1000), is_reciprocal=True,
    )  # fmt: skip


def test_what_the_journal_commits_convicts_a_landmark_that_wanders_and_doubts_one_that_walks(tmp_path: Path) -> None:
    async def story() -> None:
        gate = Obeying()
        async with a_mission(tmp_path / "j", gate, is_enabled=True, dispersion_s=0, n_landmarks=3) as (mission, _, journal):
            await until(lambda: mission.state.phase is MissionPhase.EXPLORATION, what="landmarks stand")
            wanderer, one, other = sorted(mission.state.landmarks)
            walks = ModeRecord(
                gateway="g", journal=journal.journal_id, offset=1, boot=journal.boot, sequence=10_000, revision=0,
                wall_anchor_ns=journal.identity.wall_anchor_ns, node=one, mode=Mode.CRW, cause=Cause.NATURAL,
                t_start_ns=Nanoseconds(time.monotonic_ns() + NS_PER_S), t_end_ns=None, error_ns=Nanoseconds(0),
            )  # fmt: skip
            n_stops = sum(request.node == one for request in gate.given)
            journal.append(JournalWrite(records=(walks, _meeting(journal, wanderer, one, sequence=10_001))))
            await until(lambda: sum(request.node == one for request in gate.given) > n_stops, what="it is stopped once more")
            assert {wanderer, one, other} == mission.state.landmarks, "one contradiction convicts nobody"
            journal.append(JournalWrite(records=(_meeting(journal, wanderer, other, sequence=10_002),)))
            await until(lambda: gate.told(StimulationAction.START) == {wanderer}, what="who wandered is let go")
            await until(lambda: len(mission.state.landmarks) == 3, what="another one stands for it")
            assert wanderer not in mission.state.landmarks
            assert ("landmark.doubt", "", one) in gate.notes

    asyncio.run(story())


def let_follow(nodes: NodeBook, node: int) -> None:
    """Have a biobot walk, and its backpack able to have it follow walls."""
    known = nodes.find(NodeId(node))
    assert known is not None
    nodes.introduce(known, Hello(eui64=node, firmware=1, beacon_period_ms=0, capabilities=Capability.STIMULATION | Capability.FOLLOW_WALLS))
    known.mode = a_spell(node)


def a_spell(node: int, *, mode: Mode = Mode.CRW, cause: Cause = Cause.NATURAL) -> ModeRecord:
    return ModeRecord(
        gateway="g", journal="j", offset=1, boot=BootId(1), sequence=node, revision=0, wall_anchor_ns=Nanoseconds(0), node=NodeId(node),
        mode=mode, cause=cause, t_start_ns=Nanoseconds(0), t_end_ns=None, error_ns=Nanoseconds(0),
    )  # fmt: skip


def test_in_a_wall_phase_those_who_can_and_are_free_follow_walls_without_a_train_and_a_killed_one_ends_all_the_same(tmp_path: Path) -> None:
    """Biobot 2 cannot, 3 is steered by somebody, and one is the landmark: of six, three are told, and told when it is over."""

    async def story() -> None:
        gate, again = Obeying(), Obeying()
        walls, start = StimulationAction.FOLLOW_WALLS, StimulationAction.START
        config: dict[str, Any] = {"n_landmarks": 1, "dispersion_s": 0, "wall_following_every_s": 1.0, "wall_following_s": 0.5}
        async with a_mission(tmp_path / "j", gate, controlled={NodeId(3)}, **config) as (mission, nodes, journal):
            for node in (1, 3, 4, 5, 6):
                let_follow(nodes, node)
            await mission.handle_order(an_order(MissionAction.START))
            await until(lambda: mission.state.phase is MissionPhase.EXPLORATION, what="the landmark stands")
            (landmark,) = mission.state.landmarks
            free = {1, 4, 5, 6} - {int(landmark)}
            await until(lambda: gate.told(start) >= free, what="a wall phase was over")
            assert gate.told(walls) == free
            assert gate.told(start) == free
            assert {request.pulse for request in gate.given if request.action in {walls, start}} == {PulseRequest(duration_ms=0)}
            await until(lambda: mission.state.following.keys() == free and "begun" in mission.state.reason, what="another one has begun")
            number = mission.state.wall_phase
            shown = await mission.handle_order(an_order(MissionAction.SHOW))
            assert f"; wall phase {number} has begun: {len(free)} biobots" in shown.reason
            assert ("mission.walls", "", None) in gate.notes
            stopped = min(free)
            stop = StimulationRequest(
                command_id="s", node=NodeId(stopped), action=StimulationAction.STOP, operator="ann", issued_wall_ns=Nanoseconds(0)
            )
            mission.on_stage(stop, stage_of(stop, Stage.ACCEPTED))
            assert mission.state.following.keys() == free - {stopped}
            await journal.drain()
        async with a_mission(tmp_path / "j", again, controlled=set(), **config) as (mission, nodes, _):
            await until(lambda: again.told(start) >= free - {stopped}, what="it is over in the next process too")
            assert stopped not in again.told(start), "whom an operator stopped is not let go by the mission"

    asyncio.run(story())
