"""One finished map: as it is served, and as it is kept for the next start."""

import zlib
from dataclasses import dataclass
from hashlib import blake2b
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Self

import msgspec

from mapper.map_job import MapDocuments
from mapper.types import Recipe

_SOURCES = ("*.py", "kernels/*.py", "kernels/*.c", "kernels/*.h", "data/*.json")
_FASTEST = 1  # of zlib's levels: the others take up to ten times as long for a tenth less


class FinishedMap(msgspec.Struct, frozen=True, kw_only=True):
    """A map and its circumstances.

    It is of all records that had come at ``begun_wall_ns``; it was done at ``computed_wall_ns``, after ``computing_s`` with the waiting.
    """

    version: int
    begun_wall_ns: int
    computed_wall_ns: int
    computing_s: float
    documents: MapDocuments


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSnapshot:
    """A finished map as it is served; it never changes. ``change``: the store's newest change that is in it."""

    finished: FinishedMap
    change: int
    etag: str
    map_json: bytes
    diagram_json: bytes

    @classmethod
    def of(cls, finished: FinishedMap, *, change: int) -> Self:
        """Put version and times into the documents."""
        head = msgspec.json.encode({name: getattr(finished, name) for name in finished.__struct_fields__ if name != "documents"})
        documents = finished.documents
        map_json, diagram_json = (_join_objects(head, body) for body in (documents.map_json, documents.diagram_json))
        return cls(
            finished=finished,
            change=change,
            etag=f'"{finished.version}-{blake2b(map_json, digest_size=8).hexdigest()}"',
            map_json=map_json,
            diagram_json=diagram_json,
        )

    @property
    def version(self) -> int:
        """Its number; a later map has a higher one."""
        return self.finished.version

    @property
    def n_encounters(self) -> int:
        """How many encounters it is of."""
        return self.finished.documents.n_encounters

    @property
    def drawing(self) -> bytes:
        """What pictures of it are drawn from."""
        return self.finished.documents.drawing

    @property
    def begun_wall_ns(self) -> int:
        """When the records that it is of were taken from the store."""
        return self.finished.begun_wall_ns


def fingerprint(recipe: Recipe, *, window_ns: int | None) -> str:
    """Name what a map is made by: version and sources of the program with its trained rules, the recipe, the window."""
    facts = msgspec.json.encode([version_of("biobot-gateway"), _sum_sources(), recipe, window_ns], order="deterministic")
    return blake2b(facts, digest_size=16).hexdigest()


def _sum_sources() -> int:
    """Return the CRC-32 of all that computes a map, names too: an installation from a working tree changes under one version."""
    root = Path(__file__).parent
    paths = [path for pattern in _SOURCES for path in root.glob(pattern)]
    total = 0
    for path in sorted(paths):
        total = zlib.crc32(path.read_bytes(), zlib.crc32(path.relative_to(root).as_posix().encode(), total))
    return total


def pack(finished: FinishedMap) -> bytes:
    """Return a finished map as it is kept."""
    return zlib.compress(msgspec.msgpack.encode(finished), _FASTEST)


def unpack(document: bytes) -> FinishedMap | None:
    """Invert `pack`; None for what is something else."""
    try:
        return msgspec.msgpack.decode(zlib.decompress(document), type=FinishedMap)
    except (zlib.error, msgspec.DecodeError, UnicodeDecodeError):
        return None


def _join_objects(first: bytes, second: bytes) -> bytes:
    """Make one JSON object of two that are not empty and have no key in common."""
    return first[:-1] + b"," + second[1:]
