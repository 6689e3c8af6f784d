"""The whole system over CAN: simulator, slcan adapter on a pty, python-can's own slcan, gateway, Zenoh, mapper."""

from pathlib import Path

import pytest

from studies.system import RunningSystem, SystemSettings
from tests.e2e.test_system import settled_ledger, wait_for_end

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(280)]


@pytest.mark.parametrize("link", ["slcan?unit=7", "slcan?fd=1"])
def test_nothing_is_lost_over_an_slcan_adapter(tmp_path: Path, link: str) -> None:
    settings = SystemSettings(out=tmp_path, seed=15, speed=8, n_biobots=40, n_landmarks=4, dispersion_s=1, exploration_s=4, link=link)
    with RunningSystem(settings=settings) as system:
        assert system.radio.startswith("can:slcan:")
        wait_for_end(system)
        ledger = settled_ledger(system)

    assert ledger.is_complete, ledger
    assert ledger.n_encounters > 30
