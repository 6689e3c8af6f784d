"""The correlated random walk of [Dir16] eq. (1) between walls.

An insect walks straight legs at constant speed. A leg's length is exponential with mean l*, and its direction is drawn anew,
isotropically, where the leg ends freely. Where a wall ends it, the new direction is uniform in the half-plane that points
away from the wall, and a new exponential length is drawn. Where a new direction runs straight into another wall that the
insect touches as well, no time passes and it is drawn again, from the half-plane of that wall: in effect it is uniform over
all ways out of a corner.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator import draws
from simulator.arenas.arena import Arena
from tests.simulator.plain.leg_log import Floats, Indices, Legs

_LENGTH_STREAM = 2
_DIRECTION_STREAM = 3

# Insects times walls in one block of the ray search: bounds its memory to some ten arrays of this many numbers.
_BLOCK = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reach:
    """How far rays go before they touch a wall; arrays of shape (k,).

    Parameters
    ----------
    length
        Distance to the first touch [length]; ``inf`` where nothing is in the way.
    normal_x, normal_y
        Unit normal of what is touched, pointing back to the insect; arbitrary where ``length`` is ``inf``.
    """

    length: Floats
    normal_x: Floats
    normal_y: Floats


class Walk:
    """All insects' walks: where each is, and the legs it makes next.

    Parameters
    ----------
    arena
        Walls to stay within.
    speed
        Of every insect [length/s].
    mean_leg
        Mean length l* of a free leg [length].
    ids
        Identities; an insect's draws are keyed by (seed, id, number of the leg).
    seed
        0 to 2^64 - 1.
    """

    __slots__ = ("_arena", "_ids", "_leg_number", "_mean_leg", "_normal_x", "_normal_y", "_seed", "_speed", "_steered", "_t_s", "_x", "_y")

    def __init__(self, arena: Arena, *, speed: float, mean_leg: float, ids: tuple[int, ...], seed: int) -> None:
        self._arena = arena
        self._speed = speed
        self._mean_leg = mean_leg
        self._ids = np.array(ids, dtype=np.uint64)
        self._seed = seed
        places = arena.draw_places(seed=seed, ids=self._ids)
        self._x = places[:, 0].copy()
        self._y = places[:, 1].copy()
        # When the next leg begins; inf for an insect that stands still.
        self._t_s = np.zeros(len(ids))
        # Normal of the wall that ended the last leg; both 0 after a free end.
        self._normal_x = np.zeros(len(ids))
        self._normal_y = np.zeros(len(ids))
        self._leg_number = np.zeros(len(ids), dtype=np.uint64)
        # Rows whose next leg has a given direction, and a given length where that is not nan.
        self._steered: dict[int, tuple[float, float, float]] = {}

    def legs_until(self, end_s: float) -> Iterator[Legs]:
        """Make legs until every walking insect's last one reaches ``end_s`` [s]; at most one leg an insect in each batch.

        A leg is made whole, whatever ``end_s`` is, so that how often this is called changes nothing.
        """
        while (rows := np.flatnonzero(self._t_s < end_s)).size:
            made = self._next_legs(rows)
            taking_time = made.t_end_s > made.t_start_s
            yield Legs(
                biobot=made.biobot[taking_time],
                t_start_s=made.t_start_s[taking_time],
                t_end_s=made.t_end_s[taking_time],
                x=made.x[taking_time],
                y=made.y[taking_time],
                vx=made.vx[taking_time],
                vy=made.vy[taking_time],
            )

    def rests(self, rows: Indices, *, t_start_s: float, t_end_s: float) -> Legs:
        """Return legs on which insects stand where they are."""
        still = np.zeros(rows.size)
        return Legs(biobot=rows, t_start_s=still + t_start_s, t_end_s=still + t_end_s, x=self._x[rows], y=self._y[rows], vx=still, vy=still)

    def halt(self, rows: Indices, x: Floats, y: Floats) -> None:
        """Let insects stand still at places reached within their last legs, shape (k,) [length]."""
        self._x[rows] = x
        self._y[rows] = y
        self._t_s[rows] = np.inf

    def release(self, rows: Indices, *, at_s: float) -> None:
        """Let halted insects walk on from ``at_s`` [s], in any direction."""
        self._t_s[rows] = at_s
        self._normal_x[rows] = 0.0
        self._normal_y[rows] = 0.0

    def steer(self, row: int, *, at_s: float, direction: tuple[float, float], length: float = float("nan")) -> None:
        """Let a halted insect's next leg begin at ``at_s`` [s] in a direction (a unit vector), with a length where one is given."""
        self.release(np.array([row]), at_s=at_s)
        self._steered[row] = (*direction, length)

    def _next_legs(self, rows: Indices) -> Legs:
        x, y, t_s = self._x[rows], self._y[rows], self._t_s[rows]
        number = self._leg_number[rows]
        self._leg_number[rows] += np.uint64(1)
        direction_x, direction_y = self._draw_directions(rows, number)
        bits = draws.words(seed=self._seed, biobot=self._ids[rows], stream=_LENGTH_STREAM, index=number)
        length = self._mean_leg * draws.exponential(bits)
        for place in [k for k, row in enumerate(rows.tolist()) if row in self._steered]:
            direction_x[place], direction_y[place], forced = self._steered.pop(int(rows[place]))
            length[place] = length[place] if np.isnan(forced) else forced
        reach = reach_walls(self._arena, x=x, y=y, direction_x=direction_x, direction_y=direction_y)
        touches = reach.length < length
        t_end_s = t_s + np.minimum(length, reach.length) / self._speed
        vx, vy = self._speed * direction_x, self._speed * direction_y
        # The next leg begins exactly where this one, as told, ends: rounding of the time must not make the path jump.
        self._x[rows] = x + vx * (t_end_s - t_s)
        self._y[rows] = y + vy * (t_end_s - t_s)
        self._t_s[rows] = t_end_s
        self._normal_x[rows] = np.where(touches, reach.normal_x, 0.0)
        self._normal_y[rows] = np.where(touches, reach.normal_y, 0.0)
        return Legs(biobot=rows, t_start_s=t_s, t_end_s=t_end_s, x=x, y=y, vx=vx, vy=vy)

    def _draw_directions(self, rows: Indices, number: NDArray[np.uint64]) -> tuple[Floats, Floats]:
        u = draws.uniform(draws.words(seed=self._seed, biobot=self._ids[rows], stream=_DIRECTION_STREAM, index=number))
        normal_x, normal_y = self._normal_x[rows], self._normal_y[rows]
        at_wall = (normal_x != 0) | (normal_y != 0)
        # From the wall: within a quarter turn of the normal to either side. In the open: any turn from the x axis.
        cosine, sine = draws.circle(np.where(at_wall, 0.5 * u - 0.25, u))
        return (
            np.where(at_wall, normal_x * cosine - normal_y * sine, cosine),
            np.where(at_wall, normal_y * cosine + normal_x * sine, sine),
        )


