"""Laws of the benchmark: it runs, and Mesa does the same work."""

from dataclasses import replace

import pytest

from studies.bench_sim import CASES, main, time_in_turns


@pytest.mark.campaign
def test_a_quick_round_tells_every_case_and_the_memory(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quick"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in CASES)
    assert "peak of memory" in out


def test_a_pace_is_agent_seconds_over_the_core_s_time() -> None:
    case = replace(CASES["paper-units, empty square"], insects=10, duration_s=5.0)
    timing = time_in_turns({"few": (case, lambda _: sum(range(100_000)))}, rounds=3)[0]
    assert timing.agent_s == 50.0
    assert timing.pace == pytest.approx(50.0 / timing.cpu_s)


def test_mesa_meets_as_often_as_the_engine() -> None:
    """About 2,100 encounters in 200 s, so 105 in 10 s (s.d. 10 %); steps of a tenth of a passage miss the grazing ones, about 1 in 100."""
    pytest.importorskip("mesa")
    from studies.mesa_peer import MesaSpace, Walk, count_encounters  # noqa: PLC0415  # where Mesa is installed

    walk = Walk(insects=150, side=50.0, speed=1.0, mean_leg=10.0, detection=1.0, step_s=0.1, duration_s=10.0)
    expected = replace(CASES["paper-units, empty square"], duration_s=100.0).run(1) / 10.0
    assert count_encounters(walk, space=MesaSpace.CLASSIC, seed=1) == pytest.approx(expected, rel=0.35)
