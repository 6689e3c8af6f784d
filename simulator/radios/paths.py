"""Where everybody was at many instants at once, from the legs of their paths."""

import numpy as np

from simulator.legs import Floats, Legs


class Paths:
    """Paths of ``n`` biobots.

    Parameters
    ----------
    legs
        Every leg, in any order; those of each biobot leave no gap. Of legs that begin together all but one have no length.
    """

    __slots__ = ("_bounds", "_legs", "_n")

    def __init__(self, legs: Legs, *, n: int) -> None:
        order = np.lexsort((legs.t_end_s, legs.t_start_s, legs.biobot))
        self._legs = Legs(**{name: getattr(legs, name)[order] for name in Legs.__dataclass_fields__})
        self._bounds = np.searchsorted(self._legs.biobot, np.arange(n + 1)).tolist()
        self._n = n

    def places(self, t_s: Floats) -> Floats:
        """Return where all were, shape (k, n, 2) [length], at instants of shape (k,) [s]."""
        places = np.empty((t_s.size, self._n, 2))
        legs = self._legs
        for row in range(self._n):
            low, high = self._bounds[row], self._bounds[row + 1]
            leg = low + np.maximum(np.searchsorted(legs.t_start_s[low:high], t_s, side="right") - 1, 0)
            elapsed = t_s - legs.t_start_s[leg]
            places[:, row, 0] = legs.x[leg] + legs.vx[leg] * elapsed
            places[:, row, 1] = legs.y[leg] + legs.vy[leg] * elapsed
        return places

    def place(self, row: int, t_s: float) -> tuple[float, float]:
        """Return where one biobot was [length] at an instant [s]."""
        low, high = self._bounds[row], self._bounds[row + 1]
        legs = self._legs
        leg = low + max(int(legs.t_start_s[low:high].searchsorted(t_s, side="right")) - 1, 0)
        elapsed = t_s - legs.t_start_s[leg]
        return float(legs.x[leg] + legs.vx[leg] * elapsed), float(legs.y[leg] + legs.vy[leg] * elapsed)
