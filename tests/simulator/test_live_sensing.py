"""Laws of backpacks that form encounters from beacons while the world goes on."""

import itertools
from collections import defaultdict

import numpy as np
import pytest

from firmware_protocol.messages import (
    MAX_ENCOUNTER_MS,
    ConfigurationReport,
    ConfigurationResult,
    Configure,
    EncounterBatch,
    EncounterEntry,
    Hello,
)
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, NodeId, RssiDbm
from simulator.backpacks.backpack import Backpack, Transmission
from simulator.backpacks.backpack_config import BackpackConfig
from simulator.clock import DriftingClock
from simulator.config import Ranges
from simulator.errors import ParameterError
from simulator.motion import MotionParameters
from simulator.radios.fidelity import compare
from simulator.radios.live_sensing import LiveSensing
from simulator.radios.paths import Paths
from simulator.radios.proximity import ProximityConfig, unite
from simulator.radios.radio import RadioConfig
from simulator.radios.sensing import SensingConfig, sense
from simulator.swarm import Swarm
from simulator.swarm_config import SwarmConfig
from simulator.truth import TruthRecorder
from simulator.world import World
from tests.simulator.arenas import square
from tests.simulator.base_station import BaseStation

PERIOD_S = 0.5
SECONDS = 20.0


class Site:
    """A swarm with beacons, and a base station on its line; time is moved by hand."""

    def __init__(self, *, biobots: int = 20, radio: RadioConfig | None = None, seed: int = 1, boot: int = 4) -> None:
        ranges = Ranges(detection=1.0, communication=8.0)
        self.world = World(
            square(8.0), motion=MotionParameters(speed=0.25, mean_leg=3.0), ranges=ranges, ids=range(1, biobots + 1), seed=seed
        )
        self.recorder = TruthRecorder(self.world)
        self.radio = radio or RadioConfig()
        self.sensing = SensingConfig(seed=seed, detection=1.0, communication=8.0, period_s=PERIOD_S, radio=self.radio)
        backpack = BackpackConfig(
            beacon_period_ms=round(1000 * PERIOD_S), proximity=self.sensing.proximity(per_s=1000), provisional_ms=5_000
        )
        config = SwarmConfig(seed=seed, boot=BootId(boot), radio=self.radio, sensing=self.sensing, backpack=backpack, wander_ppm=50.0)
        self.swarm = Swarm(self.world, config=config, observe=self.recorder.record)
        self.base = BaseStation()
        self.now_ns = 0
        self.sent = bytearray()

    def run(self, until_s: float) -> None:
        while self.now_ns < until_s * NS_PER_S and not (self.swarm.has_ended and self.swarm.is_settled):
            self.now_ns += 10 * NS_PER_MS
            self.base.tick(self.now_ns)
            self.swarm.feed(self.base.take_outgoing(), now_ns=self.now_ns)
            self.swarm.step(self.now_ns)
            told = self.swarm.coordinator.take_bytes()
            self.sent += told
            self.base.feed(told, now_ns=self.now_ns)

    def finish(self) -> "Site":
        self.swarm.end_at(round(SECONDS * NS_PER_S))
        self.run(SECONDS + 120)
        assert self.swarm.is_settled
        return self

    def final_entries(self) -> list[tuple[int, EncounterEntry]]:
        return [(node, one) for (node, _), ledger in self.base.ledgers.items() for one in ledger.entries() if not one.is_ongoing]

    def reported(self, *, only_final: bool = True) -> dict[tuple[int, int], list[tuple[float, float]]]:
        rows = [line.split(",") for line in self.swarm.reports.to_csv().decode().splitlines()[1:]]
        found: dict[tuple[int, int], list[tuple[float, float]]] = defaultdict(list)
        for row in rows:
            if not only_final or row[6] == "0":
                found[int(row[0]), int(row[3])].append((float(row[4]), float(row[5])))
        return found


@pytest.fixture(scope="module")
def plain() -> Site:
    return Site().finish()


def test_backpacks_announce_their_beacon_period(plain: Site) -> None:
    hellos = [one for _, one in plain.base.of_type(Hello) if isinstance(one, Hello)]
    assert len(hellos) >= 20
    assert {one.beacon_period_ms for one in hellos} == {500}


