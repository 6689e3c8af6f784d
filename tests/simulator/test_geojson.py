"""Laws of arena files."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.arenas.arena import Arena
from simulator.arenas.geojson import dump_arena, load_arena, parse_arena
from simulator.errors import ArenaError
from tests.simulator.arenas import arenas

RING = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]
HOLE = [[1, 1], [2, 1], [2, 2], [1, 1]]
FAR = [[[9, 0], [12, 0], [12, 4], [9, 0]]]
POLYGON = {"type": "Polygon", "coordinates": [RING, HOLE]}
FEATURE = {"type": "Feature", "properties": None, "geometry": POLYGON}


def parse(document: object) -> Arena:
    return parse_arena(json.dumps(document).encode(), source="file")


@pytest.mark.parametrize(
    ("document", "components", "holes"),
    [
        (POLYGON, 1, 1),
        (FEATURE, 1, 1),
        ({"type": "FeatureCollection", "features": [FEATURE]}, 1, 1),
        ({"type": "MultiPolygon", "coordinates": [[RING, HOLE], FAR]}, 2, 1),
        ({"type": "Polygon", "coordinates": [[[*position, 7.5] for position in RING]]}, 1, 0),
        ({"type": "Polygon", "coordinates": [RING[::-1]], "crs": {"any": "thing"}}, 1, 0),
    ],
)
def test_areas_are_read_however_they_are_wrapped(document: object, components: int, holes: int) -> None:
    betti = parse(document).betti
    assert (betti.components, betti.holes) == (components, holes)


@settings(max_examples=30)
@given(arenas())
def test_reading_inverts_writing(arena: Arena) -> None:
    again = parse_arena(dump_arena(arena).encode(), source="again")
    assert again.polygon.equals_exact(arena.polygon, 0.0)
    assert again.betti == arena.betti


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "not JSON"),
        (b"\xff\xfe\x00", "not UTF-8"),
        (b'{"type": "Polygon", "coordinates": ', "not JSON: Expecting value in line 1"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"type": "Polygon", "coordinates": [[[' + b"9" * 5000 + b", 0]]]}", "numbers too long"),
        (b"[1, 2]", "holds a JSON list"),
        (b"{}", "geometry is of type None"),
        (b'{"type": "Point", "coordinates": [1, 2]}', "type 'Point'; wanted Polygon or MultiPolygon"),
        (b'{"type": "Feature", "geometry": null}', "no geometry"),
        (b'{"type": "FeatureCollection", "features": []}', "0 features; wanted exactly one"),
        (b'{"type": "FeatureCollection"}', "features is null"),
        (b'{"type": "Polygon"}', "polygon is null; wanted a list of rings"),
        (b'{"type": "Polygon", "coordinates": []}', "polygon has no ring"),
        (b'{"type": "MultiPolygon", "coordinates": []}', "empty"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 4], [0, 4]]]}', "ring 1 has 4 positions and is not closed"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [0, 0]]]}', "ring 1 has 3 positions and is closed"),
        (b'{"type": "Polygon", "coordinates": [[]]}', "ring 1 has 0 positions"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], [4, "x"], [4, 4], [0, 0]]]}', r"position 2 is \[4, \"x\"\]; wanted two numbers"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], [4, true], [4, 4], [0, 0]]]}', "wanted two numbers"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], 5, [4, 4], [0, 0]]]}', "position 2 is 5; wanted a list of two numbers"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], [4, NaN], [4, 4], [0, 0]]]}', "wanted finite numbers"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], [4, Infinity], [4, 4], [0, 0]]]}', "wanted finite numbers"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], [4, 1' + b"0" * 400 + b"], [4, 4], [0, 0]]]}", "wanted finite numbers"),
        (b'{"type": "Polygon", "coordinates": [[[0, 0], [2, 2], [2, 0], [0, 2], [0, 0]]]}', "Self-intersection"),
    ],
)  # fmt: skip
def test_every_fault_is_named(content: bytes, problem: str) -> None:
    with pytest.raises(ArenaError, match=problem) as caught:
        parse_arena(content, source="file.geojson")
    assert str(caught.value).startswith("file.geojson: ")


@given(st.binary(max_size=200))
def test_no_bytes_raise_anything_but_an_arena_error(content: bytes) -> None:
    with pytest.raises(ArenaError):
        parse_arena(content, source="noise")


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
)


@given(st.sampled_from(["Polygon", "MultiPolygon", "Feature", "FeatureCollection"]), JSON)
def test_no_json_raises_anything_but_an_arena_error(kind: str, inner: object) -> None:
    with pytest.raises(ArenaError):
        parse({"type": kind, "coordinates": inner, "geometry": inner, "features": inner})


def test_a_missing_file_and_a_directory_are_named(tmp_path: Path) -> None:
    with pytest.raises(ArenaError, match=r"none\.geojson: cannot be read: No such file"):
        load_arena(tmp_path / "none.geojson")
    with pytest.raises(ArenaError, match="cannot be read: Is a directory"):
        load_arena(tmp_path)


def test_a_byte_order_mark_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "bom.geojson"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(POLYGON).encode())
    assert load_arena(path).betti.holes == 1
