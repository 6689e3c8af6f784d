"""The reference coordinator firmware against the base station's own end of a native dongle; no process, no device, no sleep."""

from collections import deque
from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dialects.interface import CoordinatorIdentified, HostEvent, HostLost, HostOpened, LostWhy, PayloadHeard, SendSettled
from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.envelope import (
    ConfigureCoordinator,
    CoordinatorConfigured,
    CoordinatorHello,
    CoordinatorLog,
    Envelope,
    EnvelopeFault,
    NodeJoined,
    RadioConfirm,
    RadioReceived,
    RadioSend,
    RadioStatus,
    decode_envelope,
    encode_envelope,
)
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.link import Link, LinkConfig, LinkState, PayloadReceived, Role
from firmware_protocol.units import ShortAddress
from studies.c_link import CCoordinator
from studies.c_wire import Wire

MS = 1_000_000
NODE = ShortAddress(0x1234)
HELLO = CoordinatorHello(firmware=0x0100, eui64=0x00124B0000000001, pan_id=0xB10B, channel=20, max_radio_payload=57)


@dataclass
class Desk:
    """A host and the firmware on one line, which damages the bytes that it is told to damage; time passes in steps of 50 ms."""

    dongle: CCoordinator
    host: NativeHost = field(default_factory=NativeHost)
    now_ms: int = 2**32 - 3_000
    damage: deque[int] = field(default_factory=deque)
    events: list[HostEvent] = field(default_factory=list)
    confirms: bool = True
    reopens: bool = False
    session: int = 0

    def open(self) -> None:
        self.session += 1
        self.host.open(session=self.session, now_ns=self.now_ms * MS)

    def run(self, steps: int) -> None:
        for _ in range(steps):
            self.now_ms += 50
            self.dongle.set_now_ms(self.now_ms & 0xFFFF_FFFF)
            self.note(self.host.handle_deadline(now_ns=self.now_ms * MS))
            for _ in range(3):
                self.dongle.feed(self.carry(b"".join(self.host.take_frames())))
                self.note(self.host.feed(self.carry(self.dongle.take_bytes()), now_ns=self.now_ms * MS))

    def carry(self, stream: bytes) -> bytes:
        line = bytearray(stream)
        for at in range(0, len(line), 40):
            if self.damage:
                line[at] ^= self.damage.popleft()
        return bytes(line)

    def note(self, events: list[HostEvent]) -> None:
        self.events += events
        for event in events:
            if isinstance(event, PayloadHeard) and self.confirms:
                self.host.confirm(event.receipt)
            elif isinstance(event, HostLost) and self.reopens:
                self.open()

    def heard(self) -> list[bytes]:
        return [event.received.payload for event in self.events if isinstance(event, PayloadHeard)]

    def settled(self) -> dict[int, int]:
        return {event.ticket: event.status for event in self.events if isinstance(event, SendSettled)}


def opened(wire: Wire) -> Desk:
    desk = Desk(dongle=CCoordinator(wire))
    desk.open()
    desk.run(2)
    return desk


@dataclass
class Bench:
    """The firmware with a link of its own at the other end, which may say what a host never says."""

    dongle: CCoordinator
    link: Link = field(default_factory=lambda: Link(role=Role.INITIATOR, config=LinkConfig(max_queue=10_000)))
    decoder: CobsDecoder = field(default_factory=CobsDecoder)
    now_ms: int = 0
    said: list[Envelope] = field(default_factory=list)
    confirms: bool = True

    def run(self, steps: int = 1) -> None:
        for _ in range(steps):
            self.now_ms += 50
            self.dongle.set_now_ms(self.now_ms)
            self.link.handle_deadline(now_ns=self.now_ms * MS)
            for _ in range(3):
                self.dongle.feed(b"".join(encode_frame(body) for body in self.link.take_frames()))
                for body in self.decoder.feed(self.dongle.take_bytes()):
                    assert isinstance(body, bytes)
                    self.hear(body)

    def hear(self, body: bytes) -> None:
        for event in self.link.receive(body, now_ns=self.now_ms * MS):
            if isinstance(event, PayloadReceived):
                envelope = decode_envelope(event.payload)
                assert not isinstance(envelope, EnvelopeFault)
                self.said.append(envelope)
                if self.confirms:
                    self.link.confirm(event.receipt)

    def ask(self, payload: bytes) -> None:
        self.link.send(payload, now_ns=self.now_ms * MS)


def bench(wire: Wire) -> Bench:
    made = Bench(dongle=CCoordinator(wire))
    made.link.open(session=9, now_ns=0)
    made.run(2)
    return made


def test_a_dongle_that_starts_asks_for_a_session_and_says_who_it_is(wire: Wire) -> None:
    dongle = CCoordinator(wire)
    assert dongle.take_bytes() == encode_frame(bytes([6, 0, 0, 0]))
    desk = opened(wire)

    assert HostOpened() in desk.events
    assert {event.hello for event in desk.events if isinstance(event, CoordinatorIdentified)} == {HELLO}
    assert desk.dongle.is_open
    assert desk.host.faults == {}