def test_what_backpacks_report_from_beacons_is_close_to_the_truth(plain: Site) -> None:
    """At 0.25 units/s and a period of 0.5 s, an end is missed by about a sixth of a second, and the exit threshold adds 0.15 units."""
    of_pair: dict[tuple[int, int], list[tuple[float, float]]] = defaultdict(list)
    for (node, peer), spells in plain.reported().items():
        of_pair[min(node, peer), max(node, peer)] += spells
    united = [
        (start / 1e9, end / 1e9, *pair)
        for pair, spells in of_pair.items()
        for start, end in unite([(round(a * 1e9), round(b * 1e9)) for a, b in spells], bridge=round(1.15e9 * PERIOD_S))
    ]
    fidelity = compare(united, plain.recorder.encounters(zero_s=0.0))
    assert float(fidelity["sensitivity_in_time"] or 0) > 0.85
    assert float(fidelity["precision_in_time"] or 0) > 0.8
    assert fidelity["false_share"] == 0


def test_all_that_was_logged_arrives_once_and_no_two_reports_of_a_side_overlap(plain: Site) -> None:
    final = [(node, one.peer, one.start_ms, one.duration_ms) for node, one in plain.final_entries()]
    assert len(final) == len(set(final)) == sum(len(one) for one in plain.reported().values()) > 80
    assert plain.swarm.reports.n_unacknowledged == 0
    for spells in plain.reported().values():
        for earlier, later in itertools.pairwise(spells):
            assert later[0] - earlier[1] > 1.15 * PERIOD_S - 0.003


def test_a_side_logs_the_same_live_as_in_a_whole_run_but_for_the_phase_of_the_beacons(plain: Site) -> None:
    """Live clocks were switched on before the run, so beacons fall elsewhere: the time in contact agrees, not each instant."""
    whole = sense(Paths(plain.world.legs(), n=20), ids=plain.world.ids, arena=plain.world.arena, until_s=SECONDS, config=plain.sensing)
    live_s = sum(end - start for spells in plain.reported().values() for start, end in spells)
    whole_s = sum(one.end_ns - one.start_ns for one in whole.observations) / 1e9
    assert live_s == pytest.approx(whole_s, rel=0.04)


def test_an_ongoing_report_reaches_no_further_than_the_last_beacon(plain: Site) -> None:
    rows = [line.split(",") for line in plain.swarm.reports.to_csv().decode().splitlines()[1:]]
    final = plain.reported()
    ongoing = [row for row in rows if row[6] == "1"]
    assert ongoing
    for row in ongoing:
        start_s, end_s = float(row[4]), float(row[5])
        assert any(abs(a - start_s) < 0.003 and end_s <= b + 0.003 for a, b in final[int(row[0]), int(row[3])])


def test_reports_share_the_channel_with_beacons_and_still_all_arrive() -> None:
    site = Site(radio=RadioConfig(csma=True, loss=0.1)).finish()
    assert site.swarm.reports.n_unacknowledged == 0
    assert len(site.final_entries()) == sum(len(one) for one in site.reported().values()) > 80
    counts = site.swarm.air_counts
    assert counts is not None
    beacons = 20 * SECONDS / PERIOD_S
    assert counts["sent"] > 1.2 * beacons
    assert counts["airtime_ns"] > 1_056_000 * counts["sent"]  # reports are longer than beacons


def test_the_same_seed_gives_the_same_bytes() -> None:
    radio = RadioConfig(csma=True, hidden_nodes=True, carrier_dbm=-60.0, fading_db=2.0, burst_good_s=5.0, burst_bad_s=0.5)
    first, second = (Site(biobots=8, radio=radio) for _ in range(2))
    for site in (first, second):
        site.run(5.0)
    assert first.sent == second.sent
    assert first.sent


def test_a_backpack_that_is_switched_off_neither_sends_nor_hears() -> None:
    clocks = {NodeId(one): DriftingClock(start_ms=0, drift_ppb=0) for one in (1, 2, 3)}
    places = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])
    live = LiveSensing(
        list(clocks), clocks=clocks, arena=square(), config=SensingConfig(seed=1, detection=1.0, communication=8.0), places=places,
        coordinator_place=(0.0, 0.0),
    )  # fmt: skip
    before, _ = live.advance(2 * NS_PER_S, places=places)
    live.switch_off(NodeId(3))
    after, _ = live.advance(5 * NS_PER_S, places=places)
    assert {(one.node, one.peer) for one in before} == {(a, b) for a in (1, 2, 3) for b in (1, 2, 3) if a != b}
    assert {(one.node, one.peer) for one in after} == {(1, 2), (2, 1)}


