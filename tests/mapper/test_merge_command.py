"""``biobot-mapper merge`` as a person and a program see it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mapper.__main__ import main
from tests.mapper.worlds import NS, walk_track

HEADER = "t_start_s,t_end_s,id1,id2\n"
MODES = "t_start_s,t_end_s,id,mode,cause\n"
_CUT_S = 60.0
_OVERLAP_S = 10.0


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the directories ``whole``, ``first`` and ``second``: a ring of 20 landmarks, all of its time and two windows."""
    folder = tmp_path_factory.mktemp("ring")
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    modes = MODES + "".join(f"-1,,{spell.node},S,command\n" for spell in spells)
    for name, begin, end in (("whole", -1.0, 999.0), ("first", -1.0, _CUT_S + _OVERLAP_S), ("second", _CUT_S, 999.0)):
        (folder / name).mkdir()
        inside = [(max(one[0] / NS, begin), min(one[1] / NS, end), *one[2:]) for one in rows if one[1] > begin * NS and one[0] < end * NS]
        (folder / name / "encounters.csv").write_text(HEADER + "".join(f"{a:.9f},{b:.9f},{i},{j}\n" for a, b, i, j in inside))
        (folder / name / "modes.csv").write_text(modes)
    return folder


def _map(*arguments: object, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main([*map(str, arguments), "--json", "-"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def _status(arguments: list[str]) -> object:
    try:
        return main(arguments)
    except SystemExit as leaving:
        return leaving.code


def _same(document: dict[str, Any], expected: dict[str, Any]) -> None:
    """All that two maps say of the place is the same; ``run`` says besides how it read the file, and ``merge`` what it merged."""
    names = (expected.keys() & document.keys()) - {"merged", "stationary", "assumptions"}
    assert {name: document[name] for name in names} == {name: expected[name] for name in names}


def test_windows_of_a_recording_merge_to_the_map_of_the_whole(ring: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = _map("run", ring / "whole/encounters.csv", "--modes", ring / "whole/modes.csv", capsys=capsys)
    merged = _map("merge", ring / "first", ring / "second", capsys=capsys)
    _same(merged, whole)
    assert merged["betti_numbers"] == [1, 1]
    assert merged["merged"]["n_repeated"] > 0
    assert merged["merged"]["n_shared_landmarks"] == 20
    first, second = merged["merged"]["inputs"]
    assert first["n_encounters"] + second["n_encounters"] == merged["n_encounters"] + merged["merged"]["n_repeated"]


def test_a_recording_merged_with_itself_is_its_map(ring: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = _map("run", ring / "whole/encounters.csv", "--modes", ring / "whole/modes.csv", capsys=capsys)
    _same(_map("merge", ring / "whole", ring / "whole", capsys=capsys), whole)


def test_the_order_of_inputs_does_not_matter(ring: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = _map("merge", ring / "first", ring / "second", "--speed-mps", "0.5", capsys=capsys)
    _same(_map("merge", ring / "second", ring / "first", "--speed-mps", "0.5", capsys=capsys), one)


def test_clocks_that_differ_are_brought_together(ring: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The second window, by a clock that is 1000 s ahead."""
    late = [line.split(",") for line in (ring / "second/encounters.csv").read_text().splitlines()[1:]]
    (tmp_path / "late.csv").write_text(HEADER + "".join(f"{float(a) + 1000:.9f},{float(b) + 1000:.9f},{i},{j}\n" for a, b, i, j in late))
    (tmp_path / "modes.csv").write_text((ring / "second/modes.csv").read_text().replace("\n-1,", "\n999,"))
    modes = ("--modes", ring / "first/modes.csv", "--modes", tmp_path / "modes.csv")
    merged = _map("merge", ring / "first/encounters.csv", tmp_path / "late.csv", *modes, "--shift-s", "0,-1000", capsys=capsys)
    _same(merged, _map("merge", ring / "first", ring / "second", capsys=capsys))


def test_recordings_without_a_common_biobot_stay_apart_and_that_is_said(
    ring: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = [line.split(",") for line in (ring / "whole/encounters.csv").read_text().splitlines()[1:]]
    (tmp_path / "other.csv").write_text(HEADER + "".join(f"{a},{b},{int(i) + 5000},{int(j) + 5000}\n" for a, b, i, j in other))
    assert main(["merge", str(ring / "whole/encounters.csv"), str(tmp_path / "other.csv")]) == 0
    told = capsys.readouterr()
    assert told.out.startswith("2 components")
    assert "fall into 2 components that no biobot joins" in told.err


@pytest.mark.parametrize(
    ("arguments", "status", "told"),
    [
        (["merge"], 2, "give recordings or maps"),
        (["merge", "first", "second", "--shift-s", "1"], 2, "--shift-s has 1 values for 2 recordings"),
        (["merge", "first", "second", "--shift-s", "1,x"], 2, "'1,x'; wanted seconds for each input"),
        (["merge", "first/encounters.csv", "second/encounters.csv", "--modes", "first/modes.csv"], 2, "--modes is given 1 times for 2"),
        (["merge", "first", "nowhere"], 1, "nowhere: cannot be read"),
        (["merge", "first", "."], 1, "encounters.csv: cannot be read"),
        (["merge", "first", "empty.csv"], 1, "empty.csv: 0 encounters"),
    ],
)
def test_what_is_wrong_is_said(
    arguments: list[str], status: int, told: str, ring: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ring)
    (ring / "empty.csv").write_text(HEADER)
    assert _status(arguments) == status
    assert told in capsys.readouterr().err


@pytest.fixture(scope="module")
def maps(ring: Path) -> Path:
    """The folder of the ring, with a map of each of its directories beside it."""
    for name in ("whole", "first", "second"):
        own = ring / name
        assert main(["run", str(own / "encounters.csv"), "--modes", str(own / "modes.csv"), "--json", str(ring / f"{name}.json")]) == 0
    return ring


def test_finished_maps_of_windows_join_to_one_with_the_hole_of_the_whole(maps: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = json.loads((maps / "whole.json").read_text())
    joined = _map("merge", maps / "first.json", maps / "second.json", capsys=capsys)
    assert joined["betti_numbers"] == whole["betti_numbers"] == [1, 1]
    assert joined["diameter"] == pytest.approx(whole["diameter"], rel=0.1)
    assert joined["n_components"] == 1
    assert joined["holes"][0]["death"] == pytest.approx(whole["holes"][0]["death"], rel=0.15)
    again = _map("merge", maps / "second.json", maps / "first.json", capsys=capsys)
    _same({**again, "warnings": []}, {**joined, "warnings": []})


def test_a_map_joined_with_itself_has_its_points_and_its_diagram(maps: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = json.loads((maps / "whole.json").read_text())
    twice = _map("merge", maps / "whole.json", maps / "whole.json", capsys=capsys)
    assert len(twice["points"]) == len(whole["points"])
    for dimension in ("0", "1"):
        deaths = [[death for _, death in document["intervals"][dimension] if death is not None] for document in (twice, whole)]
        assert sum(deaths[0]) == pytest.approx(sum(deaths[1]), rel=1e-3)
    assert twice["betti_numbers"] == whole["betti_numbers"]


def test_a_map_and_a_recording_join(maps: Path, capsys: pytest.CaptureFixture[str]) -> None:
    joined = _map("merge", maps / "first.json", maps / "second", capsys=capsys)
    assert joined["betti_numbers"] == [1, 1]
    assert joined["merged"]["maps"] == [str(maps / "first.json")]
    assert [one["name"] for one in joined["merged"]["inputs"]] == [str(maps / "second")]


def test_maps_that_share_nothing_are_kept_apart(maps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = json.loads((maps / "second.json").read_text())
    for part in other["merging"]:
        part["points"] = [[t, one + 5000, two + 5000] for t, one, two in part["points"]]
        part["stands"] = [[node + 5000, begin, end] for node, begin, end in part["stands"]]
    (tmp_path / "other.json").write_text(json.dumps(other))
    joined = _map("merge", maps / "first.json", tmp_path / "other.json", capsys=capsys)
    assert joined["n_components"] == 2
    assert "2 groups that share neither" in joined["warnings"][0]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda document: document.pop("merging"), "the map does not tell its distances"),
        (lambda document: document["merging"][0]["distances"].pop(), "distances; wanted"),
        (lambda document: document["merging"][0].pop("points"), "no map of this mapper"),
        (lambda document: document["parameters"].update(speed_mps=2.0), "the maps differ in speed_mps: 2.0, None"),
    ],
)
def test_what_is_wrong_with_a_map_is_said(
    change: Callable[[dict[str, Any]], object], told: str, maps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = json.loads((maps / "second.json").read_text())
    change(document)
    (tmp_path / "wrong.json").write_text(json.dumps(document))
    assert main(["merge", str(maps / "first.json"), str(tmp_path / "wrong.json")]) == 1
    assert told in capsys.readouterr().err
