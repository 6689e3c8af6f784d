"""What backpacks need of the world in which their insects live, be it walked now or recorded earlier."""

from collections.abc import Sequence
from typing import Protocol

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.events import Cause, EncounterBegan, Event, Mode
from simulator.legs import Floats, Indices


class Habitat(Protocol):
    """A world as ``simulator.world.World`` is one; its docstrings are the law for all."""

    @property
    def arena(self) -> Arena | None:
        """Where the insects walk; None where that and all places are unknown (every place is then nan)."""

    @property
    def ids(self) -> tuple[int, ...]:
        """All identities, ascending."""

    @property
    def now_s(self) -> float:
        """The present [s]."""

    @property
    def ranges(self) -> Ranges:
        """Detection and communication radius."""

    def advance(self, until_s: float, /) -> list[Event]:
        """Let time run to ``until_s`` [s] and return what happened before it."""

    def stop(self, biobot_id: int, /, *, cause: Cause) -> bool:
        """Make a biobot stand still from now on."""

    def start(self, biobot_id: int, /, *, cause: Cause) -> bool:
        """Let a biobot walk from now on."""

    def follow_walls(self, biobot_id: int, /, *, cause: Cause) -> bool:
        """Let a biobot walk from now on, and keep to walls until a start or a stop."""

    def turn(self, biobot_id: int, angle_rad: float, /) -> bool:
        """Turn a biobot at once, to the left where the angle is positive; a naturally resting one walks on."""

    def run_straight(self, biobot_id: int, distance: float, /) -> bool:
        """Make a biobot run straight on for a distance [length], or to the next wall; a naturally resting one walks on."""

    def mode(self, biobot_id: int, /) -> Mode:
        """Return the present mode of a biobot."""

    def positions(self) -> Floats:
        """Return where all biobots are now: shape (n, 2) [length]; nan where unknown."""

    def positions_of(self, biobot_ids: Sequence[int] | Indices, t_s: Sequence[float] | Floats, /) -> Floats:
        """Return where each of some biobots was at its instant: shape (k, 2) [length]; nan where unknown."""

    def positions_at(self, t_s: Sequence[float] | Floats, /) -> Floats:
        """Return where all biobots were at each of some instants: shape (k, n, 2) [length]; nan where unknown."""

    def open_encounters(self) -> list[EncounterBegan]:
        """Return the encounters told to have begun and not yet to have ended."""
