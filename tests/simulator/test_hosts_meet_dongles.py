"""Laws of every dialect, in memory: the base station's host at one end of a line, the virtual dongle at the other."""

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.crc import append_crc, strip_crc
from firmware_protocol.dialects.choice import make_host
from firmware_protocol.dialects.interface import CoordinatorIdentified, Host, HostEvent, HostLost, HostOpened, PayloadHeard, SendSettled
from firmware_protocol.envelope import BROADCAST_ADDRESS, RadioReceived, RadioStatus
from firmware_protocol.errors import EncodeError
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from firmware_protocol.units import BROADCAST, RssiDbm, ShortAddress
from simulator.dongles.choice import DONGLES, host_dialect, make_dongle
from simulator.dongles.interface import Dongle

MS = 1_000_000
NODE = ShortAddress(0x1234)
EUI64 = 0x00124B00000000AA
PAYLOADS = st.binary(min_size=1, max_size=MAX_RADIO_PAYLOAD)

every_dialect = pytest.mark.parametrize("dialect", DONGLES)


class Line:
    """A host and a dongle with a line between them that spoils the bytes whose turn is in ``spoiled``; a lost host is opened again."""

    def __init__(self, dialect: str, *, spoiled: dict[int, int] | None = None, answers: RadioStatus = RadioStatus.SENT) -> None:
        self.host: Host = make_host(host_dialect(dialect))
        self.dongle: Dongle = make_dongle(dialect, index=0)
        self.now_ns = 0
        self.n_opened = 0
        self.identified: list[CoordinatorIdentified] = []
        self.heard: list[RadioReceived] = []
        self.settled: dict[int, int] = {}
        self.dropped: Counter[int] = Counter()
        self.sent: list[tuple[int, bytes]] = []
        self.lost: list[HostLost] = []
        self._answers = answers
        self._spoiled = spoiled or {}
        self._n_carried = 0
        self._session = 0
        self.dongle.start(now_ns=0)
        self.dongle.node_joined(NODE, eui64=EUI64, now_ns=0)
        self.take(self.host.open(session=0, now_ns=0))

    def run(self, for_ms: int, *, step_ms: int = 10) -> None:
        for _ in range(for_ms // step_ms):
            self.now_ns += step_ms * MS
            deadline_ns = self.host.next_deadline_ns()
            if deadline_ns is not None and deadline_ns <= self.now_ns:
                self.take(self.host.handle_deadline(now_ns=self.now_ns))
            for frame in self.host.take_frames():
                self.dongle.feed(self._carry(frame), now_ns=self.now_ns)
            due_ns = self.dongle.next_deadline_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self.dongle.handle_deadline(now_ns=self.now_ns)
            while self.dongle.requests:
                request = self.dongle.requests.popleft()
                self.sent.append((request.destination, request.payload))
                self.dongle.confirm(request.handle, self._answers, now_ns=self.now_ns)
            self.take(self.host.feed(self._carry(self.dongle.take_bytes()), now_ns=self.now_ns))

    def write_one(self) -> bool:
        """Carry the host's next frame to the dongle, which says nothing yet; return whether there was one."""
        frames = self.host.take_frames(at_most=1)
        for frame in frames:
            self.dongle.feed(self._carry(frame), now_ns=self.now_ns)
        return bool(frames)

    def run_until_open(self, *, within_ms: int = 120_000) -> None:
        for _ in range(within_ms // 100):
            if self.host.is_open:
                return
            self.run(100)
        pytest.fail(f"the host did not open within {within_ms} ms: {self.lost}")

    def take(self, events: list[HostEvent]) -> None:
        for event in events:
            match event:
                case HostOpened():
                    self.n_opened += 1
                case CoordinatorIdentified():
                    self.identified.append(event)
                case PayloadHeard(received=received, receipt=receipt):
                    self.heard.append(received)
                    self.host.confirm(receipt)
                case SendSettled(ticket=ticket, status=status):
                    assert ticket not in self.settled, "a payload's fate is told once"
                    assert ticket not in self.dropped
                    self.settled[ticket] = status
                case HostLost(dropped=dropped):
                    self.lost.append(event)
                    self.dropped.update(dropped)
                    self._session += 1
                    self.take(self.host.open(session=self._session, now_ns=self.now_ns))
                case _:
                    pass

    def offer(self, payload: bytes) -> bool:
        received = RadioReceived(source=NODE, rssi_dbm=RssiDbm(-60), lqi=90, payload=payload)
        return self.dongle.take_from_radio(received, eui64=EUI64, now_ns=self.now_ns)

    def _carry(self, data: bytes) -> bytes:
        carried = bytearray(data)
        for at in range(len(data)):
            carried[at] ^= self._spoiled.get(self._n_carried + at, 0)
        self._n_carried += len(data)
        return bytes(carried)


@every_dialect
def test_a_dongle_opens_and_says_who_it_is(dialect: str) -> None:
    line = Line(dialect)
    line.run_until_open()
    line.run(1_000)
    hello = line.identified[-1].hello
    assert hello.max_radio_payload >= MAX_RADIO_PAYLOAD
    assert 11 <= hello.channel <= 26
    assert hello.eui64 >> 40 in {0x00124B, 0x0013A2}  # Texas Instruments, Digi
    assert hello.pan_id == 0xB10B
    assert line.dongle.is_open
    assert not line.lost


@every_dialect
@settings(max_examples=10)
@given(payloads=st.lists(PAYLOADS, max_size=30))
def test_what_is_heard_comes_up_once_as_it_was_and_in_order(dialect: str, payloads: list[bytes]) -> None:
    line = Line(dialect)
    line.run_until_open()
    for payload in payloads:
        assert line.offer(payload)
        line.run(20)
    line.run(500)
    assert [one.payload for one in line.heard] == payloads
    assert {one.source for one in line.heard} <= {NODE}


@every_dialect
@settings(max_examples=5)
@given(payloads=st.lists(PAYLOADS, min_size=1, max_size=12), status=st.sampled_from([RadioStatus.SENT, RadioStatus.NO_ACK]))
def test_every_payload_sent_goes_out_once_and_its_fate_comes_back(dialect: str, payloads: list[bytes], status: RadioStatus) -> None:
    line = Line(dialect, answers=status)
    line.run_until_open()
    tickets = [line.host.send(destination=NODE, payload=payload, now_ns=line.now_ns) for payload in payloads]
    line.run(3_000)
    assert line.sent == [(NODE, payload) for payload in payloads]
    assert line.settled == dict.fromkeys(tickets, status)


@every_dialect
def test_an_urgent_payload_goes_ahead_of_those_that_wait(dialect: str) -> None:
    line = Line(dialect)
    line.run_until_open()
    for index in range(30):
        line.host.send(destination=NODE, payload=b"%d" % index, now_ns=line.now_ns)
    line.host.send(destination=NODE, payload=b"stop", now_ns=line.now_ns, is_urgent=True)
    line.run(5_000)
    assert len(line.sent) == 31
    assert [payload for _, payload in line.sent].index(b"stop") <= 4


@every_dialect
def test_a_payload_that_is_forgotten_before_it_was_written_is_not_sent(dialect: str) -> None:
    line = Line(dialect)
    line.run_until_open()
    line.run(1000)
    tickets = [line.host.send(destination=NODE, payload=b"%d" % number, now_ns=line.now_ns) for number in range(30)]
    for ticket in tickets[20:25]:
        line.host.forget(ticket)
    line.run(3000)
    assert [payload for _, payload in line.sent] == [b"%d" % number for number in range(30) if number not in range(20, 25)]
    assert not set(tickets[20:25]) & line.settled.keys()


@every_dialect
def test_an_urgent_payload_is_the_next_one_whatever_the_host_holds_ready(dialect: str) -> None:
    line = Line(dialect)
    line.run_until_open()
    line.run(1_000)
    for i in range(40):
        line.host.send(destination=NODE, payload=b"%d" % i, now_ns=line.now_ns)
    n_written = 0
    for _ in range(3):
        n_written += line.write_one()
    line.host.send(destination=NODE, payload=b"STOP", now_ns=line.now_ns, is_urgent=True)
    line.host.send(destination=NODE, payload=b"STOP too", now_ns=line.now_ns, is_urgent=True)
    line.run(2_000)
    said = [payload for _, payload in line.sent]
    assert said.index(b"STOP") == n_written, "it waits for what was on the line, for nothing else"
    assert said.index(b"STOP too") == n_written + 1
    assert len(said) == 42


@every_dialect
def test_an_urgent_broadcast_goes_ahead_of_urgent_payloads_to_single_biobots(dialect: str) -> None:
    line = Line(dialect)
    line.run_until_open()
    line.run(1_000)
    for i in range(6):
        line.host.send(destination=NODE, payload=b"%d" % i, now_ns=line.now_ns)
    n_written = int(line.write_one())
    for i in range(5):
        line.host.send(destination=NODE, payload=b"STOP %d" % i, now_ns=line.now_ns, is_urgent=True)
    n_written += line.write_one()
    line.host.send(destination=BROADCAST, payload=b"ALL", now_ns=line.now_ns, is_urgent=True)
    line.run(3_000)
    said = [payload for _, payload in line.sent]
    assert said.index(b"ALL") == n_written, "it waits for what was on the line, for nothing else"
    assert [payload for payload in said if payload.startswith(b"STOP")] == [b"STOP %d" % i for i in range(5)]
    assert len(said) == 12


@every_dialect
@settings(max_examples=8)
@given(data=st.data())
def test_what_is_withdrawn_never_goes_out_and_all_else_does_once(dialect: str, data: st.DataObject) -> None:
    """Whatever is sent, urgent or not, written one by one, and withdrawn, at any moment."""
    line = Line(dialect)
    line.run_until_open()
    line.run(1_000)
    sent: dict[int, bytes] = {}
    withdrawn: set[int] = set()
    for i in range(data.draw(st.integers(1, 30))):
        match data.draw(st.sampled_from(("send", "urgent", "broadcast", "withdraw", "write", "run"))):
            case "withdraw" if sent:
                ticket = data.draw(st.sampled_from(sorted(sent)))
                if line.host.withdraw(ticket):
                    assert ticket not in withdrawn
                    withdrawn.add(ticket)
            case "write":
                line.write_one()
            case "run":
                line.run(20)
            case kind:
                payload = b"%d" % i
                to = BROADCAST if kind == "broadcast" else NODE
                sent[line.host.send(destination=to, payload=payload, now_ns=line.now_ns, is_urgent=kind != "send")] = payload
    line.run(3_000)
    assert not line.lost
    assert sorted(payload for _, payload in line.sent) == sorted(payload for ticket, payload in sent.items() if ticket not in withdrawn)
    assert set(line.settled) == set(sent) - withdrawn


@every_dialect
def test_a_broadcast_goes_out_as_one(dialect: str) -> None:
    line = Line(dialect)
    line.run_until_open()
    ticket = line.host.send(destination=BROADCAST_ADDRESS, payload=b"all", now_ns=line.now_ns)
    line.run(1_000)
    assert line.sent == [(BROADCAST_ADDRESS, b"all")]
    assert line.settled == {ticket: RadioStatus.SENT}


@every_dialect
def test_a_payload_that_is_too_long_is_refused_at_once(dialect: str) -> None:
    line = Line(dialect)
    line.run_until_open()
    with pytest.raises(EncodeError, match="58"):
        line.host.send(destination=NODE, payload=bytes(MAX_RADIO_PAYLOAD + 1), now_ns=line.now_ns)


@every_dialect
def test_a_dongle_that_starts_anew_is_noticed_and_opened_again(dialect: str) -> None:
    line = Line(dialect)
    line.run_until_open()
    line.run(1_000)
    line.dongle.start(now_ns=line.now_ns)
    while line.n_opened < 2 and line.now_ns < 90_000 * MS:
        line.run(100)
    assert line.n_opened >= 2
    line.run(3_000)
    assert line.offer(b"after")
    line.run(500)
    assert line.heard[-1].payload == b"after"


@every_dialect
@settings(max_examples=15, deadline=None)
@given(
    spoiled=st.dictionaries(st.integers(0, 8_000), st.integers(1, 255), max_size=120),
    payloads=st.lists(st.binary(max_size=MAX_RADIO_PAYLOAD - 2).map(append_crc), unique=True, min_size=1, max_size=30),
)
def test_noise_never_alters_a_payload_and_never_doubles_a_fate_and_the_line_heals(
    dialect: str, spoiled: dict[int, int], payloads: list[bytes]
) -> None:
    """What passes a dongle's checksum of 8 bits by chance is caught by the CRC-16 that every message ends with."""
    line = Line(dialect, spoiled=spoiled)
    line.run_until_open()
    for payload in payloads:
        if line.host.is_open:
            line.host.send(destination=NODE, payload=payload, now_ns=line.now_ns)
        line.offer(payload)
        line.run(50)
    line.run(40_000, step_ms=50)
    line.run_until_open()
    assert {one.payload for one in line.heard if strip_crc(one.payload) is not None} <= {*payloads}
    unspoiled = line._n_carried > max(spoiled, default=0)
    if unspoiled:
        before = len(line.heard)
        assert line.offer(b"healed")
        line.run(1_000)
        assert [one.payload for one in line.heard[before:]][-1:] == [b"healed"]


@every_dialect
@settings(max_examples=60)
@given(chunks=st.lists(st.binary(max_size=300), max_size=8))
def test_no_bytes_from_a_line_raise_at_either_end(dialect: str, chunks: list[bytes]) -> None:
    line = Line(dialect)
    for chunk in chunks:
        line.take(line.host.feed(chunk, now_ns=line.now_ns))
        line.dongle.feed(chunk, now_ns=line.now_ns)
        line.run(20)
