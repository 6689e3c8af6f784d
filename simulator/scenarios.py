"""Named arenas.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from shapely.geometry import Polygon, box

from simulator.arena import Arena, build_arena
from simulator.errors import ScenarioError


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A square arena with obstacles, drawn with side 50 and scaled to the side wanted.

    Parameters
    ----------
    obstacles
        Lowest x and y, highest x and y of each [length, where the side is 50].
    """

    name: str
    summary: str
    obstacles: tuple[tuple[float, float, float, float], ...]

    def build(self, side: float) -> Arena:
        """Make the arena with this side [length]."""
        scale = side / _DRAWN_SIDE
        holes = [box(scale * x_min, scale * y_min, scale * x_max, scale * y_max).exterior for x_min, y_min, x_max, y_max in self.obstacles]
        return build_arena(Polygon(box(0.0, 0.0, side, side).exterior, holes), source=self.name)


_DRAWN_SIDE = 50.0

# [Dir16] VI describes squares without obstacle, with one in the middle, and with two; their sizes are not printed.
SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        "no-obstacle": Scenario(name="no-obstacle", summary="a square room ([Dir16] VI, scenario 1)", obstacles=()),
        "one-obstacle": Scenario(
            name="one-obstacle",
            summary="a square room, one square obstacle of 16/50 of its side in the middle ([Dir16] VI, scenario 2)",
            obstacles=((17.0, 17.0, 33.0, 33.0),),
        ),
        "two-obstacles": Scenario(
            name="two-obstacles",
            summary="a square room, two square obstacles of 13/50 of its side on a diagonal ([Dir16] VI, scenario 3)",
            obstacles=((8.0, 8.0, 21.0, 21.0), (29.0, 29.0, 42.0, 42.0)),
        ),
    }
)


def find_scenario(name: str) -> Scenario:
    """Return the scenario of this name, or raise ScenarioError."""
    if name not in SCENARIOS:
        raise ScenarioError(kind="scenario", got=name, known=tuple(SCENARIOS))
    return SCENARIOS[name]
