"""A swarm led through a place that it does not cover at once."""

import numpy as np
import pytest
import shapely

from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.herding import BeaconPath
from simulator.motion import MotionParameters
from simulator.world import World
from studies.herded import HerdedExploration, explore_herded


def _explore() -> HerdedExploration:
    world = World(
        build_arena(shapely.box(0, 0, 90, 20)),
        motion=MotionParameters(speed=1.0, mean_leg=8.0),
        ranges=Ranges(detection=1.0, communication=8.0),
        ids=range(1, 41),
        seed=5,
    )
    return explore_herded(world, BeaconPath([(12, 10), (78, 10)], speed=0.25), radius=12.0, landmarks=6)


@pytest.fixture(scope="module")
def run() -> HerdedExploration:
    return _explore()


def test_landmarks_are_set_ahead_and_withdrawn_behind(run: HerdedExploration) -> None:
    """At no time do more stand than within the beacon's reach and just behind it; in all, many more places are occupied."""
    begins = np.array([spell.t_start_ns for spell in run.spells]) / 1e9
    ends = np.array([run.end_s if spell.t_end_ns is None else spell.t_end_ns / 1e9 for spell in run.spells])
    at_once = [int(((begins <= t_s) & (t_s < ends)).sum()) for t_s in np.linspace(run.begin_s, run.end_s - 1, 50)]
    assert min(at_once) >= 4
    assert max(at_once) <= 14
    assert run.n_stands > 20


def test_the_swarm_sees_all_of_the_way_but_not_at_one_time(run: HerdedExploration) -> None:
    assert run.positions[:, 0].min() < 12
    assert run.positions[:, 0].max() > 78
    centre_s = (run.table.t_start_ns + run.table.t_end_ns) / 2e9
    early = run.positions[centre_s < run.begin_s + 60]
    assert early[:, 0].max() < 60


def test_the_same_seed_is_the_same_run(run: HerdedExploration) -> None:
    again = _explore()
    assert np.array_equal(run.table.t_start_ns, again.table.t_start_ns)
    assert run.spells == again.spells
