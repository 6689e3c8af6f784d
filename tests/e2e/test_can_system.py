"""The whole system over CAN: simulator, slcan adapter on a pty, python-can's own slcan, gateway, Zenoh, mapper."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from studies.ledger import Ledger
from studies.system import RunningSystem, SystemSettings
from tests.e2e.test_system import settled_ledger, wait_for_end

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(280)]


LINKS = ("slcan?unit=7", "slcan?fd=1")


def live_through(link: str, out: Path) -> tuple[str, Ledger]:
    """Return what the gateway opened, and whether it and the mapper have everything."""
    settings = SystemSettings(
        out=out, seed=15, speed=8, n_biobots=40, n_landmarks=4, dispersion_s=1, exploration_s=4, drain_s=120, link=link
    )
    with RunningSystem(settings=settings) as system:
        wait_for_end(system)
        return system.radio, settled_ledger(system)


def test_nothing_is_lost_over_an_slcan_adapter(tmp_path: Path) -> None:
    """Classic CAN and CAN FD, at the same time: either mostly waits."""
    with ThreadPoolExecutor(len(LINKS)) as pool:
        lives = list(pool.map(live_through, LINKS, [tmp_path / str(number) for number in range(len(LINKS))]))

    for radio, ledger in lives:
        assert radio.startswith("can:slcan:")
        assert ledger.is_complete, ledger
        assert ledger.n_encounters > 30
