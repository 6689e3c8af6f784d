"""Laws of the proximity logger, and of putting both sides' logs together."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.errors import ParameterError
from simulator.radios.proximity import Closed, Opened, ProximityConfig, ProximityLogger, common_time, unite

CONFIG = ProximityConfig(enter_dbm=-50.0, exit_dbm=-55.0, gap=1150)
PEERS = (1, 2)
beacons = st.lists(st.tuples(st.integers(0, 2500), st.integers(-65, -40), st.sampled_from(PEERS)), max_size=60)


def hear(config: ProximityConfig, heard: list[tuple[int, int, int]], *, polls: bool = False) -> list[Opened | Closed]:
    """Give beacons (time since the last one, strength, peer) to a logger, and close it."""
    logger, now = ProximityLogger(config=config), 0
    told: list[Opened | Closed] = []
    for wait, rssi_dbm, peer in heard:
        if polls:
            told += logger.poll(now=now + wait // 2)
        now += wait
        told += logger.hear(peer, at=now, rssi_dbm=rssi_dbm)
    return told + logger.close_all()


def slow_log(config: ProximityConfig, heard: list[tuple[int, int, int]], *, peer: int) -> list[tuple[int, int]]:
    """The rule for one beacon to open, literally: cut what is kept at gaps, and begin each piece at its first strong beacon."""
    now, kept = 0, []
    for wait, rssi_dbm, who in heard:
        now += wait
        if who == peer and rssi_dbm >= config.exit_dbm:
            kept.append((now, rssi_dbm))
    pieces: list[list[tuple[int, int]]] = []
    for one in kept:
        if pieces and one[0] - pieces[-1][-1][0] <= config.gap:
            pieces[-1].append(one)
        else:
            pieces.append([one])
    spells = []
    for piece in pieces:
        strong = [t for t, rssi_dbm in piece if rssi_dbm >= config.enter_dbm]
        if strong:
            spells.append((strong[0], piece[-1][0]))
    return spells


@given(heard=beacons, polls=st.booleans())
def test_the_logger_finds_what_the_rule_says_however_often_it_is_polled(heard: list[tuple[int, int, int]], *, polls: bool) -> None:
    closed = [one for one in hear(CONFIG, heard, polls=polls) if isinstance(one, Closed)]
    for peer in PEERS:
        assert [(one.start, one.end) for one in closed if one.peer == peer] == slow_log(CONFIG, heard, peer=peer)


@given(heard=beacons, min_beacons=st.integers(1, 4))
def test_intervals_never_overlap_and_begin_and_end_with_a_beacon(heard: list[tuple[int, int, int]], min_beacons: int) -> None:
    config = ProximityConfig(enter_dbm=-50.0, exit_dbm=-55.0, gap=1150, min_beacons=min_beacons)
    times, now = {peer: [] for peer in PEERS}, 0  # type: dict[int, list[int]], int
    for wait, _, peer in heard:
        now += wait
        times[peer].append(now)
    last_end = dict.fromkeys(PEERS, -1)
    for one in hear(config, heard):
        if isinstance(one, Closed):
            assert one.start in times[one.peer]
            assert one.end in times[one.peer]
            assert last_end[one.peer] < one.start <= one.end
            assert one.n_beacons >= min_beacons
            assert one.mean_rssi_dbm >= config.exit_dbm
            last_end[one.peer] = one.end


@given(heard=beacons)
def test_what_is_opened_is_closed_once_and_began_where_it_was_said_to(heard: list[tuple[int, int, int]]) -> None:
    told = hear(CONFIG, heard)
    opened = [(one.peer, one.start) for one in told if isinstance(one, Opened)]
    assert sorted(opened) == sorted((one.peer, one.start) for one in told if isinstance(one, Closed))


@given(heard=st.lists(st.tuples(st.integers(1, 2000), st.integers(-65, -51), st.just(1)), max_size=40))
def test_beacons_below_enter_never_open_an_encounter(heard: list[tuple[int, int, int]]) -> None:
    assert hear(CONFIG, heard) == []


def test_beacons_between_the_thresholds_keep_an_encounter_and_weaker_ones_do_not() -> None:
    kept = hear(CONFIG, [(0, -50, 1), (1000, -55, 1), (1000, -55, 1), (1000, -56, 1), (1000, -50, 1)])
    assert [(one.start, one.end) for one in kept if isinstance(one, Closed)] == [(0, 2000), (4000, 4000)]


def test_the_gap_tolerated_is_exact() -> None:
    config = ProximityConfig(enter_dbm=-50.0, exit_dbm=-55.0, gap=1150)
    assert [one.end for one in hear(config, [(0, -45, 1), (1150, -45, 1)]) if isinstance(one, Closed)] == [1150]
    assert [one.end for one in hear(config, [(0, -45, 1), (1151, -45, 1)]) if isinstance(one, Closed)] == [0, 1151]
    logger = ProximityLogger(config=config)
    logger.hear(1, at=0, rssi_dbm=-45.0)
    assert logger.next_due() == 1151
    assert logger.poll(now=1150) == []
    assert [one.end for one in logger.poll(now=1151)] == [0]
    assert logger.next_due() is None


def test_an_encounter_of_many_beacons_counts_from_the_first() -> None:
    config = ProximityConfig(enter_dbm=-50.0, exit_dbm=-55.0, gap=1150, min_beacons=3)
    told = hear(config, [(0, -45, 1), (1000, -45, 1), (1000, -48, 1), (1000, -54, 1)])
    assert told == [
        Opened(peer=1, start=0, rssi_dbm=-48),
        Closed(peer=1, start=0, end=3000, mean_rssi_dbm=-48.0, n_beacons=4),
    ]
    assert hear(config, [(0, -45, 1), (1000, -45, 1), (1000, -53, 1), (1000, -45, 1)]) == []


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"exit_dbm": -45.0}, r"exit_dbm is -45.0; wanted at most enter_dbm, -50.0"),
        ({"gap": 0}, r"gap is 0; wanted at least one unit"),
        ({"min_beacons": 0}, r"min_beacons is 0; wanted at least 1"),
    ],
)
def test_a_logger_that_cannot_work_is_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        ProximityConfig(**({"enter_dbm": -50.0, "exit_dbm": -55.0, "gap": 1150} | values))  # type: ignore[arg-type]  # by name


spells = st.lists(st.tuples(st.integers(0, 500), st.integers(0, 50)).map(lambda one: (one[0], one[0] + one[1])), max_size=20)


@given(spells=spells, bridge=st.integers(0, 60))
def test_united_intervals_cover_the_given_ones_and_lie_further_apart_than_the_bridge(spells: list[tuple[int, int]], bridge: int) -> None:
    united = unite(spells, bridge=bridge)
    assert all(any(a <= start and end <= b for a, b in united) for start, end in spells)
    assert all(later[0] - earlier[1] > bridge for earlier, later in itertools.pairwise(united))
    assert unite(reversed(spells), bridge=bridge) == united


@given(one=spells, other=spells)
def test_common_time_is_what_counting_every_unit_gives(one: list[tuple[int, int]], other: list[tuple[int, int]]) -> None:
    first, second = unite(one, bridge=0), unite(other, bridge=0)
    units = [{t for a, b in side for t in range(a, b)} for side in (first, second)]
    assert common_time(first, second) == len(units[0] & units[1])
