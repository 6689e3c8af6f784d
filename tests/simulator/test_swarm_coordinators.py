"""Laws of a swarm with several coordinators, of coverage, and of backpacks that fall silent; all in memory."""

from collections.abc import Callable

from firmware_protocol.envelope import RadioStatus
from firmware_protocol.messages import Action, Hello, HelloRequest, Neighbours, StimulateReply, StimulationResult
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId
from simulator.events import BackpackSilenced, Event, ModeChanged, SilenceReason
from simulator.radios.coverage import CoverageConfig
from simulator.radios.radio import RadioConfig
from simulator.response import ResponseConfig
from simulator.swarm import Swarm
from simulator.swarm_config import SwarmConfig
from tests.simulator.base_station import BaseStation, a_command
from tests.simulator.fake_habitat import ScriptedWorld

BOOT = BootId(4)
LEFT, RIGHT = (0.0, 5.0), (10.0, 5.0)
SURE = ResponseConfig(probability=1.0, probability_habituated=1.0)


class Site:
    """A swarm with a base station at each coordinator's line; time is moved by hand."""

    def __init__(
        self, world: ScriptedWorld, *, radius: float | None = None, loss: float = 0.0, n_lines: int = 2, keeps_history: bool = True
    ) -> None:
        self.world = world
        self.events: list[Event] = []
        coverage = CoverageConfig(places=(LEFT, RIGHT)[:n_lines], radius=radius)
        config = SwarmConfig(seed=1, boot=BOOT, radio=RadioConfig(loss=loss), coverage=coverage, response=SURE, keeps_history=keeps_history)
        self.swarm = Swarm(world, config=config, observe=self.events.extend)
        self.bases = [BaseStation() for _ in range(n_lines)]
        self.now_ns = 0
        self.sent = [bytearray() for _ in range(n_lines)]

    def run_until(self, until_s: float, *, done: Callable[[], bool] = lambda: False) -> None:
        while self.now_ns < until_s * NS_PER_S and not done():
            self.now_ns += 10 * NS_PER_MS
            for index, base in enumerate(self.bases):
                base.tick(self.now_ns)
                self.swarm.feed(base.take_outgoing(), now_ns=self.now_ns, coordinator=index)
            self.swarm.step(self.now_ns)
            for base, coordinator, sent in zip(self.bases, self.swarm.coordinators, self.sent, strict=True):
                told = coordinator.take_bytes()
                sent.extend(told)
                base.feed(told, now_ns=self.now_ns)

    def finish(self, *, within_s: float = 120.0) -> None:
        at_s = self.now_ns / NS_PER_S
        self.swarm.end_at(self.now_ns)
        self.run_until(at_s + within_s, done=lambda: self.swarm.has_ended and self.swarm.is_settled)
        assert self.swarm.is_settled

    def heard(self, base: int) -> set[tuple[int, int]]:
        return {
            (node, entry.peer)
            for (node, _), ledger in self.bases[base].ledgers.items()
            for entry in ledger.entries()
            if not entry.is_ongoing
        }

    def hellos(self, base: int) -> list[int]:
        return [node for node, _ in self.bases[base].of_type(Hello)]


def test_each_backpack_reports_to_the_nearer_coordinator_and_both_say_who_they_are() -> None:
    world = ScriptedWorld({1: (1.0, 5.0), 2: (1.5, 5.0), 3: (9.0, 5.0), 4: (8.5, 5.0)})
    world.meet(1, 2, start_s=1.0, end_s=2.0)
    world.meet(3, 4, start_s=1.0, end_s=2.0)
    site = Site(world)
    site.run_until(4.0)
    site.finish()
    assert site.heard(0) == {(1, 2), (2, 1)}
    assert site.heard(1) == {(3, 4), (4, 3)}
    names = [base.hellos[0] for base in site.bases]
    assert names[0].eui64 != names[1].eui64
    assert names[0].pan_id != names[1].pan_id
    assert site.swarm.n_rejoined == 0


