"""Laws of ``biobot-gateway audit``."""

import contextlib
import csv
import json
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from firmware_protocol.contract.commands import PulseRequest, Stage, StimulationRequest, WaveformName
from firmware_protocol.contract.records import decode_record, encode_record
from gateway.__main__ import main
from gateway.journal_file import AuditSelection, open_journal_file, read_audit_rows
from tests.gateway.audited import WALL_NS, a_note, a_stage, commit, delete, swap, write_audited

ROOT = Path(__file__).parents[2]
_Captured = pytest.CaptureFixture[str]


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    write_audited(tmp_path / "j", 20)
    return tmp_path / "j"


def _run(captured: _Captured, *arguments: str | Path) -> tuple[int, str, str]:
    status = main(["audit", *map(str, arguments)])
    said = captured.readouterr()
    return status, said.out, said.err


def test_a_whole_log_is_whole_while_it_is_written_and_when_it_is_not(journal: Path, capsys: _Captured) -> None:
    status, out, _ = _run(capsys, "verify", journal)
    assert (status, out.split()[:2]) == (0, ["20", "rows,"])
    file = open_journal_file(journal, now_wall_ns=WALL_NS, now_ns=0, machine_boot="m")
    commit(file, [a_note(99)])
    status, out, _ = _run(capsys, "verify", journal)
    assert (status, out.split()[:2]) == (0, ["21", "rows,"])
    assert out.split()[-1] == file.audit_head.chain.hex()
    file.close()


@pytest.mark.parametrize(("edit", "told"), [(delete(4, 4), "row 4 is missing"), (swap(3, 9), "reordered: what was row 3 is row 9 now")])
def test_a_log_that_was_changed_exits_with_1_and_says_where(
    journal: Path, capsys: _Captured, edit: Callable[[sqlite3.Connection], None], told: str
) -> None:
    with contextlib.closing(sqlite3.connect(journal)) as database, database:
        edit(database)
    status, _, err = _run(capsys, "verify", journal)
    assert status == 1
    assert told in err
    assert "audit show" in err, "and the next step"
    assert main(["journal", "check", str(journal)]) == 1
    assert told in capsys.readouterr().err


def test_a_noted_head_is_found_and_one_that_is_not_there_is_missed(journal: Path, capsys: _Captured) -> None:
    heads = [row.chain.hex() for row in read_audit_rows(journal, AuditSelection()) if not hasattr(row, "reason")]
    status, out, _ = _run(capsys, "verify", journal, "--head", heads[11][:16])
    assert (status, out.splitlines()[-1]) == (0, f"{heads[11][:16]} is row 12")
    status, _, err = _run(capsys, "verify", journal, "--head", "00" * 32)
    assert status == 1
    assert "no row has the hash" in err
    with pytest.raises(SystemExit, match="2"):
        main(["audit", "verify", str(journal), "--head", "xyz"])


def test_rows_are_chosen_by_biobot_operator_command_kind_and_time(journal: Path, capsys: _Captured) -> None:
    def numbers(*flags: str) -> list[int]:
        status, out, _ = _run(capsys, "show", journal, "--json", *flags)
        assert status == 0
        return [json.loads(line)["id"] for line in out.splitlines()]

    stages = [number for number in range(1, 21) if number % 3]
    assert numbers() == list(range(1, 21))
    assert numbers("--operator", "ann") == numbers("--kind", "stage") == stages
    assert numbers("--node", "3") == [number for number in stages if (number - 1) % 4 == 3]
    assert numbers("--command", "c9") == [10]
    assert numbers("--since", "2026-11-18T11:06:56+00:00") == [number for number in stages if number > 16], "notes are of the first second"


def test_a_kind_of_which_there_is_no_row_is_said_with_those_that_there_are(journal: Path, tmp_path: Path, capsys: _Captured) -> None:
    for action in (("show", journal), ("export", journal, "--csv", tmp_path / "t.csv")):
        status, out, err = _run(capsys, *action, "--kind", "stages")
        assert (status, out) == (1, "")
        assert "'stages'" in err
        assert "stage" in err.partition("there is ")[2]
    assert not (tmp_path / "t.csv").exists()


