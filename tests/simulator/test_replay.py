"""``biobot-sim replay`` and long runs of ``serve`` as processes: over TCP and pty, with bad input, and killed without warning."""

import contextlib
import csv
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from simulator.__main__ import main
from tests.simulator.base_station import BaseStation
from tests.simulator.test_serve import DEADLINE_S, end_of, final_entries, ready, rows_of, talk

HEADER = "t_start_s,t_end_s,id1,id2\n"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "dish.csv"
    rows = [f"{1000 + 2 * k},{1001.5 + 2 * k},{1 + k % 3},{5 + k % 2}\n" for k in range(10)]
    path.write_text(HEADER + "".join(rows))
    return path


def start(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-m", "simulator", *arguments], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


@contextlib.contextmanager
def connected(address: str) -> Iterator[socket.socket]:
    host, port = address.removeprefix("tcp:").rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=DEADLINE_S) as line:
        line.settimeout(0.005)
        yield line


def listen_to(base: BaseStation, line: socket.socket, process: subprocess.Popen[str]) -> None:
    """Let a base station listen until the process has ended."""

    def read() -> bytes:
        try:
            return line.recv(4096)
        except (TimeoutError, ConnectionError):
            return b""

    def write(data: bytes) -> None:
        with contextlib.suppress(ConnectionError):
            line.sendall(data)

    talk(base, read=read, write=write, until=lambda: process.poll() is not None)


def test_a_replay_tells_the_recorded_encounters_at_their_times_and_its_files_are_a_recording_again(recording: Path, tmp_path: Path) -> None:
    out, ready_file = tmp_path / "out", tmp_path / "ready"
    process = start(
        "replay", str(recording), "--link", "tcp:127.0.0.1:0", "--speed", "20", "--drain-s", "20", "--report-period-s", "0.1",
        "--out", str(out), "--ready-file", str(ready_file),
    )  # fmt: skip
    base = BaseStation()
    with connected(ready(process, ready_file)) as line:
        listen_to(base, line, process)
    told = end_of(process)
    assert process.returncode == 0, told
    recorded = rows_of(recording)
    assert final_entries(base) == sorted((int(row[a]), int(row[b])) for row in recorded for a, b in (("id1", "id2"), ("id2", "id1")))
    replayed = rows_of(out / "encounters.csv")
    assert [(row["id1"], row["id2"]) for row in replayed] == [(row["id1"], row["id2"]) for row in recorded]
    for row, was in zip(replayed, recorded, strict=True):
        assert float(row["t_start_s"]) * 20 + 1000 == pytest.approx(float(was["t_start_s"]))
        assert float(row["t_end_s"]) * 20 + 1000 == pytest.approx(float(was["t_end_s"]))
    run = json.loads((out / "run.json").read_text())
    assert (run["program"], run["speed_factor"], run["source"]) == ("biobot-sim replay", 20.0, str(recording))
    assert run["reports_unacknowledged"] == 0
    assert sorted(one.name for one in out.iterdir()) == ["encounters.csv", "modes.csv", "reported.csv", "run.json"]
    assert main(["replay", str(out), "--link", "tcp:127.0.0.1:0", "--speed", "1000", "--drain-s", "0"]) == 0


def test_a_directory_of_results_replays_with_its_places_over_two_lines(tmp_path: Path) -> None:
    first, out = tmp_path / "first", tmp_path / "out"
    made = ["--scenario", "one-obstacle", "--biobots", "20", "--duration", "20", "--seed", "3", "--out", str(first)]
    assert main(["run", *made]) == 0
    links = ("--link", f"pty:{tmp_path / 'a'}", "--link", f"pty:{tmp_path / 'b'}")
    assert main(["replay", str(first), *links, "--speed", "40", "--drain-s", "0", "--out", str(out)]) == 0
    assert len(rows_of(out / "encounters.csv")) == len(rows_of(first / "encounters.csv"))
    standing = {row["id"] for row in rows_of(first / "modes.csv") if row["mode"] == "S"}
    assert {row["id"] for row in rows_of(out / "modes.csv") if row["mode"] == "S"} == standing
    assert (out / "truth.npz").exists()
    assert len(json.loads((out / "run.json").read_text())["coordinator_places"]) == 2


