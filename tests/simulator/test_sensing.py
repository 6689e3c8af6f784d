"""Laws of whole runs sensed by beacons."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.config import Ranges
from simulator.errors import ParameterError
from simulator.legs import Legs
from simulator.motion import MotionParameters
from simulator.radios import sensing
from simulator.radios.beacons import BeaconSchedule
from simulator.radios.fidelity import Encounter, compare
from simulator.radios.medium import airtime_ns
from simulator.radios.paths import Paths
from simulator.radios.radio import RADIO_PRESETS, RadioConfig
from simulator.radios.sensing import Sensed, SensingConfig, sense, thresholds
from simulator.truth import TruthRecorder
from simulator.world import World
from tests.simulator.arenas import square

pytestmark = pytest.mark.xdist_group("sensing")
"""What they share is made once, by one worker."""

SECONDS = 60.0


class Walked:
    """A finished run of slow insects: they meet for some 20 s, so a beacon's period is short beside it."""

    def __init__(self, *, biobots: int = 40, side: float = 10.0, speed: float = 0.1, seed: int = 1) -> None:
        self.ranges = Ranges(detection=1.0, communication=8.0)
        motion = MotionParameters(speed=speed, mean_leg=3.0)
        self.world = World(square(side), motion=motion, ranges=self.ranges, ids=range(1, biobots + 1), seed=seed)
        recorder = TruthRecorder(self.world)
        recorder.record(self.world.advance(SECONDS))
        self.true: Sequence[Encounter] = recorder.encounters(zero_s=0.0)
        self.paths = Paths(self.world.legs(), n=biobots)

    def sense(self, **values: object) -> Sensed:
        config = SensingConfig(seed=1, detection=1.0, communication=8.0, **values)  # type: ignore[arg-type]  # by name
        return sense(self.paths, ids=self.world.ids, arena=self.world.arena, until_s=SECONDS, config=config)


@pytest.fixture(scope="module")
def walked() -> Walked:
    return Walked()


EXACT = RadioConfig(rssi_step_db=0.0)
AT_RADIUS = {"enter_dbm": EXACT.median_dbm(1.0), "exit_dbm": EXACT.median_dbm(1.0)}


def test_with_nothing_lost_and_thresholds_at_the_radius_encounters_converge_to_the_exact_ones(walked: Walked) -> None:
    """A side sees an encounter from its first beacon inside to its last: each end is at most one period off (and the time on the air)."""
    loss = []
    for period_s in (1.6, 0.4, 0.1):
        sensed = walked.sense(radio=EXACT, period_s=period_s, **AT_RADIUS)
        fidelity = compare(sensed.encounters, walked.true)
        assert fidelity["precision_in_time"] == pytest.approx(1.0, abs=1e-5)
        assert fidelity["false_share"] == 0
        loss.append(1 - float(fidelity["sensitivity_in_time"] or 0))
        for start_s, end_s, id1, id2 in walked.true:
            if end_s - start_s > 3 * period_s:
                near = [one for one in sensed.encounters if one[2:] == (id1, id2) and one[0] < end_s and one[1] > start_s]
                # A pair that parts for less than the bridged gap is one encounter to the gateway.
                assert near
                assert min(one[0] for one in near) <= start_s + 1.1 * period_s + 1e-4
                assert max(one[1] for one in near) >= end_s - 1.1 * period_s - 1e-4
    assert loss[0] > 2.5 * loss[1] > 6 * loss[2]
    assert loss[2] < 0.01


def test_the_time_that_is_missed_is_what_beacons_at_random_phases_miss(walked: Walked) -> None:
    """Two sides' beacons come at independent phases: at each end the sooner of two uniform waits is missed, a third of a period."""
    sensed = walked.sense(radio=EXACT, period_s=1.0, **AT_RADIUS)
    long = [one for one in walked.true if one[1] - one[0] > 5.0 and one[0] > 0.0 and one[1] < SECONDS]
    missed = []
    for start_s, end_s, *pair in long:
        near = [one for one in sensed.encounters if list(one[2:]) == pair and one[0] < end_s and one[1] > start_s]
        missed.append((end_s - start_s) - sum(one[1] - one[0] for one in near))
    assert len(missed) > 60
    assert np.mean(missed) == pytest.approx(2 / 3, abs=0.12)


