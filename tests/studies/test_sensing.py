"""Laws of the study of beacon sensing."""

from pathlib import Path

import pytest

from studies import sensing
from studies.errors import MarkerError
from studies.sensing import BEGIN, END, PERIODS_S, SENSINGS, study, to_markdown
from studies.tables import put_between_markers


@pytest.mark.campaign
def test_the_study_covers_every_period_and_radio_and_finds_most_encounters() -> None:
    rows = list(study(duration_s=60.0, radii_m=(0.5,)))
    assert [(row.sensing, row.period_s) for row in rows] == [(one.name, period_s) for one in SENSINGS for period_s in PERIODS_S]
    assert all(row.true_encounters == rows[0].true_encounters > 50 for row in rows)
    ideal = [row for row in rows if row.sensing == "ideal"]
    assert all(row.heard == 1 and (row.detected or 0) > 0.8 for row in ideal)
    durations = [row.duration_error_s or 0.0 for row in ideal]
    assert durations == sorted(durations, reverse=True)  # the rarer the beacons, the shorter an encounter seems
    assert len(to_markdown(rows).splitlines()) == 2 + len(rows)


def test_the_table_replaces_what_stood_between_the_markers_and_nothing_else(tmp_path: Path) -> None:
    document = f"before\n{BEGIN}\nold\n{END}\nafter\n"
    written = put_between_markers(document, "| new |", path=tmp_path, markers=(BEGIN, END))
    assert written == f"before\n{BEGIN}\n\n| new |\n\n{END}\nafter\n"
    assert put_between_markers(written, "| new |", path=tmp_path, markers=(BEGIN, END)) == written


@pytest.mark.parametrize("document", ["", BEGIN, f"{END}{BEGIN}", f"{BEGIN}{BEGIN}{END}", f"{BEGIN}{END}{END}"])
def test_a_document_without_its_markers_is_left_alone(tmp_path: Path, document: str) -> None:
    path = tmp_path / "page.md"
    path.write_text(document)
    with pytest.raises(MarkerError, match="wanted each of the markers"):
        sensing.main(["--quick", "--write", str(path)])
    assert path.read_text() == document
