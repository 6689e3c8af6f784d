"""Horizons: how far one can see from a point at most, in each of many directions; a quick way to rule out lines that walls cross.

What is behind a horizon is hidden for certain. What is before it may still be hidden, by a wall too narrow to fill a whole sector or
one that is seen at a grazing angle: ``simulator.arenas.visibility`` decides.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Bools = NDArray[np.bool_]

_SECTORS = 512

# A wall counts for a sector if it reaches beyond it on both sides by this share of a sector, and if the point is this share of the
# arena's extent before it: rounding cannot then make a line miss it.
_OVERLAP = 1e-5
_LEAST_HEIGHT = 1e-4
# How far behind the horizon a place must be to be hidden for certain, as a share of the extent.
_DEPTH = 1e-6

# Points times walls in one block: bounds memory to some hundred megabytes.
_BLOCK = 400_000

_EDGE = 2.0 * np.pi * np.arange(_SECTORS) / _SECTORS
_EDGE_X, _EDGE_Y = np.cos(_EDGE), np.sin(_EDGE)


def find_hidden(points: Floats, targets: Floats, *, i: Indices, j: Indices, start: Floats, end: Floats) -> Bools:
    """Tell for which pairs a wall stands clearly between point and target.

    Parameters
    ----------
    points, targets
        Shapes (n, 2) and (m, 2) [length], in the arena.
    i, j
        Rows of the two that make each pair, shape (k,).
    start, end
        Ends of the walls, shape (w, 2); the arena is on the left of each.

    Returns
    -------
    Bools
        Shape (k,). False says nothing.
    """
    extent = float(np.ptp(start, axis=0).max())
    hidden = np.zeros(i.size, dtype=bool)
    order = np.argsort(i, kind="stable")
    views, first = np.unique(i[order], return_index=True)
    bounds = np.append(first, i.size)
    block = max(1, _BLOCK // len(start))
    for k in range(0, views.size, block):
        rows = views[k : k + block]
        pairs = order[bounds[k] : bounds[min(k + block, views.size)]]
        horizon = _measure_horizons(points[rows], start, end, extent=extent)
        way = targets[j[pairs]] - points[i[pairs]]
        sector = np.floor(np.arctan2(way[:, 1], way[:, 0]) * (_SECTORS / (2.0 * np.pi))).astype(np.int64) % _SECTORS
        distance = np.sqrt(way[:, 0] ** 2 + way[:, 1] ** 2)
        hidden[pairs] = distance > horizon[np.searchsorted(rows, i[pairs]), sector] + _DEPTH * extent
    return hidden


def _measure_horizons(points: Floats, start: Floats, end: Floats, *, extent: float) -> Floats:
    """Return the distance of the nearest wall that fills each sector, at its further edge, shape (n, sectors) [length]; inf for none.

    Walls seen from behind are left out: from within the arena one from before comes first.
    """
    along = end - start
    to_x, to_y = start[:, 0] - points[:, 0, None], start[:, 1] - points[:, 1, None]
    # Twice the area of the triangle over the wall: positive before it.
    area = to_x * along[:, 1] - to_y * along[:, 0]
    row, wall = np.nonzero(area > _LEAST_HEIGHT * extent * np.sqrt(along[:, 0] ** 2 + along[:, 1] ** 2))
    area, to_x, to_y = area[row, wall], to_x[row, wall], to_y[row, wall]
    along = along[wall]
    # The wall's start is on the right as seen from a point before it, so sectors count up from there.
    right = np.arctan2(to_y, to_x) * (_SECTORS / (2.0 * np.pi))
    left = np.arctan2(to_y + along[:, 1], to_x + along[:, 0]) * (_SECTORS / (2.0 * np.pi))
    left += np.where(left < right, _SECTORS, 0)
    first = np.ceil(right + _OVERLAP).astype(np.int64)
    count = np.floor(left - _OVERLAP).astype(np.int64) - first
    kept = np.flatnonzero(count > 0)
    which = np.repeat(kept, count[kept])
    ends = np.cumsum(count[kept])
    sector = first[which] + np.arange(which.size) - np.repeat(ends - count[kept], count[kept])
    furthest = np.zeros(which.size)
    for edge in (sector % _SECTORS, (sector + 1) % _SECTORS):
        furthest = np.maximum(furthest, area[which] / (_EDGE_X[edge] * along[which, 1] - _EDGE_Y[edge] * along[which, 0]))
    horizon = np.full((len(points), _SECTORS), np.inf)
    np.minimum.at(horizon.reshape(-1), row[which] * _SECTORS + sector % _SECTORS, furthest)
    return horizon
