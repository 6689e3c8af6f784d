"""Laws of reading a run's directory: all of a good one, and of a bad one the file, the reason and what to do."""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely

from simulator.errors import ArenaError, RunFileError
from simulator.pictures.recorded_run import RUN_FILES, read_run
from tests.simulator.runs import change_description, change_truth, make_run, run_with_a_door_that_closes


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("made") / "run")


@pytest.fixture
def directory(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "run"))


def test_what_a_run_writes_is_read_back(made: Path) -> None:
    run = read_run(made)
    rows = list(csv.DictReader((made / "encounters.csv").read_text().splitlines()))
    assert (run.name, run.preset, run.seed, run.unit, run.end_s) == ("two-obstacles", "paper-units", 3, "unit", 20.0)
    assert run.position.shape == (21, 40, 2)
    assert run.met_place.shape == (len(rows), 2)
    assert [float(row["t_start_s"]) for row in rows] == run.met_start_s.tolist()
    assert [int(row["id2"]) for row in rows] == run.ids[run.met_second].tolist()
    assert {path.name for path in made.iterdir()} <= set(RUN_FILES)


def test_landmarks_stand_and_nobody_else_does(made: Path) -> None:
    landmarks, resting = read_run(made).standing_at(10.0)
    assert landmarks.sum() == 6
    assert not resting.any()


def test_where_no_landmarks_are_told_those_who_stand_by_command_are_landmarks(directory: Path) -> None:
    change_description(directory, landmark_ids=None)
    assert read_run(directory).standing_at(10.0)[0].sum() == 6


def test_who_rests_by_nature_is_no_landmark(directory: Path) -> None:
    rows = (directory / "modes.csv").read_text().replace("0.000000000,20.000000000,40,CRW", "5.000000000,8.000000000,40,S")
    (directory / "modes.csv").write_text(rows)
    run = read_run(directory)
    row = int(np.flatnonzero(run.ids == 40)[0])
    assert [bool(run.standing_at(at_s)[1][row]) for at_s in (4.9, 5.0, 7.9, 8.0)] == [False, True, True, False]
    assert not run.standing_at(6.0)[0][row]


def test_the_end_of_a_spell_that_lasts_to_the_end_belongs_to_it(made: Path) -> None:
    run = read_run(made)
    assert run.standing_at(run.end_s)[0].sum() == 6


def test_the_arena_of_an_instant_is_that_of_the_last_change(directory: Path) -> None:
    run = run_with_a_door_that_closes(directory)
    holes = [run.track.arena_at(at_s).betti.holes for at_s in (0.0, 11.9, 12.0, 20.0)]
    assert holes == [2, 2, 1, 1]


def test_a_change_may_be_a_file_beside_the_others(directory: Path) -> None:
    shutil.copy(directory / "arena.geojson", directory / "arena-2.geojson")
    change_description(directory, arena_changes=[{"at_s": 5, "file": "arena-2.geojson"}])
    assert len(read_run(directory).arenas) == 2


def _cut(name: str) -> Callable[[Path], object]:
    return lambda at: (at / name).write_bytes((at / name).read_bytes()[:-40])


def _remove(name: str) -> Callable[[Path], object]:
    return lambda at: (at / name).unlink()


def _replace(name: str, old: str, new: str) -> Callable[[Path], object]:
    return lambda at: (at / name).write_text((at / name).read_text().replace(old, new, 1))


