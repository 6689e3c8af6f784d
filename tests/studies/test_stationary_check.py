"""The study of the search for who stands still."""

import pytest

from studies.stationary_check import Score, main, score
from studies.trials import SETTINGS


def test_a_dense_run_has_its_landmarks_found_and_one_in_which_all_walk_has_none() -> None:
    setting = SETTINGS["big-square/hisser-field"]
    standing = score(setting, range(102, 105), all_walk=False)
    walking = score(setting, range(102, 105), all_walk=True)
    assert (standing.n_wrong, walking.n_found, walking.n_missed) == (0, 0, 0)
    assert standing.n_right + standing.n_missed == 3 * setting.landmarks


def test_a_row_tells_precision_and_recall() -> None:
    line = Score(n_runs=4, n_found=2, n_wrong_runs=1, n_right=9, n_wrong=1, n_missed=3).line("some")
    assert line.split() == ["some", "4", "2", "1", "0.9000", "0.750"]


def test_the_table_has_the_settings_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--runs", "1", "--first-seed", "0", "--setting", "hisser-field, all walk"]) == 0
    head, row = capsys.readouterr().out.splitlines()
    assert head.split()[0] == "setting"
    assert row.split()[-5:] == ["1", "0", "0", "-", "-"]
