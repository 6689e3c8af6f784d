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


def pack(parts: WorldParts) -> bytes:
    """Write a snapshot."""
    head = {
        "now_s": parts.now_s.hex(),
        "detection": parts.ranges.detection.hex(),
        "communication": parts.ranges.communication.hex(),
        "is_torus": parts.is_torus,
        "keeps_legs": parts.keeps_legs,
        "arena": shapely.to_wkb(parts.arena.polygon, hex=True),
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
            arrays = dict(archive)
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise SnapshotError(source=source, problem=f"its archive cannot be read ({error})") from error
    head = json.loads(arrays["head"].tobytes())
    shape = shapely.from_wkb(head["arena"])
    if not isinstance(shape, Polygon | MultiPolygon):
        raise SnapshotError(source=source, problem=f"its arena is a {shape.geom_type}")
    return WorldParts(
        engine=arrays["engine"].tobytes(),
        legs=Legs(**{name: arrays[f"leg_{name}"] for name in LEG_FIELDS}) if "leg_x" in arrays else None,
        ids=arrays["ids"],
        lost_first=arrays["lost_first"],
        now_s=float.fromhex(head["now_s"]),
        ranges=Ranges(detection=float.fromhex(head["detection"]), communication=float.fromhex(head["communication"])),
        is_torus=head["is_torus"],
        keeps_legs=head["keeps_legs"],
        arena=build_arena(shape, source=source),
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
