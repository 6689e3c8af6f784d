"""Laws of a whole run's files."""

import csv
import io
import json
from dataclasses import fields
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely

from firmware_protocol.errors import ConfigurationError
from simulator.arenas.geojson import load_arena
from simulator.arenas.scenarios import SCENARIOS
from simulator.config import RunConfig
from simulator.errors import ArenaError, OutputError, ParameterError, ScenarioError
from simulator.log import set_up_logging
from simulator.motion import MotionParameters
from simulator.output import OutputDirectory
from simulator.presets import PRESETS
from simulator.progress import shown_progress
from simulator.run import run
from simulator.setting import choose_setting

FILES = ["arena.geojson", "encounters.csv", "modes.csv", "run.json", "truth.npz"]


def config(out: Path, /, **changed: object) -> RunConfig:
    fields: dict[str, object] = {"scenario": "two-obstacles", "seed": 1, "out": str(out), "biobots": 60, "duration_s": 60.0}
    return RunConfig(**(fields | changed))  # type: ignore[arg-type]  # fields of different types, by name


def read(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text())))


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "out"
    run(config(out))
    return out


def test_a_run_leaves_its_five_files_and_nothing_else(results: Path) -> None:
    assert sorted(path.name for path in results.iterdir()) == FILES
    assert [path.name for path in results.parent.iterdir()] == ["out"]


def test_rows_of_encounters_are_in_canonical_order(results: Path) -> None:
    assert (results / "encounters.csv").read_bytes().startswith(b"t_start_s,t_end_s,id1,id2\n")
    rows = [(float(r["t_start_s"]), float(r["t_end_s"]), int(r["id1"]), int(r["id2"])) for r in read(results / "encounters.csv")]
    assert len(rows) > 100
    assert rows == sorted(rows)
    assert all(0 <= start <= end <= 60 and 1 <= first < second <= 60 for start, end, first, second in rows)
    assert rows[0][0] == 0
    assert max(row[1] for row in rows) == 60


def test_no_pair_meets_twice_at_once(results: Path) -> None:
    spells: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in read(results / "encounters.csv"):
        spells.setdefault((row["id1"], row["id2"]), []).append((float(row["t_start_s"]), float(row["t_end_s"])))
    for times in spells.values():
        assert all(earlier[1] <= later[0] for earlier, later in pairwise(times))


def test_landmarks_stand_by_command_all_the_time_and_others_walk(results: Path) -> None:
    rows = read(results / "modes.csv")
    assert list(rows[0]) == ["t_start_s", "t_end_s", "id", "mode", "cause"]
    assert {(row["t_start_s"], row["t_end_s"]) for row in rows} == {("0.000000000", "60.000000000")}
    landmarks = json.loads((results / "run.json").read_text())["landmark_ids"]
    assert len(landmarks) == 8  # 60 * 20 / 150
    assert {int(row["id"]) for row in rows if (row["mode"], row["cause"]) == ("S", "command")} == set(landmarks)
    assert {int(row["id"]) for row in rows if (row["mode"], row["cause"]) == ("CRW", "natural")} == set(range(1, 61)) - set(landmarks)


def test_truth_is_where_both_were(results: Path) -> None:
    truth = np.load(results / "truth.npz")
    rows = read(results / "encounters.csv")
    assert sorted(truth.files) == ["encounter_position", "ids", "position", "t_s"]
    assert truth["encounter_position"].shape == (len(rows), 2)
    assert truth["position"].shape == (truth["t_s"].size, 60, 2)
    assert truth["ids"].tolist() == list(range(1, 61))
    assert truth["t_s"][[0, -1]].tolist() == [0, 60]
    arena = load_arena(results / "arena.geojson")
    assert shapely.contains_xy(arena.polygon, *truth["position"].reshape(-1, 2).T).all()
    # At unit speed each is within 0.15 s of walk of its nearest sample, and within half a radius of the middle.
    centre_s = np.array([(float(row["t_start_s"]) + float(row["t_end_s"])) / 2 for row in rows])
    sample = np.abs(truth["t_s"][:, None] - centre_s).argmin(axis=0)
    for name in ("id1", "id2"):
        at = truth["position"][sample, [int(row[name]) - 1 for row in rows]]
        assert np.hypot(*(at - truth["encounter_position"]).T).max() <= 0.5 + 0.15 + 1e-6


