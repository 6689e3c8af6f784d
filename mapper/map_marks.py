"""Marks of a map: places by which two maps of one site can be laid over each other, whatever frame each of them is in.

A mark is an encounter, known by who met and when, or a landmark, known by who stood and since when. Maps that are made one after the
other share many of both; a map has no direction and no handedness of its own, so only what is shared tells how one lies in the other.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from mapper.errors import MapDocumentError
from mapper.record_columns import to_unsigned
from mapper.types import FloatArray, IntArray, MapResult

_NS_PER_S = 1e9
# A corrected record may tell another middle of the same encounter, or another beginning of the same stand.
_SAME_S = 2.0

_Key = tuple[bool, int, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Marks:
    """The m marks of a map.

    Parameters
    ----------
    xy
        Their places [unit of the map], shape (m, 2), finite.
    component
        Of the map's components, shape (m,).
    key
        Whether it is a landmark, and who: two ids, the lower first, or that of the landmark twice.
    t_s
        Middle of the encounter, or since when the landmark stood [s], shape (m,).
    """

    xy: FloatArray
    component: IntArray
    key: tuple[_Key, ...]
    t_s: FloatArray

    def __len__(self) -> int:
        return len(self.key)

    def of_component(self, component: int) -> "Marks":
        """Return those of one component."""
        rows = np.flatnonzero(self.component == component)
        return Marks(
            xy=self.xy[rows], component=self.component[rows], key=tuple(self.key[row] for row in rows.tolist()), t_s=self.t_s[rows]
        )


_Id = Annotated[int, Meta(ge=0)]


class _Point(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    x: float
    y: float
    t: float
    id1: _Id
    id2: _Id
    component: _Id


class _Landmark(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    id: _Id
    x: float
    y: float
    component: _Id
    t_start: float


class _Document(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    points: list[_Point]
    landmarks: list[_Landmark]


_decoder = msgspec.json.Decoder(_Document)


def read_marks(document: bytes, *, source: str) -> Marks:
    """Take the marks from the JSON of a map that the service made.

    Raises
    ------
    MapDocumentError
        It is none.
    """
    try:
        map_ = _decoder.decode(document)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MapDocumentError(source=source, problem=str(error)) from error
    placed: list[_Point | _Landmark] = [*map_.points, *map_.landmarks]
    return _make_marks(
        places=[(one.x, one.y) for one in placed],
        components=[one.component for one in placed],
        keys=[*((False, one.id1, one.id2) for one in map_.points), *((True, one.id, one.id) for one in map_.landmarks)],
        times_s=[*(one.t for one in map_.points), *(one.t_start for one in map_.landmarks)],
    )


def take_marks(result: MapResult) -> Marks:
    """Take the marks from a map itself."""
    points = result.points
    met = zip(points.id1.tolist(), points.id2.tolist(), strict=True)
    return _make_marks(
        places=[*zip(points.x.tolist(), points.y.tolist(), strict=True), *((one.x, one.y) for one in result.landmarks)],
        components=[*points.component.tolist(), *(one.component for one in result.landmarks)],
        keys=[
            *((False, to_unsigned(id1), to_unsigned(id2)) for id1, id2 in met),
            *((True, to_unsigned(one.node), to_unsigned(one.node)) for one in result.landmarks),
        ],
        times_s=[*(points.t_ns / _NS_PER_S).tolist(), *(one.t_start_ns / _NS_PER_S for one in result.landmarks)],
    )


def shared_marks(first: Marks, second: Marks) -> tuple[IntArray, IntArray]:
    """Find the marks that two maps share.

    Returns
    -------
    tuple of IntArray
        Rows of the first and of the second, shape (k,) each, ordered by time: of marks of one key those that are nearest to each other in
        time, either way, and no further than 2 s. Of the second and the first they are the same pairs.
    """
    ours, theirs = _rows_by_key(first), _rows_by_key(second)
    pairs: list[tuple[float, int, int]] = []
    for key, rows in ours.items():
        others = theirs.get(key)
        if others is None:
            continue
        gaps = np.abs(first.t_s[rows][:, None] - second.t_s[others][None, :])
        for place, other in zip(*np.nonzero((gaps == gaps.min(axis=1, keepdims=True)) & (gaps == gaps.min(axis=0))), strict=True):
            if gaps[place, other] <= _SAME_S:
                pairs.append((float(first.t_s[rows[place]]), rows[place], others[other]))
    pairs.sort()
    found = np.array([(mine, other) for _, mine, other in pairs], dtype=np.int64).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _rows_by_key(marks: Marks) -> dict[_Key, list[int]]:
    rows: defaultdict[_Key, list[int]] = defaultdict(list)
    for row, key in enumerate(marks.key):
        rows[key].append(row)
    return rows


def _make_marks(
    *, places: Sequence[tuple[float, float]], components: Sequence[int], keys: Iterable[_Key], times_s: Sequence[float]
) -> Marks:
    return Marks(
        xy=np.array(places, dtype=np.float64).reshape(-1, 2),
        component=np.array(components, dtype=np.int64),
        key=tuple((is_landmark, min(id1, id2), max(id1, id2)) for is_landmark, id1, id2 in keys),
        t_s=np.array(times_s, dtype=np.float64),
    )
