"""The Z-Stack host against the virtual chip, beyond what every dialect's laws say: payloads, statuses, silence."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.dialects.interface import (
    HostLost,
    LostWhy,
    NodeSeen,
    SendSettled,
)
from firmware_protocol.dialects.znp_opening import ZnpHostConfig
from firmware_protocol.dialects.znp_statuses import radio_status_of
from firmware_protocol.dialects.znp_window import MAX_QUEUE, SendWindow
from firmware_protocol.envelope import RadioReceived, RadioStatus
from firmware_protocol.errors import LinkFullError
from firmware_protocol.framing.znp import ZnpDecoder
from firmware_protocol.units import BROADCAST, RSSI_UNKNOWN, RssiDbm
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import Message, decode_command
from firmware_protocol.znp.numbers import BIOBOT_CLUSTER, BIOBOT_ENDPOINT, Command, DeviceState, ZnpStatus
from simulator.dongles.znp import ZnpDongleConfig
from tests.simulator.znp_bench import CC2531, CC2531_WITH_LOADER, CC2652, EUI64, MS, NODE, S, a_bench, frame, heard, opened, settled


def test_what_is_heard_has_its_sender_and_quality_and_no_strength() -> None:
    bench = opened()
    received = RadioReceived(source=NODE, rssi_dbm=RssiDbm(-60), lqi=90, payload=b"abc")
    assert bench.dongle.take_from_radio(received, eui64=EUI64, now_ns=bench.now_ns)
    bench.run(20)
    assert heard(bench)[0].received == RadioReceived(source=NODE, rssi_dbm=RssiDbm(RSSI_UNKNOWN), lqi=90, payload=b"abc")


def test_messages_for_others_are_counted_and_not_heard() -> None:
    bench = opened()
    ours = {"group": 0, "source": NODE, "source_endpoint": 1, "was_broadcast": 0, "lqi": 1, "security": 0, "timestamp": 0, "sequence": 0}
    for endpoint, cluster in ((1, BIOBOT_CLUSTER), (BIOBOT_ENDPOINT, 6)):
        message = znp.IncomingMessage(**ours, destination_endpoint=endpoint, cluster=cluster, data=b"x")
        bench.events += bench.host.feed(frame(message), now_ns=bench.now_ns)
    assert not heard(bench)
    assert bench.host.faults["znp.foreign_message"] == 2


@pytest.mark.parametrize("status", list(RadioStatus))
def test_every_fate_that_the_radio_knows_comes_back_as_it_was(status: RadioStatus) -> None:
    bench = opened()
    ticket = bench.host.send(destination=NODE, payload=b"abc", now_ns=bench.now_ns)
    bench.run(50)
    assert [(one.destination, one.payload) for one in bench.answer(status)] == [(NODE, b"abc")]
    bench.run(50)
    assert settled(bench) == {ticket: status}


def test_statuses_that_nobody_has_named_are_other() -> None:
    known = {status: radio_status_of(status) for status in range(256) if radio_status_of(status) is not RadioStatus.OTHER}
    assert known[ZnpStatus.SUCCESS] is RadioStatus.SENT
    assert [status for status, outcome in known.items() if outcome is RadioStatus.SENT] == [0]
    assert known[ZnpStatus.MAC_TRANSACTION_EXPIRED] is known[ZnpStatus.APS_NO_ACK] is RadioStatus.NO_ACK
    assert [status for status, outcome in known.items() if outcome is RadioStatus.QUEUE_FULL] == [0x10, 0x11, 0x13, 0x1A, 0xB2, 0xC7, 0xF1]
    assert set(known) <= {*ZnpStatus}


def test_two_urgent_payloads_do_not_wait_for_the_answer_to_a_request() -> None:
    bench = opened()
    bench.host.take_frames()
    bench.host.send(destination=NODE, payload=b"first", now_ns=bench.now_ns)
    (first,) = bench.host.take_frames()
    bench.host.send(destination=NODE, payload=b"second", now_ns=bench.now_ns)
    assert bench.host.take_frames() == []
    for number in range(4):
        bench.host.send(destination=NODE, payload=b"STOP %d" % number, now_ns=bench.now_ns, is_urgent=True)
    on_top = bench.host.take_frames()
    assert [b"STOP %d" % number in frame for number, frame in enumerate(on_top)] == [True, True]
    for written in (first, *on_top):
        bench.dongle.feed(written, now_ns=bench.now_ns)
    bench.run(300)
    assert [request.payload for request in bench.answer()] == [b"first", *(b"STOP %d" % number for number in range(4))]
    bench.run(100)
    assert [request.payload for request in bench.answer()] == [b"second"]
    bench.run(100)
    assert list(settled(bench).values()) == [RadioStatus.SENT] * 6


def test_a_broadcast_is_written_on_top_of_two_urgent_payloads() -> None:
    bench = opened()
    bench.host.take_frames()
    bench.host.send(destination=NODE, payload=b"first", now_ns=bench.now_ns)
    written = bench.host.take_frames()
    for number in range(3):
        bench.host.send(destination=NODE, payload=b"STOP %d" % number, now_ns=bench.now_ns, is_urgent=True)
    written += bench.host.take_frames()
    bench.host.send(destination=BROADCAST, payload=b"ALL", now_ns=bench.now_ns, is_urgent=True)
    written += bench.host.take_frames()
    assert len(written) == 4
    assert b"ALL" in written[-1]
    for one in written:
        bench.dongle.feed(one, now_ns=bench.now_ns)
    bench.run(300)
    assert {request.payload for request in bench.answer()} == {b"first", b"STOP 0", b"STOP 1", b"STOP 2", b"ALL"}
    bench.run(100)
    assert list(settled(bench).values()) == [RadioStatus.SENT] * 5


def test_a_chip_without_room_is_left_in_peace_for_a_while() -> None:
    """16 urgent payloads fill the radio's queue; the 17th is refused, and the next one waits for 100 ms."""
    bench = opened()
    tickets = [bench.host.send(destination=NODE, payload=b"%d" % i, now_ns=bench.now_ns, is_urgent=True) for i in range(18)]
    bench.run(250, step_ms=2)
    # Each waited for its answer beside others: had one of the answers been lost, this could be another's.
    assert settled(bench) == {tickets[16]: RadioStatus.OTHER} | {tickets[17]: RadioStatus.OTHER}
    times = [one for one in bench.asked if isinstance(one, znp.DataRequest)]
    assert len(times) == 18
    bench.answer()
    bench.run(50)
    assert settled(bench) == dict.fromkeys(tickets[:16], RadioStatus.SENT) | dict.fromkeys(tickets[16:], RadioStatus.OTHER)


