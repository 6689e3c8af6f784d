"""The study of long runs, on short ones."""

from dataclasses import replace

import numpy as np

from studies.large_runs import RUNS, LargeCase, LongRun, Outcome, describe, judge_map, simulate_long

SHORT = replace(RUNS["squares/10,000 s"], duration_s=60.0)


def _judge(run: LongRun, limit: int) -> Outcome:
    return judge_map(run, LargeCase(setting=SHORT.name, seed=1, limit=limit))


def test_encounters_are_of_the_time_in_which_landmarks_stand() -> None:
    run = simulate_long(SHORT, 1)
    assert len(run.spells) == SHORT.landmarks
    begin_ns, end_ns = run.spells[0].t_start_ns, run.spells[0].t_start_ns + round(SHORT.duration_s * 1e9)
    assert (run.table.t_start_ns >= begin_ns).all()
    assert (run.table.t_end_ns <= end_ns).all()


def test_a_limit_that_is_not_reached_changes_nothing_but_the_time_taken() -> None:
    run = simulate_long(SHORT, 1)
    free, limited = _judge(run, 0), _judge(run, len(run.table))
    assert replace(limited, limit=0, seconds=free.seconds) == free


def test_a_limit_that_is_reached_changes_the_map() -> None:
    run = simulate_long(SHORT, 1)
    free, limited = _judge(run, 0), _judge(run, 150)
    assert limited.bottleneck != free.bottleneck
    assert 0 < limited.metric_error < 1


def test_a_line_tells_the_share_that_is_right_and_its_standard_error() -> None:
    """Of four runs one is counted wrong: 75 %, and the root of 0.75 * 0.25 / 4 is 21.7 %."""
    outcome = _judge(simulate_long(SHORT, 1), 0)
    holes = np.array([0, 0, 0, 1]) + outcome.true_holes
    line = describe([replace(outcome, holes=int(one)) for one in holes])
    assert "75.0 +- 21.7 %" in line
    assert "none" in line
