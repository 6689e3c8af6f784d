"""Arenas: polygons with holes in which insects walk, and what is known of their shape."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.polygon import orient

from simulator import draws
from simulator.errors import ArenaError

Floats = NDArray[np.float64]

# An insect's centre keeps this share of the arena's extent away from every wall. It is far below any length of interest and far
# above rounding, so that no insect is ever outside; coordinates far from the origin, which round more coarsely, get more.
_WALL_MARGIN_OF_EXTENT = 1e-9
_WALL_MARGIN_OF_COORDINATE = 1e-12

# Corners this near, as a share of the extent, are one.
_SPECK_OF_EXTENT = 1e-14
# Squares and products of lengths beyond this, or its inverse, lose their digits.
_LEAST_EXTENT = 1e-60

_PLACEMENT_STREAM = 1
_MAX_PLACEMENT_TRIES = 100_000
_TRIES_AT_ONCE = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class BettiNumbers:
    """Numbers of connected components and of holes."""

    components: int
    holes: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arena:
    """An area bounded by straight walls; make one with ``build_arena``.

    Parameters
    ----------
    polygon
        The area, in the length unit of whoever made it.
    wall_start, wall_end
        Ends of every wall, shape (n_walls, 2) [length], read-only. The arena is on the left of the way from start to end.
    wall_inward
        Unit normal of every wall that points into the arena, shape (n_walls, 2), read-only.
    margin
        How far from every wall an insect's centre stays [length]; about a billionth of the extent.
    betti
        True Betti numbers of the area that an insect can walk.
    """

    polygon: Polygon | MultiPolygon
    wall_start: Floats
    wall_end: Floats
    wall_inward: Floats
    margin: float
    betti: BettiNumbers

    @property
    def area(self) -> float:
        """The area [length^2]."""
        return float(self.polygon.area)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x and y, largest x and y [length]."""
        x_min, y_min, x_max, y_max = self.polygon.bounds
        return float(x_min), float(y_min), float(x_max), float(y_max)

    def has_room(self, points: Floats) -> NDArray[np.bool_]:
        """Tell which points (shape (k, 2) [length]) an insect may stand on: inside, and not within the margin of a wall."""
        inside = np.asarray(shapely.contains_xy(self.polygon, points[:, 0], points[:, 1]))
        clear = np.asarray(shapely.distance(self.polygon.boundary, shapely.points(points[inside]))) > self.margin
        inside[inside] = clear
        return inside

    def expect_within(self, bounds: tuple[float, float, float, float]) -> None:
        """Raise ArenaError where this arena reaches beyond the bounds of a world's first one: lower and upper corner [length]."""
        low, high = bounds[:2], bounds[2:]
        if not all(low[k] <= self.bounds[k] and self.bounds[2 + k] <= high[k] for k in range(2)):
            raise ArenaError(source="arena", problem=f"its bounds {self.bounds} reach beyond {bounds}, those of the world's first arena")

    def nearest_room(self, points: Floats) -> Floats:
        """Return each of some points (shape (n, 2) [length]), or where it has no room, the nearest place that has some.

        Raises
        ------
        ArenaError
            No place near a point has room: the arena is thinner there than twice the margin.
        """
        crowded = np.flatnonzero(~self.has_room(points))
        if not crowded.size:
            return points
        room = self.polygon.buffer(-4.0 * self.margin)
        moved = points.copy()
        if not room.is_empty:
            nearest = shapely.shortest_line(room, shapely.points(points[crowded]))
            moved[crowded] = shapely.get_coordinates(nearest)[::2]
        if room.is_empty or not self.has_room(moved[crowded]).all():
            raise ArenaError(
                source="arena", problem=f"no room for an insect near {tuple(points[crowded[0]].tolist())}; widen the arena there"
            )
        return moved

    def draw_places(self, *, seed: int, ids: NDArray[np.uint64]) -> Floats:
        """Draw a place for each biobot, uniformly over the area.

        Parameters
        ----------
        seed
            0 to 2^64 - 1.
        ids
            Identities, shape (n,). A place depends on the seed and the biobot's own id alone.

        Returns
        -------
        Floats
            Shape (n, 2) [length].

        Raises
        ------
        ArenaError
            After some 100,000 tries in the bounding box some biobot still has no place: the area is too thin.
        """
        x_min, y_min, x_max, y_max = self.bounds
        places = np.empty((ids.size, 2))
        waiting = np.arange(ids.size)
        attempt, n_attempts = 0, 1
        while attempt < _MAX_PLACEMENT_TRIES:
            # Each takes the first of its tries that fits, so that how many are looked at in one go changes nothing.
            index = np.tile(2 * np.arange(attempt, attempt + n_attempts, dtype=np.uint64), waiting.size)
            owner = np.repeat(ids[waiting], n_attempts)
            across = draws.uniform(draws.words(seed=seed, biobot=owner, stream=_PLACEMENT_STREAM, index=index))
            up = draws.uniform(draws.words(seed=seed, biobot=owner, stream=_PLACEMENT_STREAM, index=index + np.uint64(1)))
            tried = np.column_stack([x_min + (x_max - x_min) * across, y_min + (y_max - y_min) * up])
            fits = self.has_room(tried).reshape(waiting.size, n_attempts)
            first = fits.argmax(axis=1) + n_attempts * np.arange(waiting.size)
            found = fits.any(axis=1)
            places[waiting[found]] = tried[first[found]]
            waiting = waiting[~found]
            if not waiting.size:
                return places
            attempt += n_attempts
            n_attempts = max(1, min(4 * n_attempts, _TRIES_AT_ONCE // waiting.size))
        raise ArenaError(
            source="arena",
            problem=f"no room found for {waiting.size} of {ids.size} biobots in {_MAX_PLACEMENT_TRIES} tries each; "
            f"its area, {self.area:g}, is too thin a part of its bounding box",
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArenaChange:
    """What an arena becomes, as when a door closes.

    Parameters
    ----------
    at_s
        When, after the landmarks are set [s].
    """

    at_s: float
    arena: Arena


def build_arena(shape: Polygon | MultiPolygon, *, source: str = "arena") -> Arena:
    """Check a shape and build an arena from it.

    Parameters
    ----------
    shape
        Polygon or several that do not overlap, holes allowed.
    source
        Where the shape came from, for messages.

    Raises
    ------
    ArenaError
        It is empty, has no area, or is invalid as simple features go: crosses itself, has a hole outside, parts that overlap.

    Notes
    -----
    Insects cannot pass where two walls only touch in a point, and the Betti numbers count accordingly: parts that touch in a
    point are two components, and rings of one part that touch in a point bound one hole.
    """
    if shape.is_empty or not np.isfinite(shapely.get_coordinates(shape)).all():
        raise ArenaError(source=source, problem="it is empty or has coordinates that are not finite; give at least one closed ring")
    try:
        shape = _without_specks(shape, source=source)
        is_valid = shape.is_valid and shape.area > 0
    except shapely.errors.GEOSException as error:
        raise ArenaError(source=source, problem=f"its coordinates are too large or too small to compute with ({error})") from error
    if not is_valid:
        raise ArenaError(source=source, problem=f"not a valid area: {shapely.is_valid_reason(shape)}; mend the outline there")
    parts = [orient(part, sign=1.0) for part in (shape.geoms if isinstance(shape, MultiPolygon) else [shape])]
    rings = [ring for part in parts for ring in (part.exterior, *part.interiors)]
    coordinates = [np.asarray(ring.coords, dtype=np.float64)[:, :2] for ring in rings]
    start = np.concatenate([ring[:-1] for ring in coordinates])
    end = np.concatenate([ring[1:] for ring in coordinates])
    along = end - start
    length = np.sqrt(along[:, 0] ** 2 + along[:, 1] ** 2)
    start, end, along, length = (values[length > 0] for values in (start, end, along, length))
    inward = np.column_stack([-along[:, 1], along[:, 0]]) / length[:, None]
    for array in (start, end, inward):
        array.setflags(write=False)
    extent = float(np.max(start.max(axis=0) - start.min(axis=0)))
    return Arena(
        polygon=parts[0] if len(parts) == 1 else MultiPolygon(parts),
        wall_start=start,
        wall_end=end,
        wall_inward=inward,
        margin=max(_WALL_MARGIN_OF_EXTENT * extent, _WALL_MARGIN_OF_COORDINATE * float(np.abs(start).max())),
        betti=BettiNumbers(components=len(parts), holes=sum(_count_holes(part) for part in parts)),
    )


def _without_specks(shape: Polygon | MultiPolygon, *, source: str) -> Polygon | MultiPolygon:
    """Make one of corners that rounding cannot tell apart: a wall of 1e-200 has no direction that could be computed."""
    places = shapely.get_coordinates(shape)
    with np.errstate(over="ignore"):
        extent = float(np.max(places.max(axis=0) - places.min(axis=0)))
    if not _LEAST_EXTENT < extent < 1.0 / _LEAST_EXTENT:
        raise ArenaError(source=source, problem=f"its extent is {extent:g}; wanted {_LEAST_EXTENT:g} to {1.0 / _LEAST_EXTENT:g}")
    tolerance = _SPECK_OF_EXTENT * extent
    steps = np.abs(np.diff(places, axis=0)).max(axis=1)
    if not ((steps > 0) & (steps <= tolerance)).any():
        return shape
    tidied = shapely.remove_repeated_points(shape, tolerance)
    return tidied if isinstance(tidied, Polygon | MultiPolygon) and not tidied.is_empty else shape


def _count_holes(part: Polygon) -> int:
    """Count the bounded gaps that an insect can walk around: groups of touching rings, but for the group of the outer one."""
    rings = [part.exterior, *part.interiors]
    group = list(range(len(rings)))
    first, second = shapely.STRtree(rings).query(rings, predicate="intersects")
    for one, other in zip(first.tolist(), second.tolist(), strict=True):
        low, high = sorted((group[one], group[other]))
        group = [low if mark == high else mark for mark in group]
    return len(set(group)) - 1
