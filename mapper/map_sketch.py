"""The part of a finished map that places, routes and pins look at: from the map itself, or from its JSON."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from firmware_protocol.first_use import prepare
from mapper.errors import MapDocumentError
from mapper.hole_shapes import draw_outline
from mapper.record_columns import to_unsigned
from mapper.types import FloatArray, IntArray, MapResult

_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Stand:
    """A landmark: who (as the log has it) stood where, from when to when [s of the map's clock]; ``t_end_s`` None: to the end."""

    node: str
    t_start_s: float
    t_end_s: float | None
    x: float
    y: float
    component: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Obstacle:
    """What stands in a hole: its number on the map, from 1; a simple polygon, shape (k, 2); and a place inside, shape (2,)."""

    number: int
    component: int
    polygon: FloatArray
    centre: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapSketch:
    """A map as a drawing with times; lengths are in ``length_unit``.

    Parameters
    ----------
    xy, component
        Of p points, shapes (p, 2) and (p,).
    met_xy, met_component, met_t_s, met_id1, met_id2
        Of all encounters that have a place, the points first: shape (q, 2), and (q,) for the others; times [s of the map's clock].
    edges
        Of the complex, as indices of points, shape (e, 2).
    cover_radii
        Of each component.
    """

    xy: FloatArray
    component: IntArray
    met_xy: FloatArray
    met_component: IntArray
    met_t_s: FloatArray
    met_id1: tuple[str, ...]
    met_id2: tuple[str, ...]
    landmarks: tuple[Stand, ...]
    obstacles: tuple[Obstacle, ...]
    edges: IntArray
    cover_radii: tuple[float, ...]
    length_unit: str


def sketch_map(result: MapResult) -> MapSketch:
    """Take from a finished map what places and routes need."""
    points = result.points

    def name(node: int) -> str:
        return result.node_names.get(node, str(to_unsigned(node)))

    met = [points] if result.others is None else [points, result.others]
    return MapSketch(
        xy=np.column_stack([points.x, points.y]),
        component=points.component,
        met_xy=np.concatenate([np.column_stack([part.x, part.y]) for part in met]),
        met_component=np.concatenate([part.component for part in met]),
        met_t_s=np.concatenate([part.t_ns for part in met]) / _NS_PER_S,
        met_id1=tuple(name(node) for part in met for node in part.id1.tolist()),
        met_id2=tuple(name(node) for part in met for node in part.id2.tolist()),
        landmarks=tuple(
            Stand(
                node=name(landmark.node),
                t_start_s=landmark.t_start_ns / _NS_PER_S,
                t_end_s=None if landmark.t_end_ns is None else landmark.t_end_ns / _NS_PER_S,
                x=landmark.x,
                y=landmark.y,
                component=landmark.component,
            )
            for landmark in result.landmarks
        ),
        obstacles=tuple(
            Obstacle(number=number, component=hole.component, polygon=hole.outline_xy, centre=hole.centre)
            for number, hole in enumerate(result.holes, start=1)
            if hole.centre is not None
        ),
        edges=result.edges,
        cover_radii=tuple(part.cover_radius for part in result.components),
        length_unit=result.length_unit,
    )


_Natural = Annotated[int, Meta(ge=0)]
_Place = tuple[float, float]


class _Point(msgspec.Struct, frozen=True, kw_only=True):
    x: float
    y: float
    t: float
    id1: _Natural | str
    id2: _Natural | str
    component: _Natural


class _Hole(msgspec.Struct, frozen=True, kw_only=True):
    component: _Natural
    outline_xy: list[_Place]
    centre: _Place | None


class _Landmark(msgspec.Struct, frozen=True, kw_only=True):
    id: _Natural | str
    x: float
    y: float
    component: _Natural
    t_start: float
    t_end: float | None


class _Complex(msgspec.Struct, frozen=True, kw_only=True):
    edges: list[tuple[_Natural, _Natural]]


class _Component(msgspec.Struct, frozen=True, kw_only=True):
    cover_radius: Annotated[float, Meta(ge=0)]


class _Parameters(msgspec.Struct, frozen=True, kw_only=True):
    length_unit: str


class _Document(msgspec.Struct, frozen=True, kw_only=True):
    points: Annotated[list[_Point], Meta(min_length=1)]
    holes: list[_Hole]
    landmarks: list[_Landmark]
    complex: _Complex
    components: Annotated[list[_Component], Meta(min_length=1)]
    parameters: _Parameters


prepare(_Document)


def sketch_document(document: Mapping[str, object], *, source: str) -> MapSketch:
    """Take the same from the JSON object of a map, as ``biobot-mapper run --json`` and ``/api/v1/map`` give it.

    Parameters
    ----------
    source
        Where it comes from, for the error.

    Raises
    ------
    MapDocumentError
        It is no map, or one of an earlier version that does not tell where landmarks and obstacles are.
    """
    try:
        map_ = msgspec.convert(document, _Document)
    except msgspec.ValidationError as error:
        raise MapDocumentError(source=source, problem=str(error)) from error
    _check(map_, source)
    xy = np.array([(point.x, point.y) for point in map_.points])
    component = np.array([point.component for point in map_.points], dtype=np.int64)
    return MapSketch(
        xy=xy,
        component=component,
        met_xy=xy,
        met_component=component,
        met_t_s=np.array([point.t for point in map_.points]),
        met_id1=tuple(str(point.id1) for point in map_.points),
        met_id2=tuple(str(point.id2) for point in map_.points),
        landmarks=tuple(
            Stand(node=str(one.id), t_start_s=one.t_start, t_end_s=one.t_end, x=one.x, y=one.y, component=one.component)
            for one in map_.landmarks
        ),
        obstacles=tuple(_obstacles(map_, source)),
        edges=np.array(map_.complex.edges, dtype=np.int64).reshape(-1, 2),
        cover_radii=tuple(part.cover_radius for part in map_.components),
        length_unit=map_.parameters.length_unit,
    )


def _check(map_: _Document, source: str) -> None:
    n_points, n_components = len(map_.points), len(map_.components)
    faults = []
    if any(max(edge) >= n_points for edge in map_.complex.edges):
        faults.append(f"an edge leads to a point beyond the {n_points} there are")
    components = [part.component for part in map_.points] + [part.component for part in map_.holes]
    if max(components + [part.component for part in map_.landmarks]) >= n_components:
        faults.append(f"something is in a component beyond the {n_components} there are")
    if not all(isfinite(value) for point in map_.points for value in (point.x, point.y, point.t)):
        faults.append("a place or a time is not finite")
    if faults:
        raise MapDocumentError(source=source, problem="; ".join(faults))


def _obstacles(map_: _Document, source: str) -> list[Obstacle]:
    found = []
    for number, hole in enumerate(map_.holes, start=1):
        if hole.centre is None:
            continue
        polygon = draw_outline(np.array(hole.outline_xy[:-1]).reshape(-1, 2)) if len(hole.outline_xy) > 3 else None
        if polygon is None:
            raise MapDocumentError(source=source, problem=f"outline_xy of hole {number} is no polygon")
        found.append(Obstacle(number=number, component=hole.component, polygon=polygon, centre=np.array(hole.centre)))
    return found
