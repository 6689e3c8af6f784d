"""Laws of ``biobot-gateway journal``: it finds what is damaged, and exports what is there, whole or not at all."""

import asyncio
import contextlib
import csv
import json
import os
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, Mode
from gateway.__main__ import main
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import JournalWrite, SegmentBuilder, open_journal_file
from tests.gateway.makers import a_mode_record, an_encounter_record
from tests.gateway.test_journal_segments import a_report

S = 1_000_000_000


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    """Ten encounters of 1 s, each corrected once, the last one void then; two modes; thirty messages; in segments of ten records."""
    path = tmp_path / "j"
    records: list[JournalRecord] = []
    for revision in (0, 1):
        for number in range(10):
            t_end_s = 10 * number + 1 + revision
            records.append(
                an_encounter_record(sequence=number, node_a=1, node_b=2, t_start_s=10 * number, t_end_s=t_end_s, revision=revision)
            )
    last = records[-1]
    assert isinstance(last, EncounterRecord)
    records[-1] = EncounterRecord(**{name: getattr(last, name) for name in last.__struct_fields__} | {"is_void": True})
    records += [a_mode_record(sequence=100 + number, node=number, mode=Mode.S) for number in range(2)]
    file = open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="")
    offset = 1
    for first in range(0, len(records), 10):
        builder = SegmentBuilder(first_offset=offset, windows=file.windows)
        builder.add(JournalWrite(records=tuple(records[first : first + 10])))
        for number in range(10):
            builder.add(JournalWrite(report=a_report(first + number, wall_ns=(first + number) * S, payload=bytes([number]))))
        file.commit(builder)
        offset = builder.next_offset
    file.close()
    return path


