"""Legs: the straight pieces, or rests, that make up every insect's path, kept for the whole run."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


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

    def __len__(self) -> int:
        return self.biobot.size

    def at(self, t_s: Floats | float) -> tuple[Floats, Floats]:
        """Return the place on each leg at its instant ``t_s`` [s]; nothing checks that the leg is running then."""
        elapsed = t_s - self.t_start_s
        return self.x + self.vx * elapsed, self.y + self.vy * elapsed

    def take(self, indices: Indices) -> "Legs":
        """Return the legs at ``indices``, shape (k,)."""
        return Legs(**{name: getattr(self, name)[indices] for name in LEG_FIELDS})


LEG_FIELDS = ("biobot", "t_start_s", "t_end_s", "x", "y", "vx", "vy")


def join(parts: list[Legs]) -> Legs:
    """Put legs together, in the order given."""
    return Legs(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in LEG_FIELDS})


def in_order(legs: Legs) -> Legs:
    """Sort legs by biobot, then start; a leg of no length before the one that begins where it ends."""
    return legs.take(np.lexsort((legs.t_end_s, legs.t_start_s, legs.biobot)))


def locate(legs: Legs, *, biobot: Indices, t_s: Floats) -> Indices:
    """Find the leg on which each biobot was at an instant.

    Parameters
    ----------
    legs
        In order of biobot, then start, as ``in_order`` puts them.
    biobot
        Rows of biobots, shape (k,).
    t_s
        An instant for each [s], shape (k,), not before the biobot's first leg.

    Returns
    -------
    Indices
        The last leg of that biobot that began at or before ``t_s``, shape (k,).
    """
    found = np.empty(biobot.size, dtype=np.int64)
    if not biobot.size:
        return found
    order = np.argsort(biobot, kind="stable")
    rows, first_asked = np.unique(biobot[order], return_index=True)
    first_leg = np.searchsorted(legs.biobot, rows, side="left")
    last_leg = np.searchsorted(legs.biobot, rows, side="right")
    for part, begin, end in zip(np.split(order, first_asked[1:]), first_leg.tolist(), last_leg.tolist(), strict=True):
        found[part] = begin + np.searchsorted(legs.t_start_s[begin:end], t_s[part], side="right") - 1
    return found
