"""Arenas from files: GeoJSON, SVG drawings and black-and-white floor plans, brought to the preset's unit of length.

What each kind means by free and by solid is told in its own module: ``geojson``, ``svg``, ``floor_plan``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon

from simulator.arenas.arena import Arena, BettiNumbers, build_arena
from simulator.arenas.geojson import parse_arena
from simulator.errors import ArenaError

_MAX_BYTES = 64 * 1024 * 1024

# Walls of an arena from a file. Shortest paths take a byte for every corner and wall: some half a gigabyte for 20,000 walls.
MAX_WALLS = 20_000

SUFFIXES = (".geojson", ".json", ".svg", ".png")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArenaFile:
    """An arena, and what its file held beside it.

    Parameters
    ----------
    counts
        What was left out on the way, by kind: ``specks_removed``, ``shapes_ignored``, ``walls_simplified_away``.
    """

    arena: Arena
    counts: Mapping[str, int]


def load_arena_file(path: Path, *, scale: float = 1.0, simplify: float | None = None) -> ArenaFile:
    """Read an arena from a file whose suffix tells its kind.

    Parameters
    ----------
    path
        ``.geojson`` or ``.json``, ``.svg``, ``.png``.
    scale
        Length of a unit of the file: of its coordinates, or of a pixel [length].
    simplify
        Leave out corners so that no wall moves by more than this [length, after scaling].

    Raises
    ------
    ArenaError
        The file cannot be read, is too large, is not what its suffix says, holds no valid area, has more walls than ``MAX_WALLS``, or
        would lose or gain components or holes by being simplified.
    """
    source = str(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ArenaError(source=source, problem=f"its name ends in {suffix!r}; wanted {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    shape, counts = _read_shape(_read_bytes(path), suffix=suffix, source=source)
    if scale != 1.0:
        with np.errstate(over="ignore"):
            shape = shapely.transform(shape, lambda places: scale * places)
        if not np.isfinite(shapely.get_coordinates(shape)).all():
            raise ArenaError(source=source, problem=f"some coordinate times the scale {scale!r} is beyond any number; give a smaller scale")
    arena = build_arena(shape, source=source)
    if simplify is not None:
        n_walls = len(arena.wall_start)
        arena = simplify_arena(arena, tolerance=simplify, source=source)
        counts = {**counts, "walls_simplified_away": n_walls - len(arena.wall_start)}
    if len(arena.wall_start) > MAX_WALLS:
        problem = f"it has {len(arena.wall_start)} walls; wanted at most {MAX_WALLS}: give --arena-simplify LENGTH, or a coarser drawing"
        raise ArenaError(source=source, problem=problem)
    return ArenaFile(arena=arena, counts=counts)


def simplify_arena(arena: Arena, *, tolerance: float, source: str = "arena") -> Arena:
    """Leave out corners by the rule of Douglas and Peucker, moving no wall by more than the tolerance [length].

    Raises
    ------
    ArenaError
        The Betti numbers would change, or the outline would no longer be valid.

    References
    ----------
    D. Douglas, T. Peucker, "Algorithms for the reduction of the number of points required to represent a digitized line", 1973.
    """
    simpler = shapely.simplify(arena.polygon, tolerance, preserve_topology=True)
    found: BettiNumbers | None = None
    if isinstance(simpler, Polygon | MultiPolygon) and simpler.is_valid and not simpler.is_empty:
        simplified = build_arena(simpler, source=source)
        found = simplified.betti
        if found == arena.betti:
            return simplified
    was = f"{arena.betti.components} component(s) and {arena.betti.holes} hole(s)"
    becomes = "no valid area" if found is None else f"{found.components} and {found.holes}"
    raise ArenaError(source=source, problem=f"simplified by {tolerance:g}, its {was} become {becomes}; give a smaller --arena-simplify")


def _read_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ArenaError(source=str(path), problem=f"cannot be read: {error.strerror or error}") from error
    if len(content) > _MAX_BYTES:
        raise ArenaError(source=str(path), problem=f"larger than {_MAX_BYTES // 2**20} MiB; simplify the outline")
    return content


def _read_shape(content: bytes, *, suffix: str, source: str) -> tuple[Polygon | MultiPolygon, dict[str, int]]:
    # The parsers of drawings and pictures are loaded when one is read, not for every run.
    match suffix:
        case ".svg":
            from simulator.arenas.svg import read_svg  # noqa: PLC0415

            return read_svg(content, source=source)
        case ".png":
            from simulator.arenas.floor_plan import read_floor_plan  # noqa: PLC0415

            return read_floor_plan(content, source=source)
        case _:
            return parse_arena(content, source=source).polygon, {}