def test_a_line_says_who_wanted_what_of_whom_and_what_became_of_it(tmp_path: Path, capsys: _Captured) -> None:
    path = tmp_path / "j"
    with contextlib.closing(open_journal_file(path, now_wall_ns=WALL_NS, now_ns=0, machine_boot="m")) as file:
        commit(
            file,
            [a_stage(0), a_stage(0, operator="\x1b[2Jeve\u202e\n", stage=Stage.REFUSED, reason="wait 1.5 s\r\n"), a_note(3, why="a b")],
        )
    status, out, _ = _run(capsys, "show", path)
    assert status == 0
    accepted, refused, note = out.splitlines()
    assert accepted == "2026-11-18T11:06:40.000Z      1 ann: turn_left biobot 3 accepted, 500 ms of stimulation [c0]"
    assert refused.endswith(r"2 \x1b[2Jeve\u202e\n: turn_left biobot 3 refused [c0]: wait 1.5 s\r\n")
    assert note.endswith("3 ben: order number=3 why='a b'")


def test_a_table_has_all_rows_and_no_formulas(tmp_path: Path, capsys: _Captured) -> None:
    path, table, lines = tmp_path / "j", tmp_path / "t.csv", tmp_path / "t.jsonl"
    with contextlib.closing(open_journal_file(path, now_wall_ns=WALL_NS, now_ns=0, machine_boot="m")) as file:
        commit(file, [a_stage(0, operator="=cmd()"), a_note(1, at=float("nan"), octets=b"\x01")])
    assert _run(capsys, "export", path, "--csv", table)[0] == _run(capsys, "export", path, "--json", lines)[0] == 0
    with table.open(encoding="utf-8", newline="") as stream:
        first, second = csv.DictReader(stream)
    assert (first["operator"], first["action"], first["train_ms"], first["facts"]) == ("'=cmd()", "turn_left", "500", "")
    assert json.loads(second["facts"]) == {"number": 1, "at": "nan", "octets": "01"}
    exported = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()]
    assert [row["hash"] for row in exported] == [first["hash"], second["hash"]]
    status, _, err = _run(capsys, "export", path, "--csv", tmp_path / "nowhere" / "t.csv")
    assert status == 1
    assert "there is no directory" in err


