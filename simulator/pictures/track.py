"""Where biobots were between the instants at which a run wrote their places, for drawing only.

A run's files hold places at evenly spaced instants; the legs between them are not in the files. Between two samples a biobot is
shown on the straight line from one to the other. Where that line would cross a wall it is known to be wrong, and the biobot is
shown at the nearer sample instead, so that nobody is ever drawn where nobody can walk. No figure is computed from this.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from simulator.arenas.arena import Arena

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Track:
    """Places of all biobots over time.

    Parameters
    ----------
    t_s
        Instants of the samples [s], ascending, shape (m,), m at least 1.
    position
        Where each biobot was at each, shape (m, n, 2) [length].
    arenas
        From which instant on [s] which walls stood; the first holds from the start.
    """

    __slots__ = ("_arenas", "_crossings", "_position", "_t_s")

    def __init__(self, *, t_s: Floats, position: Floats, arenas: Sequence[tuple[float, Arena]]) -> None:
        self._t_s = t_s
        self._position = position
        self._arenas = tuple(arenas)
        self._crossings: dict[int, Flags] = {}
        for _, arena in self._arenas:
            shapely.prepare(arena.polygon)

    def arena_at(self, at_s: float) -> Arena:
        """Return the arena of an instant [s]."""
        return next((arena for from_s, arena in reversed(self._arenas) if from_s <= at_s), self._arenas[0][1])

    def crosses(self, sample: int) -> Flags:
        """Tell whose straight line from ``sample`` to the next leaves the arena at either: shape (n,)."""
        known: Flags | None = self._crossings.get(sample)
        if known is None:
            lines = shapely.linestrings(np.stack([self._position[sample], self._position[sample + 1]], axis=1))
            ends = {id(arena): arena for arena in (self.arena_at(float(at_s)) for at_s in self._t_s[sample : sample + 2])}
            known = ~np.logical_and.reduce([shapely.covers(arena.polygon, lines) for arena in ends.values()])
            self._crossings[sample] = known
        return known

    def at(self, at_s: float) -> Floats:
        """Return where to draw every biobot at an instant [s]: shape (n, 2) [length]; beyond the ends, the first or last sample."""
        last = self._t_s.size - 1
        sample = int(np.clip(np.searchsorted(self._t_s, at_s, side="right") - 1, 0, last))
        if sample == last or at_s <= self._t_s[sample]:
            return np.array(self._position[sample])
        share = (at_s - self._t_s[sample]) / (self._t_s[sample + 1] - self._t_s[sample])
        before, after = self._position[sample], self._position[sample + 1]
        places: Floats = before + share * (after - before)
        crossing = self.crosses(sample)
        places[crossing] = (before if at_s < self._switch_s(sample) else after)[crossing]
        return places

    def lines(self, *, rows: NDArray[np.int64], from_s: float, to_s: float) -> Floats:
        """Return the ways of some biobots between two instants.

        Returns
        -------
        Floats
            Shape (len(rows), k, 2) [length]; a row of nan parts what is not to be joined, because a wall is between.
        """
        inner = np.flatnonzero((self._t_s > from_s) & (self._t_s < to_s))
        nodes = np.stack([self.at(from_s)[rows], *(self._position[k][rows] for k in inner), self.at(to_s)[rows]], axis=1)
        # Between two nodes lies one nan, or the middle of the two where the straight line stays inside.
        between = (nodes[:, :-1] + nodes[:, 1:]) / 2.0
        first = int(np.clip(np.searchsorted(self._t_s, from_s, side="right") - 1, 0, self._t_s.size - 1))
        for gap in range(between.shape[1]):
            if first + gap + 1 < self._t_s.size:
                between[self.crosses(first + gap)[rows], gap] = np.nan
        woven = np.empty((rows.size, nodes.shape[1] + between.shape[1], 2))
        woven[:, ::2], woven[:, 1::2] = nodes, between
        return woven

    def _switch_s(self, sample: int) -> float:
        """Return when a biobot whose line crosses a wall is shown at the next sample: half way, or when walls change in between."""
        start_s, end_s = float(self._t_s[sample]), float(self._t_s[sample + 1])
        return next((from_s for from_s, _ in self._arenas if start_s < from_s <= end_s), (start_s + end_s) / 2.0)