def _csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_whole_journal_is_found_whole_and_described(journal: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["journal", "check", str(journal)]) == 0
    assert capsys.readouterr().out == "3 segments, 22 records, 30 reports\n"
    assert main(["journal", "info", str(journal)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["oldest_offset"], told["head_offset"], told["records"], told["reports"]) == (1, 22, 22, 30)
    assert told["size_octets"] >= 4096


def _cut_contents(database: sqlite3.Connection) -> None:
    database.execute("UPDATE contents SET records = substr(records, 1, length(records) - 1) WHERE segment = 2")


def _spoil_one_octet(database: sqlite3.Connection) -> None:
    (reports,) = database.execute("SELECT reports FROM contents WHERE segment = 2").fetchone()
    database.execute("UPDATE contents SET reports = ? WHERE segment = 2", (reports[:-1] + bytes([reports[-1] ^ 1]),))


def _lose_a_segment(database: sqlite3.Connection) -> None:
    database.execute("DELETE FROM segments WHERE segment = 2")


def _lose_contents(database: sqlite3.Connection) -> None:
    database.execute("DELETE FROM contents WHERE segment = 2")


@pytest.mark.parametrize(
    ("harm", "word"),
    [
        (_cut_contents, "segment 2 (offsets 11 to 20): its bytes are not"),
        (_spoil_one_octet, "CRC-32"),
        (_lose_a_segment, "offsets 11 to 20 are missing"),
        (_lose_contents, "it has no contents"),
    ],
)
def test_a_fault_is_named_with_the_next_step_and_what_is_whole_is_counted(
    journal: Path, capsys: pytest.CaptureFixture[str], harm: Callable[[sqlite3.Connection], None], word: str
) -> None:
    with contextlib.closing(sqlite3.connect(journal, isolation_level=None)) as database:
        harm(database)
    assert main(["journal", "check", str(journal)]) == 1
    told = capsys.readouterr()
    assert word in told.err
    assert "1 fault; stop the gateway" in told.err
    assert told.out == "2 segments, 12 records, 20 reports\n"


def test_all_faults_are_told_and_what_is_whole_is_exported_without_them(
    journal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with contextlib.closing(sqlite3.connect(journal, isolation_level=None)) as database:
        _cut_contents(database)
        database.execute("DELETE FROM contents WHERE segment = 3")
    assert main(["journal", "check", str(journal)]) == 1
    told = capsys.readouterr().err
    assert "segment 2 (offsets 11 to 20)" in told
    assert "segment 3 (offsets 21 to 22)" in told
    assert "2 faults" in told
    out = tmp_path / "out.csv"
    assert main(["journal", "export", str(journal), "--csv", str(out)]) == 1
    assert main(["journal", "export", str(journal), "--csv", str(out), "--skip-damaged"]) == 0
    assert [int(row["sequence"]) for row in _csv(out)] == list(range(10))
    told = capsys.readouterr().err
    assert told.count("left out: segment 2 (offsets 11 to 20)") == 1
    assert "2 damaged parts" in told
    assert main(["journal", "export", str(journal), "--csv", str(out), "--kind", "reports", "--skip-damaged"]) == 0
    assert [int(row["number"]) for row in _csv(out)] == list(range(10))


def test_offsets_that_are_missing_are_neither_passed_over_in_silence_nor_exported_twice(journal: Path, tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(journal, isolation_level=None)) as database:
        _lose_a_segment(database)
    out = tmp_path / "out.csv"
    assert main(["journal", "export", str(journal), "--csv", str(out), "--kind", "modes"]) == 1
    assert main(["journal", "export", str(journal), "--csv", str(out), "--kind", "modes", "--skip-damaged"]) == 0
    assert [int(row["offset"]) for row in _csv(out)] == [21, 22]


def test_a_cut_journal_is_told_as_damaged_and_a_directory_as_one(journal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.closing(sqlite3.connect(journal)) as database:
        database.execute("PRAGMA journal_mode = DELETE")
    os.truncate(journal, 20_000)
    for arguments in (["check"], ["export", "--csv", str(tmp_path / "out.csv")]):
        assert main(["journal", arguments[0], str(journal), *arguments[1:]]) == 1
        assert "keep a copy of the file" in capsys.readouterr().err
    assert main(["journal", "check", str(tmp_path)]) == 1
    assert "is a directory" in capsys.readouterr().err


def test_pages_overwritten_on_the_disk_are_found(journal: Path) -> None:
    with contextlib.closing(sqlite3.connect(journal)) as database:
        database.execute("PRAGMA journal_mode = DELETE")
    body = bytearray(journal.read_bytes())
    body[len(body) // 2 : len(body) // 2 + 3000] = bytes(3000)
    journal.write_bytes(body)
    assert main(["journal", "check", str(journal)]) == 1


@pytest.mark.parametrize("text", [None, "", "no database at all, but long enough to be looked at" * 40])
def test_what_is_no_journal_is_said_to_be_none(tmp_path: Path, text: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "j"
    if text is not None:
        path.write_text(text)
    for arguments in (["check"], ["info"], ["export", "--csv", str(tmp_path / "out.csv")]):
        assert main(["journal", arguments[0], str(path), *arguments[1:]]) == 1
        assert str(path) in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists()


def test_the_newest_revision_of_what_counts_is_exported(journal: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    assert main(["journal", "export", str(journal), "--csv", str(out)]) == 0
    rows = _csv(out)
    assert [(int(row["sequence"]), int(row["revision"]), int(row["end_wall_ns"])) for row in rows] == [
        (number, 1, (10 * number + 2) * S) for number in range(9)
    ]
    assert rows[0]["is_reciprocal"] == "false"
    assert (rows[0]["rssi_a_dbm"], rows[0]["rssi_b_dbm"], rows[0]["path_a_mm"]) == ("-60", "", "")
    assert main(["journal", "export", str(journal), "--csv", str(out), "--all-revisions"]) == 0
    assert len(_csv(out)) == 20


def test_a_time_is_cut_out_with_what_reaches_into_it(journal: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    span = ["--from", "1970-01-01T00:00:12", "--until", "1970-01-01T00:00:30Z"]
    assert main(["journal", "export", str(journal), "--csv", str(out), *span]) == 0
    assert [int(row["sequence"]) for row in _csv(out)] == [1, 2]
    assert main(["journal", "export", str(journal), "--csv", str(out), "--kind", "reports", *span]) == 0
    assert [int(row["number"]) for row in _csv(out)] == list(range(12, 30))
    assert main(["journal", "export", str(journal), "--csv", str(out), "--from", "1970-01-02", "--until", "1970-01-01"]) == 2


def test_parquet_says_the_same_as_csv_of_every_kind(journal: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    assert main(["journal", "export", str(journal), "--csv", str(tmp_path / "t.csv"), "--kind", "all"]) == 0
    assert main(["journal", "export", str(journal), "--parquet", str(tmp_path / "t.parquet"), "--kind", "all"]) == 0
    for kind, n_rows in (("encounters", 9), ("modes", 2), ("mission", 0), ("reports", 30)):
        table = parquet.read_table(tmp_path / f"t.{kind}.parquet").to_pylist()
        texts = [{name: "" if value is None else str(value).lower() for name, value in row.items()} for row in table]
        rows = [{name: value.lower() for name, value in row.items()} for row in _csv(tmp_path / f"t.{kind}.csv")]
        assert texts == rows
        assert len(rows) == n_rows


def test_an_export_that_fails_leaves_what_was_there(journal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.csv"
    out.write_text("before")
    with contextlib.closing(sqlite3.connect(journal, isolation_level=None)) as database:
        database.execute("UPDATE contents SET records = x'ffffffff01' WHERE segment = 3")
    assert main(["journal", "export", str(journal), "--csv", str(out)]) == 1
    assert "journal check" in capsys.readouterr().err
    assert out.read_text() == "before"
    assert not [one.name for one in tmp_path.iterdir() if "partial" in one.name]
    assert main(["journal", "export", str(journal), "--csv", str(tmp_path / "no" / "out.csv")]) == 1
    assert f"there is no directory {tmp_path / 'no'}" in capsys.readouterr().err


def test_a_journal_is_exported_while_a_gateway_writes_it(tmp_path: Path) -> None:
    out = tmp_path / "out.csv"

    async def story() -> None:
        journal = Journal.open(tmp_path / "j", health=Health())
        running = asyncio.ensure_future(journal.run())
        for number in range(50):
            record = an_encounter_record(sequence=number, node_a=1, node_b=2, t_start_s=number, t_end_s=number + 1)
            await journal.append(JournalWrite(records=(record,)))
        writing = [journal.append(JournalWrite(records=(a_mode_record(sequence=n, node=1, mode=Mode.S),))) for n in range(1000, 1200)]
        for arguments in (["export", "--csv", str(out)], ["check"], ["info"]):
            assert await asyncio.to_thread(main, ["journal", arguments[0], str(tmp_path / "j"), *arguments[1:]]) == 0
        await asyncio.gather(*writing)
        running.cancel()
        await asyncio.wait({running})
        journal.close()

    asyncio.run(story())
    assert len(_csv(out)) == 50
