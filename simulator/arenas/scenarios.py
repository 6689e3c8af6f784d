"""Named arenas, and how they change while insects walk in them.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
[Jea03]: R. Jeanson et al., "A model of animal movements in a bounded space", Journal of Theoretical Biology 225, 2003.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

from simulator.arenas import floors
from simulator.arenas.arena import Arena, build_arena
from simulator.arenas.maze import draw_maze
from simulator.arenas.rubble import draw_rubble
from simulator.errors import ScenarioError

Shape = Polygon | MultiPolygon

_DRAWN_SIDE = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """What an arena becomes after a share of the time in which insects explore."""

    share: float
    draw: Callable[[int], Shape]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """An arena, drawn in a square of side 50 and scaled to the side wanted.

    Parameters
    ----------
    draw
        Draws it, given a seed.
    is_random
        Whether the seed matters.
    changes
        What it becomes later, in order.
    """

    name: str
    summary: str
    draw: Callable[[int], Shape]
    is_random: bool = False
    changes: tuple[Change, ...] = ()

    def build(self, side: float, *, seed: int = 0) -> Arena:
        """Make the arena as it is at first, in a square of this side [length]; a run gives its own seed."""
        return build_arena(_scale(self.draw(seed), side), source=self.name)

    def build_changes(self, side: float, *, seed: int = 0) -> tuple[tuple[float, Arena], ...]:
        """Make what it becomes later: shares of the time of exploration, and arenas."""
        return tuple((change.share, build_arena(_scale(change.draw(seed), side), source=self.name)) for change in self.changes)


def _scale(shape: Shape, side: float) -> Shape:
    scale = side / _DRAWN_SIDE

    def place(drawn: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(drawn == _DRAWN_SIDE, side, scale * drawn)

    return shapely.transform(shape, place)


def _fixed(name: str, summary: str, draw: Callable[[], Shape]) -> Scenario:
    return Scenario(name=name, summary=summary, draw=lambda _: draw())


# [Dir16] VI describes squares without obstacle, with one in the middle, and with two; their sizes are not printed.
_ALL = (
    _fixed("no-obstacle", "a square room ([Dir16] VI, scenario 1)", floors.square),
    _fixed(
        "one-obstacle",
        "a square room, one square obstacle of 16/50 of its side in the middle ([Dir16] VI, scenario 2)",
        lambda: floors.square((17.0, 17.0, 33.0, 33.0)),
    ),
    _fixed(
        "two-obstacles",
        "a square room, two square obstacles of 13/50 of its side on a diagonal ([Dir16] VI, scenario 3)",
        lambda: floors.square((8.0, 8.0, 21.0, 21.0), (29.0, 29.0, 42.0, 42.0)),
    ),
    _fixed("three-obstacles", "a square room with a triangle, a disc and a square", floors.three_obstacles),
    _fixed("four-obstacles", "a square room, obstacles in the shapes of L, U, T and a cross", floors.four_obstacles),
    _fixed("five-obstacles", "a square room, five square obstacles of 8/50 of its side like the five of a die", floors.five_obstacles),
    _fixed("six-pillars", "a square room with six eight-sided pillars", floors.six_pillars),
    _fixed("disc", "a round room of 96 sides, as the arena of [Jea03]", floors.disc),
    _fixed("corridor", "a straight corridor, 50 by 8", floors.corridor),
    _fixed("l-room", "a room of two wings at a right angle", floors.l_room),
    _fixed("u-corridor", "a corridor bent twice", floors.u_corridor),
    _fixed("t-junction", "two corridors that meet in a T", floors.t_junction),
    _fixed("cross", "two corridors that cross", floors.cross),
    _fixed("ring-corridor", "a corridor in a circle", floors.ring_corridor),
    _fixed("star", "seven spikes with tips of 18 degrees", floors.star),
    _fixed("thin-walls", "a hall cut by four walls of 0.05, each with a gap at alternate ends", floors.thin_walls),
    _fixed("office", "six rooms on a corridor, two pairs joined by doors of their own, and a block of desks", floors.office),
    Scenario(name="maze", summary="a maze of 36 cells with four loops, drawn by the run's seed", draw=draw_maze, is_random=True),
    Scenario(name="rubble", summary="a room strewn with broken pieces, drawn by the run's seed", draw=draw_rubble, is_random=True),
    _fixed("two-islands", "two rooms without a way between them, one with an obstacle", floors.two_islands),
    Scenario(
        name="closing-door",
        summary="two rooms with an obstacle each and a door between, which closes at half time",
        draw=lambda _: floors.two_rooms(is_open=True),
        changes=(Change(share=0.5, draw=lambda _: floors.two_rooms(is_open=False)),),
    ),
)

SCENARIOS: Mapping[str, Scenario] = MappingProxyType({scenario.name: scenario for scenario in _ALL})


def find_scenario(name: str) -> Scenario:
    """Return the scenario of this name, or raise ScenarioError."""
    if name not in SCENARIOS:
        raise ScenarioError(kind="scenario", got=name, known=tuple(SCENARIOS))
    return SCENARIOS[name]
