"""The command line as a user meets it."""

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.__main__ import main
from studies.ports import free_port
from studies.reference import COMMANDS

_ROOT = Path(__file__).parents[2]


def _gateway(*arguments: str, cwd: Path, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gateway", *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(_ROOT), **(env or {})},
        timeout=120,
        check=False,
    )


def _in_process(*arguments: str, cwd: Path, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Do the same where no second process is needed: an interpreter takes a second to start, and there are many cases."""
    out, err, before = io.StringIO(), io.StringIO(), dict(os.environ)
    os.environ.update({"COLUMNS": "80", **(env or {})})
    try:
        with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main(list(arguments))
    except SystemExit as leaving:
        status = int(leaving.code or 0)
    finally:
        os.environ.clear()
        os.environ.update(before)
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())


def _status(endpoint: str, *, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Ask a gateway that is starting; each try waits some seconds for it."""
    for _ in range(20):
        told = _in_process("status", "--connect", endpoint, cwd=cwd)
        if told.returncode == 0:
            break
    return told


def test_help_fits_one_screen_and_version_is_told(tmp_path: Path) -> None:
    for arguments in (["--help"], *([*command.split(), "--help"] for command in COMMANDS["biobot-gateway"][1])):
        result = _in_process(*arguments, cwd=tmp_path)
        assert result.returncode == 0
        assert len(result.stdout.splitlines()) <= 45
    assert _gateway("--version", cwd=tmp_path).stdout.startswith("biobot-gateway ")


def test_flags_win_over_the_environment_and_that_over_the_file(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text('name = "from_file"\nsite = "from_file"\njournal = "f.sqlite"\n[stimulation]\nmin_gap_s = 4.0\n')
    result = _in_process(
        "run",
        "--config",
        str(file),
        "--port",
        "tcp:127.0.0.1:1",
        "--name",
        "from_flag",
        "--check-config",
        cwd=tmp_path,
        env={"BIOBOT_GATEWAY__SITE": "from_env", "BIOBOT_GATEWAY__NAME": "from_env"},
    )
    assert result.returncode == 0, result.stderr
    config = json.loads(result.stdout)
    assert (config["name"], config["site"], config["journal"]) == ("from_flag", "from_env", "f.sqlite")
    assert config["stimulation"]["min_gap_s"] == 4.0
    assert list(tmp_path.iterdir()) == [file], "checking makes nothing"


@pytest.mark.parametrize(
    ("toml", "arguments", "word"),
    [
        ("nmae = 'x'\n", [], "unknown key 'nmae'"),
        ("[stimulation]\nmin_gap_s = 0.5\n", [], "min_gap_s"),
        ("[stimulation]\nmax_trains = 31\n", [], "max_trains"),
        ("[stimulation]\npulse_width_us = 9000\nfrequency_hz = 100\n", [], "two phases must fit"),
        ("[stimulation]\nchannel = 8\n", [], "channels 0 to 7"),
        ("[stimulation]\nwaveform = 'square'\n", [], "waveform"),
        ("[backpacks]\nrssi_enter_dbm = -70\nrssi_exit_dbm = -60\n", [], "must not be above backpacks.rssi_enter_dbm = -70"),
        ("[backpacks]\nbeacon_period_ms = 0\n", [], "beacon_period_ms"),
        ("name = 'a/b'\n", [], "a gateway name has"),
        ("", ["--port", "can:can0"], "must be can:INTERFACE:CHANNEL"),
        ("", ["--port", "tcp:127.0.0.1:1"], "is named twice"),
        ("", ["--port", "can:slcan:/dev/x?unit=1&fd=1", "--port", "can:slcan:/dev/x?unit=2"], "the same for all units of a bus"),
        ("", ["--port", "can:slcan:/dev/x?unit=1", "--port", "can:slcan:/dev/x?unit=2&bitrate=250000"], "bitrate=250000"),
        ("name = ", [], "not valid TOML"),
    ],
)
def test_a_wrong_configuration_is_told_and_is_exit_2(tmp_path: Path, toml: str, arguments: list[str], word: str) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(toml)
    result = _in_process("run", "--config", str(file), "--port", "tcp:127.0.0.1:1", *arguments, "--check-config", cwd=tmp_path)
    assert result.returncode == 2
    assert word in result.stderr
    assert "Traceback" not in result.stderr


def test_no_port_a_missing_file_and_bad_usage_are_exit_2(tmp_path: Path) -> None:
    for arguments, word in (
        (["run"], "no radio"),
        (["run", "--config", "nowhere.toml"], "nowhere.toml"),
        (["fly"], "invalid choice"),
        (["command", "7", "jump"], "invalid choice"),
        (["command", "-7", "stop"], "node is -7"),
        (["command", "7", "stop", "--ttl-ms", "0"], "--ttl-ms is 0"),
        (["stop"], "give numbers of biobots, or --all"),
        (["stop", "everybody"], "'everybody' is no biobot's number; give numbers, or --all for every biobot"),
    ):
        result = _in_process(*arguments, cwd=tmp_path)
        assert (result.returncode, "Traceback" in result.stderr) == (2, False), result.stderr
        assert word in result.stderr


def test_a_journal_that_cannot_be_used_and_a_gateway_that_is_not_there_are_exit_1(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no database" * 100)
    result = _gateway("run", "--port", "tcp:127.0.0.1:1", "--journal", "text", cwd=tmp_path)
    assert (result.returncode, "Traceback" in result.stderr) == (1, False)
    assert "journal text: is no journal" in result.stderr
    result = _in_process("command", "7", "stop", "--connect", f"tcp/127.0.0.1:{free_port()}", cwd=tmp_path)
    assert (result.returncode, "Traceback" in result.stderr) == (1, False)
    assert "nobody listens there" in result.stderr


def test_a_gateway_with_no_dongle_runs_answers_and_stops_on_sigterm(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with subprocess.Popen(
        [sys.executable, "-m", "gateway", "run", "--port", "serial:/dev/not-there", "--listen", endpoint],
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(_ROOT)},
    ) as gateway:
        assert gateway.stderr is not None
        told: dict[str, dict[str, str]] = {}
        while not {"gateway.started", "radio.down"} <= set(told):
            line = json.loads(gateway.stderr.readline())
            told[line["event"]] = line
        assert "list-ports" in told["radio.down"]["reason"]
        result = _in_process("command", "7", "stop", "--connect", endpoint, cwd=tmp_path)
        assert result.returncode == 1
        (stage,) = map(json.loads, result.stdout.splitlines())
        assert (stage["stage"], stage["node"]) == ("refused", 7)
        gateway.send_signal(signal.SIGTERM)
        rest = gateway.stderr.read()
        assert gateway.wait(timeout=60) == 0
    assert "gateway.stopped" in rest
    assert "Traceback" not in rest


def test_a_configuration_can_be_checked_without_a_command(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text('site = "ruin"\n')

    result = _in_process("--config", str(file), "--check-config", cwd=tmp_path)

    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["site"] == "ruin"
    file.write_text('sight = "ruin"\n')
    result = _in_process("--config", str(file), "--check-config", cwd=tmp_path)
    assert result.returncode == 2
    assert "sight" in result.stderr


def test_a_second_gateway_of_the_same_name_at_a_site_is_refused(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "gateway", "run", "--port", "tcp:127.0.0.1:1", "--listen", endpoint]
    with subprocess.Popen(command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(_ROOT)}, stderr=subprocess.DEVNULL) as gateway:
        try:
            while "is connecting" in (told := _status(endpoint, cwd=tmp_path)).stdout:
                pass  # the first status may be told before the radio was tried
            other = ["run", "--port", "tcp:127.0.0.1:1", "--journal", "b.sqlite", "--listen", f"tcp/127.0.0.1:{free_port()}"]
            result = _gateway(*other, "--connect", endpoint, cwd=tmp_path)
        finally:
            gateway.send_signal(signal.SIGTERM)

    assert result.returncode == 1
    assert "another --name" in result.stderr
    status = json.loads(told.stdout)
    assert status["missing"][0].startswith("no radio is up: tcp:127.0.0.1:1 is down (cannot open")
    assert status["radio_reports"]["tcp:127.0.0.1:1"]["state"] == "down"


def test_no_command_is_bad_usage(tmp_path: Path) -> None:
    result = _in_process(cwd=tmp_path)

    assert result.returncode == 2
    assert "list-ports" in result.stderr


def test_the_status_of_a_gateway_that_is_not_there_fails_and_says_what_to_look_at(tmp_path: Path) -> None:
    result = _in_process("status", "--connect", f"tcp/127.0.0.1:{free_port()}", cwd=tmp_path)

    assert result.returncode == 1
    assert "nobody listens there; is the gateway or router running, and the port right?" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_stop_that_reaches_nobody_says_that_nothing_was_stopped(tmp_path: Path) -> None:
    result = _in_process("stop", "--all", "--connect", f"tcp/127.0.0.1:{free_port()}", cwd=tmp_path)

    assert result.returncode == 1
    assert "nothing was stopped: cannot connect: " in result.stderr


def test_the_status_of_a_running_gateway_is_printed(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "gateway", "run", "--port", "tcp:127.0.0.1:1", "--listen", endpoint, "--name", "base7"]
    with subprocess.Popen(command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(_ROOT)}, stderr=subprocess.DEVNULL) as gateway:
        try:
            result = _status(endpoint, cwd=tmp_path)
            elsewhere = _in_process("stop", "all", "--site", "other", "--connect", endpoint, cwd=tmp_path)
            stopped = _in_process("stop", "7", "--all", "--connect", endpoint, cwd=tmp_path)
        finally:
            gateway.send_signal(signal.SIGTERM)

    assert elsewhere.returncode == 1
    assert "are site and endpoint right? There is gateway 'base7' at site 'local'. Nothing was stopped" in elsewhere.stderr
    # Its dongle is not there: all are wanted, and nothing confirms; it is asked all the same.
    assert {json.loads(line)["action"] for line in stopped.stdout.splitlines()} == {"stop_all"}
    assert "asked: base7;" in stopped.stderr
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["gateway"] == "base7"
    assert gateway.returncode == 0
