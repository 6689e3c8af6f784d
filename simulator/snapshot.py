"""Snapshots of a world as bytes: a checksum, then an archive of arrays. Whatever is damaged is refused, never half read."""

import hashlib
import io
import json
import zipfile
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

from simulator.arenas.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.errors import SnapshotError
from simulator.legs import LEG_FIELDS, Legs

_MARK = b"biobot world 1\n"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorldParts:
    """What a world is made of."""

    engine: bytes
    legs: Legs | None
    ids: NDArray[np.int64]
    lost_first: NDArray[np.bool_]
    now_s: float
    ranges: Ranges
    is_torus: bool
    keeps_legs: bool
    arena: Arena
    bounds: tuple[float, float, float, float]


def pack(parts: WorldParts) -> bytes:
    """Write a snapshot."""
    head = {
        "now_s": float(parts.now_s).hex(),
        "detection": float(parts.ranges.detection).hex(),
        "communication": float(parts.ranges.communication).hex(),
        "is_torus": parts.is_torus,
        "keeps_legs": parts.keeps_legs,
        "arena": shapely.to_wkb(parts.arena.polygon, hex=True),
        "bounds": [value.hex() for value in parts.bounds],
    }
    arrays: dict[str, NDArray[np.generic]] = {
        "head": np.frombuffer(json.dumps(head).encode(), dtype=np.uint8),
        "engine": np.frombuffer(parts.engine, dtype=np.uint8),
        "ids": parts.ids,
        "lost_first": parts.lost_first,
    }
    if parts.legs is not None:
        arrays |= {f"leg_{name}": getattr(parts.legs, name) for name in LEG_FIELDS}
    archive = io.BytesIO()
    np.savez(archive, **arrays)  # type: ignore[arg-type]  # the stubs take every keyword for allow_pickle
    return seal(archive.getvalue(), mark=_MARK)


def unpack(content: bytes, *, source: str) -> WorldParts:
    """Read a snapshot; ``source`` names it in messages. Raises SnapshotError."""
    body = unseal(content, mark=_MARK, source=source)
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            return _read_parts(dict(archive), source=source)
    except (ValueError, KeyError, TypeError, AttributeError, OSError, zipfile.BadZipFile, shapely.errors.ShapelyError) as error:
        raise SnapshotError(source=source, problem=f"what is in it does not fit together ({error})") from error


def _read_parts(arrays: dict[str, NDArray[np.generic]], *, source: str) -> WorldParts:
    head = json.loads(arrays["head"].tobytes())
    bounds = [float.fromhex(value) for value in head["bounds"]]
    shape = shapely.from_wkb(head["arena"])
    if not isinstance(shape, Polygon | MultiPolygon):
        raise SnapshotError(source=source, problem=f"its arena is a {shape.geom_type}")
    ids = arrays["ids"].astype(np.int64, casting="safe")
    lost_first = arrays["lost_first"].astype(np.bool_, casting="safe")
    legs = None
    if "leg_x" in arrays:
        numbers = {name: arrays[f"leg_{name}"].astype(np.float64, casting="safe") for name in LEG_FIELDS if name != "biobot"}
        legs = Legs(biobot=arrays["leg_biobot"].astype(np.int64, casting="safe"), **numbers)
        if {column.shape for column in numbers.values()} != {legs.biobot.shape} or not (
            (legs.biobot >= 0) & (legs.biobot < ids.size)
        ).all():
            raise SnapshotError(source=source, problem="its legs are no insects'")
    if ids.ndim != 1 or lost_first.shape != ids.shape or not ids.size or not (np.diff(ids) > 0).all():
        raise SnapshotError(source=source, problem="its identities are not in order")
    return WorldParts(
        engine=arrays["engine"].tobytes(),
        legs=legs,
        ids=ids,
        lost_first=lost_first,
        now_s=float.fromhex(head["now_s"]),
        ranges=Ranges(detection=float.fromhex(head["detection"]), communication=float.fromhex(head["communication"])),
        is_torus=bool(head["is_torus"]),
        keeps_legs=bool(head["keeps_legs"]),
        arena=build_arena(shape, source=source),
        bounds=(bounds[0], bounds[1], bounds[2], bounds[3]),
    )


def seal(body: bytes, *, mark: bytes) -> bytes:
    """Put a mark and a checksum before some bytes."""
    return mark + hashlib.sha256(body).digest() + body


def unseal(content: bytes, *, mark: bytes, source: str) -> bytes:
    """Return what was sealed with this mark; ``source`` names it in messages. Raises SnapshotError."""
    start = len(mark) + hashlib.sha256().digest_size
    if not content.startswith(mark):
        raise SnapshotError(source=source, problem=f"it does not begin as a snapshot does, with {mark.decode().strip()!r}")
    body = content[start:]
    if hashlib.sha256(body).digest() != content[len(mark) : start]:
        raise SnapshotError(source=source, problem="it is damaged or cut short: its checksum does not fit")
    return body
