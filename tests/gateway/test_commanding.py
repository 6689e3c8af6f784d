"""Laws of what waits between the bus and the gate, on a real gate and real commanders."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import cast

from firmware_protocol.contract.commands import CommandStage, PulseRequest, Refusal, Stage, StimulationAction
from gateway.bus_commands import CommandAnswer
from gateway.commanders import Commanders
from gateway.commanding import Commanding
from gateway.control_book import ControlBook
from gateway.dead_man import DeadMan
from gateway.health import Health
from tests.gateway.control_fakes import NoteBook
from tests.gateway.fake_air import Site, a_command, a_site
from tests.gateway.fake_radio import until

_NO_TRAIN = PulseRequest(duration_ms=0)


class _Answer:
    """Keeps the stages of a command, and is made when it comes in."""

    def __init__(self) -> None:
        self.came_ns = time.monotonic_ns()
        self.stages: list[CommandStage] = []

    def tell(self, stage: CommandStage) -> None:
        self.stages.append(stage)

    def of_bus(self) -> CommandAnswer:
        return cast("CommandAnswer", self)


def _run(path: Path, story: Callable[[Site, Commanding, asyncio.TaskGroup], Awaitable[None]]) -> None:
    async def run() -> None:
        health, notes = Health(), NoteBook()
        commanders = Commanders(silence_s=1.2, health=health, notes=notes)
        async with a_site(path, 5, is_commander_there=commanders.is_there) as site:
            dead_man = DeadMan(
                gate=site.gate,
                book=ControlBook(),
                commanders=commanders,
                can_reach=lambda _node: True,
                last_heard_ns=lambda _node: 0,
                notes=notes,
                health=health,
                boot=1,
            )
            async with asyncio.TaskGroup() as tasks:
                await story(site, Commanding(gate=site.gate, commanders=commanders, dead_man=dead_man), tasks)

    asyncio.run(run())


def test_what_waits_for_its_commander_is_overtaken_by_a_stop_that_comes_meanwhile(tmp_path: Path) -> None:
    async def story(site: Site, commanding: Commanding, tasks: asyncio.TaskGroup) -> None:
        moving = _Answer()
        commanding.take(tasks, a_command(5, StimulationAction.START, commander="ann", hold_ms=1_000), moving.of_bus())
        await asyncio.sleep(0)
        stopping = _Answer()
        commanding.take(tasks, a_command(5, StimulationAction.STOP, pulse=_NO_TRAIN), stopping.of_bus())
        await until(lambda: bool(stopping.stages) and stopping.stages[-1].is_final, what="it stands")
        commanding.commanders.came("ann")
        await until(lambda: bool(moving.stages), what="the start is answered")
        assert moving.stages[-1].refusal is Refusal.OVERTAKEN
        assert {frame.message.action.name for frame in site.air.frames} == {"STOP"}

    _run(tmp_path / "j", story)


def test_a_stop_waits_for_no_commander(tmp_path: Path) -> None:
    async def story(site: Site, commanding: Commanding, tasks: asyncio.TaskGroup) -> None:
        stopping = _Answer()
        commanding.take(tasks, a_command(5, StimulationAction.STOP, commander="nobody"), stopping.of_bus())
        await asyncio.sleep(0)
        assert [frame.message.action.name for frame in site.air.frames] == ["STOP"], "it is sent before anything else happens"
        await until(lambda: stopping.stages[-1].stage is Stage.BIOBOT_CONFIRMED, what="it stands")

    _run(tmp_path / "j", story)