def test_payloads_go_up_in_order_and_down_with_their_outcome(wire: Wire) -> None:
    desk = opened(wire)
    up = [bytes([n]) * 57 for n in range(30)]
    for payload in up:
        assert desk.dongle.take_from_radio(payload, source=NODE, rssi_dbm=-61, lqi=200)
    tickets = [desk.host.send(destination=NODE, payload=bytes([n]) * 57, now_ns=desk.now_ms * MS) for n in range(12)]

    desk.run(10)

    assert desk.heard() == up
    sent = desk.dongle.take_sent()
    assert [one.payload for one in sent] == [bytes([n]) * 57 for n in range(12)]
    assert {one.destination for one in sent} == {NODE}
    for index, one in enumerate(sent):
        desk.dongle.confirm(one.handle, RadioStatus.NO_ACK if index % 2 else RadioStatus.SENT)
    desk.run(5)
    assert desk.settled() == {ticket: int(RadioStatus.NO_ACK if index % 2 else RadioStatus.SENT) for index, ticket in enumerate(tickets)}


def test_a_radio_that_is_full_says_so(wire: Wire) -> None:
    """The core lets its radio hold 16 payloads; a radio may have room for fewer."""
    for room, held in ((3, 3), (64, 16)):
        desk = opened(wire)
        desk.dongle.set_radio_room(room)
        tickets = [desk.host.send(destination=NODE, payload=b"x", now_ns=desk.now_ms * MS) for _ in range(20)]

        desk.run(10)

        assert desk.settled() == {ticket: int(RadioStatus.QUEUE_FULL) for ticket in tickets[held:]}
        for one in desk.dongle.take_sent():
            desk.dongle.confirm(one.handle, RadioStatus.SENT)
        desk.run(5)
        assert desk.settled() == {
            ticket: int(RadioStatus.QUEUE_FULL if at >= held else RadioStatus.SENT) for at, ticket in enumerate(tickets)
        }


def test_a_payload_that_is_too_long_or_empty_is_refused_with_its_handle(wire: Wire) -> None:
    line = bench(wire)
    line.said.clear()
    for handle, size in ((1, 58), (2, 235), (3, 0), (4, 57)):
        line.ask(encode_envelope(RadioSend(handle=handle, destination=NODE, payload=bytes(size))))

    line.run(5)

    assert line.said == [
        RadioConfirm(handle=1, status=RadioStatus.TOO_LONG),
        RadioConfirm(handle=2, status=RadioStatus.TOO_LONG),
        RadioConfirm(handle=3, status=RadioStatus.OTHER),
    ]
    assert [len(one.payload) for one in line.dongle.take_sent()] == [57]


def test_the_network_is_set_as_asked_or_not_at_all(wire: Wire) -> None:
    line = bench(wire)
    line.said.clear()
    for wish in (
        ConfigureCoordinator(token=1, pan_id=0x1111, channel=26, permit_join_s=60),
        ConfigureCoordinator(token=2, pan_id=0x2222, channel=27),
        ConfigureCoordinator(token=3),
    ):
        line.ask(encode_envelope(wish))

    line.run(5)

    assert line.said == [
        CoordinatorConfigured(token=1, result=0, pan_id=0x1111, channel=26, permit_join_s=60),
        CoordinatorConfigured(token=2, result=1, pan_id=0x1111, channel=26, permit_join_s=60),
        CoordinatorConfigured(token=3, result=0, pan_id=0x1111, channel=26, permit_join_s=60),
    ]


def test_joined_nodes_and_log_lines_are_told(wire: Wire) -> None:
    line = bench(wire)
    line.said.clear()
    assert line.dongle.node_joined(NODE, 0x00124B0000000042)
    assert line.dongle.log(level=2, code=7, text="é".encode() * 29)
    assert not line.dongle.log(level=2, code=7, text=b"x" * 59)
    assert not line.dongle.log(level=4, code=7, text=b"")

    line.run(5)

    assert line.said == [NodeJoined(address=NODE, eui64=0x00124B0000000042), CoordinatorLog(level=2, code=7, text="é" * 29)]


def test_what_makes_no_sense_is_counted_and_answers_nothing(wire: Wire) -> None:
    line = bench(wire)
    line.said.clear()
    for payload in (b"", b"\x99", b"\x20\x01", encode_envelope(HELLO), encode_envelope(RadioConfirm(handle=1, status=0))):
        line.ask(payload)

    line.run(5)

    assert line.said == []
    assert line.dongle.counters()["bad_envelopes"] == 5
    assert line.link.state is LinkState.OPEN