def reach_walls(arena: Arena, *, x: Floats, y: Floats, direction_x: Floats, direction_y: Floats) -> Reach:
    """Find how far insects can walk straight on before they come within the arena's margin of a wall.

    Parameters
    ----------
    x, y
        Where they are, shape (k,) [length], inside the arena.
    direction_x, direction_y
        Unit vectors, shape (k,).

    Returns
    -------
    Reach
        Length 0 for an insect that touches a wall and heads into it. One that touches a wall and heads away is free: rounding
        may put it a little nearer than the margin, and it never gets nearer still.

    Notes
    -----
    A wall is the set of points within the margin of a segment: a strip before its face, and a disc around each corner.
    Ties go to faces before corners, then to the wall that comes first.
    """
    block = max(1, _BLOCK // arena.wall_start.shape[0])
    parts = [
        _reach_block(arena, x=x[k : k + block], y=y[k : k + block], dx=direction_x[k : k + block], dy=direction_y[k : k + block])
        for k in range(0, x.size, block)
    ]
    return Reach(
        length=np.concatenate([part.length for part in parts]),
        normal_x=np.concatenate([part.normal_x for part in parts]),
        normal_y=np.concatenate([part.normal_y for part in parts]),
    )


def _reach_block(arena: Arena, *, x: Floats, y: Floats, dx: Floats, dy: Floats) -> Reach:
    dx_, dy_ = dx[:, None], dy[:, None]
    from_corner_x = x[:, None] - arena.wall_start[:, 0]
    from_corner_y = y[:, None] - arena.wall_start[:, 1]
    nx, ny = arena.wall_inward[:, 0], arena.wall_inward[:, 1]
    along_x, along_y = arena.wall_end[:, 0] - arena.wall_start[:, 0], arena.wall_end[:, 1] - arena.wall_start[:, 1]
    along_squared = along_x**2 + along_y**2
    height = from_corner_x * nx + from_corner_y * ny
    climb = dx_ * nx + dy_ * ny
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        to_face = np.maximum((height - arena.margin) / -climb, 0.0)
        # Where along the wall the face is met, as a share of its length.
        share = ((from_corner_x + to_face * dx_) * along_x + (from_corner_y + to_face * dy_) * along_y) / along_squared
    # One margin further at both ends, so that a grazing ray cannot slip between a face and its corner by rounding; not so from well
    # below the margin, where beyond an end the disc alone is in the way.
    slack = np.where(height < (1.0 - 1e-6) * arena.margin, 0.0, arena.margin / np.sqrt(along_squared))
    to_face = np.where((climb < 0) & (height >= 0) & (share >= -slack) & (share <= 1 + slack), to_face, np.inf)
    # Every corner is the start of one wall.
    approach = from_corner_x * dx_ + from_corner_y * dy_
    aside = from_corner_x * dy_ - from_corner_y * dx_
    inside = np.maximum(arena.margin**2 - aside**2, 0.0)
    to_corner = np.where((np.abs(aside) < arena.margin) & (approach < 0), np.maximum(-approach - np.sqrt(inside), 0.0), np.inf)
    rows = np.arange(x.size)
    face, corner = np.argmin(to_face, axis=1), np.argmin(to_corner, axis=1)
    face_length, corner_length = to_face[rows, face], to_corner[rows, corner]
    at_corner = corner_length < face_length
    touch_x = from_corner_x[rows, corner] + np.where(at_corner, corner_length, 0.0) * dx
    touch_y = from_corner_y[rows, corner] + np.where(at_corner, corner_length, 0.0) * dy
    distance = np.sqrt(touch_x**2 + touch_y**2)
    return Reach(
        length=np.minimum(face_length, corner_length),
        normal_x=np.where(at_corner, touch_x / distance, nx[face]),
        normal_y=np.where(at_corner, touch_y / distance, ny[face]),
    )
