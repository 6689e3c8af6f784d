"""The gateway's configuration: everything that is wrong with it is told at once, with file and key."""

import json
import socket
from pathlib import Path

import pytest

from firmware_protocol.errors import ConfigurationError
from gateway.__main__ import main
from gateway.config_loading import load_gateway_config, read_address
from gateway.journal_file import open_journal_file


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
        source + "stimulation.frequency_hz is 100, but its own limits are 50 to 55",
        source + "stimulation.channel is 9",
        source + "backpacks.rssi_exit_dbm is -60",
        source + f"recording.directory {tmp_path}/file/below: {tmp_path}/file is a file",
    ):
        assert sum(problem.startswith(start) for problem in problems) == 1, (start, problems)
    assert len(problems) == 15
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "gateway.toml"], "looking makes nothing"


def test_a_train_that_no_window_would_ever_admit_is_a_fault_of_the_configuration(tmp_path: Path) -> None:
    (problem,) = problems_of(tmp_path, 'ports = ["tcp:127.0.0.1:1"]\n[stimulation]\nmax_on_s = 0.4\n')
    assert "stimulation.duration_ms is 500, but no window takes more stimulation than stimulation.max_on_s = 0.4 s" in problem


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


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('connect = ["tcp/base.local:0"]', "connect: endpoint 'tcp/base.local:0' has port '0', but it must be 1 to 65535"),
        ('listen = ["tcp/127.0.0.1:70000"]', "has port '70000', but it must be 0 to 65535"),
        ('connect = ["tcp/foo"]', "names no host and port; give tcp/HOST:PORT"),
        ('log_level = "LOUD"', "wanted DEBUG or INFO or WARNING or ERROR"),
    ],
)
def test_endpoints_need_host_and_port_and_names_are_told_their_choices(tmp_path: Path, line: str, told: str) -> None:
    (problem,) = problems_of(tmp_path, f'ports = ["tcp:127.0.0.1:1"]\n{line}\n')
    assert told in problem


def test_a_variable_of_a_number_is_told_that_a_number_is_wanted_and_one_of_a_list_is_split() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_gateway_config(environment={"BIOBOT_GATEWAY__LINK__OPEN_TIMEOUT_S": "abc", "BIOBOT_GATEWAY__PORTS": "tcp:127.0.0.1:1"})
    (problem,) = caught.value.problems
    assert "float" in problem
    assert "array" not in problem
    environment = {"BIOBOT_GATEWAY__PORTS": "tcp:127.0.0.1:1, tcp:127.0.0.1:2"}
    assert load_gateway_config(environment=environment).ports == ("tcp:127.0.0.1:1", "tcp:127.0.0.1:2")


def test_the_journal_that_is_there_is_tried_and_nothing_is_left_of_that(tmp_path: Path) -> None:
    path = tmp_path / "j.sqlite"
    open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="", gateway="base1").close()
    before = {one.name for one in tmp_path.iterdir()}

    def problems(name: str) -> list[str]:
        flags = {"journal": str(path), "name": name, "ports": ["tcp:127.0.0.1:1"]}
        try:
            load_gateway_config(flags=flags, tries_places=True)
        except ConfigurationError as error:
            return list(error.problems)
        return []

    assert problems("base1") == []
    (problem,) = problems("base2")
    assert 'set name = "base1", or name another journal' in problem
    assert {one.name for one in tmp_path.iterdir()} == before
    path.write_text("a diary")
    assert "is no journal" in problems("base1")[0]


def test_a_gateway_of_another_name_does_not_start_with_the_journal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "j.sqlite"
    open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="", gateway="base1").close()
    arguments = ["run", "--port", "tcp:127.0.0.1:1", "--journal", str(path), "--name", "base2", "--listen", "tcp/127.0.0.1:0"]
    assert main(arguments) == 1
    assert "is of gateway 'base1', but this gateway is called 'base2'" in capsys.readouterr().err
    assert main([*arguments, "--check-config"]) == 2
    assert 'set name = "base1"' in capsys.readouterr().err


@pytest.mark.parametrize("end", ["listen", "connect"])
def test_an_endpoint_without_tls_is_told_by_the_flag_that_gave_it(end: str) -> None:
    flags: dict[str, object] = {"listen": [], "connect": [], end: ["tls/127.0.0.1:7447"]}
    with pytest.raises(ConfigurationError) as caught:
        load_gateway_config(environment={}, flags=flags, flag_names={"listen": "--listen", "connect": "--connect"}, needs_radio=False)
    assert [problem.split(" ")[0] for problem in caught.value.problems] == [f"--{end}:"]


def test_a_check_says_what_would_be_in_the_way_now_and_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The other program may be the service whose file is checked, and a dongle may come later: warnings, each with the next step."""
    path = tmp_path / "j.sqlite"
    journal = open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="", gateway="base1")
    with socket.create_server(("127.0.0.1", 0)) as one, socket.create_server(("127.0.0.1", 0)) as other:
        endpoint, monitor = f"tcp/127.0.0.1:{one.getsockname()[1]}", f"127.0.0.1:{other.getsockname()[1]}"
        arguments = ["run", "--name", "base1", "--journal", str(path), "--listen", endpoint, "--monitor", monitor, "--check-config"]
        arguments += ["--port", f"serial:{tmp_path}/dongle", "--port", "can:socketcan:nocan9?unit=1"]
        assert main(arguments) == 0
        told = capsys.readouterr()
        assert main(["router", "--listen", endpoint, "--check-config"]) == 0
        assert f"warning: listen: {endpoint}: another program has it; end what" in capsys.readouterr().err
    for warning in (
        f"listen: {endpoint}: another program has it; end what listens there",
        f"monitor.listen: {monitor}: another program has it; end what listens there",
        f"journal {path}: a gateway has it open; stop that one",
        f"port serial:{tmp_path}/dongle: {tmp_path}/dongle is not there; plug the dongle in",
        "there is no network interface nocan9; plug the adapter in",
    ):
        assert sum(f"warning: {warning}" in line or f": {warning}" in line for line in told.err.splitlines()) == 1, warning
    assert len(told.err.splitlines()) == 5
    assert json.loads(told.out)["name"] == "base1"
    journal.close()
    (tmp_path / "dongle").touch()
    assert main([*arguments[:-2], "--check-config"]) == 0
    assert capsys.readouterr().err == "", "what is in nobody's way is not told"
