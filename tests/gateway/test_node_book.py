"""Laws of what is known of biobots, and of where earlier starts' instants lie."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.messages import Hello, Neighbour, Neighbours, Status, WireCause, WireMode
from firmware_protocol.units import NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.issuer import RecordIssuer
from gateway.modes import ModeReport, ModeTracker
from gateway.nodes import Node, NodeBook, NodeMemory, cause_of, mode_of


def _heard(book: NodeBook, *, boot: int = 1) -> Node:
    node, _ = book.heard(
        node=NodeId(1),
        boot=BootId(boot),
        radio="r",
        address=ShortAddress(1),
        rssi_dbm=RssiDbm(-50),
        lqi=1,
        sent_ms=Milliseconds(0),
        now_ns=1,
        now_wall_ns=Nanoseconds(1),
    )
    return node


def _a_status(mode: WireMode) -> Status:
    return Status(mode=mode, cause=WireCause.NATURAL, mode_since_ms=Milliseconds(0), battery_mv=3000, buffered=0, dropped=0)


def _a_report(peer: int) -> Neighbours:
    return Neighbours(part=0, n_parts=1, neighbours=(Neighbour(node=NodeId(peer), rssi_dbm=RssiDbm(-40)),))


def test_a_repeated_older_status_does_not_replace_a_newer_one_of_its_boot() -> None:
    book = NodeBook(gateway="g")
    node = _heard(book)
    assert book.take_status(node, _a_status(WireMode.S), number=2)
    assert not book.take_status(node, _a_status(WireMode.CRW), number=1)
    assert node.status == _a_status(WireMode.S)
    assert book.take_status(_heard(book, boot=2), _a_status(WireMode.CRW), number=0)
    assert node.status == _a_status(WireMode.CRW)


def test_a_repeated_older_neighbour_report_does_not_replace_a_newer_one() -> None:
    book = NodeBook(gateway="g")
    node = _heard(book)
    assert book.take_neighbours(node, _a_report(20), number=4, wall_ns=Nanoseconds(1)) is not None
    assert book.take_neighbours(node, _a_report(10), number=3, wall_ns=Nanoseconds(2)) is None
    assert book.adjacency() == {NodeId(1): frozenset({NodeId(20)})}


def test_two_devices_under_one_number_are_told_of_once() -> None:
    book = NodeBook(gateway="g")
    node = _heard(book)
    told = [book.introduce(node, Hello(eui64=eui64, firmware=1, beacon_period_ms=0, capabilities=1)) for eui64 in (7, 7, 9, 7, 9, 11)]
    assert told == [None, None, 7, None, None, 9]


def test_a_set_wall_clock_between_two_starts_moves_no_restored_mode() -> None:
    def an_issuer(anchor_ns: int, earlier: tuple[Nanoseconds, ...] = ()) -> RecordIssuer:
        return RecordIssuer(gateway="g", journal="j", boot=BootId(1), wall_anchor_ns=Nanoseconds(anchor_ns), earlier_anchors=earlier)

    report = ModeReport(
        node=NodeId(1),
        boot=BootId(1),
        since_ms=Milliseconds(0),
        t_start_ns=Nanoseconds(10**12),
        error_ns=Nanoseconds(0),
        mode=mode_of(WireMode.S),
        cause=cause_of(WireCause.COMMAND),
        is_from_reply=False,
    )
    records = ModeTracker(issuer=an_issuer(5)).observe(report)
    after = ModeTracker(issuer=an_issuer(3600 * 10**9, earlier=(Nanoseconds(5),)))
    after.restore(records)
    assert after.observe(report) == [], "it is the spell that is known"


_HEARD = st.tuples(st.integers(1, 4), st.sampled_from(["r", "s"]), st.integers(1, 3), st.integers(0, 3), st.integers(0, 50))
"""Biobot, radio, address, boot and tick: few of each, so that they meet."""


def _hear(book: NodeBook, node: int, radio: str, address: int, boot: int, sent_ms: int, *, at_s: float = 1) -> Node:
    heard, _ = book.heard(
        node=NodeId(node),
        boot=BootId(boot),
        radio=radio,
        address=ShortAddress(address),
        rssi_dbm=RssiDbm(-50),
        lqi=1,
        sent_ms=Milliseconds(sent_ms),
        now_ns=int(at_s * NS_PER_S),
        now_wall_ns=Nanoseconds(1),
    )
    return heard


def _memory(node: int, *, address: int, boot: int = 1) -> NodeMemory:
    return NodeMemory(
        node=NodeId(node),
        boot=BootId(boot),
        radio="r",
        address=ShortAddress(address),
        eui64=node,
        firmware=1,
        beacon_period_ms=0,
        capabilities=1,
        is_introduced=True,
    )


@given(messages=st.lists(_HEARD, max_size=40))
def test_no_two_biobots_are_ever_reached_at_one_address_of_one_radio(messages: list[tuple[int, str, int, int, int]]) -> None:
    book = NodeBook(gateway="g")
    for message in messages:
        _hear(book, *message)
        main = [(node.radio, node.address) for node in book.all() if node.address is not None]
        assert len(main) == len(set(main))
        owners: dict[tuple[str, int], NodeId] = {}
        for node in book.all():
            for place in book.places_of(node.node, now_ns=2 * NS_PER_S):
                assert owners.setdefault((place.radio, place.address), node.node) == node.node
            if node.address is not None:
                assert owners[node.radio, node.address] == node.node


@given(messages=st.permutations([(boot, tick) for boot in (1, 2, 3) for tick in (5, 6, 7)]))
def test_the_newest_message_says_where_a_biobot_is_in_whatever_order_they_come(messages: list[tuple[int, int]]) -> None:
    book = NodeBook(gateway="g")
    for boot, tick in messages:
        _hear(book, 1, "old" if (boot, tick) != (3, 7) else "new", 10 * boot + tick, boot, tick)
    node = book.find(NodeId(1))
    assert node is not None
    assert (node.radio, node.address, node.boot) == ("new", 37, 3)


def test_an_address_that_another_biobot_takes_is_lost_until_the_first_is_heard_again() -> None:
    book = NodeBook(gateway="g")
    first = _hear(book, 1, "r", 7, 1, 1)
    _hear(book, 2, "r", 7, 1, 1)
    assert first.address is None
    assert first.memory().address is None
    _hear(book, 1, "r", 8, 1, 2)
    assert first.address == 8


def test_an_address_that_two_remembered_biobots_claim_and_one_of_many_are_believed_of_none() -> None:
    book = NodeBook(gateway="g")
    book.restore([_memory(1, address=7), _memory(2, address=7), _memory(3, address=8), _memory(4, address=0xFFFF)], heard_ns={}, now_ns=0)
    assert [node.address for node in book.all()] == [None, None, 8, None]


def test_a_life_that_is_over_never_comes_back_however_long_the_present_one_is_silent() -> None:
    book = NodeBook(gateway="g")
    _hear(book, 1, "r", 7, 3, 1)
    _hear(book, 1, "s", 8, 4, 1)
    node = _hear(book, 1, "r", 7, 3, 99, at_s=100_000)
    assert (node.boot, node.radio, node.address, node.last_heard_ns) == (4, "s", 8, NS_PER_S)
    restored = NodeBook(gateway="g")
    restored.restore([_memory(1, address=7, boot=4)], heard_ns={}, now_ns=0)
    restored.restore_earlier_boots([(NodeId(1), BootId(boot)) for boot in (3, 4)])
    assert _hear(restored, 1, "r", 9, 3, 99, at_s=100_000).boot == 4


def test_a_count_of_starts_that_was_set_back_is_believed_when_the_larger_one_is_silent_and_nobody_is_locked_out() -> None:
    book = NodeBook(gateway="g")
    _hear(book, 1, "r", 7, 300, 1)
    assert _hear(book, 1, "r", 8, 1, 1, at_s=2).boot == 300
    assert _hear(book, 1, "r", 8, 1, 2, at_s=62).boot == 1
    assert _hear(book, 1, "r", 7, 300, 2, at_s=63).boot == 300, "from a queue: it cannot be told from a later life"
    assert _hear(book, 1, "r", 8, 1, 3, at_s=64).boot == 300
    assert _hear(book, 1, "r", 8, 1, 4, at_s=124).boot == 1


def test_a_biobot_that_went_over_is_at_both_radios_for_some_minutes_and_no_longer() -> None:
    book = NodeBook(gateway="g")
    _hear(book, 1, "r", 7, 1, 1, at_s=1)
    _hear(book, 1, "s", 8, 1, 2, at_s=2)
    assert [(place.radio, place.address) for place in book.places_of(NodeId(1), now_ns=300 * NS_PER_S)] == [("s", 8), ("r", 7)]
    assert [place.radio for place in book.places_of(NodeId(1), now_ns=301 * NS_PER_S + 1)] == ["s"]
    _hear(book, 2, "r", 7, 1, 1, at_s=3)
    assert [place.radio for place in book.places_of(NodeId(1), now_ns=4 * NS_PER_S)] == ["s"], "its former address is another's"
