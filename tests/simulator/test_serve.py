"""``biobot-sim serve`` as a process: a base station on its line hears everything, commands insects, and the files tell the same."""

import contextlib
import csv
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import serial

from firmware_protocol.messages import Action, StimulateReply, StimulationResult
from simulator.__main__ import main
from tests.simulator.base_station import BaseStation, a_command

DEADLINE_S = 60.0


def serve(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "simulator", "serve", "--scenario", "two-obstacles", "--seed", "5", *arguments]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def ready(process: subprocess.Popen[str], file: Path) -> str:
    deadline_s = time.monotonic() + DEADLINE_S
    while not file.exists():
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    return file.read_text().strip()


def talk(
    base: BaseStation,
    *,
    read: Callable[[], bytes],
    write: Callable[[bytes], object],
    until: Callable[[], bool],
    deadline_s: float = DEADLINE_S,
) -> None:
    """Let the base station use a line until something is so."""
    end_s = time.monotonic() + deadline_s
    while not until():
        assert time.monotonic() < end_s
        base.tick(time.monotonic_ns())
        write(base.take_outgoing())
        base.feed(read(), now_ns=time.monotonic_ns())
        write(base.take_outgoing())


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def final_entries(base: BaseStation) -> list[tuple[int, int]]:
    return sorted((node, one.peer) for (node, _), ledger in base.ledgers.items() for one in ledger.entries() if not one.is_ongoing)


def end_of(process: subprocess.Popen[str]) -> str:
    _, told = process.communicate(timeout=DEADLINE_S)
    return told


def test_a_whole_run_over_a_pty_arrives_complete_and_a_stop_halts_the_insect(tmp_path: Path) -> None:
    path, out, ready_file = tmp_path / "dongle", tmp_path / "out", tmp_path / "ready"
    process = serve(
        "--link", f"pty:{path}", "--biobots", "40", "--speed", "20", "--duration", "5", "--drain-s", "20",
        "--report-period-s", "0.2", "--out", str(out), "--ready-file", str(ready_file),
    )  # fmt: skip
    assert ready(process, ready_file) == f"serial:{path}"
    base = BaseStation()
    with serial.Serial(str(path), 115_200, timeout=0.005, exclusive=True) as port:
        commanded: list[int] = []

        def done() -> bool:
            if not commanded and 3 in base.address:
                commanded.append(base.send(base.address[3], a_command(77, Action.STOP), now_ns=time.monotonic_ns()))
            return process.poll() is not None

        def read() -> bytes:
            try:
                return port.read(4096)
            except OSError:  # the simulator has hung up
                return b""

        def write(data: bytes) -> None:
            with contextlib.suppress(OSError):
                port.write(data)

        talk(base, read=read, write=write, until=done)
    told = end_of(process)
    assert process.returncode == 0, told
    assert "Traceback" not in told
    assert not path.is_symlink()
    assert not ready_file.exists()

    run = json.loads((out / "run.json").read_text())
    reported, truth = rows_of(out / "reported.csv"), rows_of(out / "encounters.csv")
    assert len(truth) > 50
    assert {row["is_acknowledged"] for row in reported} == {"1"}
    both_sides = sorted((int(row[a]), int(row[b])) for row in truth for a, b in (("id1", "id2"), ("id2", "id1")))
    assert final_entries(base) == both_sides
    assert sorted((int(row["node"]), int(row["peer"])) for row in reported if row["is_ongoing"] == "0") == both_sides
    replies = {(node, one.command, one.result) for node, one in base.of_type(StimulateReply) if isinstance(one, StimulateReply)}
    assert replies == {(3, 77, StimulationResult.DONE)}
    stopped = [row for row in rows_of(out / "modes.csv") if row["mode"] == "S"]
    assert [(row["id"], row["cause"]) for row in stopped] == [("3", "command")]
    assert [(one["id"], one["command"], one["mode"]) for one in run["commands"]] == [(3, 77, "S")]
    assert (run["speed_factor"], run["seed"], run["reports_unacknowledged"]) == (20.0, 5, 0)
    assert abs(run["t0_wall_ns"] / 1e9 - time.time()) < 300
    with np.load(out / "truth.npz") as archive:
        place = archive["position"][:, list(archive["ids"]).index(3)]
        still = archive["t_s"] > float(stopped[0]["t_start_s"]) + 0.1
    assert np.ptp(place[still], axis=0).max() == 0.0
    assert np.ptp(place[~still], axis=0).max() > 0.0


def test_over_tcp_with_a_port_of_its_own_choice_and_the_first_signal_drains(tmp_path: Path) -> None:
    ready_file, out = tmp_path / "ready", tmp_path / "out"
    process = serve(
        "--link", "tcp:127.0.0.1:0", "--biobots", "30", "--speed", "20", "--drain-s", "60", "--loss", "0.1", "--out", str(out),
        "--ready-file", str(ready_file),
    )  # fmt: skip
    host, port = ready(process, ready_file).removeprefix("tcp:").rsplit(":", 1)
    base = BaseStation()
    with socket.create_connection((host, int(port)), timeout=DEADLINE_S) as line:
        line.settimeout(0.01)

        def read() -> bytes:
            try:
                return line.recv(4096)
            except (TimeoutError, ConnectionError):
                return b""

        def write(data: bytes) -> None:
            with contextlib.suppress(ConnectionError):
                line.sendall(data)

        talk(base, read=read, write=write, until=lambda: len(final_entries(base)) > 20)
        process.send_signal(signal.SIGTERM)
        talk(base, read=read, write=write, until=lambda: process.poll() is not None)
    assert process.returncode == 0, end_of(process)
    truth = rows_of(out / "encounters.csv")
    assert final_entries(base) == sorted((int(row[a]), int(row[b])) for row in truth for a, b in (("id1", "id2"), ("id2", "id1")))
    end_of(process)


