"""Rubble: a floor strewn with broken pieces, at random."""

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon, box

from simulator import chance, draws

_PLACE_STREAM = 301
_SIZE_STREAM = 302
_CORNER_STREAM = 303

_SIDE = 50.0
_PIECES = 40
_RADII = (1.5, 5.0)
_FEWEST_CORNERS, _MOST_CORNERS = 4, 8
# Pieces lie on each other, or so far apart that insects pass and meet in between.
_PASSAGE = 1.5
_GRID = 1e-6


def draw_rubble(seed: int) -> Polygon:
    """Draw a square of side 50 strewn with some thirty pieces of four to eight corners, which may lie on each other and on the walls.

    Forty pieces are thrown; one that would leave a slit narrower than 1.5 beside another, or at a wall, is left out. Pockets that no way
    leads into are filled, so the floor is in one piece. How many holes it has is a matter of chance: the arena counts them.
    """
    room = box(0.0, 0.0, _SIDE, _SIDE)
    heap: list[Polygon] = []
    for number in range(_PIECES):
        piece = _draw_piece(seed, number)
        to_wall = shapely.distance(piece, room.exterior)
        gaps = [*shapely.distance(piece, heap).tolist(), to_wall] if heap else [to_wall]
        if all(gap == 0.0 or gap >= _PASSAGE for gap in gaps):
            heap.append(piece)
    floor = shapely.difference(room, shapely.union_all(heap, grid_size=_GRID), grid_size=_GRID)
    parts = shapely.get_parts(floor).tolist()
    largest = max(parts, key=lambda part: float(part.area))
    assert isinstance(largest, Polygon)
    return largest


def _draw_piece(seed: int, number: int) -> Polygon:
    def lot(stream: int, index: int) -> float:
        return chance.uniform(seed=seed, biobot=number, stream=stream, index=index)

    x, y = _SIDE * lot(_PLACE_STREAM, 0), _SIDE * lot(_PLACE_STREAM, 1)
    radius = _RADII[0] + (_RADII[1] - _RADII[0]) * lot(_SIZE_STREAM, 0)
    count = _FEWEST_CORNERS + int((_MOST_CORNERS + 1 - _FEWEST_CORNERS) * lot(_SIZE_STREAM, 1))
    # Each corner keeps to its own part of the turn, so the outline never crosses itself.
    turns = np.array([(k + 0.8 * lot(_CORNER_STREAM, 2 * k)) / count for k in range(count)])
    reach = radius * np.array([0.6 + 0.4 * lot(_CORNER_STREAM, 2 * k + 1) for k in range(count)])
    corners: NDArray[np.float64] = np.column_stack(draws.circle(turns)) * reach[:, None] + (x, y)
    return Polygon(corners)
