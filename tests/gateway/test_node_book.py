"""Laws of what is known of biobots, and of where earlier starts' instants lie."""

from firmware_protocol.messages import Hello, Neighbour, Neighbours, Status, WireCause, WireMode
from firmware_protocol.units import BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.issuer import RecordIssuer
from gateway.modes import ModeReport, ModeTracker
from gateway.nodes import Node, NodeBook, cause_of, mode_of


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