def test_a_full_queue_refuses_the_radio_and_loses_nothing_that_it_took(wire: Wire) -> None:
    """While no base station is there, the dongle takes what fits, and leaves the rest to the backpacks.

    Of 4096 bytes, 16 confirmations of 4 and 16 answers of 16 are reserved; all have 3 bytes more in this build, with its tags: 416. A heard
    payload of 57 takes 65, so 56 fit.
    """
    desk = Desk(dongle=CCoordinator(wire))
    taken = [bytes([n]) * 57 for n in range(100) if desk.dongle.take_from_radio(bytes([n]) * 57, source=NODE, rssi_dbm=-50, lqi=1)]
    assert taken == [bytes([n]) * 57 for n in range(56)]

    desk.open()
    desk.run(20)

    assert desk.heard() == taken
    assert desk.dongle.counters()["refused_payloads"] == 44
    assert desk.dongle.take_from_radio(b"again", source=NODE, rssi_dbm=-50, lqi=1)


def test_a_base_station_whose_disk_stalls_can_still_stop_a_biobot(wire: Wire) -> None:
    desk = opened(wire)
    desk.confirms = False
    while desk.dongle.take_from_radio(bytes(57), source=NODE, rssi_dbm=-50, lqi=1):
        desk.run(1)
    ticket = desk.host.send(destination=NODE, payload=b"stop", now_ns=desk.now_ms * MS, is_urgent=True)

    desk.run(3)

    assert [one.payload for one in desk.dongle.take_sent()] == [b"stop"]
    assert ticket not in desk.settled()  # its outcome waits behind what the disk has not taken


def test_no_answer_is_lost_to_a_base_station_that_asks_and_acknowledges_nothing(wire: Wire) -> None:
    line = bench(wire)
    line.said.clear()
    line.confirms = False
    for handle in range(2_000):
        line.ask(encode_envelope(RadioSend(handle=handle, destination=NODE, payload=bytes(58))))
    line.run(200)
    assert line.link.state is LinkState.OPEN

    line.confirms = True
    line.link.confirm(10_000)
    line.run(2_000)

    assert [envelope.handle for envelope in line.said if isinstance(envelope, RadioConfirm)] == list(range(2_000))


def test_a_slow_line_gets_whole_frames_and_nothing_is_lost(wire: Wire) -> None:
    """115,200 baud carry 576 bytes in a step; here it is 80, and less than a frame at times."""
    desk = opened(wire)
    up = [bytes([n]) * 57 for n in range(20)]
    for payload in up:
        desk.dongle.take_from_radio(payload, source=NODE, rssi_dbm=-61, lqi=200)
    for step in range(400):
        desk.dongle.set_uart_room(80 if step % 3 else 60)
        desk.run(1)

    assert desk.heard() == up
    assert not any(name.startswith("frame.") for name in desk.host.faults)


def test_a_dongle_that_restarts_in_the_middle_is_opened_anew(wire: Wire) -> None:
    desk = opened(wire)
    desk.dongle.take_from_radio(b"before", source=NODE, rssi_dbm=-61, lqi=200)
    desk.run(2)
    desk.reopens = True
    desk.dongle.restart()

    desk.run(3)
    desk.dongle.take_from_radio(b"after", source=NODE, rssi_dbm=-61, lqi=200)
    desk.run(3)

    assert [event.why for event in desk.events if isinstance(event, HostLost)] == [LostWhy.RESTARTED]
    assert desk.heard() == [b"before", b"after"]


@given(st.binary(max_size=600), st.binary(max_size=600))
def test_garbage_on_the_line_costs_time_and_nothing_else(wire: Wire, to_dongle: bytes, to_host: bytes) -> None:
    desk = opened(wire)
    desk.dongle.take_from_radio(b"first", source=NODE, rssi_dbm=-61, lqi=200)
    desk.dongle.feed(to_dongle)
    desk.note(desk.host.feed(to_host, now_ns=desk.now_ms * MS))
    ticket = desk.host.send(destination=NODE, payload=b"down", now_ns=desk.now_ms * MS)
    desk.run(40)
    for one in desk.dongle.take_sent():
        desk.dongle.confirm(one.handle, RadioStatus.SENT)
    desk.run(20)

    assert desk.heard() == [b"first"]
    assert desk.settled() == {ticket: int(RadioStatus.SENT)}


@given(st.lists(st.sampled_from((0, 0, 0, 0, 0, 0, 1, 0x80, 0xFF)), max_size=150))
def test_damaged_bytes_lose_no_payload_and_bring_none_twice(wire: Wire, damage: list[int]) -> None:
    """A byte in 40 may be damaged, in acknowledgements too.

    A host that gives up opens again, and may then hear some a second time, which the backpacks' sequence numbers sort out.
    """
    desk = opened(wire)
    desk.damage = deque(damage)
    up = [bytes([n]) * 30 for n in range(25)]
    for payload in up:
        assert desk.dongle.take_from_radio(payload, source=NODE, rssi_dbm=-61, lqi=200)
    desk.reopens = True

    desk.run(300)

    if any(isinstance(event, HostLost) for event in desk.events):
        assert set(desk.heard()) == set(up)
    else:
        assert desk.heard() == up
    assert [event.received for event in desk.events if isinstance(event, PayloadHeard)][:1] == [
        RadioReceived(source=NODE, rssi_dbm=-61, lqi=200, payload=up[0])  # type: ignore[arg-type]  # a plain integer
    ]
