"""A journal loses nothing that was written whole, whatever a crash left at its end, and takes no other file for its own."""

import json
import resource
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.cases.journal import Entry, Failure, Journal
from studies.errors import JournalBusyError, JournalError

ENTRIES = [
    Entry(digest="a", program="p", seconds=1.5, key={"n": 1}, result=[1, {"x": None}]),
    Entry(digest="b", program="p", seconds=0.0, key="ü\n", failure=Failure(kind="E", message="no\nway", traceback="at ü")),
    Entry(digest="a", program="q", seconds=2.0, result="anew"),
]


def write(path: Path) -> bytes:
    with Journal(path, study="made") as journal:
        for entry in ENTRIES:
            journal.append(entry)
    return path.read_bytes()


@given(st.data())
def test_a_journal_cut_anywhere_keeps_its_whole_lines_and_goes_on(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.jsonl"
        whole = write(path)
        cut = data.draw(st.integers(0, len(whole)))
        path.write_bytes(whole[:cut])
        n_whole = max(0, whole[:cut].count(b"\n") - 1)
        with Journal(path, study="made") as journal:
            assert journal.entries == {entry.digest: entry for entry in ENTRIES[:n_whole]}
            assert journal.has_torn_line == (cut > whole.index(b"\n") and whole[cut - 1] != ord("\n"))
            for entry in ENTRIES[n_whole:]:
                journal.append(entry)
        assert path.read_bytes() == whole


def test_a_last_line_of_rubbish_is_torn_too(tmp_path: Path) -> None:
    whole = write(tmp_path / "made.jsonl")
    (tmp_path / "made.jsonl").write_bytes(whole + b"\0" * 50 + b"\n")
    with Journal(tmp_path / "made.jsonl", study="made") as journal:
        assert journal.has_torn_line
        assert len(journal.entries) == 2
    assert (tmp_path / "made.jsonl").read_bytes() == whole


def test_a_torn_last_line_that_is_no_text_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "made.jsonl"
    head = b'{"journal":"biobot cases 1","study":"made"}\n'
    path.write_bytes(head + b'{"digest":"\xff"}\n')
    with Journal(path, study="made") as journal:
        assert (journal.has_torn_line, journal.entries) == (True, {})
    assert path.read_bytes() == head


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"important\n", "is no journal"),
        (b"important", "is no journal"),
        (b'{"journal":"biobot cases 2","study":"made"}\n', "is of the kind 'biobot cases 2'"),
        (b'{"journal":"biobot cases 1","study":"other"}\n', 'belongs to the study "other"'),
        (b'{"journal":"biobot cases 1","study":"made"}\n{"dig\n{"digest":"a","program":"p","seconds":1}\n', "line 2 is damaged"),
        (b'{"journal":"biobot cases 1","study":"ma\xffe"}\n', "is no journal"),
        (b'{"journal":"biobot cases 1","study":"made"}\n{"digest":"\xff","program":"p","seconds":1}\n{}\n', "line 2 is damaged"),
        (b'{"journal":"biobot cases 1","study":"made"}\n' + b'{"x":' + b"[" * 100_000 + b"\n{}\n", "line 2 is damaged"),
    ],
)
def test_a_foreign_or_damaged_file_is_refused_and_left_as_it_is(content: bytes, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "made.jsonl"
    path.write_bytes(content)
    with pytest.raises(JournalError, match=f"{problem}.*give another journal"):
        Journal(path, study="made")
    assert path.read_bytes() == content


def test_two_cannot_have_it_at_once_and_the_next_gets_it(tmp_path: Path) -> None:
    path = tmp_path / "made.jsonl"
    with Journal(path, study="made"), pytest.raises(JournalBusyError, match="wait for it"):
        Journal(path, study="made")
    with Journal(path, study="made") as journal:
        assert journal.entries == {}


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="is no file"):
        Journal(tmp_path, study="made")
    with pytest.raises(JournalError, match="is no file"):
        Journal(Path("/dev/zero"), study="made")
    (tmp_path / "file").write_text("")
    with pytest.raises(JournalError, match="cannot be opened"):
        Journal(tmp_path / "file" / "made.jsonl", study="made")


def test_a_full_disk_is_told_and_the_journal_is_whole_afterwards(tmp_path: Path) -> None:
    path = tmp_path / "made.jsonl"
    whole = write(path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Journal(path, study="made") as journal:
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole) + 20, before[1]))
        try:
            with pytest.raises(JournalError, match="cannot be written: File too large"):
                journal.append(ENTRIES[1])
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(path.read_bytes()) == len(whole) + 20
    with Journal(path, study="made") as journal:
        assert journal.has_torn_line
    assert path.read_bytes() == whole


def test_without_a_file_nothing_is_kept() -> None:
    with Journal(None, study="made") as journal:
        journal.append(ENTRIES[0])
        assert json.dumps(journal.entries["a"].result) == '[1, {"x": null}]'