def test_a_backpack_without_a_logger_takes_no_beacons() -> None:
    backpack = Backpack(node=NodeId(1), boot=BootId(1), eui64=1, seed=1, config=BackpackConfig(), now_ms=0, sense_neighbours=list)
    backpack.hear_beacon(NodeId(2), at_ms=5, rssi_dbm=0.0, now_ms=10)
    assert not backpack.sense_until(10_000, now_ms=10_000)
    backpack.stop_sensing(now_ms=10_000)
    assert backpack.n_buffered == 0


def test_a_backpack_reports_the_mean_strength_of_the_beacons_in_whole_dbm() -> None:
    config = BackpackConfig(proximity=ProximityConfig(enter_dbm=-50.0, exit_dbm=-60.0, gap=1150), spread_ms=0)
    backpack = Backpack(node=NodeId(1), boot=BootId(1), eui64=1, seed=1, config=config, now_ms=0, sense_neighbours=list)
    for at_ms, rssi_dbm in ((100, -45.0), (1100, -50.0), (2100, -57.0)):
        backpack.hear_beacon(NodeId(2), at_ms=at_ms, rssi_dbm=rssi_dbm, now_ms=at_ms + 50)
    assert not backpack.sense_until(3_200, now_ms=3_250)
    assert backpack.sense_until(3_251, now_ms=3_300)
    messages = [one.message for one in backpack.poll(now_ms=5_000) if isinstance(one, Transmission)]
    (entry,) = (entry for message in messages if isinstance(message, EncounterBatch) for entry in message.entries)
    assert (entry.start_ms, entry.duration_ms, entry.rssi_dbm) == (100, 2000, RssiDbm(round(-152 / 3)))


def test_a_contact_longer_than_an_entry_can_say_is_reported_in_pieces_that_touch() -> None:
    config = BackpackConfig(proximity=ProximityConfig(enter_dbm=-50.0, exit_dbm=-60.0, gap=1150), provisional_ms=10**9, spread_ms=0)
    backpack = Backpack(node=NodeId(1), boot=BootId(1), eui64=1, seed=1, config=config, now_ms=0, sense_neighbours=list)
    last_ms = 4_500_000
    for at_ms in range(0, last_ms + 1, 1000):
        backpack.hear_beacon(NodeId(2), at_ms=at_ms, rssi_dbm=-45.0, now_ms=at_ms)
    backpack.stop_sensing(now_ms=last_ms + 500)
    messages = [one.message for one in backpack.poll(now_ms=last_ms + 5_000) if isinstance(one, Transmission)]
    entries = [entry for message in messages if isinstance(message, EncounterBatch) for entry in message.entries]
    assert [(one.start_ms, one.duration_ms) for one in entries] == [(0, MAX_ENCOUNTER_MS), (MAX_ENCOUNTER_MS, last_ms - MAX_ENCOUNTER_MS)]


def test_a_beacon_period_that_is_set_over_the_air_is_kept_and_announced_and_a_weaker_threshold_hears_more() -> None:
    def n_sent(wanted: Configure | None) -> tuple[int, int]:
        site = Site(boot=9)
        site.run(2.0)
        if wanted is not None:
            for node in sorted(site.base.address):
                site.base.send(site.base.address[node], wanted, now_ns=site.now_ns)
        site.run(12.0)
        beacons = site.swarm.air_counts
        assert beacons is not None
        told = [one for ledger in site.base.ledgers.values() for one in ledger.messages.values()]
        assert all(one.result is ConfigurationResult.DONE for one in told if isinstance(one, ConfigurationReport))
        assert sum(isinstance(one, ConfigurationReport) for one in told) == (0 if wanted is None else 20)
        periods = {one.beacon_period_ms for one in told if isinstance(one, Hello)}
        assert periods == ({500} if wanted is None else {500, wanted.beacon_period_ms or 500})
        return beacons["sent"], site.swarm.reports.n_reports

    plain_sent, plain_reports = n_sent(None)
    slow_sent, _ = n_sent(Configure(token=1, beacon_period_ms=2_000, gap_tolerance_ms=2_300))
    _, more_reports = n_sent(Configure(token=1, rssi_enter_dbm=RssiDbm(-90), rssi_exit_dbm=RssiDbm(-95)))
    assert plain_sent == pytest.approx(20 * 24, rel=0.05)
    assert slow_sent == pytest.approx(20 * (4 + 5), rel=0.1)
    assert more_reports > plain_reports


def test_a_beacon_period_that_hello_cannot_say_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"beacon_period_ms is 70000; wanted 0 to 65535"):
        BackpackConfig(beacon_period_ms=70_000)
