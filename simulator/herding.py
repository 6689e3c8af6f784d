"""A beacon that keeps a swarm together and leads it: whoever strays is turned back towards it. No clock, no chance.

As in the later work of the group of [Dir16]: a beacon that moves, carried by a vehicle in the air, holds the biobots within its range and
draws them along. Here every insect that is further from it than its range is turned to face it at each call of ``tend``; within the range
it walks as it likes. Walls in between are not known to the beacon: an insect behind one is turned again until it has found the way.
"""

import math
from collections.abc import Sequence

import numpy as np

from simulator.errors import ParameterError
from simulator.legs import Floats
from simulator.world import World


class BeaconPath:
    """A way that a beacon takes at a constant speed.

    Parameters
    ----------
    corners
        Places it goes through in straight lines, at least two, of which no two that follow each other are one [length].
    speed
        Above 0 [length/s].
    """

    __slots__ = ("_corners", "_mileage", "speed")

    def __init__(self, corners: Sequence[tuple[float, float]], *, speed: float) -> None:
        self._corners = np.array(corners, dtype=np.float64).reshape(-1, 2)
        legs = np.linalg.norm(np.diff(self._corners, axis=0), axis=1)
        if len(self._corners) < 2 or not np.isfinite(self._corners).all() or not (legs > 0).all():
            raise ParameterError(name="corners", got=list(corners), wanted="at least two finite places, each other than the one before")
        if not 0 < speed < math.inf:
            raise ParameterError(name="speed", got=speed, wanted="a positive finite speed")
        self._mileage = np.concatenate([[0.0], np.cumsum(legs)])
        self.speed = speed

    @property
    def duration_s(self) -> float:
        """How long it is under way [s]."""
        return float(self._mileage[-1]) / self.speed

    def at(self, t_s: float) -> tuple[float, float]:
        """Return where it is ``t_s`` after its beginning [s]; before and after its way it stands at its ends."""
        x, y = (float(np.interp(t_s * self.speed, self._mileage, axis)) for axis in self._corners.T)
        return x, y


def distances_from(world: World, place: tuple[float, float]) -> Floats:
    """Measure how far each biobot is from a place: shape (n,) [length], rows as in ``world.ids``."""
    found: Floats = np.hypot(*(world.positions() - np.array(place)).T)
    return found


def tend(world: World, place: tuple[float, float], *, radius: float) -> int:
    """Turn everybody who walks further than ``radius`` from the beacon's place towards it; return how many.

    Who stands, by command or by itself, is left alone.
    """
    velocity = world.velocities()
    strayed = np.flatnonzero((distances_from(world, place) > radius) & velocity.any(axis=1))
    to_beacon = np.array(place) - world.positions()[strayed]
    angle = np.arctan2(to_beacon[:, 1], to_beacon[:, 0]) - np.arctan2(velocity[strayed, 1], velocity[strayed, 0])
    for row, turn in zip(strayed.tolist(), angle.tolist(), strict=True):
        world.turn(world.ids[row], math.remainder(turn, math.tau))
    return len(strayed)
