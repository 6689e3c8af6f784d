"""What a log, pins and places must not say: encounters twice, one place at two, and places that the map does not reach."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.__main__ import main
from mapper.config import RecipeConfig, make_recipe
from mapper.errors import InputFileError, PlaceError
from mapper.map_sketch import MapSketch, sketch_map
from mapper.pins import read_pins
from mapper.pipeline import compute_map
from mapper.places import find_place, parse_place
from mapper.window import drop_repeated
from tests.mapper.worlds import NS, Row, encounter_rows, table_of, walk_track

_ROWS, _SPELLS = walk_track(n_landmarks=20, n_walkers=10, duration_s=60, seed=1, is_ring=True)


def _lines(rows: list[Row]) -> str:
    return "".join(f"{begin / NS:.9f},{end / NS:.9f},{one},{other}\n" for begin, end, one, other in rows)


@pytest.fixture(scope="module")
def sketch() -> MapSketch:
    table = table_of(_ROWS)
    return sketch_map(compute_map(table, _SPELLS, make_recipe(RecipeConfig(replicates=0)), also_place=np.arange(len(table))))


@given(encounter_rows(max_size=20, n_biobots=4), st.data())
def test_encounters_told_again_are_left_out_and_counted(rows: list[Row], data: st.DataObject) -> None:
    alone = sorted(set(table_rows(rows)))
    again = data.draw(st.lists(st.sampled_from(alone), max_size=10)) if alone else []
    table, n_repeated = drop_repeated(table_of(alone + again))
    assert n_repeated == len(again)
    assert sorted(zip(table.t_start_ns.tolist(), table.t_end_ns.tolist(), table.id1.tolist(), table.id2.tolist(), strict=True)) == alone


def table_rows(rows: list[Row]) -> list[Row]:
    return [(begin, end, min(one, other), max(one, other)) for begin, end, one, other in rows]


@pytest.mark.parametrize("command", ["run", "merge"])
def test_rows_told_twice_make_the_same_map_and_a_warning(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    maps = []
    for name, rows in (("once", _ROWS), ("twice", _ROWS + _ROWS[:50])):
        path = tmp_path / f"{name}.csv"
        path.write_text("t_start_s,t_end_s,id1,id2\n" + _lines(rows))
        stationary = ",".join(str(spell.node) for spell in _SPELLS)
        assert main([command, str(path), "--stationary", stationary, "--json", str(tmp_path / f"{name}.json")]) == 0
        maps.append(json.loads((tmp_path / f"{name}.json").read_text()))
    assert maps[0]["intervals"] == maps[1]["intervals"]
    assert maps[0]["n_encounters"] == maps[1]["n_encounters"] == len(_ROWS)
    (warning,) = set(maps[1]["warnings"]) - set(maps[0]["warnings"])
    assert warning.startswith("50 rows repeat another one")
    if command == "run":
        assert [{one["name"]: one["holds"] for one in document["assumptions"]}["clean_rows"] for document in maps] == [True, False]


@pytest.mark.parametrize(
    ("place", "told"),
    [
        ("xy:1000,1000", r"from the nearest point of the map, at most .* \(cover radii, .*\) .*point:"),
        ("biobot:3@5000", r"s from its nearest encounter on the map, at most .* a quarter.*the nearest is at"),
        ("biobot:3@-5000", r"s from its nearest encounter on the map"),
    ],
)
def test_places_that_the_map_does_not_reach_are_refused_with_the_limit_and_the_nearest(place: str, told: str, sketch: MapSketch) -> None:
    with pytest.raises(PlaceError, match=told):
        find_place(parse_place(place), sketch)


def test_places_on_the_map_are_found(sketch: MapSketch) -> None:
    x, y = sketch.xy[5].tolist()
    for place in (f"xy:{x},{y}", "biobot:3@30", "biobot:3"):
        assert find_place(parse_place(place), sketch).component == 0


def test_pins_given_twice_count_once_and_one_thing_at_two_places_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "pins.csv"
    path.write_text("landmark,x,y\n1,0,0\n2,5,0\n4,0,7\n1,0,0\n")
    assert len(read_pins(path)) == 3
    path.write_text("landmark,x,y\n1,0,0\n2,5,0\n4,0,7\n1,99,99\n")
    with pytest.raises(InputFileError, match="landmark:1 is put at 0,0 and at 99,99"):
        read_pins(path)


def test_dates_with_and_without_a_zone_in_one_log_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "log.csv"
    path.write_text("start,end,id1,id2\n2026-05-04T12:00:00+02:00,2026-05-04T12:00:05,1,2\n")
    assert main(["run", str(path)]) == 1
    assert "some dates have a time zone and others have none" in capsys.readouterr().err