def test_run_json_says_what_was_run(results: Path) -> None:
    described = json.loads((results / "run.json").read_text())
    assert described["preset"] == "paper-units"
    assert described["arena"] == "two-obstacles"
    assert described["betti_numbers"] == [1, 2]
    assert described["seed"] == 1
    assert described["parameters"]["communication_radius"] == 8 * described["parameters"]["detection_radius"]
    assert described["counts"]["encounters"] == len(read(results / "encounters.csv"))


def test_same_seed_same_bytes(results: Path, tmp_path: Path) -> None:
    run(config(tmp_path / "again"))
    for name in FILES:
        if name != "run.json":  # it tells how long the run took
            assert (tmp_path / "again" / name).read_bytes() == (results / name).read_bytes()
    run(config(tmp_path / "other", seed=2))
    assert (tmp_path / "other" / "encounters.csv").read_bytes() != (results / "encounters.csv").read_bytes()


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("scenario", "holes"), [("no-obstacle", 0), ("one-obstacle", 1), ("two-obstacles", 2)])
def test_every_scenario_has_its_holes_in_both_presets(preset: str, scenario: str, holes: int) -> None:
    arena = SCENARIOS[scenario].build(PRESETS[preset].side)
    assert (arena.betti.components, arena.betti.holes) == (1, holes)
    assert arena.bounds == (0, 0, PRESETS[preset].side, PRESETS[preset].side)


def test_every_value_of_a_preset_has_its_source() -> None:
    wanted = {"side", "speed", "mean_leg", "detection", "communication", "biobots", "landmarks", "duration_s", "dispersion_s"}
    for preset in PRESETS.values():
        plain = MotionParameters(speed=preset.motion.speed, mean_leg=preset.motion.mean_leg)
        names = {one.name for one in fields(plain)}
        special = {name for name in names if getattr(plain, name) != getattr(preset.motion, name)}
        assert wanted | special <= preset.sources.keys() <= wanted | names


def test_without_dispersion_and_with_landmarks_only(tmp_path: Path) -> None:
    run(config(tmp_path / "out", biobots=5, landmarks=5, dispersion_s=0.0, scenario="no-obstacle"))
    assert {row["mode"] for row in read(tmp_path / "out" / "modes.csv")} == {"S"}


def test_a_door_closes_at_half_time_and_nobody_passes_after(tmp_path: Path) -> None:
    """At unit speed in 60 s, some of 60 insects pass the door 10 wide in the first half, and none in the second."""
    run(config(tmp_path / "out", scenario="closing-door"))
    described = json.loads((tmp_path / "out" / "run.json").read_text())
    assert described["betti_numbers"] == [1, 2]
    assert described["arena_changes"] == [{"at_s": 30.0, "betti_numbers_after": [2, 2], "file": "arena_1.geojson"}]
    first, after = (load_arena(tmp_path / "out" / name) for name in ("arena.geojson", "arena_1.geojson"))
    assert (first.betti.components, after.betti.components, after.betti.holes) == (1, 2, 2)
    truth = np.load(tmp_path / "out" / "truth.npz")
    is_left = truth["position"][:, :, 0] < 25
    assert np.any(is_left[truth["t_s"] < 30] != is_left[0])
    assert np.all(is_left[truth["t_s"] > 30] == is_left[-1])
    late = truth["position"][truth["t_s"] > 30]
    assert shapely.contains_xy(after.polygon, *late.reshape(-1, 2).T).all()


def test_one_biobot_alone_meets_nobody(tmp_path: Path) -> None:
    run(config(tmp_path / "out", biobots=1))
    assert read(tmp_path / "out" / "encounters.csv") == []
    assert np.load(tmp_path / "out" / "truth.npz")["encounter_position"].shape == (0, 2)


def test_separate_rooms_share_the_landmarks_by_size(tmp_path: Path) -> None:
    """Rooms far apart: the radio graph has a cluster in each, and the larger gets more landmarks."""
    big, small = [[0, 0], [20, 0], [20, 20], [0, 20], [0, 0]], [[100, 0], [110, 0], [110, 10], [100, 10], [100, 0]]
    path = tmp_path / "rooms.geojson"
    path.write_text(json.dumps({"type": "MultiPolygon", "coordinates": [[big], [small]]}))
    run(config(tmp_path / "out", scenario=None, arena=str(path), biobots=50, landmarks=10))
    truth = np.load(tmp_path / "out" / "truth.npz")
    landmarks = json.loads((tmp_path / "out" / "run.json").read_text())["landmark_ids"]
    in_small = truth["position"][0, :, 0] > 50
    assert abs(sum(in_small[one - 1] for one in landmarks) - 10 * in_small.mean()) < 1