def test_a_backpack_that_walks_over_says_hello_there_under_a_new_address_and_what_was_not_confirmed_comes_with_it() -> None:
    world = ScriptedWorld({1: (1.0, 5.0), 2: (1.5, 5.0)})
    site = Site(world)
    site.run_until(3.0)
    old_address = site.bases[0].address[1]
    site.bases[0].is_deaf_to_radio = True  # what is said now reaches the dongle and nobody's disk
    world.meet(1, 2, start_s=3.0, end_s=3.5)
    site.run_until(6.0)
    assert site.heard(0) == set()
    world.places[1] = (9.5, 5.0)
    site.run_until(9.0)
    assert 1 in site.hellos(1)
    assert site.swarm.n_rejoined == 1
    assert site.heard(1) == {(1, 2)}
    assert site.bases[1].address[1] != old_address
    site.bases[0].is_deaf_to_radio = False
    site.finish()
    assert site.heard(0) | site.heard(1) == {(1, 2), (2, 1)}


def test_the_coordinator_left_behind_gets_no_acknowledgement_from_the_old_address() -> None:
    world = ScriptedWorld({1: (1.0, 5.0), 2: (1.5, 5.0)})
    site = Site(world)
    site.run_until(3.0)
    world.places[1] = (9.5, 5.0)
    site.run_until(6.0)
    handle = site.bases[0].send(site.bases[0].address[1], HelloRequest(), now_ns=site.now_ns)
    stranger = next(one for one in range(1, 100) if one not in site.bases[0].address.values())
    unknown = site.bases[0].send(stranger, HelloRequest(), now_ns=site.now_ns)
    site.run_until(7.0)
    statuses = {one.handle: one.status for one in site.bases[0].confirms}
    assert (statuses[handle], statuses[unknown]) == (RadioStatus.NO_ACK, RadioStatus.UNKNOWN_ADDRESS)
    site.bases[1].send(site.bases[1].address[1], a_command(5, Action.STOP), now_ns=site.now_ns)
    site.run_until(8.0)
    replies = [(node, one.result) for node, one in site.bases[1].of_type(StimulateReply) if isinstance(one, StimulateReply)]
    assert replies == [(1, StimulationResult.DONE)]


def test_backpacks_that_go_to_and_fro_on_a_bad_radio_lose_nothing() -> None:
    world = ScriptedWorld(dict.fromkeys(range(1, 5), (1.0, 5.0)))
    for number in range(30):
        world.meet(1 + number % 3, 4, start_s=1.0 + number, end_s=1.8 + number)
    site = Site(world, loss=0.2)
    for step in range(1, 17):
        site.run_until(2.0 * step)
        for one in range(1, 5):
            world.places[one] = RIGHT if (step + one) % 3 else LEFT
    site.finish()
    assert site.swarm.n_rejoined > 20
    ledgers = [(node, ledger) for base in site.bases for (node, _), ledger in base.ledgers.items()]
    told = {(node, entry.peer, entry.start_ms) for node, ledger in ledgers for entry in ledger.entries() if not entry.is_ongoing}
    assert len(told) == 60
    assert site.swarm.reports.n_unacknowledged == 0


def test_out_of_all_coverage_a_backpack_keeps_what_it_has_and_tells_it_when_it_is_back() -> None:
    world = ScriptedWorld({1: (1.0, 5.0), 2: (1.5, 5.0)})
    site = Site(world, radius=3.0)
    site.run_until(3.0)
    world.places.update({1: (5.0, 5.0), 2: (5.2, 5.0)})
    world.meet(1, 2, start_s=4.0, end_s=5.0)
    site.run_until(40.0)
    assert site.swarm.n_uncovered == 2
    assert site.heard(0) == site.heard(1) == set()
    assert site.swarm.n_buffered == 2
    handle = site.bases[0].send(site.bases[0].address[1], HelloRequest(), now_ns=site.now_ns)
    site.run_until(41.0)
    assert [one.status for one in site.bases[0].confirms if one.handle == handle] == [RadioStatus.NO_ACK]
    world.places[1] = (9.0, 5.0)
    site.run_until(44.0)
    assert site.heard(1) == {(1, 2)}
    assert 1 in site.hellos(1)
    assert site.swarm.n_uncovered == 1


