"""Arenas as GeoJSON (RFC 7946): read with every fault named, and written.

Coordinates are plain lengths in the preset's unit, not degrees. A third coordinate is left aside.
"""

import json
import math
from pathlib import Path

from shapely.geometry import MultiPolygon, Polygon, mapping

from simulator.arenas.arena import Arena, build_arena
from simulator.errors import ArenaError

# An outline larger than this is no floor plan drawn by a person; the limit also keeps an endless file from being read.
_MAX_BYTES = 64 * 1024 * 1024

Ring = list[tuple[float, float]]


def load_arena(path: Path) -> Arena:
    """Read an arena from a GeoJSON file.

    Parameters
    ----------
    path
        A Polygon or MultiPolygon, bare, or in a Feature, or in a FeatureCollection of one.

    Raises
    ------
    ArenaError
        The file cannot be read, is not GeoJSON, holds something else, or its area is not valid.
    """
    source = str(path)
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ArenaError(source=source, problem=f"cannot be read: {error.strerror or error}") from error
    if len(content) > _MAX_BYTES:
        raise ArenaError(source=source, problem=f"larger than {_MAX_BYTES // 2**20} MiB; simplify the outline")
    return parse_arena(content, source=source)


def parse_arena(content: bytes, *, source: str) -> Arena:
    """Build an arena from the bytes of a GeoJSON text; ``source`` names it in messages. Raises ArenaError."""
    try:
        document = json.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ArenaError(source=source, problem=f"not UTF-8 text (byte {error.start}); give a GeoJSON file") from error
    except json.JSONDecodeError as error:
        raise ArenaError(source=source, problem=f"not JSON: {error.msg} in line {error.lineno}, column {error.colno}") from error
    except (RecursionError, ValueError) as error:  # ValueError: an integer of more digits than Python converts
        raise ArenaError(source=source, problem="not usable JSON: nested too deeply, or with numbers too long") from error
    return _Reader(source).read(document)


def dump_arena(arena: Arena) -> str:
    """Write an arena as a GeoJSON Polygon or MultiPolygon, one line."""
    return json.dumps(mapping(arena.polygon)) + "\n"


class _Reader:
    """Walks through a decoded GeoJSON document; knows its source for messages."""

    def __init__(self, source: str) -> None:
        self._source = source

    def read(self, document: object) -> Arena:
        geometry = self._find_geometry(document)
        kind, coordinates = geometry.get("type"), geometry.get("coordinates")
        if kind == "Polygon":
            return build_arena(Polygon(*self._polygon(coordinates, where="polygon")), source=self._source)
        if kind == "MultiPolygon":
            parts = self._list(coordinates, where="coordinates", wanted="a list of polygons")
            polygons = [Polygon(*self._polygon(part, where=f"polygon {number}")) for number, part in enumerate(parts, start=1)]
            return build_arena(MultiPolygon(polygons), source=self._source)
        raise self._fault(f"its geometry is of type {kind!r}; wanted Polygon or MultiPolygon")

    def _find_geometry(self, document: object) -> dict[str, object]:
        if not isinstance(document, dict):
            raise self._fault(f"holds a JSON {type(document).__name__}; wanted a GeoJSON object")
        kind = document.get("type")
        if kind == "FeatureCollection":
            features = self._list(document.get("features"), where="features", wanted="a list")
            if len(features) != 1:
                raise self._fault(f"its FeatureCollection has {len(features)} features; wanted exactly one (join areas in a MultiPolygon)")
            return self._find_geometry(features[0])
        if kind == "Feature":
            geometry = document.get("geometry")
            if not isinstance(geometry, dict):
                raise self._fault("its Feature has no geometry; wanted a Polygon or MultiPolygon")
            return geometry
        return document

    def _polygon(self, rings: object, *, where: str) -> tuple[Ring, list[Ring]]:
        outlines = self._list(rings, where=where, wanted="a list of rings")
        if not outlines:
            raise self._fault(f"{where} has no ring; wanted an outer ring, then its holes")
        read = [self._ring(ring, where=f"{where}, ring {number}") for number, ring in enumerate(outlines, start=1)]
        return read[0], read[1:]

    def _ring(self, positions: object, *, where: str) -> Ring:
        listed = self._list(positions, where=where, wanted="a list of positions")
        ring = [self._position(position, where=f"{where}, position {number}") for number, position in enumerate(listed, start=1)]
        if len(ring) < 4 or ring[0] != ring[-1]:
            raise self._fault(f"{where} has {len(ring)} positions and is {'' if ring and ring[0] == ring[-1] else 'not '}closed; "
                              "wanted at least 4, the last equal to the first")  # fmt: skip
        return ring

    def _position(self, position: object, *, where: str) -> tuple[float, float]:
        values = self._list(position, where=where, wanted="a list of two numbers")
        numbers = [value for value in values[:2] if isinstance(value, int | float) and not isinstance(value, bool)]
        if len(numbers) < 2:
            raise self._fault(f"{where} is {_shorten(values)}; wanted two numbers")
        try:
            x, y = float(numbers[0]), float(numbers[1])
        except OverflowError:
            x = y = math.inf
        if not (math.isfinite(x) and math.isfinite(y)):
            raise self._fault(f"{where} is {_shorten(values)}; wanted finite numbers")
        return x, y

    def _list(self, value: object, *, where: str, wanted: str) -> list[object]:
        if not isinstance(value, list):
            raise self._fault(f"{where} is {_shorten(value)}; wanted {wanted}")
        return value

    def _fault(self, problem: str) -> ArenaError:
        return ArenaError(source=self._source, problem=problem)


def _shorten(value: object) -> str:
    """Show a JSON value, cut where it is long (Python refuses to print the longest integers at all)."""
    try:
        text = json.dumps(value)
    except ValueError:
        return "a number too long to print"
    return text if len(text) <= 60 else text[:57] + "..."
