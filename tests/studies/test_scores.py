"""Scores: known by hand for made-up maps, consistent between a map and its JSON, and clear about files that do not fit."""

import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Point, Polygon, box

from mapper.config import RecipeConfig, make_recipe
from mapper.embedding import embed_in_plane
from mapper.encounter_csv import read_encounters, read_modes
from mapper.pipeline import compute_map
from mapper.report import JsonObject, to_json_object
from mapper.types import MapResult, Method
from simulator.arenas.arena import build_arena
from simulator.arenas.geodesics import geodesic_distances
from simulator.arenas.geojson import dump_arena
from simulator.config import RunConfig
from simulator.run import run
from studies.errors import MapFileError, OtherRunError, RunDirectoryError
from studies.scores import count_enclosed, describe, main, score_map, signal_to_noise, winding_number
from studies.truth import diagram_of, find_encounters, load_run, obstacle_points, true_distances

pytestmark = pytest.mark.xdist_group("scores")
"""What they share is made once, by one worker."""

Floats = NDArray[np.float64]

ROOM = box(0, 0, 10, 10)


def without(*obstacles: Polygon, room: Polygon = ROOM) -> Polygon:
    shape = room
    for obstacle in obstacles:
        rest = shape.difference(obstacle)
        assert isinstance(rest, Polygon)
        shape = rest
    return shape


RING = without(box(3, 3, 7, 7))


@pytest.fixture(scope="module")
def run_directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("runs") / "two"
    run(RunConfig(scenario="two-obstacles", seed=5, out=str(directory)))
    return directory


@pytest.fixture(scope="module")
def map_of_run(run_directory: Path) -> MapResult:
    recipe = make_recipe(RecipeConfig(method=Method.PAPER))
    return compute_map(read_encounters(run_directory / "encounters.csv"), read_modes(run_directory / "modes.csv"), recipe)


@pytest.fixture(scope="module")
def map_text(map_of_run: MapResult) -> str:
    return json.dumps(to_json_object(map_of_run))


@pytest.fixture
def map_json(map_text: str) -> JsonObject:
    document: JsonObject = json.loads(map_text)
    return document


def make_run(directory: Path, shape: Polygon | MultiPolygon, places: Floats, **further: object) -> Path:
    """Write a run of one encounter a place: at place k biobots 2k+1 and 2k+2 meet from second k to k + 0.5; they walk 1 a second."""
    directory.mkdir()
    rows = [f"{k}.0,{k}.5,{2 * k + 1},{2 * k + 2}" for k in range(len(places))]
    (directory / "encounters.csv").write_text("\n".join(["t_start_s,t_end_s,id1,id2", *rows]) + "\n")
    (directory / "arena.geojson").write_text(dump_arena(build_arena(shape)))
    (directory / "run.json").write_text(json.dumps({"unit_of_length": "unit", "parameters": {"speed": 1.0}, **further}))
    file = io.BytesIO()
    np.savez(file, encounter_position=places, t_s=np.zeros(1), ids=np.ones(1, dtype=np.int64), position=np.zeros((1, 1, 2)))
    (directory / "truth.npz").write_bytes(file.getvalue())
    return directory


def make_map(distances: Floats, *, holes: list[list[int]], zero_s: float = 0.0, **further: object) -> dict[str, object]:
    """Make the JSON of a map with these distances in seconds: its diagram, and its picture by classical MDS."""
    xy = embed_in_plane(distances).coordinates
    intervals = diagram_of(distances)
    return {
        "betti_numbers": [1, len(holes)],
        "intervals": {
            str(dimension): [[birth, death if np.isfinite(death) else None] for birth, death in intervals[dimension].tolist()]
            for dimension in (0, 1)
        },
        "points": [
            {"x": x, "y": y, "t": zero_s + k + 0.25, "id1": 2 * k + 2, "id2": 2 * k + 1, "component": 0}
            for k, (x, y) in enumerate(xy.tolist())
        ],
        "holes": [{"points": hole} for hole in holes],
        "diameter": float(distances.max()),
        "parameters": {"length_unit": "s", "speed_mps": None},
        **further,
    }


def ring_places() -> Floats:
    """32 places around the hole of ``RING``, on a square of side 6, counter-clockwise."""
    steps = np.arange(8) * 0.75 + 2
    low, high = np.full(8, 2.0), np.full(8, 8.0)
    sides = [(steps, low), (high, steps), (10 - steps, high), (low, 10 - steps)]
    return np.vstack([np.column_stack(side) for side in sides])