@pytest.mark.parametrize(
    ("changed", "error", "problem"),
    [
        ({"scenario": None}, ConfigurationError, "give --scenario NAME or --arena FILE"),
        ({"seed": None}, ConfigurationError, "give --seed N"),
        ({"out": None}, ConfigurationError, "give --out DIR"),
        ({"scenario": "moon"}, ScenarioError, "no scenario is called 'moon'; choose one of no-obstacle, one-obstacle, two-obstacles"),
        ({"preset": "hexbug"}, ScenarioError, "no preset is called 'hexbug'"),
        ({"landmarks": 61}, ParameterError, "landmarks is 61; wanted at most the number of biobots, 60"),
        ({"scenario": None, "arena": "/nowhere.geojson"}, ArenaError, "cannot be read"),
        ({"biobots": 100_000}, ParameterError, "number of encounters to expect"),
        ({"mean_leg": 1e-9}, ParameterError, "number of legs to walk"),
        ({"detection_radius": 1e-6}, ParameterError, "same unit of length"),
        ({"detection_radius": 71.0}, ParameterError, r"detection radius is 71.0; wanted less than 70.7107 unit, .*same unit of length"),
        ({"detection_radius": 40.0, "biobots": 20_000, "duration_s": 0.1}, ParameterError, "number of looks of biobots at each other"),
        ({"beacon_period_s": 0.001, "sensing": "beacon", "communication_radius": 70.0}, ParameterError, "number of beacons to be heard"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is_written(
    tmp_path: Path, changed: dict[str, object], error: type[Exception], problem: str
) -> None:
    with pytest.raises(error, match=problem):
        run(config(tmp_path / "out", **changed))
    assert list(tmp_path.iterdir()) == []


def test_long_work_says_how_far_it_is_where_nobody_sees_a_bar(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    set_up_logging()
    with shown_progress("run.progress", total=60.0, unit="s", every_s=0.0) as show:
        show(12.5)
    assert json.loads(capsys.readouterr().err) | {"time": ""} == {
        "time": "", "level": "INFO", "event": "run.progress", "done": 12.5, "of": 60.0, "unit": "s"
    }  # fmt: skip
    with shown_progress("run.progress", total=60.0, unit="s", every_s=3600.0) as show:
        show(12.5)
    assert capsys.readouterr().err == ""


def test_a_detection_radius_alone_scales_the_communication_radius(tmp_path: Path) -> None:
    ranges = choose_setting(config(tmp_path, detection_radius=2.0)).ranges
    assert (ranges.detection, ranges.communication) == (2.0, 16.0)


def test_a_directory_in_use_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(OutputError, match=r"is not empty; choose another directory, or give --force"):
        run(config(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_force_replaces_an_earlier_run_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    (tmp_path / "run.json").write_text("old")
    run(config(tmp_path, force=True))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*FILES, "mine.txt"])
    assert json.loads((tmp_path / "run.json").read_text())["seed"] == 1


def test_an_empty_directory_is_used(tmp_path: Path) -> None:
    run(config(tmp_path))
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is not a directory"):
        run(config(tmp_path / "file"))
    with pytest.raises(OutputError, match="cannot be written"):
        run(config(tmp_path / "file" / "out"))


def test_a_failed_run_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="power"), OutputDirectory(tmp_path / "out"):
        raise RuntimeError("power")
    assert list(tmp_path.iterdir()) == []


def test_a_run_of_another_kind_leaves_nothing_of_the_earlier_one(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(config(out, scenario="closing-door", sensing="beacon"))
    (out / "mine.txt").write_text("kept")
    assert {"arena_1.geojson", "encounters_true.csv", "observations.csv"} < {path.name for path in out.iterdir()}
    run(config(out, force=True))
    assert sorted(path.name for path in out.iterdir()) == sorted([*FILES, "mine.txt"])


@pytest.mark.parametrize(("preset", "scenario"), [("paper-units", "no-obstacle"), ("hisser-field", "two-obstacles")])
def test_the_expected_number_of_encounters_is_about_what_comes(tmp_path: Path, preset: str, scenario: str) -> None:
    run(config(tmp_path / "out", preset=preset, scenario=scenario, biobots=None, duration_s=None))
    told = json.loads((tmp_path / "out" / "run.json").read_text())
    assert told["counts"]["encounters"] == pytest.approx(told["expected_encounters"], rel=0.2)
