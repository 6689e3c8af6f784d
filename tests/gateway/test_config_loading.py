"""The gateway's configuration: everything that is wrong with it is told at once, with file and key."""

from pathlib import Path

import pytest

from firmware_protocol.errors import ConfigurationError
from gateway.config_loading import load_gateway_config, read_address


def problems_of(tmp_path: Path, toml: str, **environment: str) -> list[str]:
    file = tmp_path / "gateway.toml"
    file.write_text(toml)
    with pytest.raises(ConfigurationError) as caught:
        load_gateway_config(toml_path=file, environment=environment)
    return list(caught.value.problems)


def test_all_faults_of_all_kinds_and_sources_are_told_at_once(tmp_path: Path) -> None:
    """A value, a key, a name, ports, endpoints, a pulse, thresholds, files and addresses: one round."""
    (tmp_path / "file").write_text("")
    toml = f"""
    nmae = "x"
    site = "a/b"
    ports = ["serial:/dev/a", "serial:/dev/a?baud=9600", "can:can0"]
    journal = "{tmp_path}/nowhere/j.sqlite"
    listen = ["7447"]
    log_format = "xml"
    [link]
    max_backoff_s = -1
    [stimulation]
    pulse_width_us = 9000
    frequency_hz = 100
    channel = 9
    [backpacks]
    rssi_enter_dbm = -70
    rssi_exit_dbm = -60
    [recording]
    directory = "{tmp_path}/file/below"
    """
    problems = problems_of(tmp_path, toml, BIOBOT_GATEWAY__MONITOR__LISTEN="here", BIOBOT_GATEWAY__LINK__NOPE="1")

    source = f"{tmp_path}/gateway.toml: "
    for start in (
        source + "unknown key 'nmae'",
        "BIOBOT_GATEWAY__LINK__NOPE: unknown key 'link.nope'",
        source + "link.max_backoff_s is -1",
        source + "log_format is 'xml'",
        source + "site: ",
        source + "port serial:/dev/a is named twice",
        source + "port 'can:can0'",
        source + f"journal {tmp_path}/nowhere/j.sqlite: {tmp_path}/nowhere is no directory; make it",
        source + "listen: endpoint '7447' must be LINK/ADDRESS",
        "BIOBOT_GATEWAY__MONITOR__LISTEN: monitor.listen: 'here' is no HOST:PORT",
        source + "stimulation.pulse_width_us is 9000",
        source + "stimulation.channel is 9",
        source + "backpacks.rssi_exit_dbm is -60",
        source + f"recording.directory {tmp_path}/file/below: {tmp_path}/file is a file",
    ):
        assert sum(problem.startswith(start) for problem in problems) == 1, (start, problems)
    assert len(problems) == 14
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "gateway.toml"], "looking makes nothing"


def test_a_journal_that_is_a_directory_is_a_fault_of_the_configuration(tmp_path: Path) -> None:
    (problem,) = problems_of(tmp_path, f'ports = ["tcp:127.0.0.1:1"]\njournal = "{tmp_path}"\n')
    assert problem.endswith(f"journal {tmp_path}: is a directory; name a file")


@pytest.mark.parametrize(
    ("text", "address"), [("127.0.0.1:9466", ("127.0.0.1", 9466)), ("[::1]:0", ("::1", 0)), ("base.local:65535", ("base.local", 65535))]
)
def test_addresses_are_read(text: str, address: tuple[str, int]) -> None:
    assert read_address(text) == address


@pytest.mark.parametrize("text", ["", "9466", ":9466", "host:", "host:65536", "::1:80", "a b:1", "[::1]", "host:-1"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no HOST:PORT"):
        read_address(text)
