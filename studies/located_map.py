"""A map whose points have been found again in the truth of its run, with all lengths in the run's unit."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose
from typing import Annotated, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from mapper.config import RecipeConfig, make_recipe
from mapper.encounter_csv import read_modes
from mapper.pipeline import compute_map
from mapper.report import to_json_object
from mapper.types import MapResult
from studies.errors import MapFileError
from studies.truth import Floats, Indices, Intervals, RunTruth, find_encounters

_NS_PER_S = 1e9

_Natural = Annotated[int, Meta(ge=0)]
_TargetT = TypeVar("_TargetT")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocatedMap:
    """A map beside the truth; p points in all.

    Parameters
    ----------
    rows
        Row of each point in the encounters of the run, shape (p,).
    time_error_s
        Difference between each point's time and its encounter's true centre, shape (p,) [s].
    xy
        Where the map places each point, shape (p, 2) [unit of the run].
    component
        Which component of the map each is in, shape (p,).
    outlines
        For every hole of the map the points around it, in order.
    intervals
        Births and deaths in dimensions 0 and 1, all components together [unit of the run].
    distances
        For every component the map's distances between its points [unit of the run]; None if the map does not tell them.
    """

    rows: Indices
    time_error_s: Floats
    xy: Floats
    component: Indices
    outlines: tuple[Indices, ...]
    intervals: Intervals
    distances: tuple[Floats, ...] | None
    betti_numbers: tuple[int, int]


class _Point(msgspec.Struct, frozen=True, kw_only=True):
    x: float
    y: float
    t: float
    id1: int
    id2: int
    component: _Natural = 0


class _Hole(msgspec.Struct, frozen=True, kw_only=True):
    points: list[_Natural]


class _Document(msgspec.Struct, frozen=True, kw_only=True):
    """The part of the mapper's JSON object that scores need; the rest is left aside."""

    betti_numbers: tuple[int, int]
    intervals: dict[str, list[tuple[float, float | None]]]
    points: Annotated[list[_Point], Meta(min_length=1)]
    holes: list[_Hole]
    diameter: float
    parameters: dict[str, object]


class _Units(msgspec.Struct, frozen=True, kw_only=True):
    length_unit: str
    speed_mps: Annotated[float, Meta(gt=0)] | None = None


def find_map(map_: MapResult | Mapping[str, object], truth: RunTruth, *, speed: float) -> LocatedMap:
    """Find every point of a map in the truth, and convert its lengths.

    Parameters
    ----------
    map_
        A finished map, or its JSON object.
    speed
        How far a biobot walks in a second [unit of the run/s].

    Raises
    ------
    MapFileError
        The object is no map.
    OtherRunError
        It is a map of another run.
    InputFileError
        ``modes.csv`` of the run is faulty.

    Notes
    -----
    The JSON does not hold distances. For a run that no clock paced they are computed again from the files of the run, and kept if that
    gives the points of the map.
    """
    document = _convert(to_json_object(map_) if isinstance(map_, MapResult) else map_, _Document)
    units = _convert(document.parameters, _Units)
    if any(point >= len(document.points) for hole in document.holes for point in hole.points):
        raise MapFileError(source="the map", problem=f"a hole goes around a point beyond the {len(document.points)} there are")
    points = document.points
    rows, time_error_s = find_encounters(
        truth,
        t_s=np.array([point.t for point in points]),
        id1=np.array([point.id1 for point in points], dtype=np.int64),
        id2=np.array([point.id2 for point in points], dtype=np.int64),
    )
    source = map_ if isinstance(map_, MapResult) else _compute_again(document, truth)
    scale = speed / (units.speed_mps or 1.0)
    return LocatedMap(
        rows=rows,
        time_error_s=time_error_s,
        xy=scale * np.array([(point.x, point.y) for point in points]),
        component=np.array([point.component for point in points], dtype=np.int64),
        outlines=tuple(np.array(hole.points, dtype=np.int64) for hole in document.holes),
        intervals=(_intervals(document, "0", scale=scale), _intervals(document, "1", scale=scale)),
        distances=None if source is None else tuple(scale * part.distances for part in source.components),
        betti_numbers=document.betti_numbers,
    )


def _compute_again(document: _Document, truth: RunTruth) -> MapResult | None:
    """Make the map of the run's files by the recipe of a document; None where that is not the map of the document."""
    if truth.zero_wall_ns or not len(truth.encounters):
        return None
    known = {name: document.parameters[name] for name in RecipeConfig.__struct_fields__ if name in document.parameters}
    modes = truth.directory / "modes.csv"
    result = compute_map(truth.encounters, read_modes(modes) if modes.exists() else (), make_recipe(_convert(known, RecipeConfig)))
    points = result.points
    again = zip((points.t_ns / _NS_PER_S).tolist(), points.id1.tolist(), points.id2.tolist(), strict=True)
    is_same = list(again) == [(point.t, point.id1, point.id2) for point in document.points]
    return result if is_same and isclose(result.diameter, document.diameter, rel_tol=1e-9) else None


def _intervals(document: _Document, dimension: str, *, scale: float) -> Floats:
    listed = [(birth, np.inf if death is None else death) for birth, death in document.intervals.get(dimension, [])]
    return scale * np.array(listed, dtype=np.float64).reshape(-1, 2)


def _convert(value: object, kind: type[_TargetT]) -> _TargetT:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise MapFileError(source="the map", problem=f"no map of this mapper: {error}") from error