def test_a_map_that_is_the_truth_has_no_error(tmp_path: Path) -> None:
    places = ring_places()
    exact = geodesic_distances(build_arena(RING), places)
    scores = score_map(make_map(exact, holes=[list(range(32))]), make_run(tmp_path / "run", RING, places))
    assert scores.betti_errors == (0, 0)
    assert scores.bottleneck == pytest.approx((0, 0), abs=1e-12)
    assert scores.sensitivity == 1
    assert (scores.n_obstacles_found, scores.n_holes_false) == (1, 0)
    assert scores.true_diameter == exact.max()
    assert scores.time_error_s == 0
    assert scores.placement_error == pytest.approx(scores.placement_error_of_exact)
    assert scores.placement_error < 0.1


def test_speed_turns_seconds_into_lengths_and_nothing_is_fitted(tmp_path: Path) -> None:
    """Distances 10 % too long move a bar of the diagram by 10 % of its death at most, and the picture, being fitted, not at all."""
    places = ring_places()
    exact = geodesic_distances(build_arena(RING), places)
    directory = make_run(tmp_path / "run", RING, places, parameters={"speed": 0.5}, speed_factor=4.0)
    right = score_map(make_map(exact / 2, holes=[]), directory)
    long = score_map(make_map(1.1 * exact / 2, holes=[]), directory)
    told = score_map(make_map(exact / 3, holes=[]), directory, speed=3.0)
    in_metres = make_map(7 * exact / 2, holes=[]) | {"parameters": {"length_unit": "m", "speed_mps": 7.0}}
    assert right.bottleneck == pytest.approx((0, 0), abs=1e-12)
    assert told.bottleneck == pytest.approx((0, 0), abs=1e-12)
    assert score_map(in_metres, directory).bottleneck == pytest.approx((0, 0), abs=1e-12)
    _, loops = diagram_of(exact)
    assert long.bottleneck[1] == pytest.approx(0.1 * loops[0, 1])
    assert long.bottleneck_share[1] == pytest.approx(0.1 * loops[0, 1] / exact.max())
    assert long.placement_error == pytest.approx(right.placement_error)


def test_a_mirrored_map_is_as_good(tmp_path: Path) -> None:
    places = ring_places()
    directory = make_run(tmp_path / "run", RING, places)
    scores = []
    for mirror in (1.0, -1.0):
        document = make_map(geodesic_distances(build_arena(RING), places), holes=[])
        points = [
            {"t": k + 0.25, "id1": 2 * k + 1, "id2": 2 * k + 2, "x": 3 * x, "y": 3 * mirror * y} for k, (x, y) in enumerate(places.tolist())
        ]
        scores.append(score_map(document | {"points": points}, directory))
    assert scores[0].placement_error == pytest.approx(0, abs=1e-12)
    assert scores[1].placement_error == pytest.approx(0, abs=1e-12)


def test_each_obstacle_counts_once_and_each_hole_for_one(tmp_path: Path) -> None:
    """Three holes of the map: two around the one obstacle, one around nothing."""
    places = ring_places()
    document = make_map(geodesic_distances(build_arena(RING), places), holes=[list(range(32)), list(range(0, 32, 2)), [0, 1, 2]])
    scores = score_map(document, make_run(tmp_path / "run", RING, places))
    assert (scores.n_obstacles, scores.n_obstacles_found, scores.n_holes_false) == (1, 1, 2)
    assert scores.betti_errors == (0, 2)


def test_an_arena_without_obstacle_has_neither_sensitivity_nor_signal(tmp_path: Path) -> None:
    places = ring_places()
    document = make_map(geodesic_distances(build_arena(ROOM), places), holes=[])
    scores = score_map(document, make_run(tmp_path / "run", ROOM, places))
    assert scores.sensitivity is None
    assert scores.snr is None
    assert scores.placement_error == pytest.approx(0, abs=1e-9)
    assert any("not known" in line for line in describe(scores))


