"""Laws of ``biobot-sim``, run as people run it."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

SMALL = ["--biobots", "10", "--duration", "5"]


def biobot_sim(*arguments: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-m", "simulator", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=os.environ | (environment or {}),
    )


def test_a_run_is_made_from_flags_file_and_environment(tmp_path: Path) -> None:
    """Flags win over the environment, and that over the file."""
    settings = tmp_path / "settings.toml"
    settings.write_text('scenario = "no-obstacle"\nseed = 1\nbiobots = 99\nlandmarks = 2\nduration_s = 99.0\n')
    environment = {"BIOBOT_SIM__DURATION_S": "5", "BIOBOT_SIM__SEED": "2"}
    out = tmp_path / "out"
    done = biobot_sim("run", "--config", str(settings), "--biobots", "10", "--seed", "3", "--out", str(out), environment=environment)
    assert (done.returncode, done.stdout) == (0, "")
    event = json.loads(done.stderr)
    assert event["event"] == "run.done"
    described = json.loads((out / "run.json").read_text())
    assert (described["seed"], described["arena"]) == (3, "no-obstacle")
    assert {name: described["parameters"][name] for name in ("biobots", "landmarks", "duration_s")} == {
        "biobots": 10,
        "landmarks": 2,
        "duration_s": 5.0,
    }


def test_an_arena_file_is_walked(tmp_path: Path) -> None:
    arena = tmp_path / "room.geojson"
    arena.write_text('{"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 9], [0, 0]]]}')
    done = biobot_sim("run", "--arena", str(arena), *SMALL, "--seed", "1", "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "out" / "run.json").read_text())["arena"] == str(arena)


@pytest.mark.parametrize("suffix", [".svg", ".png"])
def test_a_drawing_and_a_floor_plan_are_walked(tmp_path: Path, suffix: str) -> None:
    """A room of 450 by 300 units, or pixels, with an obstacle and a speck, at 2 cm each: 9 m by 6 m."""
    plan = tmp_path / f"plan{suffix}"
    if suffix == ".svg":
        shapes = '<rect width="450" height="300" fill="none"/><circle cx="200" cy="150" r="60"/>'
        plan.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 450 300">{shapes}</svg>')
    else:
        pixels = np.full((300, 450), 255, dtype=np.uint8)
        pixels[90:210, 140:260], pixels[5, 5] = 0, 0
        Image.fromarray(pixels).save(plan)
    arguments = ["--arena", str(plan), "--arena-scale", "0.02", "--arena-simplify", "0.05", *SMALL, "--seed", "1"]
    done = biobot_sim("run", *arguments, "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    read = json.loads(done.stderr.splitlines()[0])
    described = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (read["event"], read["components"], read["holes"]) == ("arena.read", 1, 1)
    assert described["betti_numbers"] == [1, 1]
    assert 54 - 5.76 - 0.1 < described["arena_area"] < 54 - math.pi * 1.2**2 + 0.2
    assert described["arena_counts"].get("specks_removed", 1) == 1
    assert described["arena_counts"]["walls_simplified_away"] == read["walls_simplified_away"]


@pytest.mark.parametrize(
    ("arguments", "status", "problem"),
    [
        ([], 2, "give a command: run, resume, serve, replay, render or scenarios"),
        (["fly"], 2, "invalid choice: 'fly'"),
        (["run"], 2, "give --out DIR"),
        (["run", "--out", "{tmp}/out"], 2, "give --seed N"),
        (["run", "--seed", "x"], 2, "invalid int value: 'x'"),
        (["run", "--seed", "-1", "--out", "{tmp}/out"], 2, "seed is -1"),
        (["run", "--scenario", "a", "--arena", "b"], 2, "not allowed with"),
        (["run", "--scenario", "moon", "--seed", "1", "--out", "{tmp}/out"], 2, "no scenario is called 'moon'"),
        (["run", "--scenario", "no-obstacle", "--biobots", "0", "--seed", "1", "--out", "{tmp}/out"], 2, "--biobots"),
        (["run", "--scenario", "no-obstacle", "--duration", "nan", "--seed", "1", "--out", "{tmp}/out"], 2, "duration_s"),
        (["run", "--scenario", "no-obstacle", "--duration", "-5", "--seed", "1", "--out", "{tmp}/out"], 2, "duration_s"),
        (["run", "--scenario", "no-obstacle", "--seed", "1", "--out", "{tmp}"], 1, "is not empty"),
        (["run", "--scenario", "no-obstacle", "--seed", "1", "--out", "{tmp}/bad.toml/out"], 1, "cannot be written"),
        (
            ["run", "--arena", "{tmp}/bad.toml", "--seed", "1", "--out", "{tmp}/out"],
            1,
            "bad.toml: its name ends in '.toml'; wanted .geojson, .json, .svg or .png",
        ),
        (["run", "--scenario", "star", "--arena-scale", "2", "--seed", "1", "--out", "{tmp}/out"], 2, "given without an arena"),
        (["run", "--arena", "a.svg", "--arena-then", "b.svg", "--seed", "1", "--out", "{tmp}/out"], 2, "has 'b.svg'; wanted SECONDS:FILE"),
        (["run", "--arena", "a.svg", "--arena-then", "0:b.svg", "--seed", "1", "--out", "{tmp}/out"], 2, "a positive number of seconds"),
        (["run", "--arena", "a.svg", "--arena-scale", "0", "--seed", "1", "--out", "{tmp}/out"], 2, "--arena-scale"),
        (["run", "--arena", "a.svg", "--arena-scale", "inf", "--seed", "1", "--out", "{tmp}/out"], 2, "arena_scale is inf"),
        (["run", "--config", "{tmp}/none.toml"], 2, "none.toml: cannot be read: No such file"),
        (["run", "--config", "{tmp}"], 2, "cannot be read: Is a directory"),
        (["run", "--check-config", "--config", "{tmp}/bad.toml"], 2, "unknown key 'sed'"),
        (["--check-config", "--config", "{tmp}/bad.toml"], 2, "biobots is 'many'"),
        (["run", "--check-config", "--preset", "hexbug"], 2, "no preset is called 'hexbug'"),
    ],
)
def test_bad_usage_is_told_in_a_line_without_a_traceback(tmp_path: Path, arguments: list[str], status: int, problem: str) -> None:
    (tmp_path / "bad.toml").write_text('sed = 1\nbiobots = "many"\n')
    done = biobot_sim(*(argument.replace("{tmp}", str(tmp_path)) for argument in arguments))
    assert done.returncode == status
    assert problem in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["bad.toml"]


def test_a_good_configuration_passes_the_check(tmp_path: Path) -> None:
    good = tmp_path / "good.toml"
    good.write_text('scenario = "two-obstacles"\npreset = "paper-50cm"\nspeed = 0.2\n')
    for arguments in (["run", "--check-config", "--config", str(good)], ["--config", str(good), "run", "--check-config"]):
        done = biobot_sim(*arguments)
        assert (done.returncode, done.stdout) == (0, f"{good}: the configuration is valid\n")


def test_version_and_help_fit_their_screens() -> None:
    version = biobot_sim("--version")
    assert version.returncode == 0
    assert version.stdout.startswith("biobot-sim ")
    for command in ([], ["run"], ["scenarios"]):
        shown = biobot_sim(*command, "--help")
        assert shown.returncode == 0
        assert len(shown.stdout.splitlines()) <= 45


def test_scenarios_are_listed_for_people_and_for_programs() -> None:
    listed = biobot_sim("scenarios")
    assert listed.returncode == 0
    for name in ("no-obstacle", "one-obstacle", "two-obstacles", "paper-units", "paper-50cm"):
        assert name in listed.stdout
    as_json = json.loads(biobot_sim("scenarios", "--json").stdout)
    assert [scenario["betti_numbers"] for scenario in as_json["scenarios"][:3]] == [[1, 0], [1, 1], [1, 2]]
    assert {scenario["name"] for scenario in as_json["scenarios"] if scenario["depends_on_seed"]} == {"maze", "rubble"}
    changes = {scenario["name"]: scenario["changes"] for scenario in as_json["scenarios"] if scenario["changes"]}
    assert changes == {"closing-door": [{"share_of_time": 0.5, "betti_numbers_after": [2, 2]}]}
    assert [preset["name"] for preset in as_json["presets"] if preset["default"]] == ["paper-units"]
