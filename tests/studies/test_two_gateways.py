"""Two real gateways that share a swarm, one of them on a machine whose clock is wrong, and a real mapper."""

from pathlib import Path

import pytest

from studies.two_gateways import Settings, run

pytestmark = [pytest.mark.campaign, pytest.mark.e2e, pytest.mark.timeout(120)]

AHEAD_S = 300.0


def test_each_encounter_counts_once_and_when_it_was_though_two_gateways_heard_it_and_one_has_a_wrong_clock(tmp_path: Path) -> None:
    settings = Settings(n_biobots=80, seed=1, speed=8.0, duration_s=5.0, ahead_s=AHEAD_S)
    found = run(settings, tmp_path)
    assert found.ledger.is_complete, found.ledger
    assert found.n_known == len(found.intervals) == found.n_records - found.n_absorbed
    assert found.n_absorbed >= found.n_joint >= 10
    # What each gateway heard was one side of it; together they are both.
    assert found.n_reciprocal == len(found.intervals)
    assert min(begin for _, _, begin, _ in found.intervals) >= -0.1
    assert max(end for *_, end in found.intervals) <= settings.duration_s + 0.5
    clock = found.clocks["gateway2"]
    assert abs(clock["ahead_ns"] - AHEAD_S * 1e9) <= clock["bound_ns"] <= 0.1e9
    assert (clock["reference"], clock["is_corrected"]) == ("gateway1", True)
    (fault,) = found.faults
    assert fault.startswith("the clock of gateway gateway2 differs by +")
