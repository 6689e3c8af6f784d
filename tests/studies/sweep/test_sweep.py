"""A sweep by its command: real runs, real processes, killed and gone on with; and its account."""

import csv
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from mapper.__main__ import main as biobot_mapper
from simulator.__main__ import main as biobot_sim
from simulator.errors import ArenaError
from studies.cases import Failure, Finished
from studies.sweep.__main__ import main
from studies.sweep.case import SweepCase
from studies.sweep.definition import Sweep
from studies.sweep.map_case import CaseResult, compute_case
from studies.sweep.report import account_for, table, tell_failures, to_csv, to_json, wilson

KILL_WITHIN_S = 60.0
DEFINITION = """
name = "short"
repeats = 14
[grid.run]
preset = ["hisser-field"]
scenario = ["one-obstacle"]
duration_s = [400.0]
[grid.recipe]
metric = ["encounter", "landmark_profile"]
"""


def without_times(path: Path) -> Any:
    account = json.loads(path.read_text())
    for cell in account["cells"]:
        del cell["simulate_s"], cell["map_s"]
    return account


@pytest.mark.campaign
def test_a_sweep_that_was_killed_goes_on_and_gives_what_an_undisturbed_one_gives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    definition, journal = tmp_path / "short.toml", tmp_path / "short.jsonl"
    definition.write_text(DEFINITION)
    command = [sys.executable, "-m", "studies.sweep", str(definition), "--journal", str(journal), "--jobs", "2"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    began_s = time.monotonic()
    while not journal.exists() or journal.read_bytes().count(b"\n") < 6:
        assert time.monotonic() - began_s < KILL_WITHIN_S
        assert wait(process, 0.02) is None
    process.kill()
    process.wait()
    n_before = journal.read_bytes().count(b"\n") - 1
    assert 5 <= n_before < 28

    assert main([str(definition), "--journal", str(journal), "--jobs", "2", "--json", str(tmp_path / "resumed.json")]) == 0
    assert f"28 of 28 cases, {n_before} of them before" in capsys.readouterr().err
    digests = [json.loads(line)["digest"] for line in journal.read_text().splitlines()[1:]]
    assert len(set(digests)) == len(digests) == 28

    whole = ["--journal", str(tmp_path / "whole.jsonl"), "--jobs", "2", "--json", str(tmp_path / "whole.json")]
    assert main([str(definition), *whole]) == 0
    assert without_times(tmp_path / "resumed.json") == without_times(tmp_path / "whole.json")


def wait(process: subprocess.Popen[bytes], seconds: float) -> int | None:
    """Wait a little for a process to end; None where it has not."""
    try:
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
        return None


@pytest.mark.parametrize("sensing", ["ideal", "beacon"])
def test_a_case_is_what_the_commands_of_simulator_and_mapper_make(sensing: str, tmp_path: Path) -> None:
    run = ["--preset", "hisser-field", "--scenario", "one-obstacle", "--duration", "900", "--seed", "3", "--sensing", sensing]
    assert biobot_sim(["run", *run, "--out", str(tmp_path / "run")]) == 0
    encounters, modes, made = tmp_path / "run" / "encounters.csv", tmp_path / "run" / "modes.csv", tmp_path / "map.json"
    assert biobot_mapper(["run", str(encounters), "--modes", str(modes), "--metric", "encounter", "--json", str(made)]) == 0
    cell = {
        "run.preset": "hisser-field",
        "run.scenario": "one-obstacle",
        "run.duration_s": 900.0,
        "run.sensing": sensing,
        "recipe.metric": "encounter",
    }
    result = compute_case(SweepCase(cell=cell, seed=3))
    document = json.loads(made.read_text())
    assert result.map_betti == tuple(document["betti_numbers"])
    assert result.n_encounters == len(encounters.read_text().splitlines()) - 1
    assert result.true_betti == (1, 1)


def test_too_few_encounters_make_no_map_and_count_as_wrong() -> None:
    cell = {"run.scenario": "no-obstacle", "run.biobots": 2, "run.duration_s": 1.0}
    result = compute_case(SweepCase(cell=cell, seed=1))
    assert result.map_betti is None
    (account,) = account_for(sweep_of([cell], repeats=1), [finished(cell, 1, result)])
    assert (account.no_map, account.right, account.share) == (1, 0, 0.0)


def test_a_bad_definition_ends_with_2_and_a_busy_or_foreign_journal_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    definition = tmp_path / "short.toml"
    definition.write_text('name = "short"\ngrid.run.scenario = ["amaze"]\n')
    assert main([str(definition)]) == 2
    assert "amaze" in capsys.readouterr().err
    definition.write_text(DEFINITION)
    assert main([str(definition), "--check-config"]) == 0
    assert "2 cells, 28 cases, seeds 10000 to 10013" in capsys.readouterr().out
    (tmp_path / "journal").write_text("mine\n")
    assert main([str(definition), "--journal", str(tmp_path / "journal")]) == 1
    assert "is no journal" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main([str(definition), "--jobs", "0"])
    assert "from 1 to 1024" in capsys.readouterr().err


def test_a_report_that_cannot_be_written_is_told_and_the_results_stay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    definition, journal = tmp_path / "short.toml", tmp_path / "short.jsonl"
    definition.write_text(DEFINITION)
    flags = ["--journal", str(journal), "--repeats", "1", "--jobs", "1"]
    assert main([str(definition), *flags, "--csv", str(tmp_path / "none" / "x.csv")]) == 1
    assert "cannot be written" in capsys.readouterr().err
    assert len(journal.read_text().splitlines()) == 3


def test_a_case_that_fails_is_told_after_the_table_and_the_end_is_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The arena of this seed is fine, but the file it comes from is gone when the case is computed again."""
    arena, definition = tmp_path / "room.geojson", tmp_path / "short.toml"
    arena.write_text('{"type":"Polygon","coordinates":[[[0,0],[50,0],[50,50],[0,50],[0,0]]]}')
    definition.write_text(f'name = "short"\nrepeats = 2\ngrid.run.arena = ["{arena}"]\ngrid.run.duration_s = [50.0]\n')
    case = SweepCase(cell={"run.arena": str(tmp_path / "gone.geojson")}, seed=1)
    with pytest.raises(ArenaError, match=r"gone\.geojson: cannot be read"):
        compute_case(case)
    flags = [str(definition), "--journal", str(tmp_path / "short.jsonl"), "--jobs", "1"]
    assert main(flags) == 0
    lines = (tmp_path / "short.jsonl").read_text().splitlines()
    entry = json.loads(lines[2])
    del entry["result"]
    lines[2] = json.dumps(entry | {"failure": {"kind": "MemoryError", "message": "", "traceback": "at home"}})
    (tmp_path / "short.jsonl").write_text("\n".join(lines) + "\n")
    capsys.readouterr()
    assert main(flags) == 1
    told = capsys.readouterr()
    assert "1 failed: MemoryError" in told.err
    assert main([*flags, "--retry-failed"]) == 0


def sweep_of(cells: list[dict[str, Any]], *, repeats: int) -> Sweep:
    return Sweep(name="made", cells=tuple(cells), seeds=range(repeats), files={})


def finished(cell: dict[str, Any], seed: int, result: CaseResult | None, failure: Failure | None = None) -> Finished[SweepCase, CaseResult]:
    return Finished(case=SweepCase(cell=cell, seed=seed), result=result, failure=failure, seconds=1.0)


def test_the_account_adds_up() -> None:
    """Cell a: four runs, truth (1, 2): right, one hole too many, two too few with a component too many, failed. Cell b: all failed."""
    cells = [{"run.scenario": "a", "run.preset": "p"}, {"run.scenario": "b", "run.preset": "p"}]
    failure = Failure(kind="ValueError", message="no", traceback="")
    maps = [(1, 2), (1, 3), (2, 0), None]
    results = [
        None if one is None else CaseResult(true_betti=(1, 2), map_betti=one, n_encounters=10 * k, simulate_s=1.0, map_s=float(k))
        for k, one in enumerate(maps)
    ]
    cases = [
        finished(cell, seed, result if cell is cells[0] else None, None if result is not None and cell is cells[0] else failure)
        for seed, result in enumerate(results)
        for cell in cells
    ]
    sweep = sweep_of(cells, repeats=4)
    first, second = account_for(sweep, cases)
    assert (first.cases, first.failed, first.no_map, first.right, first.components_wrong) == (4, 1, 0, 1, 1)
    assert first.share == pytest.approx(1 / 3)
    assert first.standard_error == pytest.approx((2 / 9 / 3) ** 0.5)
    assert (first.hole_error, first.hole_bias, first.component_error) == pytest.approx((1.0, -1 / 3, 1 / 3))
    assert (first.encounters, first.simulate_s, first.map_s) == (10.0, 1.0, 1.0)
    assert (second.failed, second.share, second.low, second.map_s) == (4, None, None, None)
    lines = table([first, second]).splitlines()
    assert lines[1].startswith("scenario=a ")
    assert "33.3% ± 27.2%" in lines[1]
    assert json.loads(to_json(sweep, [first, second]))["cells"][0]["cell"] == cells[0]
    header, row, other = csv.reader(to_csv([first, second]).splitlines())
    assert dict(zip(header, row, strict=True))["right"] == "1"
    assert dict(zip(header, other, strict=True))["share"] == ""
    (told,) = tell_failures(cases)
    assert told == "5 failed: ValueError: no; the first is seed 0 of scenario=b, preset=p"


@pytest.mark.parametrize(("right", "runs", "low", "high"), [(8, 10, 0.4902, 0.9433), (0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0)])
def test_wilsons_interval_is_that_of_the_tables(right: int, runs: int, low: float, high: float) -> None:
    """Values of the score interval without continuity correction, as in R. Newcombe, Statistics in Medicine 17, 1998, by its formula."""
    assert wilson(right, runs) == pytest.approx((low, high), abs=5e-5)
