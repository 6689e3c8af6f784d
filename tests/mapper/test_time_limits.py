"""Parts of a record: clear errors for limits that cannot be, and maps of exactly what lies between."""

import json
from pathlib import Path

import numpy as np
import pytest

from firmware_protocol.errors import ConfigurationError
from mapper.__main__ import main
from mapper.time_limits import make_limits
from mapper.window import make_encounter_table
from tests.mapper.worlds import NS, walk_track

NONE: dict[str, float | None] = {"window_s": None, "from_s": None, "until_s": None}


@pytest.mark.parametrize(
    ("limits", "wanted", "facts"),
    [
        ({}, [(0, 4), (2, 3), (5, 9), (9, 9)], (None, None, 0, 0)),
        ({"from_s": 3}, [(3, 4), (5, 9), (9, 9)], (3, None, 1, 0)),
        ({"until_s": 6}, [(0, 4), (2, 3), (5, 6)], (None, 6, 0, 1)),
        ({"window_s": 5.5}, [(3.5, 4), (5, 9), (9, 9)], (3.5, None, 1, 0)),
        ({"window_s": 3, "until_s": 6}, [(3, 4), (5, 6)], (3, 6, 1, 1)),
        ({"window_s": 5, "from_s": 5, "until_s": 9}, [(5, 9)], (5, 9, 2, 1)),
        ({"from_s": 100}, [], (100, None, 4, 0)),
    ],
)
def test_what_lies_between_is_left_and_cut(
    limits: dict[str, float], wanted: list[tuple[float, float]], facts: tuple[float | None, float | None, int, int]
) -> None:
    table = make_encounter_table(
        t_start_ns=np.array([0, 2, 5, 9]) * NS, t_end_ns=np.array([4, 3, 9, 9]) * NS, id1=[1, 1, 1, 1], id2=[2, 3, 2, 3]
    )
    clipped, told = make_limits(**NONE | limits).clip(table)
    assert list(zip((clipped.t_start_ns / NS).tolist(), (clipped.t_end_ns / NS).tolist(), strict=True)) == wanted
    assert (told["since_s"], told["until_s"], told["n_before"], told["n_after"]) == facts
    assert told["last_encounter_s"] == max((end for _, end in wanted), default=None)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"window_s": 0.0}, "--window-s is 0; wanted 0.001 to 1e"),
        ({"window_s": float("nan")}, "--window-s is nan"),
        ({"window_s": -5}, "--window-s is -5"),
        ({"from_s": float("inf")}, "--from-s is inf"),
        ({"until_s": 1e300}, r"--until-s is 1e\+300"),
        ({"from_s": 6, "until_s": 5}, "--from-s is 6 and --until-s 5; wanted the first before the second; swap them"),
        ({"from_s": 5, "until_s": 5}, "--from-s and --until-s are both 5, so nothing lies between"),
    ],
)
def test_limits_that_cannot_be_are_refused_with_value_and_limit(limits: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make_limits(**NONE | limits)


def test_a_map_of_a_part_of_a_file_says_of_which(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "encounters.csv"
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    path.write_text("t_start_s,t_end_s,id1,id2\n" + "".join(f"{a / NS},{b / NS},{first},{second}\n" for a, b, first, second in rows))
    landmarks = ",".join(str(spell.node) for spell in spells)
    common = ["run", str(path), "--stationary", landmarks, "--json", "-"]
    assert main([*common, "--from-s", "20", "--until-s", "110", "--window-s", "80"]) == 0
    document = json.loads(capsys.readouterr().out)
    since_s = document["last_encounter_s"] - 80
    assert document["since_s"] == pytest.approx(since_s)
    assert document["n_encounters"] == sum(b / NS > since_s and a / NS < 110 for a, b, _, _ in rows)
    assert document["n_before"] + document["n_after"] == len(rows) - document["n_encounters"]
    assert document["betti_numbers"] == [1, 1]
    assert main([*common, "--from-s", "5000"]) == 1
    assert f"0 encounters of {len(rows)} between the times wanted, but a map needs at least 2; widen --from-s" in capsys.readouterr().err
    assert main([*common, "--window-s", "-1"]) == 2
    capsys.readouterr()
    assert main([*common, "--from-s", "-1e2", "--until-s", "1.1e2"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["since_s"], document["until_s"], document["n_before"]) == (-100, 110, 0)
    picture = tmp_path / "map.svg"
    told = ["--svg", str(picture), "--from-s", "20", "--until-s", "110", "--window-s", "80", "--method", "paper"]
    assert main([*common[:-2], *told]) == 0
    assert "part           from 20 s, until 110 s, the newest 80 s\n" in capsys.readouterr().out
    assert "from 20 s, until 110 s, the newest 80 s, method paper, metric encounter" in picture.read_text()
    assert main([*common[:-2], "--svg", str(picture)]) == 0
    assert "part " not in capsys.readouterr().out
    assert "method" not in picture.read_text()
    assert main([*common, "--from-s", "-inf"]) == 2
    assert "--from-s is -inf; wanted a time of the file" in capsys.readouterr().err
