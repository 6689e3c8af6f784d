"""Simple polygons in the plane: corners in order, shape (m, 2), not closed, counter-clockwise unless it is said otherwise."""

import numpy as np

from mapper.types import BoolArray, FloatArray


def signed_area(corners: FloatArray) -> float:
    """Return the area inside [length^2]: above 0 counter-clockwise, below 0 clockwise (the shoelace formula)."""
    x, y = (corners - corners[0]).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def boundary_length(corners: FloatArray) -> float:
    """Return the length of the closed boundary."""
    return float(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).sum())


def centroid(corners: FloatArray) -> FloatArray:
    """Return the centre of gravity of the area inside, shape (2,); the mean of the corners where there is no area."""
    origin = corners[0]
    x, y = (corners - origin).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    if abs(cross.sum()) <= np.finfo(np.float64).tiny:
        return np.asarray(corners.mean(axis=0))
    moments = np.array([((x + np.roll(x, -1)) * cross).sum(), ((y + np.roll(y, -1)) * cross).sum()])
    return np.asarray(origin + moments / (3.0 * cross.sum()))


def contains(corners: FloatArray, places: FloatArray) -> BoolArray:
    """Say which of some places, shape (k, 2), are inside, by the parity of crossings of a ray to the right."""
    (x, y), (next_x, next_y) = corners.T, np.roll(corners, -1, axis=0).T
    px, py = places[:, 0, None], places[:, 1, None]
    straddles = (y > py) != (next_y > py)
    rise = np.where(next_y == y, 1.0, next_y - y)
    at = x + (py - y) * (next_x - x) / rise
    return np.asarray((straddles & (px < at)).sum(axis=1) % 2 == 1)


def inner_place(corners: FloatArray) -> FloatArray:
    """Choose a place inside: the centroid, or where that is outside, the middle of the widest stretch inside that is level with it."""
    centre = centroid(corners)
    if contains(corners, centre[None])[0]:
        return centre
    (x, y), (next_x, next_y) = corners.T, np.roll(corners, -1, axis=0).T
    straddles = (y > centre[1]) != (next_y > centre[1])
    at = np.sort(x[straddles] + (centre[1] - y[straddles]) * (next_x - x)[straddles] / (next_y - y)[straddles])
    if not len(at):
        return centre
    widths = at[1::2] - at[::2]
    widest = int(widths.argmax())
    return np.array([at[2 * widest] + widths[widest] / 2, centre[1]])


def crossing_sides(starts: FloatArray, ends: FloatArray, corners: FloatArray) -> BoolArray:
    """Say which segments meet which sides of a polygon.

    Parameters
    ----------
    starts, ends
        Ends of the segments, shape (k, 2).

    Returns
    -------
    BoolArray
        Shape (k, m); column j is the side from corner j to the next. Touching counts.
    """
    a, b = corners[None], np.roll(corners, -1, axis=0)[None]
    p, q = starts[:, None], ends[:, None]
    of_p, of_q = _turn(a, b, p), _turn(a, b, q)
    of_a, of_b = _turn(p, q, a), _turn(p, q, b)
    is_proper = (of_p * of_q < 0) & (of_a * of_b < 0)
    touches = _lies_on(of_p, a, b, p) | _lies_on(of_q, a, b, q) | _lies_on(of_a, p, q, a) | _lies_on(of_b, p, q, b)
    return np.asarray(is_proper | touches)


def is_simple(corners: FloatArray) -> bool:
    """Say whether no two sides meet but neighbours, at their corner alone, and no corner is there twice."""
    m = len(corners)
    if m < 3 or len(np.unique(corners, axis=0)) < m:
        return False
    before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
    folds_back = (_turn(before, corners, after) == 0) & (((before - corners) * (after - corners)).sum(axis=1) > 0)
    return not folds_back.any() and _first_crossing(corners) is None


def uncross(corners: FloatArray) -> FloatArray | None:
    """Make a closed polyline simple and counter-clockwise by turning parts of it round: the same corners in another order.

    Returns
    -------
    FloatArray or None
        Shape (m, 2), beginning with the same corner; None where it cannot be done, as with corners on one line.

    Notes
    -----
    Two sides that cross are replaced by the other two sides of their quadrangle, which together are shorter, so it ends. It is given up
    where sides touch without crossing and nothing gets shorter.
    """
    order = corners.copy()
    while (crossing := _first_crossing(order)) is not None:
        i, j = crossing
        turned = order.copy()
        turned[i + 1 : j + 1] = order[i + 1 : j + 1][::-1]
        if boundary_length(turned) >= boundary_length(order):
            return None
        order = turned
    if not is_simple(order):
        return None
    return order if signed_area(order) > 0 else np.concatenate([order[:1], order[:0:-1]])


def scale_to_area(corners: FloatArray, area: float) -> FloatArray:
    """Shrink or widen a simple polygon about its centroid to an area above 0 [length^2]; its form stays."""
    centre = centroid(corners)
    return np.asarray(centre + (corners - centre) * np.sqrt(area / abs(signed_area(corners))))


def convex_hull(places: FloatArray) -> FloatArray:
    """Return the corners of the convex hull of some places, shape (k, 2), k at least 1, counter-clockwise from the leftmost lowest.

    Two corners where all are on one line, and one where all are one.
    """
    ordered = np.unique(places, axis=0)
    if len(ordered) <= 2:
        return ordered
    lower, upper = _half_hull(ordered), _half_hull(ordered[::-1])
    return np.array([*lower[:-1], *upper[:-1]])


def _half_hull(ordered: FloatArray) -> list[FloatArray]:
    """Go along one side of the hull: the monotone chain of Andrew 1979."""
    chain: list[FloatArray] = []
    for place in ordered:
        while len(chain) >= 2 and _turn(chain[-2], chain[-1], place) <= 0:
            chain.pop()
        chain.append(place)
    return chain


def _first_crossing(corners: FloatArray) -> tuple[int, int] | None:
    """Find two sides that are no neighbours and meet; side j is from corner j to the next."""
    m = len(corners)
    meets = np.triu(crossing_sides(corners, np.roll(corners, -1, axis=0), corners), k=2)
    meets[0, m - 1] = False
    found = np.argwhere(meets)
    return None if not len(found) else (int(found[0, 0]), int(found[0, 1]))


def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Twice the signed area of triangles: above 0 where c is to the left of the way from a to b."""
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0]), dtype=np.float64
    )


def _lies_on(turn: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> BoolArray:
    """Say where c, in line with a and b, is between them."""
    within = (np.minimum(a, b) <= c) & (c <= np.maximum(a, b))
    return np.asarray((turn == 0) & within.all(axis=-1))
