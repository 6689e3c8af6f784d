"""Sight: two insects meet only while the straight line between them stays within the arena.

Neither insect ever passes through a wall, so the line between two of them comes to cross a wall, or ceases to, only at an
instant when it passes through one of that wall's corners: when a corner is in line with both. On straight legs these instants
are roots of quadratics, and between two of them nothing changes.
"""

import numpy as np
from numpy.typing import NDArray

from simulator.arenas.arena import Arena
from tests.simulator.plain.leg_log import Floats, Indices, Legs

# Contacts times walls looked at in one block: bounds memory.
_BLOCK = 1_000_000


def keep_in_sight(
    arena: Arena, legs: Legs, *, one: Indices, other: Indices, t_start_s: Floats, t_end_s: Floats
) -> tuple[Indices, Floats, Floats]:
    """Cut contacts down to the times in which no wall stands between the two.

    Parameters
    ----------
    legs
        Straight legs.
    one, other
        The two legs of each contact, shape (k,).
    t_start_s, t_end_s
        When they are within reach [s], shape (k,), within both legs; the end may be ``inf`` for two rests.

    Returns
    -------
    contact, t_start_s, t_end_s
        Shape (m,): row of the contact, and a spell in sight. Spells of one contact may touch. A contact no wall comes
        near is returned bit for bit.
    """
    places = _places(legs, one, other, t_s=t_start_s)
    # Two rests stay where they are: any instant stands for their end.
    later = _places(legs, one, other, t_s=np.where(np.isfinite(t_end_s), t_end_s, t_start_s))
    suspect, wall = _walls_in_the_way(arena, places, later)
    if not suspect.size:
        return np.arange(one.size), t_start_s, t_end_s
    contact, begin_s, end_s = _cut(arena, legs, one=one, other=other, t_start_s=t_start_s, t_end_s=t_end_s, suspect=suspect, wall=wall)
    blocked = _is_blocked(arena, legs, one=one, other=other, contact=contact, begin_s=begin_s, end_s=end_s, suspect=suspect, wall=wall)
    clear = np.setdiff1d(np.arange(one.size), suspect)
    return (
        np.concatenate([clear, contact[~blocked]]),
        np.concatenate([t_start_s[clear], begin_s[~blocked]]),
        np.concatenate([t_end_s[clear], end_s[~blocked]]),
    )


def _places(legs: Legs, one: Indices, other: Indices, *, t_s: Floats) -> Floats:
    """Return x and y of the one, then of the other, at an instant each: shape (4, k)."""
    rows = [
        start[leg] + velocity[leg] * (t_s - legs.t_start_s[leg])
        for leg in (one, other)
        for start, velocity in ((legs.x, legs.vx), (legs.y, legs.vy))
    ]
    return np.stack(rows)


