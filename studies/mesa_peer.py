"""The same walk and search in Mesa's continuous space, with time steps: what a modeller would otherwise write.

Mesa has no walls but the sides of its space and no encounters but a search for neighbours, so this is the empty square; legs end at whole
steps, and an encounter is told at the step at which it is seen. Both of Mesa's spaces are here.

References
----------
J. Kazil, D. Masad, A. Crooks, "Utilizing Python for Agent-Based Modeling: The Mesa Framework", 2020.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from random import Random
from typing import Protocol

import mesa
from mesa.experimental import continuous_space
from mesa.space import ContinuousSpace


class MesaSpace(StrEnum):
    """Which of Mesa's continuous spaces."""

    CLASSIC = "mesa.space"
    EXPERIMENTAL = "mesa.experimental.continuous_space"


@dataclass(frozen=True, slots=True, kw_only=True)
class Walk:
    """What is walked: insects in a square, lengths and seconds as in a preset."""

    insects: int
    side: float
    speed: float
    mean_leg: float
    detection: float
    step_s: float
    duration_s: float


class _Walker(Protocol):
    def move(self) -> None: ...

    def seen(self) -> list[int]: ...


class _Heading:
    """Direction and rest of the leg of one insect."""

    __slots__ = ("_left_s", "_random", "_walk", "vx", "vy")

    def __init__(self, walk: Walk, random: Random) -> None:
        self._walk, self._random = walk, random
        self._turn()

    def _turn(self) -> None:
        angle = self._random.uniform(0.0, 2.0 * math.pi)
        self.vx, self.vy = self._walk.speed * math.cos(angle), self._walk.speed * math.sin(angle)
        self._left_s = self._random.expovariate(self._walk.speed / self._walk.mean_leg)

    def follow(self, x: float, y: float) -> tuple[float, float]:
        """Return where a step leads; another direction is drawn when the leg is over and at the walls."""
        step_s, side = self._walk.step_s, self._walk.side
        self._left_s -= step_s
        if self._left_s <= 0.0:
            self._turn()
        while not (0.0 <= x + self.vx * step_s < side and 0.0 <= y + self.vy * step_s < side):
            self._turn()
        return x + self.vx * step_s, y + self.vy * step_s


class _ClassicInsect(mesa.Agent):  # type: ignore[misc]  # Mesa has no types
    def __init__(self, model: mesa.Model, walk: Walk, space: ContinuousSpace, number: int) -> None:
        super().__init__(model)
        self.number, self._space, self._radius = number, space, walk.detection
        self._heading = _Heading(walk, model.random)
        space.place_agent(self, (model.random.uniform(0, walk.side), model.random.uniform(0, walk.side)))

    def move(self) -> None:
        self._space.move_agent(self, self._heading.follow(*self.pos))

    def seen(self) -> list[int]:
        return [other.number for other in self._space.get_neighbors(self.pos, self._radius)]


class _ExperimentalInsect(continuous_space.ContinuousSpaceAgent):  # type: ignore[misc]  # same
    def __init__(self, model: mesa.Model, walk: Walk, space: continuous_space.ContinuousSpace, number: int) -> None:
        super().__init__(space, model)
        self.number, self._radius = number, walk.detection
        self._heading = _Heading(walk, model.random)
        self.position = (model.random.uniform(0, walk.side), model.random.uniform(0, walk.side))

    def move(self) -> None:
        x, y = self.position
        self.position = self._heading.follow(float(x), float(y))

    def seen(self) -> list[int]:
        return [other.number for other in self.get_neighbors_in_radius(self._radius)[0]]


def count_encounters(walk: Walk, *, space: MesaSpace, seed: int) -> int:
    """Walk in steps and return how many encounters began after the start."""
    model = mesa.Model(seed=seed)
    insects = _make_insects(model, walk, space)
    count, together = 0, None
    for _ in range(round(walk.duration_s / walk.step_s)):
        for one in insects:
            one.move()
        now = {(number, other) for number, one in enumerate(insects) for other in one.seen() if other > number}
        if together is not None:
            count += len(now - together)
        together = now
    return count


def _make_insects(model: mesa.Model, walk: Walk, space: MesaSpace) -> list[_Walker]:
    if space is MesaSpace.CLASSIC:
        classic = ContinuousSpace(walk.side, walk.side, torus=False)
        return [_ClassicInsect(model, walk, classic, number) for number in range(walk.insects)]
    room = [[0.0, walk.side], [0.0, walk.side]]
    modern = continuous_space.ContinuousSpace(room, random=model.random, n_agents=walk.insects)
    return [_ExperimentalInsect(model, walk, modern, number) for number in range(walk.insects)]
