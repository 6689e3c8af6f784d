"""When the walking biobots of an exploration follow walls, who of them, and how that is told. Pure.

A wall phase follows from how long the exploration has run, pauses left out: a mission that was killed or paused is in the wall phase that
it would have been in. Who was told is part of the mission's state, until it was told to walk as before.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from firmware_protocol.contract.records import MissionPhase
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import MissionTable
from gateway.mission.steps import FollowWalls, MissionState

_TOLD = "; wall phase "


@dataclass(slots=True, kw_only=True)
class WallPhases:
    """Says what is to change in the mission's state, and who is told what; ``now_ns`` is the journal's running time."""

    config: MissionTable
    _leaving: dict[NodeId, int] = field(default_factory=dict)
    """Who is being told to walk as before, of whom that was decided when."""

    def number(self, state: MissionState, *, now_ns: int) -> int:
        """Return the number of the wall phase that an exploration is in, from 1; 0: in none."""
        every_ns = int(self.config.wall_following_every_s * NS_PER_S)
        if not every_ns or state.phase is not MissionPhase.EXPLORATION:
            return 0
        number, since_ns = divmod(state.elapsed_ns(now_ns), every_ns)
        return number if number and since_ns < self.config.wall_following_s * NS_PER_S else 0

    def decide(
        self, state: MissionState, *, now_ns: int, followers: Callable[[], Collection[NodeId]]
    ) -> tuple[dict[str, Any], list[FollowWalls]]:
        """Begin a wall phase, or end it: return what changes in the state, and the commands that follow once that is on disk."""
        number = self.number(state, now_ns=now_ns)
        if number and number != state.wall_phase:
            told = dict.fromkeys(followers(), now_ns)
            reason = _with_walls(state.reason, f"{number} has begun: {len(told)} biobots are told to follow walls")
            return {"wall_phase": number, "following": told, "reason": reason}, _steps(told, is_over=False)
        leaving = {} if number else {node: at_ns for node, at_ns in state.following.items() if self._leaving.get(node) != at_ns}
        if not leaving:
            return {}, []
        self._leaving = {**{node: at_ns for node, at_ns in self._leaving.items() if state.following.get(node) == at_ns}, **leaving}
        reason = _with_walls(state.reason, f"{state.wall_phase} is over") if state.wall_phase else state.reason
        return {"reason": reason}, _steps(leaving, is_over=True)

    def again(self, state: MissionState, *, now_ns: int) -> list[FollowWalls]:
        """Return the commands of the wall phase that goes on, by the names that they had; after its end ``decide`` has those."""
        self._leaving.clear()
        return _steps(state.following, is_over=False) if self.number(state, now_ns=now_ns) else []

    def wants(self, step: FollowWalls, state: MissionState, *, now_ns: int) -> bool:
        """Return whether a command is wanted yet: not when its time is over, nor of a landmark or one that was commanded since."""
        if state.following.get(step.node) != step.decided_ns or step.node in state.landmarks | state.awaited:
            return False
        return step.is_over is (self.number(state, now_ns=now_ns) == 0)


def _steps(nodes: Mapping[NodeId, int], *, is_over: bool) -> list[FollowWalls]:
    return [FollowWalls(node=node, decided_ns=at_ns, is_over=is_over) for node, at_ns in sorted(nodes.items())]


def _with_walls(reason: str, what: str) -> str:
    """Return why a phase of the mission began, and how its wall phase stands."""
    return f"{reason.partition(_TOLD)[0]}{_TOLD}{what}"
