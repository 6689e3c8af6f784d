"""Visibility: which points of an arena see each other along a straight line that stays within the arena.

The arena is closed: a line may run along a wall and touch corners. Where walls only touch in a point nothing passes, as in
``simulator.arenas.arena``; the corners there are taken apart into the *sectors* of the arena that meet in them.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from simulator.arenas.arena import Arena
from simulator.arenas.horizon import find_hidden
from simulator.errors import OutsideArenaError

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Bools = NDArray[np.bool_]

# What lies this share of the arena's margin apart is one place: a hundred-billionth of the extent, far above rounding.
_TOLERANCE_OF_MARGIN = 1e-2

# Walls looked at together, and left out together where none is near.
_WALLS_AT_ONCE = 32

# A line that leads into a corner by less than this angle may be one that passes it, but for rounding [rad].
_MIN_TURN = 1e-3

# Points times walls looked at in one block: bounds memory to some tens of megabytes.
_BLOCK = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Viewpoints:
    """Points of an arena, prepared to be looked from and at; made by ``Visibility``.

    Parameters
    ----------
    xy
        Shape (n, 2) [length].
    is_before
        Whether a point is on the arena's side of a wall's line, or on the wall, shape (n, n_walls).
    vertex
        The corner a point lies in, shape (n,); -1 for none.
    first_sector, n_sectors
        The sectors of the arena at that corner which the point belongs to, shape (n,): none away from corners.
    """

    xy: Floats
    is_before: Bools
    vertex: Indices
    first_sector: Indices
    n_sectors: Indices


class Visibility:
    """The walls of an arena, prepared for questions of sight.

    Notes
    -----
    A line that passes exactly through a corner may be refused, because its two halves, from end to corner, never are. Points less than
    ``tolerance`` [length] from each other, or from a wall or corner, count as being there.
    """

    __slots__ = (
        "_arena",
        "_end",
        "_is_convex",
        "_sector_in",
        "_sector_is_convex",
        "_sector_out",
        "_sector_vertex",
        "_start",
        "_vertices",
        "tolerance",
    )

    def __init__(self, arena: Arena) -> None:
        self._arena = arena
        self.tolerance = _TOLERANCE_OF_MARGIN * arena.margin
        self._vertices, self._start, self._end = _split_walls(arena, tolerance=self.tolerance)
        self._sector_in, self._sector_out = _find_sectors(self._vertices, self._start, self._end)
        self._sector_vertex = self._start[self._sector_out]
        begin, end = self._vertices[self._start[self._sector_in]], self._vertices[self._end[self._sector_out]]
        corner = self._vertices[self._sector_vertex]
        turn = _cross(corner - begin, end - corner)
        goes_on = np.sum((corner - begin) * (end - corner), axis=1) > 0
        # A corner that is flat but for rounding is no convex one: a line along its walls may have to be cut there.
        self._sector_is_convex = turn > np.where(goes_on, self.tolerance * _length(end - begin), 0.0)
        self._is_convex = np.zeros(len(self._vertices), dtype=bool)
        self._is_convex[self._sector_vertex[self._sector_is_convex]] = True

    def look_from(self, points: Floats) -> Viewpoints:
        """Prepare points of shape (n, 2) [length].

        Raises
        ------
        OutsideArenaError
            One lies outside, or is not finite.
        """
        is_finite = np.isfinite(points).all(axis=1)
        distance = np.where(is_finite, 0.0, np.inf)
        doubtful = np.flatnonzero(is_finite)
        doubtful = doubtful[~shapely.intersects_xy(self._arena.polygon, points[doubtful, 0], points[doubtful, 1])]
        distance[doubtful] = shapely.distance(self._arena.polygon, shapely.points(points[doubtful]))
        outside = np.flatnonzero(~(distance <= self.tolerance))
        if outside.size:
            row = int(outside[0])
            raise OutsideArenaError(row=row, count=outside.size, place=tuple(points[row].tolist()), distance=float(distance[row]))
        apart, nearest = cKDTree(self._vertices).query(points)
        is_corner = apart <= self.tolerance
        at = np.where(is_corner, nearest, 0)
        return Viewpoints(
            xy=points,
            is_before=self._sides(points),
            vertex=np.where(is_corner, nearest, -1),
            first_sector=np.searchsorted(self._sector_vertex, at),
            n_sectors=np.where(is_corner, np.bincount(self._sector_vertex, minlength=len(self._vertices))[at], 0),
        )

    def turning_corners(self) -> Viewpoints:
        """Prepare the corners a shortest path can turn round, or be cut at: one for each sector that is not convex."""
        sector = np.flatnonzero(~self._sector_is_convex)
        vertex = self._sector_vertex[sector]
        xy = self._vertices[vertex]
        return Viewpoints(
            xy=xy, is_before=self._sides(xy), vertex=vertex, first_sector=sector, n_sectors=np.ones(sector.size, dtype=np.int64)
        )

    def can_turn(self, points: Viewpoints, corners: Viewpoints) -> Bools:
        """Tell which points could be joined to which corner by a piece of a path that turns there: shape (points, corners).

        From a point well before both walls of a corner the way straight on leads into the wall, so a path that bends away from it there
        is no shortest one.
        """
        answer = np.zeros((len(points.xy), len(corners.xy)), dtype=bool)
        if not answer.size:
            return answer
        block = max(1, _BLOCK // len(corners.xy))
        for k in range(0, len(points.xy), block):
            for wall in (self._sector_in[corners.first_sector], self._sector_out[corners.first_sector]):
                part = points.xy[k : k + block]
                height, _, _ = self._heights(part, wall)
                apart = _length(part[:, None] - corners.xy)
                answer[k : k + block] |= height <= self.tolerance + _MIN_TURN * apart
        return answer

    def sees(self, one: Viewpoints, other: Viewpoints, *, i: Indices, j: Indices) -> Bools:
        """Tell for pairs (``i`` of the one, ``j`` of the other), shape (k,), whether the line between them is free."""
        free = np.zeros(i.size, dtype=bool)
        start, end = self._vertices[self._start], self._vertices[self._end]
        open_ = np.flatnonzero(~find_hidden(one.xy, other.xy, i=i, j=j, start=start, end=end))
        for k in range(0, open_.size, _BLOCK // _WALLS_AT_ONCE):
            part = open_[k : k + _BLOCK // _WALLS_AT_ONCE]
            free[part] = self._sees(one, other, i=i[part], j=j[part])
        return free

    def _sees(self, one: Viewpoints, other: Viewpoints, *, i: Indices, j: Indices) -> Bools:
        free = self._opens_towards(one, i, other, j) & self._opens_towards(other, j, one, i)
        begin, end = one.xy[i], other.xy[j]
        is_here = _length(end - begin) <= self.tolerance
        free[is_here] = _share_a_sector(one, other, i=i[is_here], j=j[is_here])
        strips = _Strips(begin, end, slack=2 * self.tolerance)
        # Walls that follow each other are neighbours: few boxes of walls lie in the way of a line, and one that blocks is enough.
        for first in range(0, self._start.size, _WALLS_AT_ONCE):
            open_ = np.flatnonzero(free & ~is_here)
            walls = slice(first, first + _WALLS_AT_ONCE)
            corners = self._vertices[np.concatenate([self._start[walls], self._end[walls]])]
            lines = open_[strips.meet(corners.min(axis=0), corners.max(axis=0), lines=open_)]
            differs = one.is_before[:, walls][i[lines]] != other.is_before[:, walls][j[lines]]
            line, wall = np.divmod(np.flatnonzero(differs), differs.shape[1])
            line, wall = lines[line], wall + first
            for vertex in (one.vertex[i], other.vertex[j]):
                # The walls of a corner that the line begins in are judged by the corner's sectors.
                is_apart = (vertex[line] != self._start[wall]) & (vertex[line] != self._end[wall])
                line, wall = line[is_apart], wall[is_apart]
            free[line[self._crosses(begin[line], end[line], wall)]] = False
        return free

    def _opens_towards(self, corners: Viewpoints, i: Indices, others: Viewpoints, j: Indices) -> Bools:
        """Tell whether the other is in the direction of some sector of the corner; true for what is no corner."""
        opens = corners.vertex[i] < 0
        for nth in range(int(corners.n_sectors[i].max(initial=0))):
            pair = np.flatnonzero(corners.n_sectors[i] > nth)
            sector = corners.first_sector[i[pair]] + nth
            before_in = others.is_before[j[pair], self._sector_in[sector]]
            before_out = others.is_before[j[pair], self._sector_out[sector]]
            opens[pair] |= np.where(self._sector_is_convex[sector], before_in & before_out, before_in | before_out)
        return opens

    def _crosses(self, begin: Floats, end: Floats, wall: Indices) -> Bools:
        """Tell whether lines cross walls, given that the ends of each are on different sides of its wall's line."""
        along = end - begin
        to_start, to_end = self._vertices[self._start[wall]] - begin, self._vertices[self._end[wall]] - begin
        # Which side a corner is on is one number for both its walls, so that rounding cannot open a gap between them.
        side_start, side_end = _cross(along, to_start), _cross(along, to_end)
        straddles = (np.minimum(side_start, side_end) <= 0) & (np.maximum(side_start, side_end) >= 0)
        way_start, way_end = np.sum(along * to_start, axis=1), np.sum(along * to_end, axis=1)
        square = np.sum(along * along, axis=1)
        reach = self.tolerance * np.sqrt(square)
        # A wall in line with both, but before or behind them: without this, rounding alone would decide.
        crosses: Bools = straddles & (np.maximum(way_start, way_end) >= -reach) & (np.minimum(way_start, way_end) <= square + reach)
        # A line along one wall of a convex corner, and on, leaves the arena there; rounding alone would decide whether it does.
        for vertex, side, way in ((self._start[wall], side_start, way_start), (self._end[wall], side_end, way_end)):
            crosses |= self._is_convex[vertex] & (np.abs(side) <= reach) & (way >= 0) & (way <= square)
        return crosses

    def _sides(self, points: Floats) -> Bools:
        is_before = np.empty((len(points), self._start.size), dtype=bool)
        block = max(1, _BLOCK // self._start.size)
        every_wall = np.arange(self._start.size)
        for k in range(0, len(points), block):
            height, way, length = self._heights(points[k : k + block], every_wall)
            is_on = (np.abs(height) <= self.tolerance) & (way >= -self.tolerance) & (way <= length + self.tolerance)
            is_before[k : k + block] = (height >= 0) | is_on
        return is_before

    def _heights(self, points: Floats, wall: Indices) -> tuple[Floats, Floats, Floats]:
        """Measure height over the line of each wall and way along it, shape (n, walls), and the walls' lengths, all [length]."""
        start = self._vertices[self._start[wall]]
        along = self._vertices[self._end[wall]] - start
        length = _length(along)
        x, y = points[:, 0, None] - start[:, 0], points[:, 1, None] - start[:, 1]
        return (along[:, 0] * y - along[:, 1] * x) / length, (along[:, 0] * x + along[:, 1] * y) / length, length


class _Strips:
    """Lines, to be asked which of them come near a box."""

    __slots__ = ("_half", "_middle", "_slack", "_way")

    def __init__(self, begin: Floats, end: Floats, *, slack: float) -> None:
        self._way = np.ascontiguousarray((end - begin).T)
        self._middle = np.ascontiguousarray(((begin + end) / 2).T)
        self._half = np.abs(self._way) / 2 + slack
        self._slack = slack

    def meet(self, low: Floats, high: Floats, *, lines: Indices) -> Bools:
        """Tell which of ``lines`` come within the slack of the box between two corners, and perhaps a little further."""
        half_x, half_y = (high - low) / 2
        centre_x, centre_y = (high + low) / 2
        x, y = centre_x - self._middle[0, lines], centre_y - self._middle[1, lines]
        across, up = self._half[0, lines], self._half[1, lines]
        # Apart along x, along y, or square to the line: if none of those, they may meet.
        is_beside = np.abs(self._way[0, lines] * y - self._way[1, lines] * x) > 2 * (
            across * (half_y + self._slack) + up * (half_x + self._slack)
        )
        return np.asarray((np.abs(x) <= half_x + across) & (np.abs(y) <= half_y + up) & ~is_beside)


def _split_walls(arena: Arena, *, tolerance: float) -> tuple[Floats, Indices, Indices]:
    """Number the corners of an arena, and split walls in which the corner of another ring lies.

    Returns
    -------
    vertices, start, end
        Places of the corners, shape (n_vertices, 2); for every wall its corners, shape (n_walls,).
    """
    ends = np.concatenate([arena.wall_start, arena.wall_end])
    close = cKDTree(ends).query_pairs(tolerance, output_type="ndarray")
    joined = coo_array((np.ones(len(close), dtype=bool), (close[:, 0], close[:, 1])), shape=(len(ends), len(ends)))
    _, vertex_of = connected_components(joined, directed=False)
    _, representative = np.unique(vertex_of, return_index=True)
    vertices = ends[representative]
    start, end = np.split(vertex_of.astype(np.int64), 2)
    is_whole = start != end
    starts, stops = [], []
    for wall, inside in _corners_in_walls(vertices, start, end, tolerance=tolerance):
        is_whole[wall] = False
        starts += [start[[wall]], inside]
        stops += [inside, end[[wall]]]
    return vertices, np.concatenate([start[is_whole], *starts]), np.concatenate([end[is_whole], *stops])


def _corners_in_walls(vertices: Floats, start: Indices, end: Indices, *, tolerance: float) -> list[tuple[int, Indices]]:
    """List walls with corners strictly between their ends, and those corners in order along the wall."""
    found = []
    for wall in np.flatnonzero(start != end).tolist():
        origin = vertices[start[wall]]
        along = vertices[end[wall]] - origin
        length = float(_length(along))
        to_vertex = vertices - origin
        way = to_vertex @ along / length
        inside = np.flatnonzero((np.abs(_cross(along, to_vertex)) <= tolerance * length) & (way > tolerance) & (way < length - tolerance))
        inside = inside[(inside != start[wall]) & (inside != end[wall])]
        if inside.size:
            found.append((wall, inside[np.argsort(way[inside])]))
    return found


def _find_sectors(vertices: Floats, start: Indices, end: Indices) -> tuple[Indices, Indices]:
    """List the sectors of the arena at every corner: the wall that comes in and the wall that goes out, in order of corners.

    The arena is on the left of every wall, so a sector reaches from the wall that goes out counter-clockwise to the next one that comes in.
    """
    incoming: list[list[int]] = [[] for _ in vertices]
    outgoing: list[list[int]] = [[] for _ in vertices]
    for wall, (begin, stop) in enumerate(zip(start.tolist(), end.tolist(), strict=True)):
        outgoing[begin].append(wall)
        incoming[stop].append(wall)
    pairs = []
    for walls_in, walls_out in zip(incoming, outgoing, strict=True):
        if len(walls_in) == 1 == len(walls_out):
            pairs.append((walls_in[0], walls_out[0]))
            continue
        angle_in = _angle(vertices[start[walls_in]] - vertices[end[walls_in]])
        angle_out = _angle(vertices[end[walls_out]] - vertices[start[walls_out]])
        for wall, angle in zip(walls_out, angle_out.tolist(), strict=True):
            pairs.append((walls_in[int(np.argmin((angle_in - angle) % (2 * np.pi)))], wall))
    sectors = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return sectors[:, 0], sectors[:, 1]


def _share_a_sector(one: Viewpoints, other: Viewpoints, *, i: Indices, j: Indices) -> Bools:
    """Tell whether points at one place are on the same side of whatever touches there; always, away from corners."""
    first = np.maximum(one.first_sector[i], other.first_sector[j])
    last = np.minimum(one.first_sector[i] + one.n_sectors[i], other.first_sector[j] + other.n_sectors[j])
    return np.asarray((one.vertex[i] != other.vertex[j]) | (one.vertex[i] < 0) | (first < last))


def _cross(one: Floats, other: Floats) -> Floats:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def _length(vectors: Floats) -> Floats:
    return np.asarray(np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2))


def _angle(vectors: Floats) -> Floats:
    return np.arctan2(vectors[:, 1], vectors[:, 0])