def test_what_was_asked_of_a_train_is_shown_and_exported(tmp_path: Path, capsys: _Captured) -> None:
    path, table = tmp_path / "j", tmp_path / "t.csv"
    pulse = PulseRequest(
        frequency_hz=50, pulse_width_us=4000, amplitude_mv=1500, duration_ms=300, channel=1, waveform=WaveformName.SYMMETRIC
    )
    plain = decode_record(a_stage(0).request, StimulationRequest)
    asked = replace(a_stage(0), request=encode_record(msgspec.structs.replace(plain, pulse=pulse, ttl_ms=750)))
    with contextlib.closing(open_journal_file(path, now_wall_ns=WALL_NS, now_ns=0, machine_boot="m")) as file:
        commit(file, [asked])
    _, out, _ = _run(capsys, "show", path, "--json")
    said = json.loads(out)
    assert said.items() >= {**msgspec.to_builtins(pulse), "ttl_ms": 750, "issued_wall_ns": WALL_NS}.items()
    assert _run(capsys, "export", path, "--csv", table)[0] == 0
    with table.open(encoding="utf-8", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert row.items() >= {name: str(value) for name, value in msgspec.to_builtins(pulse).items()}.items()
    assert (row["ttl_ms"], row["issued_wall_ns"]) == ("750", str(WALL_NS))


def test_a_row_that_no_gateway_wrote_is_named_and_the_others_are_shown(journal: Path, tmp_path: Path, capsys: _Captured) -> None:
    with contextlib.closing(sqlite3.connect(journal)) as database, database:
        database.execute("UPDATE audit SET wall_ns = 'noon', operator = CAST(x'ff' AS TEXT) WHERE id = 5")
        database.execute("UPDATE audit SET body = x'c1', request = x'c1', operator = CAST(x'ff' AS TEXT) WHERE id = 7")
    status, out, err = _run(capsys, "show", journal)
    assert (status, len(out.splitlines())) == (0, 19)
    assert "row 5 is not as a gateway writes it" in err
    status, _, err = _run(capsys, "export", journal, "--csv", tmp_path / "t.csv")
    assert status == 1
    assert "rows 5;" in err


def test_rows_of_whole_pages_are_shown_where_others_are_damaged(tmp_path: Path, capsys: _Captured) -> None:
    path = tmp_path / "j"
    write_audited(path, 300)
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (size,) = database.execute("PRAGMA page_size").fetchone()
    octets = bytearray(path.read_bytes())
    is_leaf_of_table = 0x0D  # SQLite's file format, 1.6
    (at,) = (at for at in range(0, len(octets), size) if octets[at] == is_leaf_of_table and b"c100" in octets[at : at + size])
    octets[at : at + size] = bytes(size)
    path.write_bytes(octets)
    status, out, err = _run(capsys, "show", path, "--json")
    numbers = [json.loads(line)["id"] for line in out.splitlines()]
    assert (status, numbers[0], numbers[-1]) == (0, 1, 300)
    missing = sorted(set(range(1, 301)) - set(numbers))
    assert missing == list(range(missing[0], missing[-1] + 1)), "one page"
    assert 0 < len(missing) < 100
    assert f"rows {missing[0]} to {missing[-1]} are not as a gateway writes it" in err


@pytest.mark.parametrize("command", [("audit", "--csv"), ("audit", "--json"), ("journal", "--csv")])
@pytest.mark.parametrize("name", ["j", "symlink", "hardlink", "other", "j-wal", "j-shm"])
def test_no_export_is_written_over_a_journal_by_whatever_name(
    journal: Path, tmp_path: Path, capsys: _Captured, command: tuple[str, str], name: str
) -> None:
    (tmp_path / "symlink").symlink_to(journal)
    (tmp_path / "hardlink").hardlink_to(journal)
    write_audited(tmp_path / "other", 3)
    journals = ("j", "other", "hardlink")  # beside them reading makes files
    before = [(tmp_path / one).read_bytes() for one in journals]
    assert main([command[0], "export", str(journal), command[1], str(tmp_path / name)]) != 0
    said = capsys.readouterr().err
    assert "which would be lost; name another file" in said
    assert [(tmp_path / one).read_bytes() for one in journals] == before
    assert (tmp_path / "symlink").is_symlink()
    assert not list(tmp_path.glob(".*.partial"))
    assert main([command[0], "export", str(journal), command[1], str(tmp_path / "table")]) == 0


def test_doses_are_told_by_biobot(tmp_path: Path, capsys: _Captured) -> None:
    path = tmp_path / "j"
    with contextlib.closing(open_journal_file(path, now_wall_ns=WALL_NS, now_ns=0, machine_boot="m")) as file:
        commit(file, [a_stage(number, stage=stage) for number in range(2) for stage in (Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)])
        commit(
            file,
            [a_stage(5, node=9), a_stage(5, node=9, stage=Stage.REFUSED), a_stage(6), replace(a_stage(6), kind="taken_back", train_ms=0)],
        )
        commit(file, [a_note(7), a_stage(8, node=0, stage=Stage.REFUSED), a_stage(9, node=70_000, stage=Stage.REFUSED)])
        commit(file, [a_stage(10, node=4, stage=Stage.REFUSED)])
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("INSERT INTO nodes VALUES (4, x'')")
        database.commit()
    status, out, _ = _run(capsys, "stats", path)
    assert status == 0
    assert [line.split() for line in out.splitlines()[1:]] == [
        ["3", "2", "1.0", "3", "2", "0", "0", "0", "2026-11-18T11:06:41.000Z"],
        ["4", "0", "0.0", "0", "0", "1", "0", "0", "-"],
        ["9", "0", "0.0", "1", "0", "1", "0", "0", "-"],
    ], "0 and 70,000 are nobody's numbers"
    _, out, _ = _run(capsys, "stats", path, "--json")
    assert [dose["on_ms"] for dose in json.loads(out)] == [1000, 0, 0]


def test_what_is_no_journal_is_said_with_the_next_step(tmp_path: Path, capsys: _Captured) -> None:
    for action in ("verify", "show", "stats"):
        status, _, err = _run(capsys, action, tmp_path / "nothing")
        assert status == 1
        assert "name the file that the gateway writes" in err


def test_following_tells_what_is_written_from_then_on(journal: Path) -> None:
    command = [sys.executable, "-m", "gateway", "audit", "show", str(journal), "--follow", "--kind", "order"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}) as child:
        assert child.stdout is not None
        shown = [child.stdout.readline() for _ in range(6)]
        with contextlib.closing(open_journal_file(journal, now_wall_ns=WALL_NS, now_ns=0, machine_boot="m")) as file:
            commit(file, [a_stage(50), a_note(51)])
            assert "number=51" in child.stdout.readline()
        child.kill()
    assert all("order" in line for line in shown)
