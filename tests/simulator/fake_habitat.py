"""A world by script: insects are where they are put, and what happens is said beforehand."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.events import Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.legs import Floats, Indices
from tests.simulator.arenas import square


@dataclass(slots=True)
class ScriptedWorld:
    """A ``Habitat``. ``script`` holds events by time; ``done`` collects what was done to insects."""

    places: dict[int, tuple[float, float]]
    script: list[tuple[float, Event]] = field(default_factory=list)
    done: list[tuple[float, str, int, float]] = field(default_factory=list)
    now_s: float = 0.0
    arena: Arena | None = field(default_factory=lambda: square(10.0))
    ranges: Ranges = field(default_factory=lambda: Ranges(detection=1.0, communication=20.0))
    modes: dict[int, Mode] = field(default_factory=dict)
    stuck: frozenset[int] = frozenset()

    @property
    def ids(self) -> tuple[int, ...]:
        return tuple(sorted(self.places))

    def meet(self, id1: int, id2: int, *, start_s: float, end_s: float) -> None:
        """Write an encounter into the script."""
        self.script.append((start_s, EncounterBegan(t_s=start_s, id1=id1, id2=id2)))
        self.script.append((end_s, EncounterEnded(t_start_s=start_s, t_end_s=end_s, id1=id1, id2=id2)))

    def advance(self, until_s: float) -> list[Event]:
        told = sorted((item for item in self.script if item[0] < until_s), key=lambda item: item[0])
        self.script = [item for item in self.script if item[0] >= until_s]
        self.now_s = until_s
        return [event for _, event in told]

    def stop(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        return self._change(biobot_id, Mode.S, cause)

    def start(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        return self._change(biobot_id, Mode.CRW, cause)

    def follow_walls(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        self.done.append((self.now_s, "walls", biobot_id, 0.0))
        return self._change(biobot_id, Mode.CRW, cause)

    def turn(self, biobot_id: int, angle_rad: float) -> bool:
        self.done.append((self.now_s, "turn", biobot_id, angle_rad))
        return biobot_id not in self.stuck

    def run_straight(self, biobot_id: int, distance: float) -> bool:
        self.done.append((self.now_s, "run", biobot_id, distance))
        return biobot_id not in self.stuck

    def mode(self, biobot_id: int) -> Mode:
        return self.modes.get(biobot_id, Mode.CRW)

    def positions(self) -> Floats:
        return np.array([self.places[one] for one in self.ids], dtype=np.float64)

    def positions_at(self, t_s: Sequence[float] | Floats) -> Floats:
        return np.broadcast_to(self.positions(), (len(t_s), len(self.ids), 2))

    def positions_of(self, biobot_ids: Sequence[int] | Indices, t_s: Sequence[float] | Floats) -> Floats:
        assert len(biobot_ids) == len(t_s)
        return np.array([self.places[one] for one in biobot_ids], dtype=np.float64)

    def open_encounters(self) -> list[EncounterBegan]:
        return []

    def _change(self, biobot_id: int, mode: Mode, cause: Cause) -> bool:
        self.done.append((self.now_s, mode.value, biobot_id, 0.0))
        if self.mode(biobot_id) is mode:
            return False
        self.modes[biobot_id] = mode
        self.script.append((self.now_s, ModeChanged(t_s=self.now_s, id=biobot_id, mode=mode, cause=cause)))
        return True