def test_a_silenced_backpack_says_and_obeys_nothing_more_and_what_it_had_is_counted_as_lost() -> None:
    world = ScriptedWorld({1: (1.0, 5.0), 2: (1.5, 5.0), 3: (2.0, 5.0)})
    world.meet(1, 2, start_s=3.0, end_s=5.0)
    world.script.append((5.0, BackpackSilenced(t_s=5.0, id=1, reason=SilenceReason.BATTERY)))
    site = Site(world, n_lines=1)
    site.run_until(5.2)
    n_sent = len(site.bases[0].ledgers[1, BOOT].messages)
    handle = site.bases[0].send(site.bases[0].address[1], a_command(9, Action.STOP), now_ns=site.now_ns)
    site.run_until(20.0)
    assert len(site.bases[0].ledgers[1, BOOT].messages) == n_sent
    assert [one.status for one in site.bases[0].confirms if one.handle == handle] == [RadioStatus.NO_ACK]
    assert [one for one in site.events if isinstance(one, ModeChanged)] == []
    assert site.heard(0) == {(2, 1)}
    assert site.swarm.n_lost == 1
    assert site.swarm.silenced == {1: "battery"}
    last = [one for node, one in site.bases[0].of_type(Neighbours) if node == 2][-1]
    assert isinstance(last, Neighbours)
    assert [one.node for one in last.neighbours] == [3]
    site.finish()


def test_a_turn_asked_for_over_the_air_turns_the_insect_and_the_answer_says_only_that_the_train_was_delivered() -> None:
    world = ScriptedWorld({1: (1.0, 5.0), 2: (1.5, 5.0)})
    site = Site(world, n_lines=1)
    site.run_until(3.0)
    site.bases[0].send(site.bases[0].address[1], a_command(5, Action.TURN_LEFT), now_ns=site.now_ns)
    site.run_until(5.0)
    ((at_s, verb, one, angle_rad),) = world.done
    assert (verb, one) == ("turn", 1)
    assert angle_rad > 0
    (noted,) = site.swarm.executed
    assert 0.04 < at_s - noted.t_s < 0.25
    assert noted.responded
    replies = [(node, reply.result) for node, reply in site.bases[0].of_type(StimulateReply) if isinstance(reply, StimulateReply)]
    assert replies == [(1, StimulationResult.DONE)]


def test_the_same_seed_gives_the_same_bytes_on_every_line() -> None:
    sites = []
    for _ in range(2):
        world = ScriptedWorld({one: (float(one), 5.0) for one in range(1, 9)})
        world.meet(1, 2, start_s=1.0, end_s=2.0)
        site = Site(world, loss=0.3)
        site.run_until(3.0)
        world.places[1] = RIGHT
        site.run_until(6.0)
        sites.append(site)
    assert sites[0].sent == sites[1].sent
    assert all(sites[0].sent)


def test_at_the_end_nobody_waits_for_a_backpack_that_stands_out_of_coverage() -> None:
    world = ScriptedWorld({1: (1.0, 5.0), 2: (1.5, 5.0), 3: (5.0, 5.0), 4: (5.1, 5.0)})
    site = Site(world, radius=3.0)
    world.meet(1, 2, start_s=1.0, end_s=2.0)
    world.meet(3, 4, start_s=1.0, end_s=2.0)
    site.run_until(4.0)
    site.finish(within_s=10.0)
    assert site.heard(0) == {(1, 2), (2, 1)}
    assert (site.swarm.n_buffered, site.swarm.n_uncovered) == (2, 2)


def test_a_train_just_before_the_end_moves_nobody_after_it() -> None:
    world = ScriptedWorld({1: (1.0, 5.0), 2: (1.5, 5.0)})
    site = Site(world, n_lines=1)
    site.run_until(3.0)
    site.bases[0].send(site.bases[0].address[1], a_command(5, Action.TURN_LEFT), now_ns=site.now_ns)
    site.run_until(5.0, done=lambda: bool(site.swarm.executed))
    site.finish()
    assert world.done == []
    assert [one.responded for one in site.swarm.executed] == [False]


def test_without_a_history_a_long_run_holds_no_more_than_a_short_one() -> None:
    world = ScriptedWorld(dict.fromkeys(range(1, 5), (1.0, 5.0)))
    for number in range(600):
        world.meet(1 + number % 3, 4, start_s=1.0 + 0.2 * number, end_s=1.1 + 0.2 * number)
    site = Site(world, n_lines=1, keeps_history=False)
    sizes = []
    for until_s in (30.0, 120.0, 140.0):
        site.run_until(until_s)
        swarm = site.swarm
        sizes.append((len(swarm._dues), len(swarm.reports._rows) + len(swarm.reports._acknowledged), len(swarm.reports._pending)))
    assert swarm.reports.n_reports == 1_200
    assert swarm.reports.n_unacknowledged == 0
    assert sizes[1][0] < 2 * sizes[0][0] + 50
    assert sizes[2][1:] == (0, 0)
