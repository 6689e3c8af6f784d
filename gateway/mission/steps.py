"""What the mission is, from phase to landmarks, and what its planner wants done. Values only."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from firmware_protocol.contract.records import LandmarkChange, LandmarkChoice, MissionPhase
from firmware_protocol.units import NodeId

Picker: TypeAlias = Callable[[Collection[NodeId], Collection[NodeId], NodeId | None], NodeId | None]
"""Says who takes a lost landmark's place: given those standing or asked, those who may not be picked, and the lost one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionState:
    """All that outlives the process: it is written to the journal whenever it changes, before anything is done about it.

    Instants and lengths are of the journal's running time [ns]: what gateways have run on it, whatever any clock says.
    """

    phase: MissionPhase = MissionPhase.IDLE
    began_ns: int = 0
    spent_ns: int = 0
    """How long the phase had run before, up to a pause."""
    explored_ns: int = 0
    """Explorations of earlier rounds, together."""
    round: int = 0
    landmarks: frozenset[NodeId] = frozenset()
    releasing: Mapping[NodeId, int] = field(default_factory=dict)
    """Who is to be let walk again, and when that was decided."""
    choice: LandmarkChoice | None = None
    changes: tuple[LandmarkChange, ...] = ()
    wall_phase: int = 0
    """The newest one of this exploration, from 1."""
    following: Mapping[NodeId, int] = field(default_factory=dict)
    """Who was told to follow walls and not yet to walk as before, and when that was decided."""
    interrupted: MissionPhase | None = None
    is_continued: bool = False
    reason: str = ""
    operator: str = ""
    order_id: str = ""

    @property
    def awaited(self) -> frozenset[NodeId]:
        """Those asked to stand still, and not known to yet."""
        return frozenset() if self.choice is None else frozenset(self.choice.awaited)

    def elapsed_ns(self, now_ns: int) -> int:
        """Return how long the phase has run, pauses left out; of a pause, how long what it interrupts had."""
        return self.spent_ns if self.phase is MissionPhase.PAUSED else self.spent_ns + max(0, now_ns - self.began_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tell:
    """Write down the state, as a phase that begins or as a revision of the one that goes on; what follows waits until it is on disk."""

    state: MissionState
    is_revision: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Choose:
    """Choose landmarks among those who may be, and hand the choice to ``take_choice``."""

    turn: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeLandmark:
    """Command a biobot to stand still. ``is_again``: it has stood, and says that it walks."""

    node: NodeId
    is_again: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LetGo:
    """Command a biobot to walk, by the name of when it was decided: a start whose outcome is not known is not given twice."""

    node: NodeId
    decided_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowWalls:
    """Tell a walking biobot to follow walls, by the name of when it was decided; ``is_over``: to walk as before."""

    node: NodeId
    decided_ns: int
    is_over: bool


MissionStep: TypeAlias = Tell | Choose | MakeLandmark | LetGo | FollowWalls
