"""Results are written whole or not at all, and where they cannot be written is told before they are computed."""

import contextlib
import json
import os
import resource
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mapper.__main__ import main
from mapper.errors import OutputFileError
from mapper.output_files import check_outputs, write_output

ROWS = "t_start_s,t_end_s,id1,id2\n" + "".join(f"{t},{t + 0.5},{a},{b}\n" for t, a, b in [(0, 1, 2), (1, 2, 3), (2, 1, 3), (3, 1, 2)])


@pytest.fixture
def encounters(tmp_path: Path) -> Path:
    path = tmp_path / "encounters.csv"
    path.write_text(ROWS)
    return path


def _run(*arguments: object, given: str = "") -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "mapper", "run", *map(str, arguments)]
    return subprocess.run(command, input=given.encode(), capture_output=True, timeout=120, check=False)


def test_a_file_is_replaced_with_its_links_and_rights_kept(tmp_path: Path) -> None:
    file, link = tmp_path / "map.json", tmp_path / "link.json"
    file.write_text("old")
    file.chmod(0o640)
    link.symlink_to(file)
    write_output(link, b"new")
    assert link.is_symlink()
    assert (file.read_text(), file.stat().st_mode & 0o777) == ("new", 0o640)
    assert sorted(tmp_path.iterdir()) == [link, file]


def test_a_disk_that_is_full_leaves_the_old_file(tmp_path: Path) -> None:
    file = tmp_path / "map.json"
    file.write_text("old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(OutputFileError, match="cannot write: file too large"):
            write_output(file, bytes(5000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("flag", ["--json", "--svg", "--png"])
def test_a_place_that_cannot_be_written_to_is_told_before_the_input_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flag: str
) -> None:
    nowhere = tmp_path / "none" / "map"
    assert main(["run", str(tmp_path / "missing.csv"), flag, str(nowhere)]) == 1
    assert f"{nowhere}: cannot write: there is no directory {nowhere.parent}" in capsys.readouterr().err


def test_a_directory_without_write_permission_is_refused() -> None:
    with pytest.raises(OutputFileError, match="cannot write"):
        check_outputs([Path("/proc/biobot.json")], [])


def test_links_in_a_circle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(OutputFileError, match="cannot write"):
        check_outputs([tmp_path / "a"], [])


def test_a_full_device_is_an_error(encounters: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(encounters), "--json", "/dev/full"]) == 1
    assert "/dev/full: cannot write: no space left on device" in capsys.readouterr().err


def test_a_named_pipe_is_written_through(encounters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe, received = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: received.append(pipe.read_text()))
    reader.start()
    assert main(["run", str(encounters), "--json", str(pipe)]) == 0
    reader.join()
    assert json.loads(received[0])["n_encounters"] == 4
    assert pipe.is_fifo()
    assert "encounters     4" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["-", "/dev/stdout", "/dev/fd/1"])
def test_each_format_goes_to_standard_output_alone(encounters: Path, name: str) -> None:
    assert json.loads(_run(encounters, "--json", name).stdout)["n_encounters"] == 4
    if name == "-":
        assert _run(encounters, "--svg", name).stdout.startswith(b"<?xml")
        picture = _run(encounters, "--png", name).stdout
        assert picture.startswith(b"\x89PNG")
        assert picture.endswith(b"IEND\xaeB`\x82")


def test_standard_output_redirected_to_a_file_is_appended_to(encounters: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("before\n")
    with log.open("a") as file:
        command = [sys.executable, "-m", "mapper", "run", str(encounters), "--json", "/dev/stdout"]
        subprocess.run(command, stdout=file, stderr=subprocess.DEVNULL, timeout=120, check=True)
    first, second = log.read_text().splitlines()
    assert (first, json.loads(second)["n_encounters"]) == ("before", 4)


def test_two_results_on_standard_output_are_refused(encounters: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(encounters), "--svg", "-", "--json", "-"]) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert "standard output is named for two outputs" in output.err


def test_a_file_with_the_map_leaves_the_summary_on_the_screen(encounters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(encounters), "--json", str(tmp_path / "map.json"), "--svg", str(tmp_path / "map.svg")]) == 0
    assert "encounters     4" in capsys.readouterr().out
    assert json.loads((tmp_path / "map.json").read_text())["n_encounters"] == 4


def test_an_input_may_be_standard_input() -> None:
    assert json.loads(_run("-", "--json", "-", given=ROWS).stdout)["n_encounters"] == 4
    twice = _run("-", "--modes", "-", given=ROWS)
    assert twice.returncode == 2
    assert b"standard input can be given for one file" in twice.stderr
    wrong = _run("-", given="a,b\n")
    assert wrong.returncode == 1
    assert b"-: line 1: the header 'a,b' lacks" in wrong.stderr


def test_a_hard_link_to_an_input_and_a_database_are_not_written_over(tmp_path: Path) -> None:
    source, database = tmp_path / "log.csv", tmp_path / "store.sqlite"
    source.write_text("a")
    (tmp_path / "again.csv").hardlink_to(source)
    with contextlib.closing(sqlite3.connect(database)) as connection:
        connection.execute("CREATE TABLE one (n)")
    with pytest.raises(OutputFileError, match="is also an input"):
        check_outputs([tmp_path / "again.csv"], [source])
    with pytest.raises(OutputFileError, match="is a database"):
        check_outputs([database], [source])


@pytest.mark.parametrize("program", ["mapper", "simulator", "gateway"])
def test_standard_output_without_room_is_told_in_a_line(program: str) -> None:
    arguments = {"mapper": ["config", "schema"], "simulator": ["scenarios"], "gateway": ["config", "schema"]}[program]
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run([sys.executable, "-m", program, *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.endswith("cannot write: no space left on device; make room, or send the output to another place")