def _walls_in_the_way(arena: Arena, before: Floats, after: Floats) -> tuple[Indices, Indices]:
    """List pairs (contact, wall) for which the line between the two insects may cross the wall at some time.

    A wall can only stand between them if it reaches into the box around all four places, and if at some time one of the two
    is behind its line and one before it: on straight legs, at the start or at the end.
    """
    both_x, both_y = np.stack([before[0::2], after[0::2]]).reshape(4, -1), np.stack([before[1::2], after[1::2]]).reshape(4, -1)
    x_min, x_max, y_min, y_max = both_x.min(axis=0), both_x.max(axis=0), both_y.min(axis=0), both_y.max(axis=0)
    low = np.minimum(arena.wall_start, arena.wall_end)
    high = np.maximum(arena.wall_start, arena.wall_end)
    block = max(1, _BLOCK // low.shape[0])
    contacts, walls = [], []
    for k in range(0, x_min.size, block):
        part = slice(k, k + block)
        near = (
            (x_min[part, None] <= high[:, 0])
            & (x_max[part, None] >= low[:, 0])
            & (y_min[part, None] <= high[:, 1])
            & (y_max[part, None] >= low[:, 1])
        )
        contact, wall = np.nonzero(near)
        contacts.append(contact + k)
        walls.append(wall)
    contact, wall = np.concatenate([np.empty(0, np.int64), *contacts]), np.concatenate([np.empty(0, np.int64), *walls])
    height = (both_x[:, contact] - arena.wall_start[wall, 0]) * arena.wall_inward[wall, 0] + (
        both_y[:, contact] - arena.wall_start[wall, 1]
    ) * arena.wall_inward[wall, 1]
    astride = (height.min(axis=0) < 0) & (height.max(axis=0) >= 0)
    return contact[astride], wall[astride]


def _cut(
    arena: Arena, legs: Legs, *, one: Indices, other: Indices, t_start_s: Floats, t_end_s: Floats, suspect: Indices, wall: Indices
) -> tuple[Indices, Floats, Floats]:
    """Cut each suspect contact wherever a corner of a suspect wall is in line with both insects."""
    cuts = [_times_in_line(legs, one[suspect], other[suspect], corner=ends[wall]) for ends in (arena.wall_start, arena.wall_end)]
    cut_s = np.concatenate([roots for pair in cuts for roots in pair])
    owner = np.tile(suspect, 4)
    inside = (cut_s > t_start_s[owner]) & (cut_s < t_end_s[owner])  # false for nan, where there is no root
    whole = np.unique(suspect)
    owner = np.concatenate([owner[inside], whole, whole])
    cut_s = np.concatenate([cut_s[inside], t_start_s[whole], t_end_s[whole]])
    order = np.lexsort((cut_s, owner))
    owner, cut_s = owner[order], cut_s[order]
    lasting = (owner[1:] == owner[:-1]) & (cut_s[1:] > cut_s[:-1])
    return owner[:-1][lasting], cut_s[:-1][lasting], cut_s[1:][lasting]


def _times_in_line(legs: Legs, one: Indices, other: Indices, *, corner: Floats) -> tuple[Floats, Floats]:
    """Solve for when a corner (shape (k, 2)) is in line with both insects: two roots [s] each, nan where there is none."""
    origin_s = np.maximum(legs.t_start_s[one], legs.t_start_s[other])
    ax, ay, bx, by = _places(legs, one, other, t_s=origin_s)
    ax, ay, bx, by = ax - corner[:, 0], ay - corner[:, 1], bx - corner[:, 0], by - corner[:, 1]
    ux, uy, wx, wy = legs.vx[one], legs.vy[one], legs.vx[other], legs.vy[other]
    # cross(a + u tau, b + w tau) = 0
    square, linear, constant = ux * wy - uy * wx, ax * wy - ay * wx + ux * by - uy * bx, ax * by - ay * bx
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # The sum that does not cancel gives one root, the product of the roots the other (square = 0: the one there is).
        q = -0.5 * (linear + np.copysign(np.sqrt(linear**2 - 4.0 * square * constant), linear))
        return origin_s + q / square, origin_s + constant / q


def _is_blocked(
    arena: Arena,
    legs: Legs,
    *,
    one: Indices,
    other: Indices,
    contact: Indices,
    begin_s: Floats,
    end_s: Floats,
    suspect: Indices,
    wall: Indices,
) -> NDArray[np.bool_]:
    """Tell which spells have a suspect wall of their contact between the two, looking at the middle of each."""
    middle_s = np.where(np.isfinite(end_s), 0.5 * (begin_s + end_s), begin_s)
    ax, ay, bx, by = _places(legs, one[contact], other[contact], t_s=middle_s)
    order = np.argsort(suspect, kind="stable")
    suspect, wall = suspect[order], wall[order]
    first, last = np.searchsorted(suspect, contact, side="left"), np.searchsorted(suspect, contact, side="right")
    spell = np.repeat(np.arange(contact.size), last - first)
    its_wall = wall[np.arange(spell.size) - np.repeat(np.cumsum(last - first) - (last - first), last - first) + first[spell]]
    ax, ay, bx, by = ax[spell], ay[spell], bx[spell], by[spell]
    start, end, inward = arena.wall_start[its_wall], arena.wall_end[its_wall], arena.wall_inward[its_wall]
    # Strictly on one side or not: a corner exactly in line belongs to one side for both walls that share it.
    start_left = (bx - ax) * (start[:, 1] - ay) - (by - ay) * (start[:, 0] - ax) >= 0
    end_left = (bx - ax) * (end[:, 1] - ay) - (by - ay) * (end[:, 0] - ax) >= 0
    a_before = (ax - start[:, 0]) * inward[:, 0] + (ay - start[:, 1]) * inward[:, 1] >= 0
    b_before = (bx - start[:, 0]) * inward[:, 0] + (by - start[:, 1]) * inward[:, 1] >= 0
    crossed = (start_left != end_left) & (a_before != b_before)
    return np.bincount(spell[crossed], minlength=contact.size) > 0
