"""Laws of the whole simulated site in memory: nothing is lost on the way, and the same seed gives the same bytes."""

from collections.abc import Callable

import pytest

from firmware_protocol.messages import (
    Action,
    Hello,
    HelloRequest,
    Neighbours,
    Status,
    StimulateReply,
    StimulationResult,
    TimeSyncRequest,
    WireMode,
)
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId
from simulator.config import Ranges
from simulator.errors import ParameterError
from simulator.events import EncounterEnded, Event, ModeChanged
from simulator.motion import MotionParameters
from simulator.radios.radio import RadioConfig
from simulator.swarm import Swarm
from simulator.swarm_config import SwarmConfig
from simulator.world import World
from tests.simulator.arenas import square
from tests.simulator.base_station import BaseStation, a_command

BOOT = BootId(4)


class Site:
    """A swarm, and a base station on the other end of its line; time is moved by hand."""

    def __init__(self, *, biobots: int = 12, seed: int = 1, loss: float = 0.0, speed: float = 1.0, boot: int = BOOT) -> None:
        self.events: list[Event] = []
        self.world = World(
            square(10.0), motion=MotionParameters(speed=speed, mean_leg=3.0), ranges=Ranges(detection=1.0, communication=8.0),
            ids=range(1, biobots + 1), seed=seed,
        )  # fmt: skip
        config = SwarmConfig(seed=seed, boot=BootId(boot), radio=RadioConfig(loss=loss))
        self.swarm = Swarm(self.world, config=config, observe=self.events.extend)
        self.base = BaseStation()
        self.now_ns = 0
        self.sent = bytearray()

    def run_until(self, until_s: float, *, is_cut: bool = False, done: Callable[[], bool] = lambda: False) -> None:
        while self.now_ns < until_s * NS_PER_S and not done():
            self.now_ns += 10 * NS_PER_MS
            self.base.tick(self.now_ns)
            heard = self.base.take_outgoing()
            if not is_cut:
                self.swarm.feed(heard, now_ns=self.now_ns)
            self.swarm.step(self.now_ns)
            told = self.swarm.coordinator.take_bytes()
            self.sent += told
            if not is_cut:
                self.base.feed(told, now_ns=self.now_ns)

    def finish(self, at_s: float, *, within_s: float = 300.0) -> None:
        self.swarm.end_at(round(at_s * NS_PER_S))
        self.run_until(at_s)
        self.run_until(at_s + within_s, done=lambda: self.swarm.has_ended and self.swarm.is_settled)
        assert self.swarm.is_settled

    def heard_entries(self) -> int:
        return sum(len(ledger.entries()) for ledger in self.base.ledgers.values())

    def met(self) -> list[tuple[int, int, float, float]]:
        """All encounters, those that the end of the run cut off included."""
        ended = [(one.id1, one.id2, one.t_start_s, one.t_end_s) for one in self.events if isinstance(one, EncounterEnded)]
        return ended + [(one.id1, one.id2, one.t_s, self.world.now_s) for one in self.world.open_encounters()]


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_both_sides_of_every_encounter_reach_the_base_station_once(loss: float) -> None:
    site = Site(loss=loss, biobots=25)
    site.finish(15.0)
    assert len(site.met()) > 50
    final = [(node, entry.peer) for (node, _), ledger in site.base.ledgers.items() for entry in ledger.entries() if not entry.is_ongoing]
    expected = [(id1, id2) for id1, id2, _, _ in site.met()] + [(id2, id1) for id1, id2, _, _ in site.met()]
    assert sorted(final) == sorted(expected)
    assert site.swarm.reports.n_unacknowledged == 0
    assert site.swarm.reports.n_reports == site.heard_entries()
    assert site.swarm.n_dropped == 0


def test_what_happens_while_the_line_is_cut_is_told_when_it_is_whole_again() -> None:
    site = Site()
    site.run_until(5.0)
    site.run_until(15.0, is_cut=True)
    site.finish(20.0)
    assert sum(not entry.is_ongoing for ledger in site.base.ledgers.values() for entry in ledger.entries()) == 2 * len(site.met())