def test_a_map_in_pieces_of_rooms_apart_is_scored(tmp_path: Path) -> None:
    """Two rooms, mapped as two components at their own places: nothing is wrong with that."""
    rooms = MultiPolygon([box(0, 0, 4, 10), box(6, 0, 10, 10)])
    places = np.array([[1.0, 1.0], [3.0, 2.0], [1.0, 9.0], [7.0, 1.0], [9.0, 2.0], [7.0, 9.0]])
    exact = geodesic_distances(build_arena(rooms), places)
    intervals = diagram_of(exact)
    assert np.isinf(intervals[0][:, 1]).sum() == 2
    document = make_map(np.where(np.isfinite(exact), exact, 0), holes=[])
    points = [
        {"t": k + 0.25, "id1": 2 * k + 1, "id2": 2 * k + 2, "x": x + 100 * (k > 2), "y": y, "component": k // 3}
        for k, (x, y) in enumerate(places.tolist())
    ]
    bars = {"0": [[0, None if np.isinf(death) else death] for death in intervals[0][:, 1].tolist()], "1": []}
    scores = score_map(document | {"points": points, "intervals": bars, "betti_numbers": [2, 0]}, make_run(tmp_path / "run", rooms, places))
    assert (scores.n_components, scores.betti_errors) == (2, (0, 0))
    assert scores.placement_error == pytest.approx(0, abs=1e-12)
    assert scores.bottleneck == pytest.approx((0, 0), abs=1e-12)


def test_times_of_a_served_run_are_on_the_wall_clock(tmp_path: Path) -> None:
    places = ring_places()
    zero_s = 1_800_000_000
    document = make_map(geodesic_distances(build_arena(RING), places), holes=[], zero_s=zero_s + 0.125)
    scores = score_map(document, make_run(tmp_path / "run", RING, places, t0_wall_ns=zero_s * 10**9))
    assert scores.time_error_s == pytest.approx(0.125, abs=1e-6)
    assert scores.metric_error_median is None


def test_an_encounter_is_found_by_its_pair_and_the_time_it_went_on(tmp_path: Path) -> None:
    directory = make_run(tmp_path / "run", RING, ring_places()[:3])
    (directory / "encounters.csv").write_text("t_start_s,t_end_s,id1,id2\n0,100,1,2\n101,102,1,2\n130,131,2,1\n")
    ids = np.ones(4, dtype=np.int64)
    rows, error_s = find_encounters(load_run(directory), t_s=np.array([99.0, 100.6, 129.0, 50.0]), id1=ids, id2=2 * ids)
    assert rows.tolist() == [0, 1, 2, 0]
    assert error_s.tolist() == pytest.approx([49.0, 0.9, 1.5, 0.0])


def test_a_map_and_its_json_have_the_same_scores(run_directory: Path, map_of_run: MapResult, map_json: JsonObject) -> None:
    scores = score_map(map_of_run, run_directory)
    assert scores == score_map(map_json, run_directory)
    assert scores.metric_error_median is not None
    assert 0.01 < scores.metric_error_median < 1
    assert scores.metric_error_rms is not None
    assert scores.placement_error_of_exact is not None
    assert 0.001 < scores.placement_error_of_exact < 0.06
    assert scores.placement_error_of_exact < scores.placement_error < 0.3
    assert scores.true_betti_numbers == (1, 2)
    assert scores.time_error_s < 1e-8


def test_the_truth_of_a_run_is_exact(run_directory: Path) -> None:
    """The diagram of 150 encounters, evenly spread, has the two obstacles as its two longest loops, far longer than the third."""
    truth = load_run(run_directory)
    rows = np.arange(0, len(truth.encounters), 3)
    distances = true_distances(truth, rows)
    picked = [0]
    while len(picked) < 150:
        picked.append(int(distances[picked].min(axis=0).argmax()))
    _, loops = diagram_of(distances[np.ix_(picked, picked)])
    lengths = loops[:, 1] - loops[:, 0]
    assert (truth.betti.components, truth.betti.holes, truth.side) == (1, 2, 50.0)
    assert lengths[1] > 4 * lengths[2:].max(initial=0)
    straight = np.linalg.norm(truth.encounter_position[rows][:, None] - truth.encounter_position[rows], axis=2)
    assert np.all(distances >= straight - 1e-12)


def test_another_run_is_refused(tmp_path: Path, map_json: JsonObject, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other"
    run(RunConfig(scenario="no-obstacle", seed=6, out=str(other)))
    with pytest.raises(OtherRunError, match="points of the map are no encounters of this run"):
        score_map(map_json, other)
    (tmp_path / "map.json").write_text(json.dumps(map_json))
    assert main([str(other), str(tmp_path / "map.json")]) == 1
    assert "error: " in capsys.readouterr().err


def test_the_command_prints_lines_or_json(
    tmp_path: Path, run_directory: Path, map_of_run: MapResult, map_json: JsonObject, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "map.json").write_text(json.dumps(map_json))
    scores = score_map(map_of_run, run_directory)
    assert main([str(run_directory), str(tmp_path / "map.json")]) == 0
    assert capsys.readouterr().out == "\n".join(describe(scores)) + "\n"
    assert main([str(run_directory), str(tmp_path / "map.json"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["bottleneck"] == list(scores.bottleneck)
    assert document["sensitivity"] == scores.sensitivity
    with pytest.raises(SystemExit, match="2"):
        main([str(run_directory), str(tmp_path / "map.json"), "--speed", "-1"])


@pytest.mark.parametrize("content", [b"", b"\xff\x00rubbish", b"[1]", b"{}", b'{"points": []}', b"[" * 100_000])
def test_a_file_that_is_no_map_is_named(tmp_path: Path, run_directory: Path, content: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "map.json").write_bytes(content)
    assert main([str(run_directory), str(tmp_path / "map.json")]) == 1
    assert "biobot-mapper run --json" in capsys.readouterr().err


def test_a_hole_around_points_that_are_not_there_is_refused(run_directory: Path, map_json: JsonObject) -> None:
    with pytest.raises(MapFileError, match="beyond"):
        score_map(map_json | {"holes": [{"points": [0, 1, 10_000]}]}, run_directory)


@pytest.mark.parametrize("name", ["run.json", "truth.npz", "encounters.csv", "arena.geojson"])
@pytest.mark.parametrize("break_it", [Path.unlink, lambda path: path.write_bytes(b"rubbish\xff")])
def test_a_broken_run_is_named(
    tmp_path: Path,
    run_directory: Path,
    map_json: JsonObject,
    name: str,
    break_it: Callable[[Path], object],
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(run_directory, tmp_path / "run")
    break_it(tmp_path / "run" / name)
    (tmp_path / "map.json").write_text(json.dumps(map_json))
    assert main([str(tmp_path / "run"), str(tmp_path / "map.json")]) == 1
    assert name in capsys.readouterr().err


def test_arrays_of_another_run_are_refused(tmp_path: Path) -> None:
    directory = make_run(tmp_path / "run", RING, ring_places())
    with (directory / "encounters.csv").open("a") as file:
        file.write("50.0,51.0,1,2\n")
    with pytest.raises(RunDirectoryError, match="33 rows"):
        load_run(directory)


@pytest.mark.parametrize(
    ("shape", "n_obstacles"),
    [
        (ROOM, 0),
        (RING, 1),
        (without(box(2, 2, 5, 5), box(5, 5, 8, 8)), 1),
        (without(Polygon([(0, 5), (3, 4), (3, 6)])), 0),
        (without(Point(3, 3).buffer(1), Polygon([(5, 5), (9, 5), (9, 9), (8, 9), (8, 6), (5, 6)])), 2),
        (MultiPolygon([RING, box(4, 4, 6, 6)]), 1),
        (MultiPolygon([box(0, 0, 4, 10), without(box(7, 4, 9, 6), room=box(6, 0, 10, 10))]), 1),
    ],
)
def test_obstacles_are_what_the_betti_numbers_count(shape: Polygon | MultiPolygon, n_obstacles: int) -> None:
    arena = build_arena(shape)
    points = obstacle_points(arena)
    assert len(points) == arena.betti.holes == n_obstacles
    assert not any(arena.polygon.intersects(Point(point)) for point in points)


@given(st.integers(3, 40), st.floats(0, 6), st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.integers(-2, 2))
def test_an_outline_winds_as_often_as_it_goes_round(corners: int, phase: float, x: float, y: float, turns: int) -> None:
    """A polygon of many corners holds a disc of 0.49 of its radius even as a triangle."""
    angle = phase + 2 * np.pi * np.arange(corners * max(abs(turns), 1)) * np.sign(turns) / corners
    outline = np.column_stack([np.cos(angle), np.sin(angle)])
    assert winding_number(outline, 0.35 * np.array([x, y])) == turns
    assert winding_number(outline, np.array([3.0 + x, y])) == 0


def test_outlines_are_matched_so_that_most_count() -> None:
    """The wide outline goes round both points; taken first for the left one, it would leave the narrow outline nothing."""
    wide = np.array([[-1.0, -1.0], [5.0, -1.0], [5.0, 1.0], [-1.0, 1.0]])
    narrow = wide * (0.3, 1.0)
    points = np.array([[0.0, 0.0], [4.0, 0.0]])
    assert count_enclosed([wide, narrow], points) == 2
    assert count_enclosed([wide], points) == 1
    assert count_enclosed([], points) == 0
    assert count_enclosed([wide], points[:0]) == 0


def test_signal_to_noise_compares_mean_squares() -> None:
    """Lengths 4 and 2 over lengths 1 and 1: (16 + 4) / 2 over 1."""
    loops = np.array([[1.0, 2.0], [0.0, 4.0], [3.0, 4.0], [1.0, 3.0]])
    assert signal_to_noise(loops, n_signals=2) == 10
    assert signal_to_noise(loops, n_signals=0) is None
    assert signal_to_noise(loops, n_signals=4) is None
