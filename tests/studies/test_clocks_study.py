"""The study of clocks and of encounters' times, on a short walk."""

from studies.clocks import failures, study, to_markdown


def test_times_and_bounds_are_as_promised_on_a_short_walk() -> None:
    rows = list(study(duration_s=240.0, losses=(0.0, 0.3)))
    assert [(row.loss, row.silent) for row in rows] == [(0.0, 0), (0.0, 20), (0.3, 0), (0.3, 20)]
    assert all(row.records > 150 for row in rows)
    assert failures([row for row in rows if not row.loss]) == []
    assert rows[2].covered > 0.9
    assert all(row.made.contradictions <= 1 for row in rows)
    assert to_markdown(rows).count("\n") == 5
