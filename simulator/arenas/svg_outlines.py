"""Outlines of SVG shapes: the text of a path checked, curves cut into straight pieces, rings filled by a fill rule.

[SVG2]: "Scalable Vector Graphics (SVG) 2", W3C, 2018.
"""

import math
import re
from dataclasses import dataclass

import numpy as np
import shapely
import svgelements
from numpy.typing import NDArray
from shapely.geometry import LinearRing, LineString, MultiPolygon, Polygon

Floats = NDArray[np.float64]

# [SVG2] 9.3.9, the grammar of path data.
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_FLAG = re.compile(r"[01]")
_GAP = re.compile(r"[\s,]*")
_ARGUMENTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
_FLAGS_OF_ARC = (3, 4)

_MAX_PIECES = 10_000
# Faces of a shape that crosses itself, times its corners: some seconds.
_MAX_WINDINGS = 300_000_000


class OutlineError(Exception):
    """A shape has no outline; the message says why, and whoever asked adds where."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """A shape of a drawing.

    Parameters
    ----------
    path
        Its segments, in its own coordinates.
    matrix
        From its own coordinates to those of the drawing: (x, y) goes to ``matrix @ (x, y, 1)``, shape (2, 3).
    is_even_odd
        Which fill rule holds: even-odd, or else nonzero ([SVG2] 13.5.2).
    """

    path: svgelements.Path
    matrix: Floats
    is_even_odd: bool

    def control_points(self) -> Floats:
        """Return points whose bounding box holds most of the shape, shape (k, 2) [user units]."""
        box = self.path.bbox()
        if box is None:
            return np.zeros((0, 2))
        x_min, y_min, x_max, y_max = (float(value) for value in box)
        return _move(np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]), self.matrix)

    def fill(self, *, tolerance: float) -> Polygon | MultiPolygon:
        """Return the area, curves cut so that no piece is further than ``tolerance`` from its curve [user units].

        Raises
        ------
        OutlineError
            It crosses itself too often.
        """
        stretch = float(np.linalg.norm(self.matrix[:, :2], ord=2))
        rings = [_move(ring, self.matrix) for ring in _flatten(self.path, tolerance=tolerance / max(stretch, 1e-300))]
        return fill_rings(rings, is_even_odd=self.is_even_odd)


def parse_path(data: str) -> svgelements.Path:
    """Read the text of a path.

    Raises
    ------
    OutlineError
        It does not keep to the grammar; where is told as the number of a character, from 1.
    """
    at, arguments, is_first = _GAP.match(data).end(), 0, True  # type: ignore[union-attr]  # the pattern matches the empty text
    command = ""
    while at < len(data):
        letter = data[at].upper()
        if letter in _ARGUMENTS:
            if is_first and letter != "M":
                raise OutlineError(f"its path begins with {data[at]!r}; wanted M or m")
            _need_whole(command, arguments, at=at)
            command, arguments, at, is_first = letter, 0, at + 1, False
        else:
            pattern = _FLAG if command == "A" and arguments % 7 in _FLAGS_OF_ARC else _NUMBER
            found = pattern.match(data, at) if _ARGUMENTS.get(command) else None
            if found is None:
                wanted = "a flag 0 or 1" if pattern is _FLAG else "a number" if _ARGUMENTS.get(command) else "a command"
                raise OutlineError(f"its path has {data[at : at + 12]!r} at character {at + 1}; wanted {wanted}")
            if not math.isfinite(float(found.group())):
                raise OutlineError(f"its path has {found.group()!r} at character {at + 1}; wanted a finite number")
            arguments, at = arguments + 1, found.end()
        at = _GAP.match(data, at).end()  # type: ignore[union-attr]  # the pattern matches the empty text
    _need_whole(command, arguments, at=at)
    return svgelements.Path(data)


def fill_rings(rings: list[Floats], *, is_even_odd: bool) -> Polygon | MultiPolygon:
    """Return what a fill rule says is inside of closed rings, shape (k, 2) each; they may cross themselves and each other.

    Raises
    ------
    OutlineError
        They cross too often.
    """
    rings = [kept for ring in rings if len(kept := _without_repetitions(ring)) >= 3]
    if not rings:
        return Polygon()
    if len(rings) == 1 and LinearRing(rings[0]).is_simple:
        return Polygon(rings[0])
    closed = [np.vstack([ring, ring[:1]]) for ring in rings]
    faces = shapely.get_parts(shapely.polygonize([shapely.union_all([LineString(ring) for ring in closed])]))
    if not faces.size:
        return Polygon()
    inside = shapely.get_coordinates(shapely.point_on_surface(faces))
    if len(inside) * sum(len(ring) for ring in rings) > _MAX_WINDINGS:
        raise OutlineError(f"it crosses itself into {len(inside)} pieces; draw a simpler outline")
    winding = sum(_count_windings(ring, inside) for ring in closed)
    is_inside = np.asarray(winding) % 2 == 1 if is_even_odd else np.asarray(winding) != 0
    area = shapely.union_all(faces[is_inside])
    return area if isinstance(area, Polygon | MultiPolygon) else Polygon()


def _need_whole(command: str, arguments: int, *, at: int) -> None:
    wanted = _ARGUMENTS.get(command, 0)
    if wanted and (arguments == 0 or arguments % wanted):
        raise OutlineError(f"its path has {arguments} numbers after {command} before character {at + 1}; wanted a multiple of {wanted}")


def _flatten(path: svgelements.Path, *, tolerance: float) -> list[Floats]:
    rings: list[Floats] = []
    pieces: list[Floats] = []
    for segment in path:
        match segment:
            case svgelements.Move():
                _close(pieces, rings)
                pieces = [_points(segment.end)]
            case svgelements.Close():
                _close(pieces, rings)
                pieces = [] if segment.end is None else [_points(segment.end)]
            case svgelements.QuadraticBezier():
                pieces.append(_cut_bezier(_points(segment.start, segment.control, segment.end), tolerance=tolerance))
            case svgelements.CubicBezier():
                controls = _points(segment.start, segment.control1, segment.control2, segment.end)
                pieces.append(_cut_bezier(controls, tolerance=tolerance))
            case svgelements.Arc():
                pieces.append(_cut_arc(segment, tolerance=tolerance))
            case _:
                pieces.append(_points(segment.end))
    _close(pieces, rings)
    return rings


def _close(pieces: list[Floats], rings: list[Floats]) -> None:
    if pieces:
        rings.append(np.vstack(pieces))


def _cut_bezier(controls: Floats, *, tolerance: float) -> Floats:
    """Cut a Bezier curve into equal parts of its parameter; the start is left out.

    A chord over a step h is at most h^2 / 8 times the largest second derivative away, which is that of the control points.
    """
    degree = len(controls) - 1
    bend = degree * (degree - 1) * float(np.hypot(*np.diff(controls, n=2, axis=0).T).max())
    count = _count_pieces(math.sqrt(bend / (8 * tolerance)))
    t = (np.arange(1, count + 1) / count)[:, None]
    weights = [math.comb(degree, k) * t**k * (1 - t) ** (degree - k) for k in range(degree + 1)]
    return np.asarray(sum(weight * control for weight, control in zip(weights, controls, strict=True)))


def _cut_arc(arc: svgelements.Arc, *, tolerance: float) -> Floats:
    """Cut an elliptic arc into equal angles; the start is left out. A chord over an angle a is r (1 - cos(a / 2)) from its circle."""
    radius = max(abs(float(arc.rx)), abs(float(arc.ry)))
    if radius == 0.0:
        return _points(arc.end)
    angle = 2 * math.acos(max(0.0, 1 - tolerance / radius))
    count = _count_pieces(abs(float(arc.sweep)) / max(angle, 1e-12))
    middle = [_points(arc.point(k / count)) for k in range(1, count)]
    return np.vstack([*middle, _points(arc.end)])


def _count_pieces(wanted: float) -> int:
    return min(_MAX_PIECES, max(1, math.ceil(wanted)))


def _points(*points: svgelements.Point) -> Floats:
    return np.array([(float(point.x), float(point.y)) for point in points])


def _move(points: Floats, matrix: Floats) -> Floats:
    return np.asarray(points @ matrix[:, :2].T + matrix[:, 2])


def _without_repetitions(ring: Floats) -> Floats:
    return ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)]


def _count_windings(ring: Floats, points: Floats) -> NDArray[np.int64]:
    """Count how often a closed ring (k + 1, 2) goes round each point (n, 2), counter-clockwise being positive."""
    winding = np.zeros(len(points), dtype=np.int64)
    x, y = points[:, 0], points[:, 1]
    for (x0, y0), (x1, y1) in zip(ring[:-1].tolist(), ring[1:].tolist(), strict=True):
        side = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
        winding += ((y0 <= y) & (y < y1) & (side > 0)).astype(np.int64) - ((y1 <= y) & (y < y0) & (side < 0))
    return winding
