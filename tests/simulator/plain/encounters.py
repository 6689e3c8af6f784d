"""Encounters in continuous time: when two insects on straight legs are within the detection radius and see each other.

The instants are roots of quadratics, of each pair of legs alone: no time step, no chunking and no order changes a bit of them.
Slices of time serve only to find the pairs of legs worth solving.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from simulator.arenas.arena import Arena
from tests.simulator.plain.leg_log import Floats, Indices, Legs
from tests.simulator.plain.sight import keep_in_sight

# Pieces of legs looked at in one go: bounds memory to some tens of megabytes.
_PIECES_PER_WINDOW = 60_000

# A root this close to the end of a leg, relative to the time, is that end: the two formulas for the place at a turn differ by
# rounding, and an encounter that goes on through the turn must not be cut in two by it.
_TIME_ROUNDING = 1e-14

# Rounding of positions in the search must not lose a pair.
_SEARCH_SLACK = 1 + 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contacts:
    """Spells within reach and in sight; arrays of shape (k,), in order of pair, then time.

    Parameters
    ----------
    first, second
        Rows of the two biobots, ``first < second``.
    t_start_s, t_end_s
        From when to when [s], ``t_start_s < t_end_s``; ``inf`` if nothing known ends it.
    """

    first: Indices
    second: Indices
    t_start_s: Floats
    t_end_s: Floats


class ContactFinder:
    """Finds all contacts between legs.

    Parameters
    ----------
    arena
        Its walls block sight.
    detection_radius
        r_d [length].
    speed
        Greatest speed of an insect [length/s].
    """

    __slots__ = ("_arena", "_radius", "_slice_s")

    def __init__(self, arena: Arena, *, detection_radius: float, speed: float) -> None:
        self._arena = arena
        self._radius = detection_radius
        # While an insect walks one radius: the search disc then holds about four times what the detection disc does.
        self._slice_s = detection_radius / speed

    def window_s(self, n_biobots: int) -> float:
        """Return how much time [s] to search in one go for a swarm of this size."""
        return self._slice_s * max(1, _PIECES_PER_WINDOW // n_biobots)

    def find(self, legs: Legs, *, begin_s: float, end_s: float) -> Contacts:
        """Find the contacts that touch ``[begin_s, end_s)`` [s].

        Parameters
        ----------
        legs
            All legs that run in part of that time.

        Returns
        -------
        Contacts
            Whole: one may begin before ``begin_s`` or end after ``end_s``, as far as these legs tell.
        """
        one, other = self._pairs_worth_solving(legs, begin_s=begin_s, end_s=end_s)
        swapped = legs.biobot[one] > legs.biobot[other]
        one, other = np.where(swapped, other, one), np.where(swapped, one, other)
        one, other, t_start_s, t_end_s = _within_reach(legs, one, other, radius=self._radius)
        touching = (t_start_s < end_s) & (t_end_s >= begin_s)
        one, other, t_start_s, t_end_s = one[touching], other[touching], t_start_s[touching], t_end_s[touching]
        kept, t_start_s, t_end_s = keep_in_sight(self._arena, legs, one=one, other=other, t_start_s=t_start_s, t_end_s=t_end_s)
        touching = (t_start_s < end_s) & (t_end_s >= begin_s)
        kept, t_start_s, t_end_s = kept[touching], t_start_s[touching], t_end_s[touching]
        return _join(first=legs.biobot[one[kept]], second=legs.biobot[other[kept]], t_start_s=t_start_s, t_end_s=t_end_s)

    def _pairs_worth_solving(self, legs: Legs, *, begin_s: float, end_s: float) -> tuple[Indices, Indices]:
        """Return pairs of legs of different biobots that may come within the radius in ``[begin_s, end_s)``."""
        n_slices = max(1, int(np.ceil((end_s - begin_s) / self._slice_s)))
        slice_s = (end_s - begin_s) / n_slices
        start_s, stop_s = np.maximum(legs.t_start_s, begin_s), np.minimum(legs.t_end_s, end_s)
        first_slice = np.clip(np.floor((start_s - begin_s) / slice_s), 0, n_slices - 1).astype(np.int64)
        last_slice = np.clip(np.floor((stop_s - begin_s) / slice_s), 0, n_slices - 1).astype(np.int64)
        n_pieces = last_slice - first_slice + 1
        leg = np.repeat(np.arange(n_pieces.size), n_pieces)
        slot = np.arange(leg.size) - np.repeat(np.cumsum(n_pieces) - n_pieces, n_pieces) + first_slice[leg]
        middle_s = begin_s + (slot + 0.5) * slice_s
        piece = Legs(
            biobot=legs.biobot[leg], t_start_s=legs.t_start_s[leg], t_end_s=legs.t_end_s[leg],
            x=legs.x[leg], y=legs.y[leg], vx=legs.vx[leg], vy=legs.vy[leg],
        )  # fmt: skip
        # A piece is taken where its leg is (or would be) in the middle of the slice: at most half a slice's walk away.
        x, y = piece.at(middle_s)
        speed = float(np.sqrt(np.max(legs.vx**2 + legs.vy**2, initial=0.0)))
        reach = (self._radius + speed * slice_s) * _SEARCH_SLACK
        # The slice as a third coordinate keeps pieces of different slices apart.
        pairs = cKDTree(np.column_stack([x, y, slot * (2.0 * reach)])).query_pairs(reach, output_type="ndarray")
        one, other = leg[pairs[:, 0]], leg[pairs[:, 1]]
        apart = legs.biobot[one] != legs.biobot[other]
        low, high = np.minimum(one, other)[apart], np.maximum(one, other)[apart]
        count = legs.biobot.size
        key = np.unique(low * count + high)
        return key // count, key % count


def _within_reach(legs: Legs, one: Indices, other: Indices, *, radius: float) -> tuple[Indices, Indices, Floats, Floats]:
    """Solve for when the distance is at most the radius; keep the pairs for which it ever is, for more than an instant."""
    start_s = np.maximum(legs.t_start_s[one], legs.t_start_s[other])
    stop_s = np.minimum(legs.t_end_s[one], legs.t_end_s[other])
    overlapping = start_s < stop_s
    one, other, start_s, stop_s = one[overlapping], other[overlapping], start_s[overlapping], stop_s[overlapping]
    apart_x = (legs.x[one] + legs.vx[one] * (start_s - legs.t_start_s[one])) - (
        legs.x[other] + legs.vx[other] * (start_s - legs.t_start_s[other])
    )
    apart_y = (legs.y[one] + legs.vy[one] * (start_s - legs.t_start_s[one])) - (
        legs.y[other] + legs.vy[other] * (start_s - legs.t_start_s[other])
    )
    closing_x, closing_y = legs.vx[one] - legs.vx[other], legs.vy[one] - legs.vy[other]
    # |apart + closing tau| <= radius, by the distance of closest approach: no cancellation for glancing pairs.
    speed_squared = closing_x**2 + closing_y**2
    miss = apart_x * closing_y - apart_y * closing_x
    moving = speed_squared > 0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        nearest_s = -(apart_x * closing_x + apart_y * closing_y) / speed_squared
        half_s = np.sqrt(np.maximum(radius**2 * speed_squared - miss**2, 0.0)) / speed_squared
    together = apart_x**2 + apart_y**2 <= radius**2
    still = np.where(together, np.inf, 0.0)  # two that keep their distance: always, or never
    begin_s = np.where(moving, start_s + (nearest_s - half_s), np.where(together, -np.inf, np.inf))
    end_s = np.where(moving, start_s + (nearest_s + half_s), still)
    snap_start_s = start_s + _TIME_ROUNDING * (1.0 + np.abs(start_s))
    snap_stop_s = stop_s * (1.0 - _TIME_ROUNDING) - _TIME_ROUNDING
    begin_s = np.where(begin_s <= snap_start_s, start_s, begin_s)
    end_s = np.where(end_s >= snap_stop_s, stop_s, end_s)
    lasting = begin_s < end_s
    return one[lasting], other[lasting], begin_s[lasting], end_s[lasting]


def _join(*, first: Indices, second: Indices, t_start_s: Floats, t_end_s: Floats) -> Contacts:
    """Put contacts in order and make one of those that touch: one ends where the next begins, at a turn or in mid-leg."""
    order = np.lexsort((t_end_s, t_start_s, second, first))
    first, second, t_start_s, t_end_s = first[order], second[order], t_start_s[order], t_end_s[order]
    new = np.ones(first.size, dtype=np.bool_)
    new[1:] = (first[1:] != first[:-1]) | (second[1:] != second[:-1]) | (t_start_s[1:] > t_end_s[:-1])
    begins = np.flatnonzero(new)
    ends = np.append(begins[1:], first.size)[: begins.size] - 1
    return Contacts(first=first[begins], second=second[begins], t_start_s=t_start_s[begins], t_end_s=t_end_s[ends])
