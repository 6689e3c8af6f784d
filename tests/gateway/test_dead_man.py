"""Laws of the dead-man, in a loop of its own with a gate that answers at once."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from firmware_protocol.contract.commands import Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import encode_record
from firmware_protocol.units import EVERYBODY, NodeId
from gateway.commanders import Commanders
from gateway.control_book import ControlBook
from gateway.dead_man import OPERATOR, DeadMan
from gateway.health import Health
from gateway.journal_file import AuditEntry
from tests.gateway.control_fakes import AnsweringGate, NoteBook
from tests.gateway.fake_radio import until
from tests.gateway.test_control_book import a_command, a_stage


@dataclass
class Watch:
    """A dead-man and what is around it."""

    gate: AnsweringGate
    commanders: Commanders
    notes: NoteBook
    dead_man: DeadMan
    reachable: set[int]

    def move(self, *nodes: int, commander: str = "ann", hold_ms: int = 0) -> None:
        """Have motions accepted and confirmed."""
        for node in nodes:
            request = a_command(node, StimulationAction.START, node=node, commander=commander, hold_ms=hold_ms)
            for stage in (Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED):
                self.dead_man.hear(request, a_stage(request, stage))


def a_watch() -> Watch:
    gate, notes, reachable = AnsweringGate(), NoteBook(), set(range(100))
    commanders = Commanders(silence_s=1.2, health=Health(), notes=notes)
    dead_man = DeadMan(
        gate=gate,
        book=ControlBook(),
        commanders=commanders,
        can_reach=lambda node: node in reachable,
        last_heard_ns=lambda _node: 0,
        notes=notes,
        health=Health(),
        boot=3,
        again_s=(0.05,),
    )
    gate.listener = dead_man.hear
    return Watch(gate, commanders, notes, dead_man, reachable)


@asynccontextmanager
async def running() -> AsyncIterator[Watch]:
    watch = a_watch()
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(watch.dead_man.run())
        try:
            yield watch
        finally:
            task.cancel()


def test_whoever_is_moved_by_one_who_goes_is_stopped_and_nobody_else() -> None:
    async def story() -> None:
        async with running() as watch:
            watch.commanders.came("ann")
            watch.commanders.came("bob")
            watch.move(1, 2)
            watch.move(3, commander="bob")
            watch.commanders.went("ann")
            await until(lambda: set(watch.dead_man.controlled()) == {3}, what="ann's are stopped")
            assert ("tester", NodeId(1)) in watch.notes.of_whom, "on record is who moved it"
            assert sorted(watch.gate.nodes()) == [1, 2]
            assert {request.operator for request in watch.gate.taken} == {OPERATOR}
            watch.commanders.came("ann")
            watch.commanders.went("ann")
            assert sorted(watch.gate.nodes()) == [1, 2], "who comes back does not get them back"

    asyncio.run(story())


def test_a_hold_that_is_over_is_ended_without_a_train() -> None:
    async def story() -> None:
        async with running() as watch:
            watch.move(1, commander="", hold_ms=30)
            await until(lambda: not watch.dead_man.controlled(), what="the hold is over")
            (stop,) = watch.gate.taken
            assert stop.pulse is not None
            assert stop.pulse.duration_ms == 0

    asyncio.run(story())


def test_a_stop_is_given_again_until_it_is_confirmed() -> None:
    async def story() -> None:
        async with running() as watch:
            watch.gate.ends[NodeId(1)] = [Stage.UNKNOWN]
            watch.commanders.came("ann")
            watch.move(1)
            watch.commanders.went("ann")
            await until(lambda: watch.gate.nodes() == [1, 1], what="it is given again")
            await until(lambda: not watch.dead_man.controlled(), what="it is confirmed")
            assert len({request.command_id for request in watch.gate.taken}) == 2

    asyncio.run(story())


def test_whoever_another_moves_by_now_is_not_stopped_again() -> None:
    async def story() -> None:
        async with running() as watch:
            watch.gate.ends[NodeId(1)] = [Stage.UNKNOWN] * 9
            watch.commanders.came("ann")
            watch.commanders.came("bob")
            watch.move(1)
            watch.commanders.went("ann")
            await until(lambda: bool(watch.gate.taken), what="it is stopped")
            request = a_command(50, StimulationAction.START, node=1, commander="bob")
            watch.dead_man.hear(request, a_stage(request, Stage.ACCEPTED))
            await until(lambda: not watch.dead_man._owed, what="nothing is owed any more")
            assert watch.notes.events("commander").count("took_over") == 1

    asyncio.run(story())


def test_a_commander_that_goes_while_its_command_is_taken_moves_nobody() -> None:
    async def story() -> None:
        async with running() as watch:
            watch.move(1)
            await until(lambda: not watch.dead_man.controlled(), what="it is stopped")
            assert watch.gate.nodes() == [1]

    asyncio.run(story())


def test_whom_a_takeover_never_reached_is_stopped_where_its_commander_is_gone_meanwhile() -> None:
    async def story() -> None:
        async with running() as watch:
            watch.commanders.came("ann")
            watch.commanders.came("bob")
            watch.move(1)
            request = a_command(50, StimulationAction.START, node=1, commander="bob")
            watch.dead_man.hear(request, a_stage(request, Stage.ACCEPTED))
            watch.commanders.went("ann")
            assert watch.gate.nodes() == []
            watch.dead_man.hear(request, a_stage(request, Stage.FAILED))
            await until(lambda: not watch.dead_man.controlled(), what="it is stopped")
            assert watch.gate.nodes() == [1]

    asyncio.run(story())


def test_who_was_moved_before_a_restart_is_stopped_as_soon_as_it_can_be_reached() -> None:
    async def story() -> None:
        watch = a_watch()
        watch.reachable.clear()
        start, stopped = (a_command(node, StimulationAction.START, node=node, commander="ann") for node in (1, 2))
        stop = a_command(9, StimulationAction.STOP, node=2)
        history: list[tuple[StimulationRequest, Stage]] = [
            (start, Stage.ACCEPTED),
            (stopped, Stage.ACCEPTED),
            (stop, Stage.ACCEPTED),
            (stop, Stage.BIOBOT_CONFIRMED),
        ]
        entries = [
            AuditEntry(
                wall_ns=0,
                command_id=request.command_id,
                stage=stage.value,
                node=request.node,
                request=encode_record(request),
                body=encode_record(a_stage(request, stage)),
            )
            for request, stage in history
        ]
        damaged = AuditEntry(wall_ns=0, command_id="x", stage="accepted", request=b"?", body=b"?")
        watch.dead_man.restore([damaged, *entries])
        async with asyncio.TaskGroup() as tasks:
            task = tasks.create_task(watch.dead_man.run())
            await asyncio.sleep(0)
            assert not watch.gate.taken
            watch.reachable.add(1)
            await until(lambda: not watch.dead_man.controlled(), what="it is stopped")
            task.cancel()
        assert watch.gate.nodes() == [1]

    asyncio.run(story())


def test_at_the_end_whom_the_configuration_names_is_stopped_and_who_is_silent_is_told_of() -> None:
    async def story() -> None:
        for whom, expected in (("none", []), ("controlled", [1, 2]), ("all", [])):
            async with running() as watch:
                watch.commanders.came("ann")
                watch.move(1, 2)
                if whom == "controlled":
                    watch.gate.never_answers.add(NodeId(2))
                await watch.dead_man.wind_down(whom, timeout_s=0.1)  # type: ignore[arg-type]  # a literal by turns
                assert watch.gate.nodes() == expected
                assert [request.node for request in watch.gate.taken if request.node == EVERYBODY] == [EVERYBODY] * (whom == "all")
                (facts,) = [facts for kind, facts in watch.notes.entries if kind == "dead_man"]
                assert (
                    facts
                    == {
                        "none": {"event": "left_moving", "nodes": [1, 2]},
                        "controlled": {"event": "wound_down", "confirmed": [1], "unconfirmed": [2]},
                        "all": {"event": "wound_down", "confirmed": [int(EVERYBODY)], "unconfirmed": []},
                    }[whom]
                )

    asyncio.run(story())
