"""Laws of the files of a run that is sensed by beacons."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

from firmware_protocol.errors import ConfigurationError
from simulator.config import RunConfig
from simulator.errors import ParameterError, ScenarioError
from simulator.run import run
from tests.simulator.test_command_line import biobot_sim


def config(out: Path, /, **changed: object) -> RunConfig:
    fields: dict[str, object] = {
        "scenario": "two-obstacles", "seed": 1, "out": str(out), "biobots": 60, "duration_s": 60.0, "sensing": "beacon", "radio": "indoor",
    }  # fmt: skip
    return RunConfig(**(fields | changed))  # type: ignore[arg-type]  # fields of different types, by name


def read(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text())))


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sensed") / "out"
    run(config(out))
    return out


def test_the_exact_encounters_are_those_of_the_ideal_run(results: Path, tmp_path: Path) -> None:
    run(config(tmp_path / "ideal", sensing="ideal", radio="ideal"))
    assert (results / "encounters_true.csv").read_bytes() == (tmp_path / "ideal" / "encounters.csv").read_bytes()
    assert (results / "modes.csv").read_bytes() == (tmp_path / "ideal" / "modes.csv").read_bytes()
    assert not (tmp_path / "ideal" / "observations.csv").exists()
    assert json.loads((tmp_path / "ideal" / "run.json").read_text())["sensing"] == {"kind": "ideal"}


def test_observed_encounters_lie_within_the_run_and_are_made_of_observations(results: Path) -> None:
    observations = read(results / "observations.csv")
    assert list(observations[0]) == ["node", "peer", "t_start_s", "t_end_s", "mean_rssi_dbm", "n_beacons"]
    ends = {(frozenset((row["node"], row["peer"])), name, row[name]) for row in observations for name in ("t_start_s", "t_end_s")}
    rows = read(results / "encounters.csv")
    assert len(rows) > 100
    for row in rows:
        assert 0 <= float(row["t_start_s"]) <= float(row["t_end_s"]) <= 60
        pair = frozenset((row["id1"], row["id2"]))
        assert (pair, "t_start_s", row["t_start_s"]) in ends
        assert (pair, "t_end_s", row["t_end_s"]) in ends


def test_places_of_truth_belong_to_the_observed_encounters(results: Path) -> None:
    truth = np.load(results / "truth.npz")
    rows = read(results / "encounters.csv")
    assert truth["encounter_position"].shape == (len(rows), 2)
    centre_s = np.array([(float(row["t_start_s"]) + float(row["t_end_s"])) / 2 for row in rows])
    sample = np.abs(truth["t_s"][:, None] - centre_s).argmin(axis=0)
    both = [truth["position"][sample, [int(row[name]) - 1 for row in rows]] for name in ("id1", "id2")]
    assert np.hypot(*(sum(both) / 2 - truth["encounter_position"]).T).max() <= 0.16  # 0.15 s of walk at unit speed


def test_run_json_says_how_true_the_observations_are_and_what_the_air_did(results: Path) -> None:
    told = json.loads((results / "run.json").read_text())
    sensing = told["sensing"]
    assert sensing["kind"] == "beacon"
    assert sensing["fidelity"]["observed_encounters"] == len(read(results / "encounters.csv")) == told["counts"]["encounters"]
    assert sensing["fidelity"]["true_encounters"] == len(read(results / "encounters_true.csv"))
    assert 0.3 < sensing["fidelity"]["sensitivity_in_time"] < 1
    assert sensing["observations"] == len(read(results / "observations.csv"))
    assert sensing["air"]["airtime_load"] == pytest.approx(60 * 1.056e-3, rel=0.03)
    assert sensing["air"]["at_neighbours"]["burst"] > 0
    assert sensing["radio"]["shadowing_db"] == 2.4
    assert sensing["exit_dbm"] < sensing["enter_dbm"]


def test_same_seed_same_bytes(results: Path, tmp_path: Path) -> None:
    run(config(tmp_path / "again"))
    for path in results.iterdir():
        if path.name != "run.json":  # it tells how long the run took
            assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes()


def test_more_beacons_show_more_of_the_contact(results: Path, tmp_path: Path) -> None:
    shares = []
    for period_s in (4.0, 1.0, 0.25):
        out = tmp_path / str(period_s)
        run(config(out, radio="ideal", beacon_period_s=period_s))
        shares.append(json.loads((out / "run.json").read_text())["sensing"]["fidelity"]["sensitivity_in_time"])
    assert shares == sorted(shares)


def test_a_detection_radius_of_a_centimetre_is_entered(tmp_path: Path) -> None:
    run(config(tmp_path / "out", preset="paper-50cm", duration_s=20.0, beacon_period_s=0.1, radio="ideal"))
    fidelity = json.loads((tmp_path / "out" / "run.json").read_text())["sensing"]["fidelity"]
    assert fidelity["detected_share"] > 0.5
    assert fidelity["sensitivity_in_time"] > 0.3


def test_flags_choose_the_sensing_and_a_bad_one_is_told(tmp_path: Path) -> None:
    base = ["run", "--scenario", "no-obstacle", "--seed", "1", "--biobots", "10", "--duration", "5", "--out", str(tmp_path / "out")]
    done = biobot_sim(*base, "--sensing", "beacon", "--beacon-period-s", "0.5", "--radio", "rubble", "--no-csma")
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "out" / "run.json").read_text())["sensing"]
    assert (told["beacon_period_s"], told["radio"]["preset"], told["radio"]["csma"]) == (0.5, "rubble", False)
    refused = biobot_sim("run", "--check-config", "--sensing", "beacon", "--radio", "sewer")
    assert refused.returncode == 2
    assert "no radio preset is called 'sewer'" in refused.stderr


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"radio": "sewer"}, ScenarioError, "no radio preset is called 'sewer'"),
        ({"burst_good_s": 0.0, "radio": "indoor"}, ParameterError, "wanted both positive, or both 0"),
        ({"exit_dbm": -20.0}, ParameterError, "exit_dbm is -20.0; wanted at most enter_dbm"),
        ({"seed": None}, ConfigurationError, "give --seed"),
    ],
)
def test_a_setting_that_cannot_be_sensed_is_refused_before_the_run(
    tmp_path: Path, changed: dict[str, object], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        run(config(tmp_path / "out", **changed))
    assert not list(tmp_path.iterdir())


def test_keys_of_beacons_are_refused_where_none_are_sent() -> None:
    refused = biobot_sim("run", "--scenario", "no-obstacle", "--seed", "1", "--out", "out", "--radio", "rubble", "--enter-dbm", "-50")
    assert refused.returncode == 2
    assert "enter_dbm, radio: of no use where sensing is ideal" in refused.stderr