def test_the_same_seed_hears_the_same_and_blocks_change_nothing(walked: Walked, monkeypatch: pytest.MonkeyPatch) -> None:
    radio = replace(RADIO_PRESETS["indoor"].config, loss=0.1)
    whole = walked.sense(radio=radio)
    assert walked.sense(radio=radio) == whole
    monkeypatch.setattr(sensing, "_BLOCK", 3_000)
    assert walked.sense(radio=radio) == whole
    other = sense(
        walked.paths, ids=walked.world.ids, arena=walked.world.arena, until_s=SECONDS,
        config=SensingConfig(seed=2, detection=1.0, communication=8.0, radio=radio),
    )  # fmt: skip
    assert other.observations != whole.observations


def test_observations_of_one_direction_never_overlap_and_encounters_of_a_pair_lie_apart(walked: Walked) -> None:
    sensed = walked.sense(radio=RADIO_PRESETS["indoor"].config)
    assert len(sensed.observations) > 100
    for earlier, later in pairwise(sensed.observations):
        assert (earlier.node, earlier.peer, earlier.start_ns) < (later.node, later.peer, later.start_ns)
        if (earlier.node, earlier.peer) == (later.node, later.peer):
            assert later.start_ns - earlier.end_ns > 1_150_000_000
    of_pair: dict[tuple[int, int], float] = {}
    for start_s, end_s, *pair in sensed.encounters:
        key = (pair[0], pair[1])
        assert pair[0] < pair[1]
        assert start_s <= end_s
        assert start_s - of_pair.get(key, -2.0) > 1.15
        of_pair[key] = end_s


def test_every_loss_has_its_cause_and_only_if_asked_for(walked: Walked) -> None:
    quiet = walked.sense().air
    assert {name for name, count in quiet.fates.items() if count} == {"heard"}
    assert quiet.load == pytest.approx(40 * airtime_ns(27) / 1e9, rel=0.03)
    everything = RadioConfig(
        loss=0.1, fading_db=6.0, sensitivity_dbm=-72.0, burst_good_s=5.0, burst_bad_s=1.0, csma=True, hidden_nodes=True, carrier_dbm=-40.0
    )
    noisy = walked.sense(radio=everything, period_s=0.5).air
    assert all(noisy.fates[name] > 0 for name in ("heard", "range", "fading", "burst", "chance", "deaf", "collision"))
    total = sum(noisy.fates.values())
    assert noisy.fates["burst"] / (total - noisy.fates["range"] - noisy.fates["fading"]) == pytest.approx(1 / 6, rel=0.1)
    crowded = walked.sense(radio=RadioConfig(csma=True), period_s=0.1, drift_ppm=0.0).air
    assert crowded.load == pytest.approx(0.4, abs=0.05)
    assert crowded.not_sent + crowded.sent == pytest.approx(40 * SECONDS * 10, rel=0.01)


def test_a_lost_share_of_beacons_is_lost_at_that_rate(walked: Walked) -> None:
    fates = walked.sense(radio=RadioConfig(loss=0.25)).air.fates
    assert fates["chance"] / (fates["chance"] + fates["heard"]) == pytest.approx(0.25, abs=0.01)


def test_hidden_nodes_collide_where_those_that_hear_each_other_wait(walked: Walked) -> None:
    open_air = walked.sense(radio=RadioConfig(csma=True), period_s=0.4).air.fates
    hidden = walked.sense(radio=RadioConfig(csma=True, hidden_nodes=True, carrier_dbm=-45.0), period_s=0.4).air.fates
    assert hidden["collision"] + hidden["deaf"] > 3 * (open_air["collision"] + open_air["deaf"])


def test_a_backpack_that_is_switched_off_neither_sends_nor_hears(walked: Walked) -> None:
    config = SensingConfig(seed=1, detection=1.0, communication=8.0)
    off = {one: 20.0 for one in walked.world.ids if one > 20}
    sensed = sense(walked.paths, ids=walked.world.ids, arena=walked.world.arena, until_s=SECONDS, config=config, off_s=off)
    assert max(end_s for _, end_s, _, id2 in sensed.encounters if id2 > 20) < 20
    assert max(one.end_ns for one in sensed.observations if one.node > 20) < 20e9
    whole = walked.sense()
    both_on = [one for one in whole.observations if max(one.node, one.peer) <= 20]
    assert [one for one in sensed.observations if max(one.node, one.peer) <= 20] == both_on


