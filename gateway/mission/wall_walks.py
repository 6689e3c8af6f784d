"""The commands of wall phases on their way to the gate: some at a time, and none to whom somebody else moves or stops."""

import asyncio
from collections import deque
from collections.abc import Callable, Collection
from functools import partial

from firmware_protocol.contract.commands import StimulationAction
from firmware_protocol.units import NodeId
from gateway.config import MissionTable
from gateway.mission.candidates import can_follow_walls, is_walking
from gateway.mission.landmark_commands import LandmarkCommander
from gateway.mission.planner import MissionPlanner
from gateway.mission.steps import FollowWalls, MissionStep
from gateway.mission.watch import stands_by_command
from gateway.nodes import NodeBook

_PAUSE_S = 0.05
"""Between two commands: 20 a second, so that other traffic does not wait for a whole swarm to be told."""

_MOST_AT_ONCE = 64
"""Under way; the gate takes 256, of all who command."""

OnDisk = asyncio.Future[None] | None


class WallWalks:
    """Belongs to one event loop; ``run`` is its task.

    Parameters
    ----------
    ran_ns
        The journal's running time now.
    controlled
        Who is under controlled motion.
    proceed
        Takes what the planner wants done because of what came of a command.
    """

    def __init__(
        self,
        *,
        config: MissionTable,
        commander: LandmarkCommander,
        planner: MissionPlanner,
        nodes: NodeBook,
        ran_ns: Callable[[], int],
        may_command: Callable[[], bool],
        controlled: Callable[[], Collection[NodeId]],
        proceed: Callable[[list[MissionStep]], object],
    ) -> None:
        self._config = config
        self._commander = commander
        self._planner = planner
        self._nodes = nodes
        self._ran_ns = ran_ns
        self._may_command = may_command
        self._controlled = controlled
        self._proceed = proceed
        self._waiting: deque[tuple[FollowWalls, OnDisk]] = deque()  # of each biobot two at most: what is not meant any more goes
        self._wake = asyncio.Event()
        self._places = asyncio.Semaphore(_MOST_AT_ONCE)

    def followers(self, *, now_ns: int) -> list[NodeId]:
        """Return who can be told to follow walls now [monotonic]: who walks and is free, and whose backpack can."""
        state, controlled = self._planner.state, self._controlled()
        busy = {*state.landmarks, *state.awaited, *controlled}
        return [one.node for one in self._nodes.all() if one.node not in busy and can_follow_walls(one, config=self._config, now_ns=now_ns)]

    def take(self, step: FollowWalls, on_disk: OnDisk) -> None:
        """Give a command when its turn comes, and what was decided is on disk."""
        self._waiting.append((step, on_disk))
        self._wake.set()

    async def run(self) -> None:
        """Give commands until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            while True:
                while not self._waiting:
                    self._wake.clear()
                    await self._wake.wait()
                step, on_disk = self._waiting.popleft()
                if not self._is_wanted(step):
                    self._end(step)
                    continue
                if on_disk is not None:
                    await asyncio.wait({on_disk})
                await self._places.acquire()
                tasks.create_task(self._give(step))
                await asyncio.sleep(_PAUSE_S)

    async def _give(self, step: FollowWalls) -> None:
        action = StimulationAction.START if step.is_over else StimulationAction.FOLLOW_WALLS
        name = f"mission-{'walk' if step.is_over else 'walls'}-{step.node}-{step.decided_ns}"
        try:
            await self._commander.walk(step.node, action, name=name, is_wanted=partial(self._is_wanted, step))
        finally:
            self._places.release()
        self._end(step)

    def _end(self, step: FollowWalls) -> None:
        """Forget one that was told to walk as before, whatever came of it; but one that a pause kept from it is told later."""
        if step.is_over and self._may_command():
            self._proceed(self._planner.leave_walls(step.node, decided_ns=step.decided_ns))

    def _is_wanted(self, step: FollowWalls) -> bool:
        node = self._nodes.find(step.node)
        if node is None or step.node in self._controlled():
            return False
        # One that rests by itself is told that it is over, too: it would go on along its wall.
        stands = node.mode is not None and stands_by_command(node.mode)
        if stands or not (step.is_over or is_walking(node)):
            return False
        return self._may_command() and self._planner.follows(step, now_ns=self._ran_ns())
