"""One finished map: as it is served, and as it is kept for the next start."""

import zlib
from dataclasses import dataclass
from hashlib import blake2b
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Self

import msgspec
import msgspec.structs

from firmware_protocol.first_use import prepare
from mapper.map_job import MapDocuments
from mapper.named_pins import Framing, NamedPin
from mapper.served_bytes import ServedBytes
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


prepare(FinishedMap)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSnapshot:
    """A finished map as it is served; it never changes. ``change``: the store's newest change that is in it."""

    finished: FinishedMap
    change: int
    etag: str
    map: ServedBytes
    diagram: ServedBytes
    barcode: ServedBytes
    coverage: ServedBytes
    lengths: ServedBytes | None

    @classmethod
    def of(cls, finished: FinishedMap, *, change: int) -> Self:
        """Put version, times and frame into the documents."""
        documents = finished.documents
        names = ("version", "begun_wall_ns", "computed_wall_ns", "computing_s")
        facts = {name: getattr(finished, name) for name in names}
        head = msgspec.json.encode(facts)
        whole = _join_objects(msgspec.json.encode(facts | {"frame": msgspec.Raw(documents.framing.frame_json)}), documents.map_json)
        etag = f"{finished.version}-{blake2b(whole, digest_size=8).hexdigest()}"
        return cls(
            finished=finished,
            change=change,
            etag=f'"{etag}"',
            map=ServedBytes(whole, tag=etag),
            diagram=ServedBytes(_join_objects(head, documents.diagram_json), tag=etag),
            barcode=ServedBytes(_join_objects(head, documents.barcode_json), tag=etag),
            coverage=ServedBytes(_join_objects(head, documents.coverage_json), tag=etag),
            lengths=None if documents.lengths is None else ServedBytes(documents.lengths, tag=etag),
        )

    def framed(self, framing: Framing) -> "MapSnapshot":
        """Return the same map with other pins."""
        documents = msgspec.structs.replace(self.finished.documents, framing=framing)
        return MapSnapshot.of(msgspec.structs.replace(self.finished, documents=documents), change=self.change)

    @property
    def map_json(self) -> bytes:
        """The map as JSON."""
        return self.map.plain

    @property
    def diagram_json(self) -> bytes:
        """The persistence diagram as JSON."""
        return self.diagram.plain

    @property
    def pins(self) -> tuple[NamedPin, ...]:
        """The pins that its frame is by."""
        return self.finished.documents.framing.pins

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
    """Return a finished map as it is kept: without the lengths between its points, which are most of it, and flash memory wears."""
    finished = msgspec.structs.replace(finished, documents=msgspec.structs.replace(finished.documents, lengths=None))
    return zlib.compress(msgspec.msgpack.encode(finished), _FASTEST)


def unpack(document: bytes) -> FinishedMap | None:
    """Invert `pack`, but for what is not kept; None for what is something else."""
    try:
        return msgspec.msgpack.decode(zlib.decompress(document), type=FinishedMap)
    except (zlib.error, msgspec.DecodeError, UnicodeDecodeError):
        return None


def _join_objects(first: bytes, second: bytes) -> bytes:
    """Make one JSON object of two that are not empty and have no key in common."""
    return first[:-1] + b"," + second[1:]
