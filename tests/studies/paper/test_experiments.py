"""The paper's experiments: each from run to figure and table, in its quick mode; and what they count, by hand."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from mapper.betti import judge_intervals
from mapper.types import BettiRule, BettiRuleKind
from studies.errors import MarkerError, SummaryError
from studies.paper.__main__ import EXPERIMENTS
from studies.paper.classification import PUBLISHED, Theta, count_holes, train
from studies.paper.classifier import sensitivity
from studies.paper.experiment import Setting, perform, read_setting
from studies.paper.report import TABLES, fill, main
from studies.paper.subsampling import signal_to_noise
from studies.paper.units import expected_encounters

pytestmark = pytest.mark.xdist_group("paper")

DOCUMENT = Path(__file__).parents[3] / "docs" / "paper.md"


def quick_setting(folder: Path) -> Setting:
    arguments = ["--quick", "--jobs", "1", "--first-seed", "5", "--out", str(folder / "out"), "--work", str(folder / "work")]
    return read_setting(arguments, prog="paper", about="")


def loops_of(*lengths: float) -> "np.ndarray[tuple[int, ...], np.dtype[np.float64]]":
    return np.column_stack([np.full(len(lengths), 1.0), 1.0 + np.array(lengths)])


@pytest.mark.campaign
def test_every_experiment_runs_from_the_first_run_to_the_last_table(tmp_path: Path) -> None:
    setting = quick_setting(tmp_path)
    for experiment in EXPERIMENTS:
        outcome = experiment.run(setting)
        assert outcome.figures
        assert len({tuple(row) for row in outcome.rows}) == 1  # all with the same keys
        summary = {"is_quick": False, "first_seed": 5, "runs": len(outcome.rows), **outcome.summary}
        setting.out.mkdir(exist_ok=True)
        (setting.out / f"{experiment.name}.json").write_text(json.dumps(summary))
    with pytest.raises(MarkerError):
        fill("no markers", setting.out, path=tmp_path / "paper.md")
    document = "\n".join(f"<!-- {name} begins --> STALE <!-- {name} ends -->" for name in ("overview", *TABLES))
    filled = fill(document, setting.out, path=tmp_path / "paper.md")
    assert "STALE" not in filled
    assert filled.count("seeds from 5") == len(TABLES)
    assert "nan" not in filled
    for table in re.findall(r"begins -->(.*?)<!-- ", filled, re.DOTALL):
        heights = [line.count("|") for line in table.splitlines() if line.startswith("|")]
        assert len(heights) >= 3


def test_figures_and_tables_are_written_and_a_second_run_takes_all_from_the_journal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setting = quick_setting(tmp_path)
    experiment = EXPERIMENTS[0]
    contents = []
    for _ in range(2):
        perform(experiment, setting)
        contents.append({path.name: path.read_bytes() for folder in (setting.out, setting.work) for path in folder.iterdir()})
    assert contents[0] == contents[1]
    assert {"units.svg", "units.png", "units.json", "units.csv", "units.jsonl"} <= contents[0].keys()
    assert contents[0]["units.png"].startswith(b"\x89PNG")
    assert "4 of 4 cases, 4 of them before" in capsys.readouterr().err


def test_a_quick_summary_or_none_is_not_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "units.json").write_text(json.dumps({"is_quick": True}))
    document = tmp_path / "paper.md"
    document.write_text("no markers")
    with pytest.raises(SummaryError, match="quick run"):
        fill("no markers", tmp_path, path=document)
    assert main(["--data", str(tmp_path), "--document", str(document)]) == 1
    assert "python -m studies.paper.units" in capsys.readouterr().err
    assert document.read_text() == "no markers"


def test_the_document_has_a_place_for_every_table_and_every_figure_it_shows() -> None:
    text = DOCUMENT.read_text()
    for name in ("overview", *TABLES):
        assert text.count(f"<!-- {name} begins -->") == text.count(f"<!-- {name} ends -->") == 1
    assert re.findall(r"!\[[^\]]+\]\((paper/[^)]+\.png)\)", text)


def test_printed_units_give_two_encounters_and_the_preset_gives_twenty_thousand() -> None:
    """METHOD 2: v T r_d (4 N_m^2 / pi + 2 N_l N_m) / A is 2.1 in 50 m x 50 m."""
    assert expected_encounters(50.0, duration_s=200.0) == pytest.approx(2.1, abs=0.05)
    assert expected_encounters(0.5, duration_s=200.0) == pytest.approx(20_700, rel=0.01)


def test_eq_15_counts_as_the_mappers_rule_does() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        loops = loops_of(*rng.exponential(0.1, 30))
        theta = Theta(q=0.5, delta=0.02, tau=2.5)
        rule = BettiRule(kind=BettiRuleKind.QUANTILE, q=theta.q, delta=theta.delta, tau=theta.tau)
        assert count_holes(loops, theta) == judge_intervals(loops, rule, diameter=1.0).sum()
    assert count_holes(np.zeros((0, 2)), theta) == 0


def test_the_published_theta_finds_nothing_in_shares_of_the_diameter() -> None:
    """No interval is longer than the diameter, so its length over 0.7 and more is far below 37."""
    assert count_holes(loops_of(1.0, 0.9, 0.01, 0.01), PUBLISHED) == 0


def test_training_finds_what_separates_two_holes_from_noise() -> None:
    rng = np.random.default_rng(1)
    diagrams = [loops_of(0.3, 0.25, *rng.uniform(0.01, 0.05, 20)) for _ in range(10)]
    training = train(diagrams, [2] * 10)
    assert training.error == 0
    assert count_holes(loops_of(0.28, 0.26, *rng.uniform(0.01, 0.05, 20)), training.theta) == 2
    assert train([loops_of(0.1)] * 3, [0, 1, 2]).error == pytest.approx(2 / 3)


def test_sensitivity_and_signal_to_noise_by_hand() -> None:
    assert sensitivity([2, 1, 5], [2, 2, 3]) == pytest.approx(6 / 7)
    assert signal_to_noise([4.0, None, 8.0], [1.0, 1.0, 4.0]) == 3.0
    assert signal_to_noise([None], [1.0]) is None