def test_reported_times_are_the_true_ones_to_the_millisecond() -> None:
    site = Site()
    site.finish(10.0)
    rows = [line.split(",") for line in site.swarm.reports.to_csv().decode().splitlines()[1:]]
    reported = [(int(row[0]), int(row[3]), float(row[4]), float(row[5])) for row in rows if row[6] == "0"]
    for id1, id2, start_s, end_s in site.met():
        for node, peer in ((id1, id2), (id2, id1)):
            near = [one for one in reported if one[:2] == (node, peer) and abs(one[2] - start_s) < 0.0021 and abs(one[3] - end_s) < 0.0021]
            assert len(near) == 1


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    first, second, other = Site(loss=0.2), Site(loss=0.2), Site(loss=0.2, seed=2)
    for site in (first, second, other):
        site.run_until(4.0)
    assert first.sent == second.sent
    assert first.sent != other.sent


def test_a_stop_halts_the_insect_and_the_answer_says_so() -> None:
    site = Site()
    site.run_until(3.0)
    handle = site.base.send(site.base.address[5], a_command(900, Action.STOP), now_ns=site.now_ns)
    site.run_until(4.0)
    place = site.world.position(5)
    site.run_until(8.0)
    assert site.world.position(5) == place
    assert site.world.position(6) != site.world.position(6, at_s=4.0)
    assert [one.status for one in site.base.confirms if one.handle == handle] == [0]
    replies = [(node, one.command, one.result) for node, one in site.base.of_type(StimulateReply) if isinstance(one, StimulateReply)]
    assert replies == [(5, 900, StimulationResult.DONE)]
    assert (5, WireMode.S) in [(node, one.mode) for node, one in site.base.of_type(Status) if isinstance(one, Status)]
    changes = [one for one in site.events if isinstance(one, ModeChanged)]
    assert [(one.id, one.mode, one.cause) for one in changes] == [(5, "S", "command")]
    (executed,) = site.swarm.executed
    assert (executed.id, executed.command, executed.mode, executed.cause) == (5, 900, "S", "command")
    assert executed.t_s == changes[0].t_s


def test_a_hold_that_ends_lets_the_insect_walk_again_by_itself() -> None:
    site = Site()
    site.run_until(3.0)
    site.base.send(site.base.address[5], a_command(1, Action.STOP, hold_ms=2_000), now_ns=site.now_ns)
    site.run_until(7.0)
    changes = [one for one in site.events if isinstance(one, ModeChanged)]
    assert [(one.mode, one.cause) for one in changes] == [("S", "command"), ("CRW", "natural")]
    assert changes[1].t_s - changes[0].t_s == pytest.approx(2.0, abs=0.02)
    assert site.world.position(5) != site.world.position(5, at_s=changes[0].t_s)


def test_the_end_of_a_starts_hold_stops_the_insect_where_the_gateway_is_gone() -> None:
    site = Site()
    site.run_until(3.0)
    site.base.send(site.base.address[5], a_command(1, Action.START, hold_ms=1_000), now_ns=site.now_ns)
    site.run_until(3.5)
    assert [one.mode for one in site.events if isinstance(one, ModeChanged) and one.id == 5][-1:] in ([], ["CRW"])
    site.run_until(7.0)
    (change,) = [one for one in site.events if isinstance(one, ModeChanged) and one.mode == "S" and one.cause == "command"]
    assert change.id == 5
    assert site.world.position(5) == site.world.position(5, at_s=change.t_s)


