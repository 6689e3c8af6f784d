"""Which coordinator each backpack belongs to: the strongest at first, another one when that is clearly stronger. Pure.

A coordinator covers a place where its signal is not weaker than at the coverage radius; with a plain law of distance that is the
disc of this radius. A backpack leaves its coordinator where another is stronger by the hand-over margin, or where its own does not
cover it any more; where none covers it, it belongs to nobody until one does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from simulator.errors import ParameterError

Place = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class CoverageConfig:
    """Where the coordinators are and how far they reach.

    Parameters
    ----------
    places
        One for each coordinator, at least one [length].
    radius
        How far a backpack and a coordinator hear each other [length]; None: everywhere.
    handover_db
        Another coordinator must be stronger by this before a backpack leaves one that still covers it [dB].
    """

    places: tuple[Place, ...]
    radius: float | None = None
    handover_db: float = 6.0

    def __post_init__(self) -> None:
        if not self.places or not all(math.isfinite(value) for place in self.places for value in place):
            raise ParameterError(name="coordinator_places", got=self.places, wanted="a finite [x, y] for each coordinator")
        if self.radius is not None and not (math.isfinite(self.radius) and self.radius > 0):
            raise ParameterError(name="coverage_radius", got=self.radius, wanted="a positive finite number")
        if not (math.isfinite(self.handover_db) and self.handover_db >= 0):
            raise ParameterError(name="handover_db", got=self.handover_db, wanted="a finite number, not negative")


class Coverage:
    """Chooses coordinators.

    Parameters
    ----------
    strength_dbm
        Signal strength at a distance [length to dBm], falling with it.
    """

    def __init__(self, config: CoverageConfig, *, strength_dbm: Callable[[float], float]) -> None:
        self._config = config
        self._strength_dbm = strength_dbm
        self._weakest_dbm = -math.inf if config.radius is None else strength_dbm(config.radius)

    @property
    def is_trivial(self) -> bool:
        """Every backpack always belongs to the only coordinator there is."""
        return len(self._config.places) == 1 and self._config.radius is None

    def distance(self, place: Place, coordinator: int) -> float:
        """Return how far a place is from a coordinator [length]."""
        x, y = self._config.places[coordinator]
        return math.hypot(place[0] - x, place[1] - y)

    def covers(self, coordinator: int, place: Place) -> bool:
        """Tell whether a coordinator and a backpack at a place hear each other."""
        return self.is_trivial or self._strength_dbm(self.distance(place, coordinator)) >= self._weakest_dbm

    def choose(self, place: Place, *, home: int | None) -> int | None:
        """Return the coordinator that a backpack at ``place`` belongs to from now on.

        Parameters
        ----------
        home
            The one it belonged to.

        Returns
        -------
        int or None
            Of equally strong ones the first; None where none covers it.
        """
        if self.is_trivial:
            return 0
        strengths = [self._strength_dbm(self.distance(place, index)) for index in range(len(self._config.places))]
        best = max(range(len(strengths)), key=lambda index: (strengths[index], -index))
        if strengths[best] < self._weakest_dbm:
            return None
        is_home_fit = home is not None and strengths[home] >= self._weakest_dbm
        if home is not None and is_home_fit and strengths[best] < strengths[home] + self._config.handover_db:
            return home
        return best


def spread_places(bounds: Sequence[float], count: int) -> tuple[Place, ...]:
    """Place coordinators over a bounding box: in the middles of as many equal strips, cut across its longer side.

    Parameters
    ----------
    bounds
        Lowest x, lowest y, highest x, highest y [length]. A square is cut across x.
    """
    low_x, low_y, high_x, high_y = bounds
    middle_x, middle_y = (low_x + high_x) / 2, (low_y + high_y) / 2
    shares = [(index + 0.5) / count for index in range(count)]
    if high_x - low_x >= high_y - low_y:
        return tuple((low_x + share * (high_x - low_x), middle_y) for share in shares)
    return tuple((middle_x, low_y + share * (high_y - low_y)) for share in shares)
