"""``biobot-mapper feasibility`` as a person and a program see it."""

import json
from pathlib import Path

import pytest

from mapper.__main__ import main

HISSERS = {
    "--side": "5",
    "--biobots": "40",
    "--landmarks": "10",
    "--speed": "0.04",
    "--detection-radius": "0.25",
    "--mean-leg": "0.5",
    "--time": "1800",
}


def _flags(**changes: str | None) -> list[str]:
    given = HISSERS | {f"--{name.replace('_', '-')}": value for name, value in changes.items()}
    return ["feasibility", *(part for flag, value in given.items() if value is not None for part in (flag, value))]


def _ask(capsys: pytest.CaptureFixture[str], **changes: str | None) -> str:
    assert main(_flags(**changes)) == 0
    output = capsys.readouterr()
    assert output.err == ""
    return output.out


def test_a_forecast_fits_one_screen(capsys: pytest.CaptureFixture[str]) -> None:
    text = _ask(capsys, obstacle="2")
    lines = text.splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 100
    assert "an obstacle of 2 m is found in 80 % of maps after " in text
    assert "twice the biobots (80, landmarks 20)" in text


def test_the_printed_units_are_called_hopeless(capsys: pytest.CaptureFixture[str]) -> None:
    printed = {
        "side": "50",
        "biobots": "150",
        "landmarks": "20",
        "speed": "0.1",
        "detection_radius": "0.01",
        "mean_leg": "0.3",
        "time": "200",
    }
    text = _ask(capsys, **printed)
    assert "hopeless: about 2.1 encounters" in text
    assert "a guess, for nothing of the kind was run" in text
    assert len(text.splitlines()) <= 40


def test_json_holds_no_infinity_and_the_same_answers(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    document = json.loads(_ask(capsys, landmarks="0", json="-"))
    assert document["outlooks"][0]["usual_side"] is None
    assert document["obstacle"] == {"side": 1.0, "found_s": None, "biobots": None}
    assert "in a time of" in _ask(capsys, json=str(tmp_path / "forecast.json"))
    written = json.loads((tmp_path / "forecast.json").read_text())
    assert written["outlooks"][0]["encounters"] == pytest.approx(1158, abs=1)
    assert [one["duration_s"] for one in written["outlooks"]] == [1800, 3600, 7200]
    assert written["law"]["command"] == "python -m studies.feasibility_check"


def test_an_area_without_a_perimeter_is_a_square(capsys: pytest.CaptureFixture[str]) -> None:
    by_area = json.loads(_ask(capsys, side=None, area="25", json="-"))
    assert by_area == json.loads(_ask(capsys, json="-"))
    corridor = json.loads(_ask(capsys, side=None, area="25", perimeter="40", json="-"))
    assert corridor["outlooks"][0]["encounters"] < by_area["outlooks"][0]["encounters"]
    assert any("much longer than a square's" in warning for warning in corridor["warnings"])


def test_landmarks_are_a_share_unless_given(capsys: pytest.CaptureFixture[str]) -> None:
    assert json.loads(_ask(capsys, landmarks=None, json="-"))["plan"]["landmarks"] == 6
    assert json.loads(_ask(capsys, landmarks=None, biobots="2", json="-"))["plan"]["landmarks"] == 1


def test_a_recording_is_set_beside_the_forecast(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "encounters.csv"
    path.write_text("t_start_s,t_end_s,id1,id2\n" + "".join(f"{t},{t + 5},1,{2 + t % 30}\n" for t in range(0, 1795, 4)))
    text = _ask(capsys, encounters=str(path))
    text = " ".join(text.split())
    assert "the recording has 449 encounters in 29.9 min; expected 1,15" in text
    assert "fewer; radios miss some" in text
    assert main([*_flags(encounters=str(path)), "--json", str(path)]) == 1
    assert "is also an input" in capsys.readouterr().err
    path.write_text("t_start_s,t_end_s,id1,id2\n")
    assert main(_flags(encounters=str(path))) == 1
    assert "0 encounters" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"side": None}, "neither --side nor --area is given; give one of the two"),
        ({"area": "25"}, "both --side and --area are given; give one of the two"),
        ({"side": "0"}, "--side is 0; wanted a number of m from 1e-09"),
        ({"side": "nan"}, "--side is nan"),
        ({"speed": "-1"}, "--speed is -1; wanted a number of m/s"),
        ({"speed": None}, "--speed is not given"),
        ({"time": "inf"}, "--time is inf"),
        ({"mean_leg": "0"}, "--mean-leg is 0"),
        ({"biobots": "1"}, "--biobots is 1; wanted 2 to 65535"),
        ({"biobots": None}, "--biobots is not given"),
        ({"biobots": "99999"}, "--biobots is 99999"),
        ({"landmarks": "40"}, "--landmarks is 40; wanted 0 to 39"),
        ({"landmarks": "-1"}, "--landmarks is -1"),
        ({"perimeter": "3"}, "--perimeter is 3 m; wanted at least 17.72 m"),
        ({"detection_radius": "2.6"}, "--detection-radius is 2.6 m; wanted at most 2.5 m"),
        ({"obstacle": "5"}, "--obstacle is 5 m; wanted less than 5 m"),
        ({"obstacle": "-2"}, "--obstacle is -2"),
    ],
)
def test_bad_numbers_end_with_value_limit_and_next_step(
    changes: dict[str, str | None], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(_flags(**changes)) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert (
        output.err.startswith("biobot-mapper: error: --") or output.err.startswith("biobot-mapper: error: neither ") or "both" in output.err
    )
    assert complaint in output.err


def test_all_faults_are_told_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["feasibility", "--side", "5"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 5


@pytest.mark.parametrize("arguments", [["feasibility", "--speed", "fast"], ["feasibility", "--biobots", "4.5"]])
def test_no_numbers_are_bad_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    assert "error: " in capsys.readouterr().err


def test_help_fits_one_screen(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["feasibility", "--help"])
    assert left.value.code == 0
    assert 0 < len(capsys.readouterr().out.splitlines()) <= 40
