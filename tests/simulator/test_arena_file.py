"""Laws of arenas from files of any kind."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
import shapely
from PIL import Image
from shapely.geometry import Polygon, box, mapping

from simulator.arenas import arena_file
from simulator.arenas.arena import build_arena
from simulator.arenas.arena_file import load_arena_file, simplify_arena
from simulator.arenas.floors import disc, ring_corridor
from simulator.errors import ArenaError

# A room of 8 by 4 with an obstacle of 2 by 1 whose lower left corner is at (1, 2), in each kind of file.
ROOM = Polygon(box(0, 0, 8, 4).exterior, [box(1, 2, 3, 3).exterior])
SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 8 4"><rect width="8" height="4"/><rect x="1" y="1" width="2" height="1"/></svg>'


def png() -> bytes:
    picture = np.full((4, 8), 255, dtype=np.uint8)
    picture[1, 1:3] = 0
    # Each pixel becomes two by two, so that the obstacle is no speck.
    file = io.BytesIO()
    Image.fromarray(picture.repeat(2, axis=0).repeat(2, axis=1)).save(file, "png")
    return file.getvalue()


def write(directory: Path, suffix: str) -> tuple[Path, float]:
    """Write the room as a file of this kind, and tell the length of its unit."""
    content = {".svg": SVG.encode(), ".png": png()}.get(suffix, json.dumps(mapping(ROOM)).encode())
    path = directory / f"room{suffix}"
    path.write_bytes(content)
    return path, 0.5 if suffix == ".png" else 1.0


@pytest.mark.parametrize("suffix", [".geojson", ".json", ".svg", ".png", ".PNG"])
def test_a_room_is_the_same_in_every_kind_of_file(tmp_path: Path, suffix: str) -> None:
    path, unit = write(tmp_path, suffix if suffix.islower() else ".png")
    path = path.rename(path.with_suffix(suffix))
    arena = load_arena_file(path, scale=unit).arena
    assert arena.polygon.equals(ROOM)
    assert (arena.betti.components, arena.betti.holes) == (1, 1)


@pytest.mark.parametrize("suffix", arena_file.SUFFIXES)
def test_the_scale_multiplies_every_length(tmp_path: Path, suffix: str) -> None:
    path, unit = write(tmp_path, suffix)
    arena = load_arena_file(path, scale=0.25 * unit).arena
    assert arena.area == 30 / 16
    assert arena.bounds == (0, 0, 2, 1)


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("plan.dxf", b"", "its name ends in '.dxf'; wanted .geojson, .json, .svg or .png"),
        ("plan", b"", "its name ends in ''; wanted"),
        ("plan.svg", b"{}", "not well-formed XML"),
        ("plan.png", SVG.encode(), "not a PNG picture"),
        ("plan.geojson", b"<svg/>", "not JSON"),
    ],
)
def test_what_is_not_its_kind_is_refused_by_name(tmp_path: Path, name: str, content: bytes, problem: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ArenaError, match=f"{name}: {problem}"):
        load_arena_file(tmp_path / name)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ArenaError, match=r"none\.svg: cannot be read: No such file"):
        load_arena_file(tmp_path / "none.svg")


def test_a_scale_beyond_numbers_is_refused(tmp_path: Path) -> None:
    path, _ = write(tmp_path, ".geojson")
    with pytest.raises(ArenaError, match="give a smaller scale"):
        load_arena_file(path, scale=1e308)


def test_too_many_walls_are_refused_unless_simplified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arena_file, "MAX_WALLS", 90)
    path = tmp_path / "disc.geojson"
    path.write_text(json.dumps(mapping(disc())))
    with pytest.raises(ArenaError, match="it has 96 walls; wanted at most 90: give --arena-simplify"):
        load_arena_file(path)
    file = load_arena_file(path, simplify=0.1)
    assert file.counts["walls_simplified_away"] == 96 - len(file.arena.wall_start) > 6


@pytest.mark.parametrize("tolerance", [0.06, 0.2, 1.0])
def test_simplifying_moves_no_wall_further_than_told_and_keeps_the_holes(tolerance: float) -> None:
    arena = build_arena(ring_corridor())
    simpler = simplify_arena(arena, tolerance=tolerance)
    assert simpler.betti == arena.betti
    assert len(simpler.wall_start) < len(arena.wall_start)
    assert shapely.hausdorff_distance(arena.polygon.boundary, simpler.polygon.boundary, densify=0.1) <= tolerance


def test_simplifying_never_changes_the_betti_numbers() -> None:
    """A pond three thousandths off a wiggly shore: moving the shore by a tenth would drown it, or make it touch."""
    shore = [(0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (5.0, 5.1), (0.0, 5.0)]
    pond = [(4.9, 5.0), (5.1, 5.0), (5.0, 5.095)]
    arena = build_arena(Polygon(shore, [pond]))
    try:
        assert simplify_arena(arena, tolerance=0.2).betti == arena.betti
    except ArenaError as error:
        assert "give a smaller --arena-simplify" in str(error)  # noqa: PT017  # either outcome keeps the law


@pytest.mark.parametrize("scale", ["1e300", "1e-300", "1e-62"])
def test_scales_beyond_all_measure_are_refused(tmp_path: Path, scale: str) -> None:
    (tmp_path / "room.geojson").write_text('{"type": "Polygon", "coordinates": [[[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]]}')
    with pytest.raises(ArenaError, match=r"extent|beyond any number"):
        load_arena_file(tmp_path / "room.geojson", scale=float(scale))