@pytest.mark.parametrize(
    ("harm", "file", "problem"),
    [
        (_remove("run.json"), "run.json", "is missing; give the directory of a finished"),
        (_remove("arena.geojson"), "arena.geojson", "is missing"),
        (_remove("encounters.csv"), "encounters.csv", "is missing"),
        (_remove("modes.csv"), "modes.csv", "is missing"),
        (_remove("truth.npz"), "truth.npz", "is missing"),
        (_cut("run.json"), "run.json", "is not JSON"),
        (_cut("encounters.csv"), "encounters.csv", "fields"),
        (_cut("modes.csv"), "modes.csv", "run.json counts 40"),
        (_cut("truth.npz"), "truth.npz", "is no whole archive"),
        (lambda at: (at / "truth.npz").write_bytes(b""), "truth.npz", "is no whole archive"),
        (_replace("encounters.csv", "id2", "id3"), "encounters.csv", "its header lacks id2"),
        (_replace("encounters.csv", "0.000000000", "soon"), "encounters.csv", "t_start_s is 'soon'; wanted a number"),
        (_replace("encounters.csv", "0.000000000", "nan"), "encounters.csv", "wanted a number"),
        (lambda at: change_description(at, format=2), "run.json", "is of format 2"),
        (lambda at: change_description(at, program="biobot-mapper run"), "run.json", "names the program 'biobot-mapper run'"),
        (lambda at: change_description(at, seed="x"), "run.json", "seed is 'x'"),
        (lambda at: change_description(at, landmark_ids=[1, 99]), "run.json", "landmark_ids"),
        (lambda at: change_description(at, landmark_ids=["1"]), "run.json", "landmark_ids"),
        (lambda at: change_description(at, arena_changes=7), "run.json", "arena_changes is 7"),
        (lambda at: change_description(at, arena_changes=[{"at_s": "x"}]), "run.json", "at_s 'x'"),
        (lambda at: change_description(at, arena_changes=[{"at_s": 1.0, "file": "../x"}]), "run.json", "plain name"),
        (lambda at: change_description(at, arena_changes=[{"at_s": 1.0, "file": "x.geojson"}]), "x.geojson", "is missing"),
        (lambda at: change_truth(at, t_s=np.zeros(3)), "truth.npz", "position has shape"),
        (lambda at: change_truth(at, ids=np.arange(40, 0, -1)), "truth.npz", "ids do not ascend"),
        (lambda at: change_truth(at, ids=np.arange(101, 141)), "run.json", "ids that truth.npz knows"),
        (lambda at: change_truth(at, position=np.full((21, 40, 2), np.nan)), "truth.npz", "not finite"),
        (lambda at: change_truth(at, encounter_position=np.zeros((3, 2))), "encounters.csv", "not of one run"),
        (lambda at: change_truth(at, t_s=np.array([None] * 21, dtype=object)), "truth.npz", "is no whole archive"),
    ],
)
def test_a_broken_run_is_refused_by_the_file_that_is_broken(
    directory: Path, harm: Callable[[Path], object], file: str, problem: str
) -> None:
    harm(directory)
    with pytest.raises(RunFileError, match=r"run again|finished biobot-sim|install the version") as refused:
        read_run(directory)
    assert problem in str(refused.value)
    assert refused.value.path == directory / file


def test_a_broken_arena_is_refused(directory: Path) -> None:
    (directory / "arena.geojson").write_text("{}")
    with pytest.raises(ArenaError, match=r"arena\.geojson"):
        read_run(directory)


@pytest.mark.parametrize("name", ["nowhere", "run/run.json"])
def test_what_is_no_directory_is_refused(directory: Path, name: str) -> None:
    with pytest.raises(RunFileError, match="finished biobot-sim run"):
        read_run(directory.parent / name)


@pytest.mark.parametrize(("scenario", "preset"), [("one-obstacle", "paper-units"), ("two-obstacles", "paper-50cm")])
def test_everybody_is_always_shown_inside_the_arena(tmp_path: Path, scenario: str, preset: str) -> None:
    """Samples 4 s apart: most straight lines between them would cross an obstacle or leave a corner."""
    run = read_run(make_run(tmp_path / "run", scenario=scenario, preset=preset, samples=6))
    for at_s in np.linspace(0.0, 20.0, 97).tolist():
        assert shapely.covers(run.track.arena_at(at_s).polygon, shapely.points(run.track.at(at_s))).all()


def test_ways_pass_through_the_samples_and_never_through_walls(tmp_path: Path) -> None:
    run = read_run(make_run(tmp_path / "run", samples=6))
    rows = np.arange(40)
    ways = run.track.lines(rows=rows, from_s=2.0, to_s=18.0)
    nodes = ways[:, ::2]
    np.testing.assert_array_equal(nodes[:, 1:-1], run.position[1:-1].transpose(1, 0, 2))
    np.testing.assert_array_equal(nodes[:, 0], run.track.at(2.0))
    np.testing.assert_array_equal(nodes[:, -1], run.track.at(18.0))
    drawn = 0
    for way in ways:
        for piece in np.split(way, np.flatnonzero(np.isnan(way[:, 0]))):
            whole = piece[~np.isnan(piece[:, 0])]
            if len(whole) > 1:
                # Rounding of a middle may put it a hair off the line.
                assert shapely.covers(run.arenas[0][1].polygon.buffer(1e-9), shapely.linestrings(whole))
                drawn += 1
    assert drawn >= 40


def test_at_a_sample_everybody_is_shown_where_they_were(made: Path) -> None:
    run = read_run(made)
    for k in (0, 7, 20):
        np.testing.assert_array_equal(run.track.at(float(run.t_s[k])), run.position[k])
    np.testing.assert_array_equal(run.track.at(1e9), run.position[-1])
    np.testing.assert_array_equal(run.track.at(-1.0), run.position[0])
