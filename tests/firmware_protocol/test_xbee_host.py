"""Laws of the host of XBee modules, against a module that answers from a table."""

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dialects.interface import (
    CoordinatorIdentified,
    CoordinatorSaid,
    HostEvent,
    HostLost,
    HostOpened,
    LostWhy,
    NodeSeen,
    PayloadHeard,
    SendSettled,
)
from firmware_protocol.dialects.xbee import XBeeHost, XBeeHostConfig
from firmware_protocol.dialects.xbee_addresses import AddressTable
from firmware_protocol.dialects.xbee_frames import (
    AT_BAD_COMMAND,
    AT_OK,
    BROADCAST64,
    UNKNOWN16,
    UNKNOWN64,
    AtCommand,
    AtResponse,
    Endpoints,
    FromModule,
    ModemStatus,
    NodeIdentification,
    Receive,
    TransmitRequest,
    TransmitStatus,
    decode_xbee,
    encode_xbee,
)
from firmware_protocol.dialects.xbee_meanings import DELIVERY, EVENTS, OF_MODULE, OUTCOME, RESTARTS
from firmware_protocol.dialects.xbee_sending import MAX_QUEUE, WINDOW
from firmware_protocol.envelope import BROADCAST_ADDRESS, RadioStatus
from firmware_protocol.errors import EncodeError, LinkFullError
from firmware_protocol.framing.xbee import encode_frame, make_decoder
from firmware_protocol.units import NS_PER_MS, NS_PER_S, RSSI_UNKNOWN, ShortAddress
from tests.strategies import u16

EUI64 = 0x0013A20041AEB54E
NODE = ShortAddress(0x7D84)
ZIGBEE = {
    "AP": b"\2", "AO": b"\0", "VR": b"\x10\x0d", "HV": b"\x42\x47", "SH": b"\0\x13\xa2\0", "SL": b"\x40\0\0\1", "MY": b"\0\0",
    "OI": b"\xb1\x0b", "ID": bytes(8), "CH": b"\x14", "NP": b"\0\x54", "AI": b"\0", "CE": b"\1", "NI": b"BASE",
}  # fmt: skip
DIGIMESH = {name: ZIGBEE[name] for name in ("AP", "AO", "VR", "HV", "SH", "SL", "CH", "NP", "NI", "CE")} | {"ID": b"\x7f\xff"}