@pytest.mark.parametrize(
    ("text", "arguments", "status", "words"),
    [
        (HEADER + "1,2,3,x\n", (), 1, "dish.csv, line 2: id2 is 'x'"),
        (HEADER + "1,2,3,100001\n", (), 2, "--renumber"),
        (HEADER + "1,2,3,4\n", ("--speed", "0"), 2, "speed_factor"),
        (HEADER + "1,2,3,4\n", ("--link", "tcp:127.0.0.1:0"), 2, "one coordinator that is heard everywhere"),
        (HEADER + "1,2,3,4\n", ("--coverage-radius", "5"), 2, "one coordinator that is heard everywhere"),
        (HEADER + "1,2,3,4\n", ("--seed", "-1"), 2, "seed"),
    ],
)
def test_what_cannot_be_replayed_is_told(
    text: str, arguments: tuple[str, ...], status: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "dish.csv"
    path.write_text(text)
    assert main(["replay", str(path), "--link", "tcp:127.0.0.1:0", *arguments]) == status
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("place", ["5", "a,b", "1;2"])
def test_a_place_that_is_none_is_told(place: str, recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["replay", str(recording), "--link", "tcp:127.0.0.1:0", "--coordinator-place", place])
    assert caught.value.code == 2
    assert "wanted two numbers" in capsys.readouterr().err


def test_without_a_source_or_a_line_replay_asks_for_them(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "--link", "tcp:127.0.0.1:0"]) == 2
    assert "give the recording" in capsys.readouterr().err
    assert main(["replay", str(recording)]) == 2
    assert "pty:" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ('link = ["pty:/tmp/a", "can:x"]', "can:x"),
        ('link = ["pty:/tmp/a", "pty:/tmp/a"]', "given twice"),
        ('link = ["pty:/tmp/a", "pty:/tmp/b"]\ncoordinator_places = [[1, 2]]', "1 places, link has 2 lines"),
        ('link = "pty:/tmp/a"\ncoordinator_places = [[1, inf]]', "finite"),
        ('link = "pty:/tmp/a"\ncoverage_radius = 0', "coverage_radius"),
        ('link = "pty:/tmp/a"\n[response]\nprobability = 2', "response.probability"),
    ],
)
def test_a_faulty_configuration_of_coordinators_or_responses_is_told(
    toml: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "serve.toml"
    path.write_text(toml)
    assert main(["serve", "--config", str(path), "--check-config"]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("link", ['"pty:/tmp/a,tcp:127.0.0.1:7600"', '["pty:/tmp/a", "tcp:127.0.0.1:7600"]'])
def test_several_lines_are_a_list_or_a_text_with_commas(link: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "serve.toml"
    path.write_text(f"link = {link}\ncoordinator_places = [[1, 2], [3, 4]]\n[response]\nprobability = 0.7\n")
    assert main(["serve", "--config", str(path), "--check-config"]) == 0
    assert "valid" in capsys.readouterr().out


def test_the_truth_of_a_run_that_was_killed_can_be_replayed(tmp_path: Path) -> None:
    ready_file = tmp_path / "ready"
    process = start(
        "serve", "--scenario", "two-obstacles", "--seed", "5", "--biobots", "60", "--speed", "20", "--link", f"pty:{tmp_path / 'dongle'}",
        "--out", str(tmp_path / "out"), "--ready-file", str(ready_file),
    )  # fmt: skip
    ready(process, ready_file)
    deadline_s = time.monotonic() + DEADLINE_S
    kept: list[Path] = []
    while not kept or len(kept[0].read_text().splitlines()) < 5:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
        kept = list(tmp_path.glob(".partial-*/encounters.csv.partial"))
    os.kill(process.pid, signal.SIGKILL)
    end_of(process)
    rows = rows_of(kept[0])
    assert len(rows) >= 4
    assert all(float(row["t_end_s"]) > float(row["t_start_s"]) for row in rows)
    run = json.loads(kept[0].with_name("run.json.partial").read_text())
    assert (run["seed"], run["speed_factor"]) == (5, 20.0)
    assert main(["replay", str(kept[0]), "--link", "tcp:127.0.0.1:0", "--speed", "1000", "--drain-s", "0"]) == 0
    with (kept[0].with_name("modes.csv.partial")).open(newline="") as file:
        assert next(csv.reader(file)) == ["t_s", "id", "mode", "cause"]
