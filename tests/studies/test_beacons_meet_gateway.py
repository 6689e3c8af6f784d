"""A run's ``encounters.csv`` against the gateway's own merging of both sides' reports."""

import numpy as np

from firmware_protocol.units import Nanoseconds, NodeId, RssiDbm
from gateway.encounters import EncounterMerger, SideReport, margin_of
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.radios.paths import Paths
from simulator.radios.radio import RADIO_PRESETS
from simulator.radios.sensing import SensingConfig, sense
from simulator.world import World
from tests.gateway.makers import an_issuer, newest_encounters
from tests.simulator.arenas import square


def test_the_encounters_of_a_sensed_run_are_those_that_a_gateway_makes_of_its_observations() -> None:
    """The reports come in any order, as they do over the air."""
    ranges = Ranges(detection=1.0, communication=8.0)
    world = World(square(12.0), motion=MotionParameters(speed=0.5, mean_leg=3.0), ranges=ranges, ids=range(1, 31), seed=1)
    world.advance(60.0)
    config = SensingConfig(seed=1, detection=1.0, communication=8.0, period_s=1.0, radio=RADIO_PRESETS["indoor"].config)
    sensed = sense(Paths(world.legs(), n=30), ids=world.ids, arena=world.arena, until_s=60.0, config=config)
    merger = EncounterMerger(issuer=an_issuer())
    records = []
    for k in np.random.default_rng(1).permutation(len(sensed.observations)).tolist():
        one = sensed.observations[k]
        records += merger.merge(
            SideReport(
                node=NodeId(one.node),
                peer=NodeId(one.peer),
                t_start_ns=Nanoseconds(one.start_ns),
                t_end_ns=Nanoseconds(one.end_ns),
                error_ns=Nanoseconds(0),
                rssi_dbm=RssiDbm(round(one.mean_rssi_dbm)),
                is_ongoing=False,
                margin_ns=margin_of(beacon_period_ms=1000, error_ns=0),
            )
        )
    merged = [(one.t_start_ns / 1e9, one.t_end_ns / 1e9, one.node_a, one.node_b) for one in newest_encounters(records)]
    assert len(merged) > 100
    assert sorted(merged) == sorted(sensed.encounters)