@dataclass
class Bench:
    """A host, and a module on its line that answers AT commands from ``answers`` unless it is ``deaf``."""

    host: XBeeHost
    answers: dict[str, bytes]
    deaf: Callable[[str], bool] = lambda _: False
    now_ns: int = 0
    events: list[HostEvent] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    requests: list[TransmitRequest] = field(default_factory=list)
    raw: list[bytes] = field(default_factory=list)

    @property
    def is_escaped(self) -> bool:
        return self.answers["AP"] == b"\2"

    def run(self, for_ms: int = 200) -> None:
        for _ in range(for_ms // 10):
            self.exchange()
            self.now_ns += 10 * NS_PER_MS
            due_ns = self.host.next_deadline_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self.events += self.host.handle_deadline(now_ns=self.now_ns)
        self.exchange()

    def exchange(self) -> None:
        while frames := self.host.take_frames():
            for frame in frames:
                self.raw.append(frame)
                for body in make_decoder(is_escaped=self.is_escaped).feed(frame):
                    if isinstance(body, bytes):
                        self._obey(decode_xbee(body))

    def say(self, *frames: FromModule) -> None:
        for frame in frames:
            self.events += self.host.feed(encode_frame(encode_xbee(frame), is_escaped=self.is_escaped), now_ns=self.now_ns)

    def of(self, kind: type) -> list[HostEvent]:
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def settled(self) -> dict[int, int]:
        return {event.ticket: event.status for event in self.events if isinstance(event, SendSettled)}

    def send(self, payload: bytes = b"payload", *, to: int = NODE, is_urgent: bool = False) -> int:
        ticket = self.host.send(destination=ShortAddress(to), payload=payload, now_ns=self.now_ns, is_urgent=is_urgent)
        self.exchange()
        return ticket

    def _obey(self, frame: object) -> None:
        match frame:
            case AtCommand(command=command, frame_id=frame_id) if not self.deaf(command):
                self.asked.append(command)
                known = command in self.answers
                status, value = (AT_OK, self.answers[command]) if known else (AT_BAD_COMMAND, b"")
                self.say(AtResponse(frame_id=frame_id, command=command, status=status, value=value))
            case TransmitRequest():
                self.requests.append(frame)


def a_bench(
    answers: dict[str, bytes] | None = None, *, deaf: Callable[[str], bool] = lambda _: False, config: XBeeHostConfig | None = None
) -> Bench:
    bench = Bench(XBeeHost(config=config), dict(answers or ZIGBEE), deaf)
    bench.events += bench.host.open(session=1, now_ns=0)
    return bench


def an_open_bench(answers: dict[str, bytes] | None = None, *, config: XBeeHostConfig | None = None) -> Bench:
    bench = a_bench(answers, config=config)
    bench.run()
    assert bench.host.is_open
    bench.events.clear()
    return bench


def heard(source64: int = EUI64, source16: int = NODE, payload: bytes = b"heard", endpoints: Endpoints | None = None) -> Receive:
    return Receive(source64=source64, source16=source16, options=1, payload=payload, endpoints=endpoints)


@pytest.mark.parametrize("mode", [1, 2])
def test_a_module_in_either_mode_opens_and_says_who_it_is(mode: int) -> None:
    bench = a_bench(ZIGBEE | {"AP": bytes([mode])})
    bench.run()
    assert bench.of(HostOpened)
    (identified,) = bench.of(CoordinatorIdentified)
    assert isinstance(identified, CoordinatorIdentified)
    hello = identified.hello
    assert (hello.eui64, hello.pan_id, hello.channel) == (0x0013A20040000001, 0xB10B, 20)
    assert (hello.firmware, hello.max_radio_payload) == (0x100D, 84)
    assert identified.description == f'XBee 3 "BASE", firmware 100D, hardware 4247, coordinator at 0x0000, API mode {mode}'
    bench.say(heard(payload=bytes(range(0x7A, 0x80)) + b"\x11\x13"))
    assert isinstance(bench.events[-1], PayloadHeard)
    assert bench.events[-1].received.payload == b"\x7a\x7b\x7c\x7d\x7e\x7f\x11\x13"
    assert bench.events[-1].received.rssi_dbm == RSSI_UNKNOWN


def test_a_module_that_does_not_know_every_parameter_opens_all_the_same() -> None:
    bench = a_bench(DIGIMESH)
    bench.run()
    (identified,) = bench.of(CoordinatorIdentified)
    assert isinstance(identified, CoordinatorIdentified)
    assert identified.hello.pan_id == 0x7FFF


def test_a_module_without_a_network_is_waited_for_and_opens_when_it_has_one() -> None:
    bench = a_bench(ZIGBEE | {"AI": b"\xff"})
    bench.run(4_500)
    assert not bench.host.is_open
    said = bench.of(CoordinatorSaid)
    assert [event.level for event in said if isinstance(event, CoordinatorSaid)] == [1, 0, 0, 0, 0]
    bench.answers["AI"] = b"\0"
    bench.say(ModemStatus(status=6))
    bench.run()
    assert bench.of(HostOpened)
    assert not bench.of(HostLost)


@pytest.mark.parametrize(("is_coordinator", "advice"), [(b"\0", "set CE to 1"), (b"\1", "ATNR")])
def test_a_module_that_finds_no_network_is_refused_with_the_reason_and_what_to_do(is_coordinator: bytes, advice: str) -> None:
    bench = a_bench(ZIGBEE | {"AI": b"\x21", "CE": is_coordinator})
    bench.run(40_000)
    (lost,) = bench.of(HostLost)
    assert isinstance(lost, HostLost)
    assert lost.why is LostWhy.REFUSED
    assert "AI = 0x21, no network was found on the channels of SC" in lost.detail
    assert advice in lost.detail
    assert bench.host.next_deadline_ns() is None


def test_a_module_that_stops_answering_in_the_middle_is_reset_once_and_asked_anew() -> None:
    bench = a_bench(deaf=lambda command: command == "NP" and "FR" not in bench.asked)
    bench.run(1_600)
    assert bench.asked[-1] == "FR"
    assert not bench.of(HostOpened)
    bench.say(ModemStatus(status=0))
    bench.run(500)
    assert bench.host.is_open
    assert bench.asked.count("FR") == 1


def test_a_module_that_does_not_even_obey_the_reset_is_asked_from_the_beginning() -> None:
    is_deaf = True
    bench = a_bench(deaf=lambda command: is_deaf and command != "AP")
    bench.run(15_000)
    assert bench.asked.count("AP") >= 3
    assert not bench.of(HostOpened)
    is_deaf = False
    bench.run(10_000)
    assert bench.host.is_open


def test_what_is_queued_before_the_module_opens_goes_out_then() -> None:
    bench = a_bench()
    ticket = bench.send()
    bench.run()
    assert len(bench.requests) == 1
    bench.say(TransmitStatus(frame_id=bench.requests[0].frame_id, destination16=NODE, retries=0, delivery=0, discovery=0))
    assert bench.settled == {ticket: RadioStatus.SENT}


def test_a_lost_host_takes_no_notice_and_can_be_opened_again() -> None:
    bench = an_open_bench()
    bench.say(ModemStatus(status=0))
    bench.events.clear()
    bench.say(heard(), ModemStatus(status=6), AtResponse(frame_id=1, command="AI", status=AT_OK, value=b"\0"))
    assert not bench.of(PayloadHeard)
    assert not bench.of(HostLost)
    assert bench.host.handle_deadline(now_ns=bench.now_ns) == []
    assert bench.host.next_deadline_ns() is None
    bench.host.open(session=2, now_ns=bench.now_ns)
    bench.run()
    assert bench.host.is_open


def test_a_reset_while_opening_begins_the_opening_anew() -> None:
    bench = a_bench(ZIGBEE | {"AI": b"\xff", "AP": b"\1"})
    bench.run(500)
    bench.answers["AP"] = b"\2"  # what is in its memory
    bench.events += bench.host.feed(encode_frame(encode_xbee(ModemStatus(status=0)), is_escaped=False), now_ns=bench.now_ns)
    bench.answers["AI"] = b"\0"
    bench.run(1_000)
    assert bench.host.is_open
    bench.say(heard(payload=b"\x11"))
    assert len(bench.of(PayloadHeard)) == 1


def test_an_answer_that_is_no_answer_to_the_knock_is_passed_over() -> None:
    bench = a_bench(deaf=lambda _: True)
    bench.run(2_500)
    bench.events += bench.host.feed(b"ERROR\rOK\r", now_ns=bench.now_ns)
    bench.exchange()
    assert bench.raw[-1] == b"ATAP2\r"


def test_a_module_in_transparent_mode_is_switched_by_text_between_silences() -> None:
    """The silences of 1.1 s are longer than ``GT``, 1 s at the factory."""
    bench = a_bench(deaf=lambda _: True)
    bench.run(2_000)
    quiet_ns = bench.now_ns
    while b"+++" not in bench.raw:
        bench.run(10)
    assert bench.now_ns - quiet_ns < 2 * NS_PER_S
    bench.run(1_000)
    assert bench.raw[-1] == b"+++", "nothing may follow within the guard time"
    for text in (b"ATAP2\r", b"ATCN\r"):
        bench.events += bench.host.feed(b"O", now_ns=bench.now_ns)
        bench.events += bench.host.feed(b"K\r", now_ns=bench.now_ns)
        bench.exchange()
        assert bench.raw[-1] == text
    bench.deaf = lambda _: False
    bench.events += bench.host.feed(b"OK\r", now_ns=bench.now_ns)
    bench.run()
    assert bench.host.is_open
    assert b"ATWR\r" not in bench.raw


def test_the_switch_is_written_into_memory_only_where_that_was_asked_for() -> None:
    bench = a_bench(deaf=lambda _: True, config=XBeeHostConfig(keeps_mode=True))
    bench.run(2_500)
    for _ in range(3):
        bench.events += bench.host.feed(b"OK\r", now_ns=bench.now_ns)
        bench.exchange()
    assert bench.raw[-3:] == [b"ATAP2\r", b"ATWR\r", b"ATCN\r"]


def test_a_module_that_refuses_the_switch_is_told_of_and_tried_again() -> None:
    bench = a_bench(deaf=lambda _: True)
    bench.run(2_500)
    bench.events += bench.host.feed(b"OK\r", now_ns=bench.now_ns)
    bench.exchange()
    for _ in range(3):
        bench.events += bench.host.feed(b"ERROR\r", now_ns=bench.now_ns)
        bench.exchange()
    said = bench.events[-1]
    assert isinstance(said, CoordinatorSaid)
    assert "ATAP2" in said.text
    bench.deaf = lambda _: False
    bench.run(500)
    assert bench.host.is_open


def test_a_line_of_text_without_an_answer_is_said_again_after_what_may_be_left_of_it_is_ended() -> None:
    bench = a_bench(deaf=lambda _: True)
    bench.run(2_500)
    bench.events += bench.host.feed(b"OK\r", now_ns=bench.now_ns)
    bench.run(1_050)
    assert bench.raw[-3:] == [b"ATAP2\r", b"\r", b"ATAP2\r"]


def test_a_line_on_which_nobody_answers_is_tried_for_ever_and_a_half_said_frame_is_ended() -> None:
    bench = a_bench(deaf=lambda _: True)
    bench.run(20_000)
    assert bench.raw.count(b"+++") >= 4
    assert any(len(frame) > 270 and not any(frame) for frame in bench.raw)
    assert not bench.events


@pytest.mark.parametrize("status", sorted(DELIVERY))
def test_every_documented_delivery_status_comes_up_as_its_outcome(status: int) -> None:
    bench = an_open_bench()
    tickets = [bench.send(), bench.send()]
    for request in bench.requests:
        bench.say(TransmitStatus(frame_id=request.frame_id, destination16=NODE, retries=0, delivery=status, discovery=0))
    assert bench.settled == dict.fromkeys(tickets, DELIVERY[status].outcome)
    assert len(bench.of(CoordinatorSaid)) == (status in OF_MODULE), "a fault of the module is told once"


def test_the_outcomes_and_the_delivery_statuses_of_a_virtual_module_agree() -> None:
    assert {status: DELIVERY[delivery].outcome for status, delivery in OUTCOME.items()} == {status: status for status in RadioStatus}


def test_a_delivery_status_of_a_newer_firmware_is_an_unknown_outcome() -> None:
    bench = an_open_bench()
    ticket = bench.send()
    bench.say(TransmitStatus(frame_id=bench.requests[0].frame_id, destination16=NODE, retries=0, delivery=0xEE, discovery=0))
    assert bench.settled == {ticket: RadioStatus.OTHER}
    said = bench.of(CoordinatorSaid)[0]
    assert isinstance(said, CoordinatorSaid)
    assert "0xEE" in said.text


def test_a_status_for_nobody_is_counted() -> None:
    bench = an_open_bench()
    bench.say(TransmitStatus(frame_id=9, destination16=NODE, retries=0, delivery=0, discovery=0))
    assert bench.host.faults == {"radio.unexpected_confirms": 1}


def test_a_few_are_in_flight_and_each_status_lets_the_next_one_go() -> None:
    bench = an_open_bench()
    tickets = [bench.send(b"%d" % index) for index in range(20)]
    assert len(bench.requests) == WINDOW
    for index in range(20):
        request = bench.requests[index]
        bench.say(TransmitStatus(frame_id=request.frame_id, destination16=NODE, retries=0, delivery=0, discovery=0))
        bench.exchange()
    assert [request.payload for request in bench.requests] == [b"%d" % index for index in range(20)]
    assert bench.settled == dict.fromkeys(tickets, RadioStatus.SENT)
    assert not {request.frame_id for request in bench.requests} & {0, 1}


def test_an_urgent_payload_does_not_wait_for_those_in_flight() -> None:
    bench = an_open_bench()
    for index in range(20):
        bench.send(b"%d" % index)
    bench.send(b"stop", is_urgent=True)
    assert bench.requests[-1].payload == b"stop"


def test_a_status_that_never_comes_is_an_unknown_outcome_and_blocks_nothing() -> None:
    bench = an_open_bench()
    tickets = [bench.send() for _ in range(WINDOW + 1)]
    bench.run(16_000)
    assert len(bench.requests) == WINDOW + 1
    assert bench.settled == dict.fromkeys(tickets[:WINDOW], RadioStatus.OTHER)
    assert bench.host.faults["xbee.status_missing"] == WINDOW


def test_a_payload_that_is_forgotten_is_not_written_or_frees_its_place() -> None:
    bench = an_open_bench()
    tickets = [bench.send(b"%d" % index) for index in range(WINDOW + 2)]
    bench.host.forget(tickets[WINDOW])
    bench.host.forget(tickets[0])
    bench.send(b"more")
    assert [request.payload for request in bench.requests] == [b"0", b"1", b"2", b"3", b"5"]
    for request in bench.requests:
        bench.say(TransmitStatus(frame_id=request.frame_id, destination16=NODE, retries=0, delivery=0, discovery=0))
    assert tickets[0] not in bench.settled
    assert tickets[WINDOW] not in bench.settled


def test_a_payload_for_nobody_that_is_forgotten_is_not_settled() -> None:
    bench = an_open_bench(DIGIMESH)
    ticket = bench.host.send(destination=NODE, payload=b"payload", now_ns=bench.now_ns)
    bench.host.forget(ticket)
    bench.run(50)
    assert not bench.settled


def test_stops_for_biobots_that_are_out_of_reach_do_not_keep_one_from_another() -> None:
    """Their statuses take seconds; a module that has no room for one more says so."""
    bench = an_open_bench()
    for index in range(20):
        bench.send(b"stop %d" % index, is_urgent=True)
    bench.send(b"stop of one that is there", is_urgent=True)
    assert len(bench.requests) == 21
    bench.send(b"acknowledge")
    assert len(bench.requests) == 21


@pytest.mark.parametrize("loses_port", [False, True])
def test_a_status_from_before_a_new_opening_settles_no_other_payload(loses_port: bool) -> None:
    """A module that was not reset still tells of what it was given before."""
    bench = an_open_bench()
    for index in range(3):
        bench.send(b"old %d" % index)
    old = list(bench.requests)
    if not loses_port:
        bench.say(ModemStatus(status=6))
    bench.events.clear()
    bench.events += bench.host.open(session=2, now_ns=bench.now_ns)
    bench.run()
    for index in range(260):
        bench.send(b"new %d" % index)
        bench.say(TransmitStatus(frame_id=bench.requests[-1].frame_id, destination16=NODE, retries=0, delivery=0, discovery=0))
    assert not {one.frame_id for one in old} & {one.frame_id for one in bench.requests[3:]}
    last = bench.send(b"last")
    for request in old:
        bench.say(TransmitStatus(frame_id=request.frame_id, destination16=0xFFFD, retries=0, delivery=0x24, discovery=0))
    assert last not in bench.settled
    assert set(bench.settled.values()) == {RadioStatus.SENT}


@pytest.mark.parametrize("answers", [ZIGBEE, DIGIMESH])
def test_a_module_that_opens_is_given_no_payload_and_is_not_asked_without_a_pause(answers: dict[str, bytes]) -> None:
    bench = an_open_bench(answers)
    bench.host.open(session=2, now_ns=bench.now_ns)
    bench.host.take_frames()
    ticket = bench.host.send(destination=ShortAddress(9), payload=b"payload", now_ns=bench.now_ns)
    for frame_id in (9, 2):
        due_ns = bench.host.next_deadline_ns()
        assert due_ns is not None
        assert due_ns > bench.now_ns
        bench.say(TransmitStatus(frame_id=frame_id, destination16=1, retries=0, delivery=0, discovery=0))
        assert bench.host.take_frames() == []
    bench.run(2_000)
    assert bench.settled == ({ticket: RadioStatus.UNKNOWN_ADDRESS} if answers is DIGIMESH else {})
    assert len(bench.requests) == (answers is ZIGBEE)


def test_frame_ids_of_payloads_that_were_forgotten_are_not_used_again_before_their_status() -> None:
    bench = an_open_bench()
    for _ in range(260):
        bench.host.forget(bench.send())
    assert len(bench.requests) == len({request.frame_id for request in bench.requests}) == 254
    last = bench.send()
    bench.say(TransmitStatus(frame_id=77, destination16=NODE, retries=0, delivery=0, discovery=0))
    bench.exchange()
    assert bench.requests[-1].frame_id == 77
    assert not bench.settled
    bench.say(TransmitStatus(frame_id=77, destination16=NODE, retries=0, delivery=0, discovery=0))
    assert bench.settled == {last: RadioStatus.SENT}


def test_the_queue_is_bounded_but_for_what_is_urgent() -> None:
    bench = an_open_bench()
    for _ in range(MAX_QUEUE + WINDOW):
        bench.send()
    with pytest.raises(LinkFullError, match=str(MAX_QUEUE)):
        bench.send()
    bench.send(is_urgent=True)
    with pytest.raises(EncodeError, match="58"):
        bench.send(bytes(58))


def test_a_silent_module_is_asked_three_times_and_then_lost_with_all_that_was_under_way() -> None:
    bench = an_open_bench()
    ticket = bench.send()
    bench.deaf = lambda _: True
    bench.run(8_000)
    (lost,) = bench.of(HostLost)
    assert isinstance(lost, HostLost)
    assert (lost.why, lost.dropped) == (LostWhy.NO_ANSWER, (ticket,))
    assert not bench.host.is_open
    assert bench.host.take_frames() == []


def test_a_module_that_answers_is_kept_for_ever() -> None:
    bench = an_open_bench()
    bench.run(60_000)
    assert not bench.of(HostLost)
    assert bench.asked[-1] == "AI"


@pytest.mark.parametrize("status", sorted(EVENTS))
def test_an_event_of_the_module_is_told_and_a_restart_ends_the_session(status: int) -> None:
    bench = an_open_bench()
    bench.say(ModemStatus(status=status))
    said = bench.events[0]
    assert isinstance(said, CoordinatorSaid)
    assert EVENTS[status].text in said.text
    assert bool(bench.of(HostLost)) == (status in RESTARTS)
    assert bench.host.is_open == (status not in RESTARTS)


def test_a_module_that_loses_its_network_is_opened_anew() -> None:
    bench = an_open_bench()
    bench.answers["AI"] = b"\x13"
    bench.run(4_000)
    (lost,) = bench.of(HostLost)
    assert isinstance(lost, HostLost)
    assert lost.why is LostWhy.RESTARTED
    assert "left its network" in lost.detail


@pytest.mark.parametrize("event", [0x03, 0x3F, 0x40])
def test_a_module_that_may_have_lost_its_network_is_asked_at_once(event: int) -> None:
    bench = an_open_bench()
    bench.answers["AI"] = b"\x13"
    bench.say(ModemStatus(status=event), heard())
    bench.run(50)
    assert bench.of(HostLost)


def test_a_module_without_its_network_is_opened_anew_however_much_is_sent_and_heard() -> None:
    """By the first status that says so, or within ten seconds."""
    for delivery, within_ms in ((0x22, 1_200), (0x24, 10_100)):
        bench = an_open_bench()
        bench.answers["AI"] = b"\x13"
        while not bench.of(HostLost) and bench.now_ns < 60 * NS_PER_S:
            bench.send()
            bench.say(TransmitStatus(frame_id=bench.requests[-1].frame_id, destination16=0xFFFD, retries=0, delivery=delivery, discovery=0))
            bench.run(100)
        (lost,) = bench.of(HostLost)
        assert isinstance(lost, HostLost)
        assert lost.why is LostWhy.RESTARTED
        assert bench.now_ns <= (within_ms + 300) * NS_PER_MS


def test_statuses_of_a_module_that_says_it_has_no_network_do_not_flood_it_with_questions() -> None:
    bench = an_open_bench()
    n_asked = len(bench.asked)
    for _ in range(500):
        bench.send()
        bench.say(TransmitStatus(frame_id=bench.requests[-1].frame_id, destination16=0xFFFD, retries=0, delivery=0x22, discovery=0))
        bench.run(10)
    assert not bench.of(HostLost), "it says that it is in a network"
    assert 3 <= len(bench.asked) - n_asked <= 7


def test_addresses_are_learnt_and_used() -> None:
    bench = an_open_bench()
    bench.send(to=NODE)
    bench.say(heard())
    bench.send(to=NODE)
    bench.send(to=BROADCAST_ADDRESS)
    assert [(one.destination64, one.destination16) for one in bench.requests] == [
        (UNKNOWN64, NODE),
        (EUI64, NODE),
        (BROADCAST64, UNKNOWN16),
    ]
    assert bench.of(NodeSeen) == [NodeSeen(address=NODE, eui64=EUI64)]
    bench.say(heard())
    assert len(bench.of(NodeSeen)) == 1, "told once"


def test_a_node_that_joins_again_is_reached_under_its_old_and_its_new_address() -> None:
    bench = an_open_bench()
    bench.say(heard())
    moved = NodeIdentification(
        sender64=EUI64, sender16=0x4321, options=2, node16=0x4321, node64=EUI64, name=b" ", parent16=0, kind=1, event=2
    )
    bench.say(moved)
    for address in (NODE, 0x4321):
        bench.send(to=address)
    assert [(one.destination64, one.destination16) for one in bench.requests] == [(EUI64, 0x4321)] * 2
    assert NodeSeen(address=ShortAddress(0x4321), eui64=EUI64) in bench.events


def test_where_a_payload_was_delivered_is_learnt_from_its_status() -> None:
    bench = an_open_bench()
    bench.say(heard())
    bench.send(to=NODE)
    bench.say(TransmitStatus(frame_id=bench.requests[0].frame_id, destination16=0x1111, retries=1, delivery=0, discovery=1))
    bench.send(to=NODE)
    assert bench.requests[-1].destination16 == 0x1111


def test_where_a_payload_was_delivered_is_learnt_of_the_node_that_it_was_for() -> None:
    """Its short address may be another's by then."""
    bench = an_open_bench()
    bench.say(heard())
    bench.send(to=NODE)
    bench.say(heard(source64=EUI64 + 1))
    bench.say(TransmitStatus(frame_id=bench.requests[0].frame_id, destination16=0x2222, retries=0, delivery=0, discovery=1))
    bench.send(to=0x2222)
    bench.send(to=NODE)
    assert [(one.destination64, one.destination16) for one in bench.requests[1:]] == [(EUI64, 0x2222), (EUI64 + 1, NODE)]


def test_a_node_without_a_short_address_keeps_the_one_it_was_allotted_over_new_openings() -> None:
    bench = an_open_bench(DIGIMESH)
    bench.say(heard(source16=UNKNOWN16), heard(source64=EUI64 + 1, source16=UNKNOWN16))
    first, second = [event.received.source for event in bench.events if isinstance(event, PayloadHeard)]
    bench.host.open(session=2, now_ns=bench.now_ns)
    bench.run()
    bench.send(to=first)
    bench.say(heard(source64=EUI64 + 1, source16=UNKNOWN16))
    assert isinstance(bench.events[-1], PayloadHeard)
    assert bench.events[-1].received.source == second
    bench.send(to=first)
    assert [one.destination64 for one in bench.requests] == [EUI64, EUI64]


@pytest.mark.parametrize(
    ("answers", "reaches"),
    [(ZIGBEE, True), (DIGIMESH, False), (DIGIMESH | {"MY": b"\0\0"}, True), (DIGIMESH | {"MY": b"\xff\xff"}, False)],
    ids=["ZigBee", "DigiMesh", "802.15.4", "802.15.4 by long addresses"],
)
def test_the_opening_tells_whether_a_short_address_that_is_not_known_may_be_somebodys(answers: dict[str, bytes], reaches: bool) -> None:
    """What a node calls itself does not: a ZigBee module says 0xFFFE of one whose address it has not learnt yet."""
    bench = an_open_bench(answers)
    for _ in range(2):
        ticket = bench.send(to=0x4321)
        bench.run(20)
        assert (bench.settled.get(ticket) == RadioStatus.UNKNOWN_ADDRESS) is not reaches
        bench.say(heard(source16=UNKNOWN16))
    assert len(bench.requests) == 2 * reaches


@pytest.mark.parametrize("address16", [*range(0xFFF8, 0x10000)])
def test_no_node_is_called_by_an_address_that_means_several(address16: int) -> None:
    bench = an_open_bench()
    bench.say(heard(source16=address16))
    assert isinstance(bench.events[-1], PayloadHeard)
    source = bench.events[-1].received.source
    assert source < 0xFFF8
    bench.send(to=source)
    assert (bench.requests[-1].destination64, bench.requests[-1].destination16) == (EUI64, UNKNOWN16)


@pytest.mark.parametrize("eui64", [0, BROADCAST64, UNKNOWN64])
def test_no_node_is_called_by_a_long_address_that_is_nobodys(eui64: int) -> None:
    bench = an_open_bench()
    bench.say(heard(source64=eui64))
    bench.send(to=NODE)
    assert (bench.requests[-1].destination64, bench.requests[-1].destination16) == (UNKNOWN64, NODE)


def test_a_network_without_short_addresses_is_given_some() -> None:
    bench = an_open_bench(DIGIMESH)
    bench.say(heard(source16=UNKNOWN16), heard(source64=EUI64 + 1, source16=UNKNOWN16), heard(source16=UNKNOWN16))
    first, second, again = [event.received.source for event in bench.events if isinstance(event, PayloadHeard)]
    assert first == again != second
    bench.send(to=second)
    assert (bench.requests[0].destination64, bench.requests[0].destination16) == (EUI64 + 1, UNKNOWN16)
    nobody = bench.send(to=next(one for one in range(1, 9) if one not in {first, second}))
    bench.run(20)
    assert bench.settled == {nobody: RadioStatus.UNKNOWN_ADDRESS}
    assert len(bench.requests) == 1


def test_explicit_endpoints_go_out_and_the_stacks_own_talk_does_not_come_up() -> None:
    ours = Endpoints(source=1, destination=1, cluster=0x0B10, profile=0xB10B)
    bench = an_open_bench(config=XBeeHostConfig(endpoints=ours))
    bench.send()
    assert bench.requests[0].endpoints == ours
    bench.say(heard(endpoints=ours), heard(endpoints=Endpoints(profile=0, cluster=0x13)))
    assert len(bench.of(PayloadHeard)) == 1
    assert bench.host.faults["xbee.zdo"] == 1


def test_a_module_that_carries_too_little_is_told_of() -> None:
    bench = a_bench(ZIGBEE | {"NP": b"\x31"})
    bench.run()
    assert any("49 bytes" in event.text for event in bench.events if isinstance(event, CoordinatorSaid))


def test_what_no_module_says_is_counted() -> None:
    bench = an_open_bench()
    for body in (b"\x92\0\0", b"\x90\0", encode_xbee(AtCommand(frame_id=3, command="AP"))):
        bench.events += bench.host.feed(encode_frame(body, is_escaped=True), now_ns=bench.now_ns)
    assert bench.host.faults == {"xbee.unknown_frame_type": 1, "xbee.bad_frame_length": 1, "xbee.wrong_direction": 1}


@given(chunks=st.lists(st.binary(max_size=60) | st.builds(heard, source16=u16).map(
    lambda frame: encode_frame(encode_xbee(frame), is_escaped=True)
), max_size=10), gaps_ms=st.lists(st.integers(0, 5_000), min_size=10, max_size=10))  # fmt: skip
def test_nothing_from_the_line_raises_in_any_state(chunks: list[bytes], gaps_ms: list[int]) -> None:
    bench = a_bench()
    for chunk, gap_ms in zip(chunks, gaps_ms, strict=False):
        bench.now_ns += gap_ms * NS_PER_MS
        bench.events += bench.host.handle_deadline(now_ns=bench.now_ns)
        bench.events += bench.host.feed(chunk, now_ns=bench.now_ns)
        bench.exchange()


@given(pairs=st.lists(st.tuples(st.integers(0, 20), st.integers(0, 30) | st.just(UNKNOWN16)), max_size=200), capacity=st.integers(1, 12))
def test_the_table_is_bounded_and_never_names_a_node_that_is_another(pairs: list[tuple[int, int]], capacity: int) -> None:
    """Whatever was said before, the address that a frame gives leads to the node that sent the frame."""
    table = AddressTable(capacity=capacity)
    for eui64, address16 in pairs:
        address, _ = table.learn(eui64=EUI64 + eui64, address16=address16)
        assert len(table) <= capacity
        assert 0 <= address < 0xFFF8
        where = table.destination(address)
        assert where is not None
        assert where[0] == EUI64 + eui64
        assert table.learn(eui64=EUI64 + eui64, address16=address16) == (address, False)


@given(first=u16, eui64s=st.lists(st.integers(1, 2**63), unique=True, min_size=1, max_size=50))
def test_an_address_that_was_forgotten_is_not_another_nodes_soon(first: int, eui64s: list[int]) -> None:
    """Somebody may still call the node by it."""
    eui64s = [eui64 for eui64 in eui64s if eui64 != BROADCAST64]
    table = AddressTable(capacity=1, first_allotted=first)
    allotted = [table.learn(eui64=eui64, address16=UNKNOWN16)[0] for eui64 in eui64s]
    assert len(set(allotted)) == len(eui64s)
    assert all(1 <= address <= 0xFFF0 for address in allotted)