def test_a_stop_by_broadcast_stops_every_insect_and_each_says_so_in_its_own_time() -> None:
    site = Site()
    site.run_until(3.0)
    site.base.send(0xFFFF, a_command(900, Action.TURN_LEFT), now_ns=site.now_ns)
    site.run_until(4.0)
    assert not site.swarm.executed, "a turn of everybody is nobody's wish"
    site.base.send(0xFFFF, a_command(901, Action.STOP), now_ns=site.now_ns)
    site.run_until(4.2)
    assert {(one.id, one.command, one.mode) for one in site.swarm.executed} == {(node, 901, "S") for node in range(1, 13)}
    site.run_until(6.0)
    replies = [(node, one.command, one.result) for node, one in site.base.of_type(StimulateReply) if isinstance(one, StimulateReply)]
    assert sorted(set(replies)) == [(node, 901, StimulationResult.DONE) for node in range(1, 13)]


def test_an_unknown_address_is_confirmed_as_unknown_and_a_broadcast_reaches_all() -> None:
    site = Site()
    site.run_until(3.0)
    unknown = next(one for one in range(1, 100) if one not in site.base.address.values())
    handle = site.base.send(unknown, HelloRequest(), now_ns=site.now_ns)
    before = len(site.base.of_type(Hello))
    everyone = site.base.send(0xFFFF, HelloRequest(), now_ns=site.now_ns)
    site.run_until(6.0)
    statuses = {one.handle: one.status for one in site.base.confirms}
    assert (statuses[handle], statuses[everyone]) == (3, 0)
    assert len(site.base.of_type(Hello)) - before == 12


def test_neighbour_reports_are_those_within_communication_range() -> None:
    site = Site(speed=1e-6)
    site.run_until(3.0)
    for node in range(1, 13):
        heard = [one for owner, one in site.base.of_type(Neighbours) if owner == node and isinstance(one, Neighbours)]
        assert {neighbour.node for part in heard for neighbour in part.neighbours} == site.world.neighbours(node)


def test_a_time_sync_brackets_the_backpacks_clock() -> None:
    site = Site()
    site.run_until(3.0)
    before_ns = site.now_ns
    for _ in range(3):
        site.base.send(site.base.address[2], TimeSyncRequest(token=6), now_ns=site.now_ns)
        site.run_until(site.now_ns / NS_PER_S + 1)
    assert [reply.token for _, reply in site.base.syncs] == [6, 6, 6]
    first, last = site.base.syncs[0], site.base.syncs[-1]
    assert first[0].sent_ms >= first[1].received_ms
    assert 1_900 < last[1].received_ms - first[1].received_ms < 2_100
    assert site.now_ns - before_ns < 4 * NS_PER_S


def test_a_world_that_lags_catches_up_in_bounded_steps_and_skips_nothing() -> None:
    on_time, late = Site(), Site()
    on_time.run_until(6.0)
    late.run_until(1.0)
    late.now_ns = 5 * NS_PER_S
    late.swarm.step(late.now_ns)
    assert late.swarm.lag_ns(late.now_ns) > 3 * NS_PER_S
    late.run_until(6.0)
    assert late.swarm.lag_ns(late.now_ns) < NS_PER_S
    met = [one for one in late.events if isinstance(one, EncounterEnded)]
    assert met == [one for one in on_time.events if isinstance(one, EncounterEnded)][: len(met)]


def test_after_the_end_the_insects_stand_still_and_the_backpacks_fall_silent() -> None:
    site = Site()
    site.finish(2.0)
    places, n_sent = site.world.positions().tolist(), len(site.base.ledgers[1, BOOT].messages)
    site.run_until(60.0)
    assert site.world.now_s == 2.0
    assert site.world.positions().tolist() == places
    assert len(site.base.ledgers[1, BOOT].messages) == n_sent


def test_more_biobots_than_node_numbers_are_refused() -> None:
    world = World(
        square(10.0), motion=MotionParameters(speed=1.0, mean_leg=3.0), ranges=Ranges(detection=0.01, communication=0.01),
        ids=[70_000], seed=1,
    )  # fmt: skip
    with pytest.raises(ParameterError, match="16 bits"):
        Swarm(world, config=SwarmConfig(seed=1, boot=BOOT), observe=lambda _: None)
