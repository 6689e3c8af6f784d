"""Laws of the paths that backpacks measure."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.messages import EncounterBatch, EncounterBatchWithPaths
from firmware_protocol.units import NS_PER_MS, BootId, NodeId
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.odometer import SCALE_ERROR, Odometer
from simulator.swarm import Swarm
from simulator.swarm_config import SwarmConfig
from simulator.world import World
from tests.simulator.arenas import square
from tests.simulator.base_station import BaseStation

NODES = [NodeId(node) for node in range(1, 41)]


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=1, max_size=20), st.integers(0, 100))
def test_a_path_grows_with_every_step_and_is_wrong_by_one_factor_for_each_biobot(steps: list[tuple[float, float]], seed: int) -> None:
    place = np.zeros((40, 2))
    odometer = Odometer(NODES, places=place, mm_per_unit=10.0, seed=seed)
    true_mm = 0.0
    ratios = []
    for index, step in enumerate(steps):
        place = place + np.array(step)
        true_mm += 10.0 * math.hypot(*step)
        odometer.advance(place, at_ns=(index + 1) * 50)
        measured = [odometer.read_mm(node, (index + 1) * 50) for node in NODES]
        assert all((1 - SCALE_ERROR) * true_mm - 1e-9 <= one <= (1 + SCALE_ERROR) * true_mm + 1e-9 for one in measured)
        if true_mm > 1e-6:
            ratios.append([one / true_mm for one in measured])
    for earlier, later in itertools.pairwise(ratios):
        assert earlier == pytest.approx(later)
    if ratios:
        assert len({round(one, 6) for one in ratios[-1]}) > 30


def test_between_two_steps_a_path_is_taken_to_grow_evenly_and_outside_of_them_not_at_all() -> None:
    odometer = Odometer(NODES[:1], places=np.zeros((1, 2)), mm_per_unit=1.0, seed=1)
    for index in range(1, 200):
        odometer.advance(np.array([[float(index), 0.0]]), at_ns=100 * index)
    whole = odometer.read_mm(NODES[0], 19_900)
    assert odometer.read_mm(NODES[0], 19_850) == pytest.approx(whole * 198.5 / 199)
    assert odometer.read_mm(NODES[0], 10**9) == whole
    assert odometer.read_mm(NODES[0], 0) == odometer.read_mm(NODES[0], 100 * (200 - 128))


def test_a_swarm_reports_paths_no_longer_than_its_insects_can_have_walked() -> None:
    ranges = Ranges(detection=1.0, communication=8.0)
    world = World(square(8.0), motion=MotionParameters(speed=0.25, mean_leg=3.0), ranges=ranges, ids=range(1, 21), seed=3)
    swarm = Swarm(world, config=SwarmConfig(seed=3, boot=BootId(1), has_imu=True, metres_per_unit=0.1), observe=lambda _: None)
    base = BaseStation()
    for now_ms in range(10, 60_000, 10):
        base.tick(now_ms * NS_PER_MS)
        swarm.feed(base.take_outgoing(), now_ns=now_ms * NS_PER_MS)
        swarm.step(now_ms * NS_PER_MS)
        base.feed(swarm.coordinator.take_bytes(), now_ns=now_ms * NS_PER_MS)
    n_paths = 0
    for ledger in base.ledgers.values():
        assert not any(isinstance(one, EncounterBatch) for one in ledger.messages.values())
        batches = [one for _, one in sorted(ledger.messages.items()) if isinstance(one, EncounterBatchWithPaths)]
        paths = [entry.path_mm for batch in batches for entry in batch.entries if not entry.is_ongoing and entry.path_mm is not None]
        n_paths += len(paths)
        # 0.25 units a second, 100 mm a unit, at most 60 s, and the error of scale.
        assert sum(paths) <= 0.25 * 100 * 60 * (1 + SCALE_ERROR) + len(paths)
    assert n_paths > 20
