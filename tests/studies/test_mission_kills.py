"""A short run of the study: one mission, killed once in each phase."""

from pathlib import Path

import pytest

from firmware_protocol.contract.records import MissionPhase
from studies.mission_kills import Plan, kill_a_mission


@pytest.mark.campaign
def test_a_mission_killed_in_each_phase_ends_with_the_landmarks_it_has_chosen(tmp_path: Path) -> None:
    plan = Plan(seed=3, kills=3, biobots=20, landmarks=3, dispersion_s=0.4, exploration_s=0.8, longest_selection_s=0.1)
    ending = kill_a_mission(plan, out=tmp_path)
    assert ending.problems == ()
    assert len(ending.killed_in) == 3
    assert ending.killed_in[0] in {MissionPhase.DISPERSION, MissionPhase.LANDMARK_SELECTION}
