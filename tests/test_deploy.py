"""Units and rules of gateway/installation/system are what their own tools take, and faults in them are found."""

import shutil
import tomllib
from pathlib import Path

import pytest

from gateway.__main__ import main
from scripts.deploy_check import SYSTEM, check_rules, check_units, exposures
from studies.reference import COMMANDS

UNITS = sorted(SYSTEM.glob("*.service"))
needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not here: install systemd")


@needs_systemd
def test_systemd_finds_nothing_wrong_with_the_units_and_little_exposed() -> None:
    assert check_units() == []
    assert len(exposures()) == len(UNITS) >= 3


@needs_systemd
@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("WatchdogSec=20", "WatchdogSeconds=20", "'WatchdogSeconds'"),
        ("Restart=always", "Restart=sometimes", "sometimes"),
        ("ProtectSystem=strict\nProtectHome=yes\nPrivateTmp=yes", "", "Overall exposure"),
    ],
)
def test_a_fault_in_a_unit_is_found(tmp_path: Path, old: str, new: str, word: str) -> None:
    text = (SYSTEM / "biobot-gateway.service").read_text()
    assert old in text
    broken = text.replace(old, new)
    if word == "Overall exposure":
        broken = broken.replace("SystemCallFilter=@system-service", "").replace("CapabilityBoundingSet=\n", "").replace("User=biobot\n", "")
    (tmp_path / "biobot-gateway.service").write_text(broken)
    assert any(word in problem for problem in check_units(tmp_path)), check_units(tmp_path)


def test_the_rules_keep_udevs_grammar_or_udev_itself_finds_nothing() -> None:
    assert check_rules() == []


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ('SUBSYSTEM="tty"', "SUBSYSTEM cannot stand before ="),
        ('SUBSISTEM=="tty"', "SUBSISTEM cannot stand"),
        ('SUBSYSTEM=="tty" GOTO="x"', "no KEY"),
        ('SUBSYSTEM=="tty, GOTO="x"', "no KEY"),
        ('SUBSYSTEM=="tty", GOTO="nowhere"', "no LABEL 'nowhere'"),
        ('GROUP="dialout",', "nothing follows the last comma"),
    ],
)
def test_a_fault_in_a_rule_is_found(tmp_path: Path, line: str, word: str) -> None:
    (tmp_path / "70-x.rules").write_text(f"# a rule\n{line}\n")
    assert any(word in problem for problem in check_rules(tmp_path)), check_rules(tmp_path)


@pytest.mark.parametrize("name", ["biobot-gateway", "biobot-mapper", "biobot-router"])
def test_each_unit_starts_a_command_that_there_is_and_is_started_for_ever(name: str) -> None:
    unit = SYSTEM / f"{name}.service"
    keys = [line.split("=", 1) for line in unit.read_text().splitlines() if "=" in line and not line.startswith("#")]
    (command,) = [value.split() for key, value in keys if key == "ExecStart"]
    values = dict(keys)
    assert command[1] in COMMANDS[Path(command[0]).name][1]
    assert (values["Restart"], values["StartLimitIntervalSec"], values["User"]) == ("always", "0", "biobot")


def test_the_example_configurations_are_valid(capsys: pytest.CaptureFixture[str]) -> None:
    example = SYSTEM / "gateway.toml"
    assert main(["--config", str(example), "--check-config"]) == 0, capsys.readouterr().err
    assert tomllib.loads(example.read_text())["monitor"]["listen"] == "127.0.0.1:9466"
