"""Laws of the channel between two radios."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import Polygon, box

from simulator.arenas.arena import build_arena
from simulator.errors import ParameterError, ScenarioError
from simulator.radios.carrier_sense import CarrierSense
from simulator.radios.channel import Channel
from simulator.radios.radio import RADIO_PRESETS, RadioConfig, choose_radio
from simulator.radios.radio_keys import RadioKeys

N = 400
IDS = range(1, N + 1)
ONE, OTHER = (side.astype(np.int64) for side in np.triu_indices(N, k=1))


def a_channel(*, seed: int = 1, **values: float) -> Channel:
    return Channel(RadioConfig(**values), seed=seed, ids=IDS)  # type: ignore[arg-type]  # every value given here is a float


PLAIN = a_channel(shadowing_db=6.0)


@given(near=st.floats(0.01, 1e4), further=st.floats(1.0, 100.0))
def test_power_falls_with_distance_in_the_median(near: float, further: float) -> None:
    powers = PLAIN.median_dbm(np.array([near, near * further]))
    assert powers[1] <= powers[0]
    assert powers[0] - powers[1] == pytest.approx(24 * math.log10(further), abs=1e-9)
    assert powers[0] == pytest.approx(PLAIN.config.median_dbm(near), abs=1e-9)


def test_without_asymmetry_both_directions_are_alike_and_with_it_they_differ_by_its_deviation() -> None:
    symmetric = a_channel(shadowing_db=6.0)
    assert np.array_equal(symmetric.pair_gain_db(ONE, OTHER), symmetric.pair_gain_db(OTHER, ONE))
    skewed = a_channel(shadowing_db=6.0, asymmetry_db=3.0)
    difference = skewed.pair_gain_db(ONE, OTHER) - skewed.pair_gain_db(OTHER, ONE)
    assert difference.std() == pytest.approx(3.0, rel=0.02)
    assert abs(difference.mean()) < 0.05
    assert np.allclose((skewed.pair_gain_db(ONE, OTHER) + skewed.pair_gain_db(OTHER, ONE)) / 2, symmetric.pair_gain_db(ONE, OTHER))


def test_shadowing_is_the_pairs_and_has_its_deviation() -> None:
    gain = a_channel(shadowing_db=4.0).pair_gain_db(ONE, OTHER)
    assert gain.std() == pytest.approx(4.0, rel=0.02)
    assert abs(gain.mean()) < 0.05
    # Neither who else is there nor the order of asking matters; the seed does.
    few = Channel(RadioConfig(shadowing_db=4.0), seed=1, ids=[7, 3])
    row = np.flatnonzero((ONE == 2) & (OTHER == 6))
    assert few.pair_gain_db(np.array([0]), np.array([1]))[0] == gain[row[0]]
    assert a_channel(seed=2, shadowing_db=4.0).pair_gain_db(ONE[:1], OTHER[:1])[0] != gain[0]


def test_fading_changes_from_packet_to_packet_and_from_receiver_to_receiver() -> None:
    channel = a_channel(fading_db=2.0)
    sender, number = np.zeros(5000, dtype=np.int64), np.arange(5000)
    first = channel.fading_db(sender, sender + 1, number)
    assert first.std() == pytest.approx(2.0, rel=0.05)
    assert abs(np.corrcoef(first[:-1], first[1:])[0, 1]) < 0.05
    assert abs(np.corrcoef(first, channel.fading_db(sender, sender + 2, number))[0, 1]) < 0.05
    assert np.array_equal(first[100:200], channel.fading_db(sender[:100], sender[:100] + 1, number[100:200]))


def test_rssi_comes_in_whole_dbm_off_by_a_constant_of_each_receiver() -> None:
    channel = a_channel(rssi_offset_db=2.0)
    everyone = np.arange(N)
    offset = channel.rssi_dbm(np.full(N, -50.0), everyone) + 50
    assert np.array_equal(offset, np.rint(offset))
    assert offset.std() == pytest.approx(2.0, rel=0.1)
    assert np.array_equal(channel.rssi_dbm(np.full(N, -70.0), everyone) + 70, offset)
    assert a_channel(rssi_step_db=0.0).rssi_dbm(np.array([-50.3]), np.array([0]))[0] == -50.3


def test_one_packet_in_a_hundred_is_lost_at_the_sensitivity_and_none_10_db_above() -> None:
    channel = a_channel(sensitivity_dbm=-97.0)
    rate = channel.packet_error_rate(np.array([-130.0, -99.0, -97.0, -95.0, -87.0]), n_octets=20)
    assert rate[2] == pytest.approx(0.01, rel=1e-6)
    assert (np.diff(rate) < 0).all()
    assert rate[0] == pytest.approx(1.0)
    assert rate[4] < 1e-12
    longer = channel.packet_error_rate(np.array([-97.0]), n_octets=40)
    assert longer[0] == pytest.approx(1 - 0.99**2, rel=1e-6)
    assert a_channel().packet_error_rate(np.array([-500.0]), n_octets=127)[0] == 0


def test_nothing_beyond_the_reach_comes_up_to_the_floor() -> None:
    channel = a_channel(shadowing_db=4.0, fading_db=2.0, rssi_offset_db=2.0)
    reach = channel.reach(-80.0)
    power = channel.median_dbm(np.full(ONE.size, reach)) + channel.pair_gain_db(ONE, OTHER) + channel.fading_db(ONE, OTHER, ONE)
    assert (channel.rssi_dbm(power, OTHER) >= -80.0).mean() < 2e-4
    assert a_channel().reach(-math.inf) == math.inf
    assert a_channel(rssi_step_db=0.0).reach(-75.0) == pytest.approx(10 ** (24.4 / 24))


def test_a_wall_is_counted_once_and_an_obstacle_once() -> None:
    arena = build_arena(Polygon(box(0, 0, 10, 10).exterior, [box(4, 0.5, 5, 9.5).exterior, box(7, 4, 8, 6).exterior]))
    channel = Channel(RadioConfig(wall_db=5.0), seed=1, ids=[1, 2], arena=arena)
    places = np.array([[1.0, 5.0], [1.0, 5.0], [6.0, 5.0], [1.0, 9.8]])
    others = np.array([[2.0, 8.0], [6.0, 5.0], [9.0, 5.1], [9.0, 9.8]])
    assert channel.walls_between(places, others).tolist() == [0, 1, 1, 0]
    assert channel.walls_between(np.array([[1.0, 5.0]]), np.array([[9.0, 5.1]])).tolist() == [2]
    power = channel.mean_dbm(np.array([0]), np.array([1]), from_place=places[1:2], to_place=others[1:2])
    assert power[0] == pytest.approx(channel.config.median_dbm(5.0) - 5.0)


def test_carrier_sense_notices_what_comes_in_above_its_threshold_walls_included() -> None:
    arena = build_arena(Polygon(box(0, 0, 10, 10).exterior, [box(4, 0.5, 5, 9.5).exterior]))
    config = RadioConfig(wall_db=15.0, shadowing_db=4.0, asymmetry_db=2.0, fading_db=9.0, hidden_nodes=True, carrier_dbm=-70.0)
    ids = range(1, 41)
    channel = Channel(config, seed=1, ids=ids, arena=arena)
    place = np.random.default_rng(1).uniform([0, 0], [10, 0.4], (40, 2)) + np.array([0.0, 5.0]) * (np.arange(40)[:, None] % 2)
    place[(place[:, 0] > 3.9) & (place[:, 0] < 5.1) & (place[:, 1] > 0.5), 0] = 3.0
    hears = CarrierSense(channel, ids=ids, place=lambda row, _t: (float(place[row, 0]), float(place[row, 1])))
    listener, talker = (side.ravel() for side in np.meshgrid(np.arange(40), np.arange(40)))
    listener, talker = listener[listener != talker], talker[listener != talker]
    mean_dbm = channel.mean_dbm(talker, listener, from_place=place[talker], to_place=place[listener])
    noticed = [hears(ids[to], ids[by], 0) for to, by in zip(listener.tolist(), talker.tolist(), strict=True)]
    assert noticed == (mean_dbm >= -70.0).tolist()
    assert 0.1 < np.mean(noticed) < 0.9


def test_every_value_of_a_radio_preset_that_is_not_the_default_has_its_source() -> None:
    plain = RadioConfig()
    for preset in RADIO_PRESETS.values():
        changed = {name for name in RadioConfig.__dataclass_fields__ if getattr(preset.config, name) != getattr(plain, name)}
        assert set(preset.sources) == changed
    assert all("assumption" in RADIO_PRESETS["rubble"].sources[name] for name in ("exponent", "shadowing_db", "wall_db", "burst_bad_s"))


def test_a_key_given_replaces_the_presets_value_and_only_it() -> None:
    chosen = choose_radio(RadioKeys(radio="indoor", wall_db=7.5, csma=False), loss=0.25)
    preset = RADIO_PRESETS["indoor"].config
    assert (chosen.wall_db, chosen.csma, chosen.loss) == (7.5, False, 0.25)
    assert (chosen.shadowing_db, chosen.exponent) == (preset.shadowing_db, preset.exponent)
    with pytest.raises(ScenarioError, match=r"no radio preset is called 'sewer'; choose one of ideal, indoor, rubble"):
        choose_radio(RadioKeys(radio="sewer"))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"burst_good_s": 3.0}, r"burst_good_s, burst_bad_s is \(3.0, 0.0\); wanted both positive, or both 0"),
        ({"shadowing_db": -1.0}, r"shadowing_db is -1.0; wanted a finite number, not negative"),
        ({"exponent": 0.0}, r"exponent is 0.0; wanted a positive finite number"),
        ({"sensitivity_dbm": math.nan}, r"sensitivity_dbm is nan; wanted a power"),
        ({"tx_power_dbm": math.inf}, r"tx_power_dbm is inf; wanted a finite number"),
    ],
)
def test_an_impossible_radio_is_refused_with_its_value(values: dict[str, float], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        RadioConfig(**values)  # type: ignore[arg-type]  # every value given here is a float


def test_an_identity_that_does_not_fit_the_keys_of_draws_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"ids is \[4294967296\]; wanted 0 to 4294967295"):
        Channel(RadioConfig(), seed=1, ids=[1, 2**32])