def test_without_a_gateway_the_second_signal_leaves_at_once_and_the_truth_is_written(tmp_path: Path) -> None:
    ready_file, out = tmp_path / "ready", tmp_path / "out"
    process = serve(
        "--link", f"pty:{tmp_path / 'dongle'}", "--biobots", "30", "--speed", "20", "--duration", "1.5", "--drain-s", "600",
        "--out", str(out), "--ready-file", str(ready_file),
    )  # fmt: skip
    ready(process, ready_file)
    assert process.stderr is not None
    while json.loads(process.stderr.readline())["event"] != "world.ended":
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGTERM)
    told = end_of(process)
    assert process.returncode == 0, told
    events = [json.loads(line) for line in told.splitlines()]
    assert any(one["event"] == "serve.ended" and one["unacknowledged"] > 0 for one in events)
    assert len(rows_of(out / "encounters.csv")) > 5
    assert {row["is_acknowledged"] for row in rows_of(out / "reported.csv")} == {"0"}
    assert not (tmp_path / "dongle").is_symlink()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "link"),
        (("--link", "can:can0"), "pty:"),
        (("--link", "tcp:127.0.0.1:0", "--loss", "1"), "loss"),
        (("--link", "tcp:127.0.0.1:0", "--loss", "nan"), "loss"),
        (("--link", "tcp:127.0.0.1:0", "--speed", "0"), "speed"),
        (("--link", "tcp:127.0.0.1:0", "--speed", "inf"), "speed"),
        (("--link", "tcp:127.0.0.1:0", "--drain-s", "-1"), "drain"),
        (("--link", "tcp:127.0.0.1:0", "--boot", "65536"), "boot"),
    ],
)
def test_bad_usage_is_told_with_the_value_and_what_is_wanted(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--scenario", "two-obstacles", "--seed", "5", *arguments]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("--link", "pty:/nowhere/at/all/dongle"), 1, "/nowhere/at/all"),
        (("--link", "serial:/dev/no-such-port"), 1, "no-such-port"),
        (("--link", "tcp:127.0.0.1:0", "--biobots", "70000", "--duration", "1"), 2, "65534"),
        (("--link", "tcp:127.0.0.1:0", "--ready-file", "/nowhere/ready"), 1, "/nowhere"),
        (("--link", "tcp:127.0.0.1:0", "--out", "/dev/null"), 1, "/dev/null"),
    ],
)
def test_what_cannot_be_had_is_told_with_its_name_and_no_traceback(arguments: tuple[str, ...], status: int, words: str) -> None:
    process = serve(*arguments)
    told = end_of(process)
    assert process.returncode == status, told
    assert words in told
    assert "Traceback" not in told


def test_a_process_that_is_held_up_says_so_once_each_time_and_skips_nothing(tmp_path: Path) -> None:
    ready_file, out = tmp_path / "ready", tmp_path / "out"
    process = serve(
        "--link", f"pty:{tmp_path / 'dongle'}", "--biobots", "10", "--duration", "4", "--drain-s", "0", "--out", str(out),
        "--ready-file", str(ready_file),
    )  # fmt: skip
    ready(process, ready_file)
    process.send_signal(signal.SIGSTOP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=1.2)
    process.send_signal(signal.SIGCONT)
    events = [json.loads(line)["event"] for line in end_of(process).splitlines()]
    of_world = [one for one in events if one.startswith("world.")]
    # A busy machine may hold it up once more: each time is told once, and its end too.
    assert of_world == ["world.behind", "world.caught_up"] * (len(of_world) // 2) + ["world.ended"]
    assert len(of_world) >= 3
    run = json.loads((out / "run.json").read_text())
    assert run["parameters"]["duration_s"] == pytest.approx(4.0)


def test_a_configuration_is_checked_without_opening_anything(tmp_path: Path) -> None:
    config = tmp_path / "serve.toml"
    config.write_text(f'link = "pty:{tmp_path / "dongle"}"\nspeed_factor = 3\n')
    process = serve("--config", str(config), "--check-config")
    assert "valid" in process.communicate(timeout=DEADLINE_S)[0]
    assert process.returncode == 0
    assert os.listdir(tmp_path) == ["serve.toml"]  # noqa: PTH208


def test_warnings_of_the_setting_come_whole(tmp_path: Path) -> None:
    place = ["--scenario", "no-obstacle", "--seed", "1", "--biobots", "5", "--wall-law", "follow"]
    line = ["--link", f"pty:{tmp_path / 'dongle'}", "--duration", "0.2", "--drain-s", "0"]
    command = [sys.executable, "-m", "simulator", "serve", *place, *line]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0
    warning = next(json.loads(line) for line in done.stderr.splitlines() if "walls.never_left" in line)
    assert "exit_hazard" in warning["hint"]