def test_a_transaction_number_in_use_is_given_to_no_other_payload() -> None:
    """A payload whose route is looked for stays open while numbers go round."""
    bench = opened()
    slow = bench.host.send(destination=NODE, payload=b"slow", now_ns=bench.now_ns)
    bench.run(50)
    (open_one,) = bench.dongle.requests
    bench.dongle.requests.clear()
    tickets = []
    for number in range(300):
        tickets.append(bench.host.send(destination=NODE, payload=b"%d" % number, now_ns=bench.now_ns))
        bench.run(4, step_ms=2)
        bench.answer()
        bench.run(4, step_ms=2)
    assert settled(bench) == dict.fromkeys(tickets, RadioStatus.SENT)
    bench.dongle.confirm(open_one.handle, RadioStatus.NO_ACK, now_ns=bench.now_ns)
    bench.run(20)
    assert settled(bench)[slow] == RadioStatus.NO_ACK


def test_a_confirm_from_before_a_new_opening_settles_no_other_payload() -> None:
    bench = opened()
    bench.host.send(destination=NODE, payload=b"old", now_ns=bench.now_ns)
    bench.run(50)
    old = bench.dongle.requests.popleft()
    bench.open()
    bench.run_until_open()
    tickets = []
    for number in range(256):
        tickets.append(bench.host.send(destination=NODE, payload=b"%d" % number, now_ns=bench.now_ns))
        bench.run(4, step_ms=2)
        if number < 255:  # the last one is still open, under the old one's number if that were free
            bench.answer()
            bench.run(4, step_ms=2)
    bench.dongle.confirm(old.handle, RadioStatus.NO_ACK, now_ns=bench.now_ns)
    bench.run(20)
    assert tickets[-1] not in settled(bench)
    assert settled(bench) == dict.fromkeys(tickets[:-1], RadioStatus.SENT)


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 300)), max_size=600))
def test_transactions_under_way_are_all_different_and_none_is_held_for_ever(steps: list[tuple[int, int]]) -> None:
    """Whatever is sent, settled, forgotten and dropped; where all 256 numbers are in use, nothing is written."""
    window = SendWindow(next_transaction=200)
    now_ns = 0
    open_ones: dict[int, tuple[int, int]] = {}
    for kind, which in steps:
        if kind == 0:
            now_ns += which * 10 * MS
        elif kind == 1 and open_ones:
            window.forget(open_ones[list(open_ones)[which % len(open_ones)]][0])
        elif kind == 2 and open_ones:
            transaction = list(open_ones)[which % len(open_ones)]
            assert window.settle(transaction) in {open_ones.pop(transaction)[0], None}
        else:
            for _ in range(which // 10):
                window.add(destination=NODE, payload=b"", is_urgent=True)
            while (taken := window.take(now_ns)) is not None:
                transaction, one = taken
                before = open_ones.pop(transaction, None)
                assert before is None or before[1] + 12 * S <= now_ns
                open_ones[transaction] = (one.ticket, now_ns)
    for ticket, _ in open_ones.values():
        window.forget(ticket)
    window.add(destination=NODE, payload=b"", is_urgent=True)
    assert window.free_at_ns() is not None
    assert window.take(now_ns + 13 * S) is not None


def test_few_payloads_are_under_way_at_a_time_and_one_that_is_forgotten_makes_room() -> None:
    bench = opened()
    tickets = [bench.host.send(destination=NODE, payload=b"%d" % i, now_ns=bench.now_ns) for i in range(10)]
    bench.run(500)
    assert len(bench.dongle.requests) == 4
    bench.host.forget(tickets[0])
    bench.host.forget(tickets[9])
    bench.run(50)
    assert len(bench.dongle.requests) == 5
    for _ in range(5):
        bench.answer()
        bench.run(100)
    assert settled(bench) == dict.fromkeys(tickets[1:9], RadioStatus.SENT)
    assert bench.host.faults["radio.unexpected_confirms"] == 1


def test_confirms_that_never_come_do_not_stop_the_others() -> None:
    bench = opened()
    for index in range(5):
        bench.host.send(destination=NODE, payload=b"%d" % index, now_ns=bench.now_ns)
    bench.run(11_000, step_ms=50)
    assert len(bench.dongle.requests) == 4
    bench.run(2_000, step_ms=50)
    assert len(bench.dongle.requests) == 5
    bench.answer()
    bench.run(50)
    assert len(settled(bench)) == 5


def test_a_full_queue_refuses_all_but_the_urgent() -> None:
    bench = opened()
    for _ in range(MAX_QUEUE + 1):  # the first is written at once
        bench.host.send(destination=NODE, payload=b"x", now_ns=bench.now_ns)
    with pytest.raises(LinkFullError, match=str(MAX_QUEUE)):
        bench.host.send(destination=NODE, payload=b"x", now_ns=bench.now_ns)
    bench.host.send(destination=NODE, payload=b"x", now_ns=bench.now_ns, is_urgent=True)


# --- watching ---


def test_a_chip_that_falls_silent_is_given_up_after_three_questions_with_all_that_it_had() -> None:
    bench = opened()
    bench.is_cut = True
    tickets = [bench.host.send(destination=NODE, payload=b"x", now_ns=bench.now_ns) for _ in range(3)]
    bench.run(4_400)
    assert bench.host.is_open
    bench.run(200)
    lost = bench.events[-1]
    assert isinstance(lost, HostLost)
    assert lost.why is LostWhy.NO_ANSWER
    assert sorted(lost.dropped) == tickets
    assert bench.host.next_deadline_ns() is None


def test_an_idle_line_is_watched() -> None:
    bench = opened()
    bench.asked.clear()
    bench.run(16_000)
    assert bench.asked.count(znp.NetworkInfoRequest()) == 3
    bench.is_cut = True
    bench.run(10_000)
    assert isinstance(bench.events[-1], HostLost)


def test_an_answer_that_is_late_is_never_taken_for_anothers() -> None:
    """The first request's refusal comes while the second would be outstanding; it must not settle the second."""
    bench = opened()
    first = bench.host.send(destination=NODE, payload=b"1", now_ns=bench.now_ns)
    bench.host.take_frames()
    bench.now_ns += 2 * S
    assert not bench.host.handle_deadline(now_ns=bench.now_ns)
    second = bench.host.send(destination=NODE, payload=b"2", now_ns=bench.now_ns)
    assert bench.host.take_frames() == [frame(znp.PingRequest())]
    refusal = znp.StatusReply(command=Command.AF_DATA_REQUEST, status=ZnpStatus.BUFFER_FULL)
    late = frame(refusal) + frame(znp.PingReply(capabilities=0))
    assert not bench.host.feed(late, now_ns=bench.now_ns)
    (request,) = ZnpDecoder().feed(b"".join(bench.host.take_frames()))
    assert isinstance(request, bytes)
    assert decode_command(request) == znp.DataRequest(
        destination=NODE, destination_endpoint=BIOBOT_ENDPOINT, source_endpoint=BIOBOT_ENDPOINT, cluster=BIOBOT_CLUSTER,
        transaction=1, options=0x20, radius=30, data=b"2",
    )  # fmt: skip
    confirm = znp.DataConfirm(status=0, endpoint=BIOBOT_ENDPOINT, transaction=0)
    assert bench.host.feed(frame(confirm), now_ns=bench.now_ns) == [SendSettled(ticket=first, status=RadioStatus.SENT)]
    assert second not in settled(bench)


def test_a_coordinator_that_leaves_its_state_is_opened_again() -> None:
    bench = opened()
    events = bench.host.feed(frame(znp.StateChange(state=0)), now_ns=bench.now_ns)
    assert isinstance(events[0], HostLost)
    assert events[0].why is LostWhy.RESTARTED


def test_a_network_that_is_gone_without_a_word_is_missed() -> None:
    bench = opened()
    bench.dongle._stack._state = DeviceState.HOLD
    bench.run(6_000)
    lost = [one for one in bench.events if isinstance(one, HostLost)]
    assert [one.why for one in lost] == [LostWhy.RESTARTED]


def test_a_network_that_is_to_stay_open_is_opened_again_before_it_closes() -> None:
    bench = opened()
    bench.asked.clear()
    bench.run(410_000, step_ms=100)
    assert len([one for one in bench.asked if isinstance(one, znp.PermitJoinRequest)]) == 2
    closed = opened(host=ZnpHostConfig(permit_join_s=0))
    closed.run(410_000, step_ms=100)
    assert not [one for one in closed.asked if isinstance(one, znp.PermitJoinRequest)]


def test_a_node_that_joins_is_seen() -> None:
    bench = opened()
    bench.dongle.node_joined(NODE, eui64=EUI64, now_ns=bench.now_ns)
    bench.run(20)
    assert NodeSeen(address=NODE, eui64=EUI64) in bench.events


def test_the_simulator_is_told_when_a_base_station_comes_and_goes() -> None:
    bench = opened()
    assert bench.dongle.is_open
    bench.is_cut = True
    bench.run(31_000, step_ms=100)
    assert not bench.dongle.is_open


# --- no way to be stuck ---

_REPORTS = (
    znp.ResetIndication(reason=0, transport=2, product=1, major=2, minor=7, hardware=1),
    znp.StateChange(state=0), znp.StateChange(state=8), znp.StateChange(state=9), znp.PingReply(capabilities=1),
    znp.VersionReply(transport=2, product=0, major=2, minor=6, maintenance=3), znp.NvReadReply(status=0, value=b"\x55"),
    znp.NvReadReply(status=10, value=b""), znp.RpcError(error=2, command=Command.SYS_VERSION),
    znp.DeviceInfoReply(status=0, eui64=1, address=0, kind=7, state=9, associated=()),
    znp.DeviceInfoReply(status=0, eui64=1, address=0xFFFE, kind=7, state=0, associated=(1, 2)),
    znp.NetworkInfoReply(address=0, state=9, pan_id=1, parent=0, extended_pan_id=0, extended_parent=0, channel=11),
    znp.DataConfirm(status=0, endpoint=BIOBOT_ENDPOINT, transaction=0),
    *(znp.StatusReply(command=one, status=status) for status in (0, 1) for one in (
        Command.SYS_OSAL_NV_ITEM_INIT, Command.SYS_OSAL_NV_WRITE, Command.AF_REGISTER, Command.AF_DATA_REQUEST,
        Command.ZDO_STARTUP_FROM_APP, Command.ZDO_MGMT_PERMIT_JOIN_REQ, Command.APP_CNF_BDB_SET_CHANNEL,
        Command.APP_CNF_BDB_START_COMMISSIONING,
    )),
)  # fmt: skip
_HAPPENINGS = st.one_of(
    st.sampled_from(_REPORTS), st.sampled_from(["send", "urgent", "open", "reset"]), st.integers(1, 5_000), st.binary(max_size=40)
)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([CC2652, CC2531, CC2531_WITH_LOADER]), st.lists(_HAPPENINGS, max_size=25))
def test_from_any_state_any_event_leads_to_an_open_dongle_in_the_end(
    config: ZnpDongleConfig, happenings: list[Message | str | int | bytes]
) -> None:
    """The host takes whatever reports, answers and noise come at whatever time; then the line is good, and it opens and works."""
    bench = a_bench(config)
    bench.open()
    for one in happenings:
        match one:
            case "send" | "urgent":
                if bench.host.is_open:
                    bench.host.send(destination=NODE, payload=b"x", now_ns=bench.now_ns, is_urgent=one == "urgent")
            case "open":
                bench.open()
            case "reset":
                bench.dongle.start(now_ns=bench.now_ns)
            case int():
                bench.run(one, step_ms=max(10, one // 40))
            case bytes():
                bench.events += bench.host.feed(one, now_ns=bench.now_ns)
            case _:
                assert not isinstance(one, str)
                bench.events += bench.host.feed(frame(one), now_ns=bench.now_ns)
        if not bench.host.is_open and bench.host.next_deadline_ns() is None:
            assert isinstance(bench.events[-1], HostLost), "who waits for nothing has said that the dongle is lost"
            bench.open()
    bench.run(30_000, step_ms=100)
    if not bench.host.is_open and bench.host.next_deadline_ns() is None:
        bench.open()
    bench.run_until_open(within_ms=60_000)
    bench.run(20_000, step_ms=50)
    if not bench.host.is_open:
        bench.open()
        bench.run_until_open()
    ticket = bench.host.send(destination=NODE, payload=b"works", now_ns=bench.now_ns)
    for _ in range(100):
        bench.answer()
        bench.run(50)
    assert settled(bench)[ticket] == RadioStatus.SENT