def test_thresholds_are_the_median_at_the_radius_and_a_little_beyond() -> None:
    radio = RadioConfig()
    enter, leave = thresholds(radio, detection=0.5, enter_dbm=None, exit_dbm=None)
    assert enter == radio.median_dbm(0.5)
    assert leave == radio.median_dbm(0.575)
    assert radio.median_dbm(0.01) == pytest.approx(-2.6)
    assert thresholds(radio, detection=0.01, enter_dbm=None, exit_dbm=None)[0] == -3  # what a receiver says of -2.6 dBm
    assert thresholds(radio, detection=0.5, enter_dbm=-80.0, exit_dbm=None) == (-80.0, -80.0)
    with pytest.raises(ParameterError, match=r"exit_dbm is -70.0; wanted at most enter_dbm, -80.0"):
        SensingConfig(seed=1, detection=0.5, communication=4.0, enter_dbm=-80.0, exit_dbm=-70.0).proximity(per_s=1000)


def test_more_beacons_than_can_be_looked_at_are_refused_before_any_work(walked: Walked, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensing, "_MAX_LOOKS", 10_000)
    with pytest.raises(ParameterError, match=r"number of beacons is 2[34]\d\d; wanted at most 250 among 40 biobots"):
        walked.sense()


@given(period_ms=st.integers(100, 5000), node=st.integers(1, 500), number=st.integers(0, 10_000))
def test_a_beacon_comes_in_its_period_or_a_tenth_later_by_either_reckoning(period_ms: int, node: int, number: int) -> None:
    schedule = BeaconSchedule(seed=1, period_ns=period_ms * 1_000_000)
    word = np.array([node], dtype=np.uint64)
    due_ns = int(schedule.due_ns(word, np.array([number], dtype=np.uint64))[0])
    following_ns = int(schedule.due_ns(word, np.array([number + 1], dtype=np.uint64))[0])
    assert 0.9 * schedule.period_ns <= following_ns - due_ns <= 1.1 * schedule.period_ns + 1
    assert number * schedule.period_ns <= due_ns < (number + 1.1) * schedule.period_ns
    assert abs(schedule.due_ms(node, number) * 1_000_000 - due_ns) <= 1_000_000


def test_a_period_too_short_for_one_attempt_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"beacon period is '0.05 s'; wanted at least 0.1 s"):
        BeaconSchedule(seed=1, period_ns=50_000_000)


def test_paths_are_where_the_world_says(walked: Walked) -> None:
    t_s = np.sort(np.random.default_rng(1).uniform(0, SECONDS, 50))
    places = walked.paths.places(t_s)
    for k, at_s in enumerate(t_s.tolist()):
        assert np.allclose(places[k], walked.world.positions(at_s=at_s), atol=1e-12)
        assert walked.paths.place(7, at_s) == pytest.approx(places[k, 7], abs=1e-12)


def test_paths_take_legs_in_any_order(walked: Walked) -> None:
    legs = walked.world.legs()
    mixed = np.random.default_rng(2).permutation(legs.biobot.size)
    shuffled = Legs(**{name: getattr(legs, name)[mixed] for name in Legs.__dataclass_fields__})
    t_s = np.linspace(0, SECONDS, 30)
    assert np.allclose(Paths(shuffled, n=40).places(t_s), walked.paths.places(t_s))


def test_fidelity_counts_time_and_encounters_of_the_pair_alone() -> None:
    true = [(0.0, 10.0, 1, 2), (20.0, 22.0, 1, 2), (0.0, 4.0, 2, 3)]
    observed = [(1.0, 9.0, 1, 2), (9.5, 12.5, 1, 2), (1.0, 3.0, 1, 3)]
    assert compare(observed, true) == {
        "true_contact_s": 16.0,
        "observed_contact_s": 13.0,
        "sensitivity_in_time": round(8.5 / 16, 6),
        "precision_in_time": round(8.5 / 13, 6),
        "true_encounters": 3,
        "observed_encounters": 3,
        "detected_share": round(1 / 3, 6),
        "false_share": round(1 / 3, 6),
        "matched": 0,
        "mean_duration_error_s": None,
    }
    single = compare([(1.0, 3.0, 1, 2), (21.0, 21.0, 1, 2)], true)
    assert (single["matched"], single["mean_duration_error_s"]) == (2, -5.0)
    assert compare([], [])["sensitivity_in_time"] is None
    assert compare(true, true)["precision_in_time"] == 1.0
