"""Legs: the straight pieces, or rests, that make up every insect's path, kept for the whole run."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_FIRST_CAPACITY = 1024


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Legs:
    """Some legs, one array element each; all arrays have shape (k,).

    Parameters
    ----------
    biobot
        Row of the biobot in the world's list of ids.
    t_start_s, t_end_s
        When the leg begins and ends [s]; ``inf`` for a rest without known end.
    x, y
        Where it begins [length].
    vx, vy
        Velocity [length/s]; both 0 for a rest.
    """

    biobot: Indices
    t_start_s: Floats
    t_end_s: Floats
    x: Floats
    y: Floats
    vx: Floats
    vy: Floats

    def at(self, t_s: Floats | float) -> tuple[Floats, Floats]:
        """Return the place on each leg at its instant ``t_s`` [s]; nothing checks that the leg is running then."""
        elapsed = t_s - self.t_start_s
        return self.x + self.vx * elapsed, self.y + self.vy * elapsed


class LegLog:
    """Every leg of a run in the order of its making; 56 bytes a leg."""

    __slots__ = ("_biobot", "_columns", "_size")

    def __init__(self) -> None:
        self._size = 0
        self._biobot = np.empty(_FIRST_CAPACITY, dtype=np.int64)
        self._columns = np.empty((6, _FIRST_CAPACITY), dtype=np.float64)

    def __len__(self) -> int:
        return self._size

    def append(self, legs: Legs) -> Indices:
        """Store legs and return their indices, shape (k,)."""
        count = legs.biobot.size
        while self._size + count > self._biobot.size:
            self._biobot = np.concatenate([self._biobot, np.empty_like(self._biobot)])
            self._columns = np.concatenate([self._columns, np.empty_like(self._columns)], axis=1)
        place = slice(self._size, self._size + count)
        self._biobot[place] = legs.biobot
        for row, values in enumerate((legs.t_start_s, legs.t_end_s, legs.x, legs.y, legs.vx, legs.vy)):
            self._columns[row, place] = values
        self._size += count
        return np.arange(place.start, place.stop, dtype=np.int64)

    def take(self, indices: Indices) -> Legs:
        """Return a copy of the legs at ``indices``, shape (k,)."""
        t_start_s, t_end_s, x, y, vx, vy = self._columns[:, indices]
        return Legs(biobot=self._biobot[indices], t_start_s=t_start_s, t_end_s=t_end_s, x=x, y=y, vx=vx, vy=vy)

    def end(self, index: int, *, at_s: float) -> None:
        """Cut leg ``index`` short: it ends at ``at_s`` [s]."""
        self._columns[1, index] = at_s

    def t_end_s(self, indices: Indices) -> Floats:
        """Return when the legs at ``indices`` end [s], shape (k,)."""
        ends: Floats = self._columns[1, indices]
        return ends

    def locate(self, biobot: Indices, t_s: Floats) -> Indices:
        """Find the leg on which each biobot was at an instant.

        Parameters
        ----------
        biobot
            Rows of biobots, shape (k,).
        t_s
            An instant for each [s], shape (k,), not before the biobot's first leg.

        Returns
        -------
        Indices
            The last leg of that biobot that began at or before ``t_s``, shape (k,); the later made one where two begin together.
        """
        order = np.lexsort((np.arange(self._size), self._columns[0, : self._size], self._biobot[: self._size]))
        starts = self._columns[0, order]
        owners = self._biobot[order]
        found = np.empty(biobot.size, dtype=np.int64)
        for row in np.unique(biobot):
            first, last = np.searchsorted(owners, [row, row + 1])
            asked = np.flatnonzero(biobot == row)
            found[asked] = order[first + np.searchsorted(starts[first:last], t_s[asked], side="right") - 1]
        return found
