"""GeoJSON of real maps: as RFC 7946 has it, honest about its frame, and where the pins say."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from mapper.__main__ import main
from mapper.config import RecipeConfig, make_recipe
from mapper.errors import PinsError, PlaceError
from mapper.frames import TangentPlane
from mapper.geojson import to_geojson
from mapper.map_sketch import sketch_map
from mapper.pins import Pin, place_pins
from mapper.pipeline import compute_map
from mapper.places import LandmarkPlace
from mapper.polygons import signed_area
from mapper.report import to_json_object
from mapper.types import MapResult
from tests.mapper.worlds import FIRST_LANDMARK, NS, Row, table_of, walk_track

_N = 20
_RADIUS_M = 10.0 / np.pi  # a ring of 20 seconds at 1 m/s


@cache
def _ring(*, n_rings: int = 1) -> MapResult:
    """Map one ring, or two that nobody joins: the ids of the second are higher by 10,000, and it is walked for half as long."""
    rows: list[Row] = []
    spells = []
    for ring in range(n_rings):
        own, stood = walk_track(n_landmarks=_N, n_walkers=30, duration_s=120 / (1 + ring), seed=1 + ring, is_ring=True)
        rows += [(start, end, first + 10_000 * ring, second + 10_000 * ring) for start, end, first, second in own]
        spells += [replace(spell, node=type(spell.node)(spell.node + 10_000 * ring)) for spell in stood]
    return compute_map(table_of(rows), spells, make_recipe(RecipeConfig(speed_mps=1.0)))


def _where(landmark: int) -> tuple[float, float]:
    """Landmark k is k seconds around the ring: clockwise, about (100, 50), beginning in the north."""
    angle = np.pi / 2 - 2 * np.pi * landmark / _N
    return 100.0 + _RADIUS_M * float(np.cos(angle)), 50.0 + _RADIUS_M * float(np.sin(angle))


def _pins(*landmarks: int, plane: TangentPlane | None = None) -> list[Pin]:
    places = np.array([_where(landmark) for landmark in landmarks])
    at = places if plane is None else plane.to_degrees(places)
    return [
        Pin(place=LandmarkPlace(node=str(FIRST_LANDMARK + landmark)), at=(x, y), is_geographic=plane is not None)
        for landmark, (x, y) in zip(landmarks, at.tolist(), strict=True)
    ]


def _of_kind(document: Any, kind: str) -> list[Any]:
    return [feature for feature in document["features"] if feature["properties"]["kind"] == kind]


def _check_form(document: Any) -> None:
    """RFC 7946: ids, closed rings of four and more, outer ones counter-clockwise, holes clockwise; and no nan."""
    assert document["type"] == "FeatureCollection"
    assert len({feature["id"] for feature in document["features"]}) == len(document["features"])
    json.dumps(document, allow_nan=False)
    for feature in document["features"]:
        assert feature["type"] == "Feature"
        geometry = feature["geometry"]
        if geometry is None:
            continue
        assert shapely.geometry.shape(geometry).is_valid
        for number, ring in enumerate(geometry["coordinates"] if geometry["type"] == "Polygon" else []):
            assert ring[0] == ring[-1]
            assert len(ring) >= 4
            assert (signed_area(np.array(ring[:-1])) > 0) is (number == 0)


def test_without_pins_the_collection_says_that_it_is_not_wgs84() -> None:
    result = _ring()
    document = to_geojson(result)
    _check_form(document)
    frame = document["coordinate_frame"]
    assert isinstance(frame, dict)
    assert (frame["kind"], frame["is_wgs84"], frame["unit"]) == ("map", False, "m")
    assert len(_of_kind(document, "point")) == len(result.points)
    assert len(_of_kind(document, "landmark")) == _N
    (hole,) = _of_kind(document, "hole")
    assert hole["properties"]["area"] == result.holes[0].area
    assert shapely.geometry.shape(hole["geometry"]).area == pytest.approx(result.holes[0].area, rel=1e-4)
    (component,) = _of_kind(document, "component")
    assert len(component["geometry"]["coordinates"]) == 2


def test_pins_bring_landmarks_to_where_they_stood() -> None:
    """Whether the map has to be mirrored is seen from the landmarks between the pins."""
    pinned = place_pins(_pins(0, 6, 13), sketch_map(_ring()))
    document = to_geojson(_ring(), pinned=pinned)
    _check_form(document)
    for landmark in _of_kind(document, "landmark"):
        x, y = landmark["geometry"]["coordinates"]
        wanted = _where(landmark["properties"]["id"] - FIRST_LANDMARK)
        assert np.hypot(x - wanted[0], y - wanted[1]) < 0.15 * 2 * _RADIUS_M
    (hole,) = _of_kind(document, "hole")
    assert shapely.geometry.shape(hole["geometry"]).contains(shapely.Point(100.0, 50.0))
    scale = pinned.frame.fits[0].similarity.scale
    assert hole["properties"]["perimeter"] == pytest.approx(scale * float(_ring().holes[0].perimeter or 0.0))
    assert [pin["geometry"]["coordinates"] for pin in _of_kind(document, "pin")] == [
        [round(value, 6) for value in _where(landmark)] for landmark in (0, 6, 13)
    ]


def test_pins_in_degrees_give_wgs84() -> None:
    plane = TangentPlane(lon=179.9999, lat=47.0)
    in_metres = to_geojson(_ring(), pinned=place_pins(_pins(0, 6, 13), sketch_map(_ring())))
    in_degrees = to_geojson(_ring(), pinned=place_pins(_pins(0, 6, 13, plane=plane), sketch_map(_ring())))
    frame = in_degrees["coordinate_frame"]
    assert isinstance(frame, dict)
    assert (frame["kind"], frame["is_wgs84"], frame["unit"]) == ("wgs84", True, "m")
    metres, degrees = (
        np.array([landmark["geometry"]["coordinates"] for landmark in _of_kind(document, "landmark")])
        for document in (in_metres, in_degrees)
    )
    assert np.abs(degrees[:, 0]).max() <= 180.0
    assert np.allclose(plane.to_metres(degrees), metres, atol=1e-2)


def test_a_component_without_pins_is_not_put_into_the_frame() -> None:
    pinned = place_pins(_pins(0, 6, 13), sketch_map(_ring(n_rings=2)))
    assert any("no pins are in component 1" in warning for warning in pinned.warnings)
    document: Any = to_geojson(_ring(n_rings=2), pinned=pinned)
    _check_form(document)
    for feature in document["features"]:
        assert (feature["geometry"] is None) is (feature["properties"]["component"] == 1)
    assert len(_of_kind(document, "hole")) == 2


def test_each_component_has_its_own_pins() -> None:
    one = _pins(0, 6, 13)
    other = [
        Pin(place=LandmarkPlace(node=str(FIRST_LANDMARK + 10_000 + k)), at=(x + 40.0, y), is_geographic=False)
        for k, (x, y) in ((k, _where(k)) for k in (2, 9, 15))
    ]
    pinned = place_pins([*one, *other], sketch_map(_ring(n_rings=2)))
    assert pinned.frame.fits.keys() == {0, 1}
    holes = _of_kind(to_geojson(_ring(n_rings=2), pinned=pinned), "hole")
    for hole, middle in zip(holes, (100.0, 140.0), strict=True):
        assert shapely.geometry.shape(hole["geometry"]).contains(shapely.Point(middle, 50.0))
    with pytest.raises(PinsError, match="component 1: 1 pin"):
        place_pins([*one, other[0]], sketch_map(_ring(n_rings=2)))


def test_a_pin_of_what_the_map_does_not_show_is_told() -> None:
    with pytest.raises(PlaceError, match="is no landmark of the map"):
        place_pins([Pin(place=LandmarkPlace(node="77"), at=(0.0, 0.0), is_geographic=False)], sketch_map(_ring()))


def test_the_json_tells_polygons_that_are_closed_and_go_around_their_centres() -> None:
    document: Any = to_json_object(_ring())
    (hole,) = document["holes"]
    assert hole["outline_xy"][0] == hole["outline_xy"][-1]
    polygon = shapely.Polygon(hole["outline_xy"])
    assert polygon.is_valid
    assert polygon.exterior.is_ccw
    assert polygon.contains(shapely.Point(hole["centre"]))
    assert polygon.area == pytest.approx(hole["area"])
    assert all(hole[f"{name}_error"] > 0 for name in ("area", "perimeter"))
    assert [landmark["id"] for landmark in document["landmarks"]] != []


@pytest.fixture(scope="module")
def ring_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ring")
    rows, spells = walk_track(n_landmarks=_N, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    lines = [f"{max(start, 0) / NS:.3f},{max(end, 0) / NS:.3f},{first},{second}\n" for start, end, first, second in rows]
    (folder / "encounters.csv").write_text("t_start_s,t_end_s,id1,id2\n" + "".join(lines))
    (folder / "modes.csv").write_text("t_start_s,t_end_s,id,mode,cause\n" + "".join(f"-1,,{spell.node},S,command\n" for spell in spells))
    pins = [(FIRST_LANDMARK + k, *_where(k)) for k in (0, 6, 13)]
    (folder / "pins.csv").write_text("landmark,x,y\n" + "".join(f"{node},{x},{y}\n" for node, x, y in pins))
    return folder


def test_the_commands_write_and_read_all_of_it(ring_files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    encounters, modes, map_json = ring_files / "encounters.csv", ring_files / "modes.csv", tmp_path / "map.json"
    given = ["run", encounters, "--modes", modes, "--speed-mps", "1", "--pins", ring_files / "pins.csv", "--json", map_json]
    given += ["--geojson", tmp_path / "map.geojson", "--svg", tmp_path / "map.svg"]
    assert main([*map(str, given)]) == 0
    assert "pins 0         3 for component 0" in capsys.readouterr().out
    document = json.loads(map_json.read_text())
    frame = document["operator_frame"]
    assert len(frame["components"][0]["pins"]) == 3
    assert shapely.Polygon(frame["holes"][0]["outline_xy"]).contains(shapely.Point(100.0, 50.0))
    _check_form(json.loads((tmp_path / "map.geojson").read_text()))
    assert "operator" in (tmp_path / "map.svg").read_text()
    asked = ["--from", f"landmark:{FIRST_LANDMARK}", "--to", f"landmark:{FIRST_LANDMARK + 8}", "--json"]
    found = []
    for source in ([encounters, "--modes", modes, "--speed-mps", "1"], [map_json]):
        assert main(["route", *map(str, source), *asked]) == 0
        found.append(json.loads(capsys.readouterr().out))
    for answer in found:
        first, second = (route["length"] for route in answer["routes"])
        # Eight and twelve of twenty seconds around, one way and the other.
        assert first == pytest.approx(8.0, rel=0.25)
        assert second == pytest.approx(12.0, rel=0.25)
    assert [route["length"] for route in found[0]["routes"]] == pytest.approx([route["length"] for route in found[1]["routes"]], rel=1e-4)


def test_what_cannot_be_done_is_told(ring_files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    encounters = str(ring_files / "encounters.csv")
    (tmp_path / "map.json").write_text("{}")
    (tmp_path / "line.csv").write_text("landmark,x,y\n1001,0,0\n1006,1,1\n1014,2,2\n")
    modes = ["--modes", str(ring_files / "modes.csv")]
    for arguments, reason in (
        (["route", encounters, "--from", "here", "--to", "point:0"], "is no place"),
        (["route", encounters, *modes, "--from", "landmark:7", "--to", "point:0"], "is no landmark of the map"),
        (["route", str(tmp_path / "map.json"), "--from", "point:1", "--to", "point:0"], "no map that can be used"),
        (["route", str(tmp_path / "none.json"), "--from", "point:1", "--to", "point:0"], "cannot be read"),
        (["run", encounters, *modes, "--pins", str(tmp_path / "line.csv")], "on one line"),
        (["run", encounters, *modes, "--pins", str(tmp_path / "none.toml")], "no such file"),
    ):
        assert main(arguments) == 1
        assert reason in capsys.readouterr().err
