"""Metric spaces that share places, glued to one: points of several maps, and the distances from those of one to those of another.

Each map knows the distances between its own points and the places where landmarks stood. What a map does not know of a landmark of
another is bounded through the places that they share, and taken in the middle of the bounds, as `mapper.profiles` does for encounters. So
every point of every map gets a profile over all landmarks, and points of different maps are as far apart as their profiles differ at most.
Distances that a map knows are left as they are: a map glued to itself is itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapper.embedding import embed_in_plane
from mapper.kernels import Kernels
from mapper.profiles import bracket_profiles
from mapper.types import BoolArray, FloatArray, IntArray

# Of places that two maps share: spread across over spread along their line. Of fewer places, or flatter, the other side looks alike.
_FLATTEST = 0.15
_MIN_SHARED = 3
# Shared points serve as references beside the landmarks, up to so many of both.
_MAX_REFERENCES = 200
_BLOCK = 64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """A map of n objects, by numbers that are the same in all maps for the same object.

    ``objects``, shape (n,), distinct; ``is_landmark``, shape (n,): a place where a landmark stood, else a point; ``distances``,
    shape (n, n) [one unit for all sheets].
    """

    objects: IntArray
    is_landmark: BoolArray
    distances: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Glued:
    """The points of some sheets, without their landmarks: ``objects``, shape (m,), ascending; ``distances``, shape (m, m)."""

    objects: IntArray
    distances: FloatArray


def group_sheets(sheets: Sequence[Sheet]) -> list[list[int]]:
    """Say which sheets share objects, directly or through others: their indices, ascending, in the order of the first of each."""
    label = list(range(len(sheets)))
    first_with: dict[int, int] = {}
    for index, sheet in enumerate(sheets):
        for one in sheet.objects.tolist():
            other = first_with.setdefault(one, index)
            old, new = max(label[index], label[other]), min(label[index], label[other])
            label = [new if group == old else group for group in label]
    return [[index for index, group in enumerate(label) if group == wanted] for wanted in sorted(set(label))]


def find_flat_joints(sheets: Sequence[Sheet]) -> list[tuple[int, int]]:
    """List pairs of sheets that share places, but fewer than three, or places on a line: one may be mirrored."""
    flat = []
    for later, one in enumerate(sheets):
        for earlier, other in enumerate(sheets[:later]):
            rows = np.flatnonzero(np.isin(one.objects, other.objects))
            if len(rows) and _flatness(one.distances[np.ix_(rows, rows)]) < _FLATTEST:
                flat.append((earlier, later))
    return flat


def glue(sheets: Sequence[Sheet], *, kernels: Kernels) -> Glued:
    """Glue sheets that share objects, directly or through others.

    Parameters
    ----------
    sheets
        At least one. Their order does not matter.

    Notes
    -----
    A distance that several sheets know is their mean.
    """
    objects = np.unique(np.concatenate([sheet.objects for sheet in sheets]))
    n = len(objects)
    known, count = np.zeros((n, n)), np.zeros((n, n), dtype=np.int32)
    is_landmark = np.zeros(n, dtype=np.bool_)
    for sheet in sheets:
        rows = np.searchsorted(objects, sheet.objects)
        known[np.ix_(rows, rows)] += sheet.distances
        count[np.ix_(rows, rows)] += 1
        is_landmark[rows] |= sheet.is_landmark
    known /= np.maximum(count, 1)
    known[count == 0] = np.inf
    points = np.flatnonzero(~is_landmark)
    distances = known[np.ix_(points, points)]
    if not np.isfinite(distances).all():
        n_sheets = np.bincount(np.searchsorted(objects, np.concatenate([sheet.objects for sheet in sheets])), minlength=n)
        references = _choose_references(is_landmark, n_sheets > 1)
        _fill(distances, bracket_profiles(_reach_all(known, references), references, kernels=kernels).middle[points])
    return Glued(objects=objects[points], distances=distances)


def _choose_references(is_landmark: BoolArray, is_shared: BoolArray) -> IntArray:
    """Take all landmarks, and of the points that several sheets know so many, evenly, as there is room for."""
    landmarks, further = np.flatnonzero(is_landmark), np.flatnonzero(is_shared & ~is_landmark)
    room = min(len(further), max(0, _MAX_REFERENCES - len(landmarks)))
    return np.union1d(landmarks, further[np.arange(room) * len(further) // max(1, room)])


def _reach_all(known: FloatArray, references: IntArray) -> FloatArray:
    """Measure from every object to every reference, along what the sheets know from reference to reference: shape (n, references)."""
    between = known[np.ix_(references, references)]
    for via in range(len(references)):
        np.minimum(between, between[:, via, None] + between[None, via, :], out=between)
    found = known[:, references]
    for column, row in zip(known[:, references].T, between, strict=True):
        np.minimum(found, column[:, None] + row[None, :], out=found)
    return found


def _fill(distances: FloatArray, profiles: FloatArray) -> None:
    """Put the largest difference of two profiles where a distance is inf."""
    for begin in range(0, len(profiles), _BLOCK):
        block = distances[begin : begin + _BLOCK]
        differences = np.abs(profiles[begin : begin + _BLOCK, None, :] - profiles[None, :, :]).max(axis=2)
        np.copyto(block, differences, where=np.isinf(block))


def _flatness(distances: FloatArray) -> float:
    """Return how far places are from a line, the lesser standard deviation in the plane over the greater; 0 for fewer than three."""
    if len(distances) < _MIN_SHARED:
        return 0.0
    spread = embed_in_plane(distances).coordinates.std(axis=0)
    return float(spread[1] / spread[0]) if spread[0] > 0 else 0.0
