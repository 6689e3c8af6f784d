"""What a map's document holds beside the map, so that it can be joined to others, and reading it back."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import floor, log10
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from firmware_protocol.first_use import prepare
from mapper.errors import InputFileError
from mapper.types import FloatArray, IntArray, Landmark, MapResult

_DIGITS = 6
_Instant = Annotated[int, Meta(ge=-(2**62), le=2**62)]
_Node = Annotated[int, Meta(ge=0, le=2**63 - 1)]
_Length = Annotated[float, Meta(ge=0)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalMap:
    """One component of a map: p points, in the order in which maxmin picked them, and l places where landmarks stood.

    ``points``, shape (p, 3): time [ns] and biobots of each encounter. ``stands``, shape (l, 3): node, begin and end [ns] of each stand.
    ``distances``, shape (p + l, p + l), points first. ``reach`` is as of `ComponentMap`, ``n_seen`` as of `LandmarkPlaces`.
    """

    name: str
    points: IntArray
    stands: IntArray
    distances: FloatArray
    reach: float
    cover_radius: float
    n_encounters: int
    n_used: int
    n_seen: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapFile:
    """The components of one map, and in what they are measured."""

    name: str
    components: tuple[LocalMap, ...]
    method: str
    metric: str
    speed_mps: float | None


class _Component(msgspec.Struct, frozen=True, kw_only=True):
    points: Annotated[list[tuple[_Instant, _Node, _Node]], Meta(min_length=1)]
    stands: list[tuple[_Node, _Instant, _Instant]]
    distances: list[_Length]
    reach: _Length
    cover_radius: _Length
    n_encounters: Annotated[int, Meta(ge=1)]
    n_used: Annotated[int, Meta(ge=0)]
    n_seen: Annotated[int, Meta(ge=0)]


class _Parameters(msgspec.Struct, frozen=True, kw_only=True):
    method: str
    metric: str
    speed_mps: Annotated[float, Meta(gt=0)] | None = None


class _Document(msgspec.Struct, frozen=True, kw_only=True):
    parameters: _Parameters
    merging: Annotated[list[_Component], Meta(min_length=1)] | None = None


prepare(_Document)


def merging_facts(result: MapResult) -> dict[str, Any]:
    """Describe what joins a map to others: identities of points and stands [ns], and all distances between them, to six digits.

    Returns
    -------
    dict
        ``merging``: for each component ``points`` [[t_ns, id1, id2], ...], ``stands`` [[node, begin_ns, end_ns], ...] and ``distances``,
        the part above the diagonal, row by row, points first; nothing where the map does not know its distances.
    """
    parts: list[dict[str, Any]] = []
    for index, part in enumerate(result.components):
        places = part.places
        if places is None or len(part.distances) != part.n_points:
            return {}
        rows = np.flatnonzero(result.points.component == index)
        points = np.column_stack([result.points.t_ns[rows], result.points.id1[rows], result.points.id2[rows]])
        whole = np.block([[part.distances, places.to_points.T], [places.to_points, places.between]])
        decimals = _DIGITS - 1 - floor(log10(whole.max())) if whole.max() > 0 else 0
        parts.append(
            {
                "points": points.tolist(),
                "stands": [
                    _whole_stand(result.landmarks, *stand)
                    for stand in zip(*(column.tolist() for column in (places.node, places.t_start_ns, places.t_end_ns)), strict=True)
                ],
                "distances": np.round(whole[np.triu_indices(len(whole), k=1)], decimals).tolist(),
                "reach": part.diameter if part.reach is None else part.reach,
                "cover_radius": part.cover_radius,
                "n_encounters": part.n_encounters,
                "n_used": part.n_used,
                "n_seen": places.n_seen,
            }
        )
    return {"merging": parts}


def _whole_stand(landmarks: Sequence[Landmark], node: int, begin: int, end: int) -> list[int]:
    """Widen a stand, as far as the record tells of it, to the spell that was told: it may have begun before and go on after it."""
    for spell in landmarks:
        last = end if spell.t_end_ns is None else spell.t_end_ns
        if spell.node == node and spell.t_start_ns <= end and begin <= last:
            begin, end = min(begin, spell.t_start_ns), max(end, last)
    return [node, begin, end]


def read_map_file(path: Path) -> MapFile:
    """Read a map that ``biobot-mapper run`` or ``merge`` wrote.

    Raises
    ------
    InputFileError
        The file cannot be read, or is no such map.
    """
    try:
        document = json.loads(path.read_bytes())
    except OSError as error:
        raise InputFileError(path=str(path), faults=[f"cannot be read: {(error.strerror or str(error)).lower()}"]) from error
    except (ValueError, RecursionError) as error:
        raise InputFileError(path=str(path), faults=[f"not JSON: {error}"]) from error
    return take_map(document, name=str(path))


def take_map(document: Mapping[str, object], *, name: str) -> MapFile:
    """Take from a map's document what merging needs; raises as `read_map_file`."""
    next_step = "give the JSON of biobot-mapper run --json FILE, or the encounters"
    try:
        content = msgspec.convert(document, _Document)
    except msgspec.ValidationError as error:
        raise InputFileError(path=name, faults=[f"no map of this mapper: {error}; {next_step}"]) from error
    if content.merging is None:
        raise InputFileError(path=name, faults=[f"the map does not tell its distances: it has no 'merging'; {next_step}"])
    components = []
    for number, part in enumerate(content.merging):
        n = len(part.points) + len(part.stands)
        if len(part.distances) != n * (n - 1) // 2:
            wanted = f"component {number} has {len(part.distances)} distances; wanted {n * (n - 1) // 2}, of {n} points and stands"
            raise InputFileError(path=name, faults=[wanted])
        distances = np.zeros((n, n))
        distances[np.triu_indices(n, k=1)] = part.distances
        components.append(
            LocalMap(
                name=name,
                points=np.array(part.points, dtype=np.int64),
                stands=np.array(part.stands, dtype=np.int64).reshape(-1, 3),
                distances=distances + distances.T,
                reach=part.reach,
                cover_radius=part.cover_radius,
                n_encounters=part.n_encounters,
                n_used=part.n_used,
                n_seen=part.n_seen,
            )
        )
    parameters = content.parameters
    return MapFile(
        name=name, components=tuple(components), method=parameters.method, metric=parameters.metric, speed_mps=parameters.speed_mps
    )
