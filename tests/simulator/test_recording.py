"""Laws of recordings: what is written is read again, and what cannot be is told with file, line and reason."""

from pathlib import Path

import numpy as np
import pytest

from simulator.__main__ import main
from simulator.config import Ranges
from simulator.errors import RecordingError
from simulator.events import Cause, Mode
from simulator.recording import RecordedEncounter, load_recording

HEADER = "t_start_s,t_end_s,id1,id2\n"


def a_csv(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "encounters.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_csv_of_encounters_is_enough_and_its_columns_may_stand_in_any_order(tmp_path: Path) -> None:
    path = a_csv(tmp_path, "\ufeffid2,note,t_end_s,id1,t_start_s\r\n4,far,30.5,9,20\r\n\r\n1,near,12,9,10.25\r\n")
    recording = load_recording(path)
    assert recording.encounters == (
        RecordedEncounter(t_start_s=10.25, t_end_s=12.0, id1=1, id2=9),
        RecordedEncounter(t_start_s=20.0, t_end_s=30.5, id1=4, id2=9),
    )
    assert recording.ids == (1, 4, 9)
    assert (recording.zero_s, recording.end_s) == (10.25, 30.5)
    assert recording.places is None
    assert recording.spells == ()


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", 1, "wanted each of t_start_s,t_end_s,id1,id2 once"),
        ("t_start_s,t_end_s,id1\n", 1, "t_start_s,t_end_s,id1"),
        (HEADER.strip() + ",id1\n1,2,3,4,5\n", 1, "once"),
        (HEADER + "1,2,3,4\n1,2,3\n", 3, "3 cells; wanted 4"),
        (HEADER + "1,2,3,4,5\n", 2, "5 cells; wanted 4"),
        (HEADER + "one,2,3,4\n", 2, "t_start_s is 'one'"),
        (HEADER + "1,nan,3,4\n", 2, "t_end_s is 'nan'"),
        (HEADER + "1,inf,3,4\n", 2, "t_end_s is 'inf'"),
        (HEADER + "2,1,3,4\n", 2, "ends at 1.0 s, before it starts at 2.0 s"),
        (HEADER + "1,2,3,-4\n", 2, "id2 is '-4'"),
        (HEADER + "1,2,3.0,4\n", 2, "id1 is '3.0'"),
        (HEADER + "1,2,3,99999999999999999999\n", 2, "id2 is '99999999999999999999'"),
        (HEADER + "1,2,3,3\n", 2, "biobot 3 meets itself"),
        (HEADER + "4,6,1,2\n1,5,2,1\n", 2, "biobots 1 and 2 meet while their encounter of line 3 still goes on"),
        (HEADER + "1,1,1,2\n1,1,1,2\n", 3, "line 2 still goes on"),
        (HEADER + '1,2,"3,4\n', 2, "no CSV"),
    ],
)
def test_a_bad_csv_is_told_with_file_line_and_reason(tmp_path: Path, text: str, line: int, words: str) -> None:
    path = a_csv(tmp_path, text)
    with pytest.raises(RecordingError) as caught:
        load_recording(path)
    assert caught.value.line == line
    assert str(caught.value).startswith(f"{path}, line {line}: ")
    assert words in str(caught.value)


def test_a_csv_that_is_no_text_or_holds_nothing_or_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="not UTF-8 text"):
        load_recording(a_csv(tmp_path, b"\xff\xfe\x00"))
    with pytest.raises(RecordingError, match="nothing to replay"):
        load_recording(a_csv(tmp_path, HEADER))
    with pytest.raises(RecordingError, match=r"nowhere\.csv: cannot be read: No such file"):
        load_recording(tmp_path / "nowhere.csv")
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match=r"holds no encounters\.csv"):
        load_recording(tmp_path / "empty")


def a_run(tmp_path: Path) -> Path:
    out = tmp_path / "run"
    arguments = ["--scenario", "one-obstacle", "--biobots", "20", "--duration", "30", "--seed", "3", "--out", str(out)]
    assert main(["run", *arguments]) == 0
    return out


def test_a_directory_of_results_is_read_whole(tmp_path: Path) -> None:
    recording = load_recording(a_run(tmp_path))
    assert recording.ids == tuple(range(1, 21))
    assert recording.zero_s == 0.0
    assert recording.end_s == pytest.approx(30.0)
    assert recording.ranges == Ranges(detection=1.0, communication=8.0)
    assert len(recording.encounters) > 5
    assert {(one.mode, one.cause) for one in recording.spells} == {(Mode.CRW, Cause.NATURAL), (Mode.S, Cause.COMMAND)}
    assert recording.places is not None
    assert recording.places.position.shape == (201, 20, 2)
    assert recording.places.arena.betti.holes == 1


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("modes.csv", "t_start_s,t_end_s,id,mode,cause\n0,1,1,RUN,natural\n", "modes.csv, line 2: mode 'RUN'"),
        ("modes.csv", "t_start_s,t_end_s,id,mode,cause\n0,5,1,S,natural\n4,6,1,CRW,natural\n", "line 3: biobot 1 is still in"),
        ("run.json", "{", "run.json: no JSON"),
        ("run.json", "[]", "no JSON object"),
        ("truth.npz", "none", "truth.npz: cannot be read"),
        ("encounters.csv", HEADER + "1,2,3,77\n", "has no places of biobot 77"),
        ("encounters.csv", HEADER + "-1,2,3,4\n", "something begins at -1.0 s"),
    ],
)
def test_a_directory_with_a_bad_file_is_told(tmp_path: Path, name: str, content: str, words: str) -> None:
    out = a_run(tmp_path)
    (out / name).write_text(content)
    with pytest.raises(RecordingError) as caught:
        load_recording(out)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"position": np.zeros((3, 4))}, "shapes"),
        ({"position": np.full((2, 1, 2), np.nan)}, "finite"),
        ({"t_s": np.array([1.0, 0.0])}, "ascending"),
    ],
)
def test_places_that_cannot_be_are_told(tmp_path: Path, change: dict[str, np.ndarray], words: str) -> None:
    out = a_run(tmp_path)
    arrays = {"t_s": np.array([0.0, 1.0]), "ids": np.array([1]), "position": np.zeros((2, 1, 2))} | change
    np.savez(out / "truth.npz", **arrays)  # type: ignore[arg-type]  # the stub takes the names for keywords of its own
    with pytest.raises(RecordingError, match=words):
        load_recording(out)
