"""Laws of the virtual XBee, alone and with our host at the other end of a line that damages what it carries."""

import random
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.crc import append_crc, strip_crc
from firmware_protocol.dialects.interface import HostEvent, HostLost, HostOpened, PayloadHeard, SendSettled
from firmware_protocol.dialects.xbee import XBeeHost
from firmware_protocol.dialects.xbee_frames import (
    AT_BAD_COMMAND,
    AT_BAD_PARAMETER,
    AT_ERROR,
    AT_OK,
    BROADCAST64,
    UNKNOWN16,
    UNKNOWN64,
    AtCommand,
    AtResponse,
    Endpoints,
    Frame,
    ModemStatus,
    NodeIdentification,
    Receive,
    ToModule,
    TransmitRequest,
    TransmitStatus,
    XBeeFault,
    decode_xbee,
    encode_xbee,
)
from firmware_protocol.envelope import BROADCAST_ADDRESS, RadioReceived, RadioStatus
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.framing.xbee import encode_frame, make_decoder
from firmware_protocol.units import NS_PER_MS, RssiDbm, ShortAddress
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from simulator.dongles.xbee import XBeeDongle, XBeeDongleConfig

NODE, EUI64 = ShortAddress(0x7D84), 0x0013A20040522BAA
every_mode = pytest.mark.parametrize("dongle", ["xbee", "xbee-ap1", "xbee-ap0"])


def received(payload: bytes) -> RadioReceived:
    return RadioReceived(source=NODE, rssi_dbm=RssiDbm(-50), lqi=100, payload=payload)


def spoil(data: bytes, kind: str, rng: random.Random, share: float) -> bytes:
    carried = bytearray()
    for byte in data:
        if rng.random() >= share:
            carried.append(byte)
            continue
        match kind:
            case "flip":
                carried.append(byte ^ 1 << rng.randrange(8))
            case "insert":
                carried += bytes([rng.randrange(256), byte])
            case _:
                pass
    return bytes(carried)


@dataclass
class Wire:
    """Our host and a module; ``carry`` does to bytes what the line does to them. A lost host is opened again."""

    dongle: Dongle
    carry: Callable[[bytes], bytes] = lambda data: data
    host: XBeeHost = field(default_factory=XBeeHost)
    now_ns: int = 0
    n_opened: int = 0
    heard: list[bytes] = field(default_factory=list)
    fates: dict[int, str] = field(default_factory=dict)
    sent: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.dongle.start(now_ns=0)
        self.dongle.node_joined(NODE, eui64=EUI64, now_ns=0)
        self.take(self.host.open(session=0, now_ns=0))

    def run(self, for_ms: int, *, step_ms: int = 10) -> None:
        for _ in range(for_ms // step_ms):
            self.now_ns += step_ms * NS_PER_MS
            due_ns = self.host.next_deadline_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self.take(self.host.handle_deadline(now_ns=self.now_ns))
            for frame in self.host.take_frames():
                self.dongle.feed(self.carry(frame), now_ns=self.now_ns)
            due_ns = self.dongle.next_deadline_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self.dongle.handle_deadline(now_ns=self.now_ns)
            while self.dongle.requests:
                request = self.dongle.requests.popleft()
                self.sent.append(request.payload)
                self.dongle.confirm(request.handle, RadioStatus.SENT, now_ns=self.now_ns)
            self.take(self.host.feed(self.carry(self.dongle.take_bytes()), now_ns=self.now_ns))

    def run_until_open(self, *, within_ms: int = 60_000) -> None:
        before_ns = self.now_ns
        while not self.host.is_open:
            self.run(50)
            assert self.now_ns - before_ns < within_ms * NS_PER_MS, "the host opens in the end"

    def take(self, events: list[HostEvent]) -> None:
        for event in events:
            match event:
                case HostOpened():
                    self.n_opened += 1
                case PayloadHeard(received=one):
                    self.heard.append(one.payload)
                case SendSettled(ticket=ticket):
                    assert ticket not in self.fates, "a payload's fate is told once"
                    self.fates[ticket] = "settled"
                case HostLost(dropped=dropped):
                    for ticket in dropped:
                        assert ticket not in self.fates, "a payload's fate is told once"
                        self.fates[ticket] = "dropped"
                    self.take(self.host.open(session=0, now_ns=self.now_ns))
                case _:
                    pass


@every_mode
def test_our_host_opens_a_module_in_any_mode_and_both_directions_work(dongle: str) -> None:
    wire = Wire(make_dongle(dongle, index=0))
    wire.run_until_open(within_ms=5_000)
    assert wire.dongle.take_from_radio(received(b"\x7e\x7d\x11\x13up"), eui64=EUI64, now_ns=wire.now_ns)
    ticket = wire.host.send(destination=NODE, payload=b"\x7e\x7d\x11\x13down", now_ns=wire.now_ns)
    wire.run(200)
    assert wire.heard == [b"\x7e\x7d\x11\x13up"]
    assert wire.sent == [b"\x7e\x7d\x11\x13down"]
    assert wire.fates == {ticket: "settled"}
    assert wire.dongle.is_open


@every_mode
def test_a_module_that_is_reset_is_opened_again_even_if_it_forgets_its_mode(dongle: str) -> None:
    wire = Wire(make_dongle(dongle, index=0))
    wire.run_until_open()
    wire.dongle.start(now_ns=wire.now_ns)
    wire.run(8_000)
    wire.run_until_open(within_ms=5_000)
    assert wire.n_opened == 2


@every_mode
def test_a_module_left_in_the_middle_of_a_frame_is_brought_back(dongle: str) -> None:
    module = make_dongle(dongle, index=0)
    wire = Wire(module)
    module.feed(b"\x7e\x01\x08\x10\x02half a frame", now_ns=0)
    wire.run_until_open(within_ms=15_000)


@pytest.mark.parametrize("kind", ["flip", "drop", "insert"])
@every_mode
@settings(max_examples=5)
@given(seed=st.integers(0, 10_000))
def test_on_a_line_that_damages_much_every_payload_has_one_fate_and_none_is_altered(dongle: str, kind: str, seed: int) -> None:
    """One byte in 300: a frame of 30 bytes in ten. What the checksum of 8 bits lets pass is caught by the messages' CRC-16."""
    rng = random.Random(seed)
    is_bad = True
    wire = Wire(make_dongle(dongle, index=0), carry=lambda data: spoil(data, kind, rng, 1 / 300) if is_bad else data)
    ups = [append_crc(b"up%d" % index) for index in range(40)]
    downs = [append_crc(b"down%d" % index) for index in range(40)]
    tickets = []
    for up, down in zip(ups, downs, strict=True):
        wire.run_until_open()
        tickets.append(wire.host.send(destination=NODE, payload=down, now_ns=wire.now_ns))
        wire.dongle.take_from_radio(received(up), eui64=EUI64, now_ns=wire.now_ns)
        wire.run(60)
    is_bad = False
    wire.run(20_000, step_ms=50)
    wire.run_until_open()
    assert set(wire.fates) == set(tickets)
    intact = [payload for payload in wire.heard if strip_crc(payload) is not None]
    assert set(intact) <= set(ups)
    assert len(intact) >= 20
    assert {payload for payload in wire.sent if strip_crc(payload) is not None} <= set(downs)


@dataclass
class Bench:
    """A module, and somebody who says frames to it and reads what it says."""

    config: XBeeDongleConfig = field(default_factory=XBeeDongleConfig)
    now_ns: int = 0

    def __post_init__(self) -> None:
        self.dongle = XBeeDongle(config=self.config)
        self.dongle.start(now_ns=0)
        self._decoder = make_decoder(is_escaped=self.config.memory.get("AP") == 2)

    def say(self, *frames: ToModule) -> list[Frame]:
        for frame in frames:
            self.dongle.feed(encode_frame(encode_xbee(frame), is_escaped=self.config.memory.get("AP") == 2), now_ns=self.now_ns)
        return self.hear()

    def at(self, command: str, value: bytes = b"", *, is_queued: bool = False) -> AtResponse:
        (answer,) = self.say(AtCommand(frame_id=7, command=command, value=value, is_queued=is_queued))
        assert isinstance(answer, AtResponse)
        assert (answer.frame_id, answer.command) == (7, command)
        return answer

    def hear(self) -> list[Frame]:
        frames = []
        for body in self._decoder.feed(self.dongle.take_bytes()):
            assert not isinstance(body, FrameFault)
            frame = decode_xbee(body)
            assert not isinstance(frame, XBeeFault)
            frames.append(frame)
        return frames

    def wait(self, for_ms: int) -> list[Frame]:
        for _ in range(for_ms // 10):
            self.now_ns += 10 * NS_PER_MS
            due_ns = self.dongle.next_deadline_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self.dongle.handle_deadline(now_ns=self.now_ns)
        return self.hear()

    def text(self, said: bytes, *, wait_ms: int = 0) -> bytes:
        self.dongle.feed(said, now_ns=self.now_ns)
        answer = self.dongle.take_bytes()
        for _ in range(wait_ms // 10):
            self.now_ns += 10 * NS_PER_MS
            due_ns = self.dongle.next_deadline_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self.dongle.handle_deadline(now_ns=self.now_ns)
            answer += self.dongle.take_bytes()
        return answer


def a_formed_bench(**memory: int) -> Bench:
    bench = Bench(XBeeDongleConfig(memory={"AP": 2, "CE": 1} | memory))
    assert bench.wait(500) == [ModemStatus(status=0), ModemStatus(status=6)]
    return bench


def test_a_module_says_that_it_starts_and_then_that_its_network_does() -> None:
    bench = Bench()
    assert bench.at("AI").value == b"\xff" if not bench.hear() else True
    bench = a_formed_bench()
    assert bench.at("AI").value == b"\0"
    assert bench.at("OI").value == b"\xb1\x0b"
    assert bench.at("MY").value == b"\0\0"


def test_a_router_finds_no_network_here() -> None:
    bench = Bench(XBeeDongleConfig(memory={"AP": 2, "CE": 0}))
    assert bench.wait(500) == [ModemStatus(status=0)]
    assert bench.at("AI").value == b"\x21"
    assert bench.at("MY").value == b"\xff\xfe"
    assert not bench.dongle.take_from_radio(received(b"x"), eui64=EUI64, now_ns=bench.now_ns)
    assert bench.say(TransmitRequest(frame_id=1, destination64=EUI64, destination16=NODE, payload=b"x")) == [
        TransmitStatus(frame_id=1, destination16=0xFFFD, retries=0, delivery=0x22, discovery=0)
    ]
    assert bench.at("CE", b"\1").status == AT_OK
    assert bench.wait(500) == [ModemStatus(status=6)]


def test_parameters_are_read_set_and_checked() -> None:
    bench = a_formed_bench()
    assert bench.at("NI").value == b"BASE"
    assert bench.at("NI", b"ROOF").status == AT_OK
    assert bench.at("NI").value == b"ROOF"
    assert bench.at("NI", b"\x07").status == AT_BAD_PARAMETER
    assert bench.at("BD", b"\7").status == AT_OK
    assert bench.at("BD").value == b"\0\0\0\7"
    assert bench.at("AO", b"\4").status == AT_BAD_PARAMETER
    assert bench.at("SH", b"\0").status == AT_ERROR
    assert bench.at("ZZ").status == AT_BAD_COMMAND
    assert bench.at("ZZ", b"\1").status == AT_BAD_COMMAND


def test_what_was_written_survives_a_reset_and_what_was_not_does_not() -> None:
    bench = a_formed_bench()
    bench.at("NI", b"KEPT")
    bench.at("WR")
    bench.at("NI", b"LOST")
    answer, *_ = bench.say(AtCommand(frame_id=1, command="FR"))
    assert answer == AtResponse(frame_id=1, command="FR", status=AT_OK)
    assert bench.wait(500) == [ModemStatus(status=0), ModemStatus(status=6)]
    assert bench.at("NI").value == b"KEPT"
    bench.at("RE")
    assert bench.dongle.settings.read("NI") == b" "


def test_a_queued_change_takes_effect_with_the_next_command_that_is_not() -> None:
    bench = a_formed_bench()
    bench.at("ID", b"\x12\x34", is_queued=True)
    assert bench.at("AI", is_queued=True).value == b"\0"
    bench.at("AC")
    assert bench.at("AI").value == b"\xff"
    assert bench.wait(500) == [ModemStatus(status=6)]
    assert bench.at("OP").value == bytes(6) + b"\x12\x34"


def test_the_mode_changes_after_the_answer() -> None:
    bench = a_formed_bench()
    assert bench.at("AP", b"\1").status == AT_OK
    bench.dongle.feed(encode_frame(encode_xbee(AtCommand(frame_id=0x11, command="AP")), is_escaped=False), now_ns=bench.now_ns)
    answer = AtResponse(frame_id=0x11, command="AP", status=AT_OK, value=b"\1")
    assert bench.dongle.take_bytes() == encode_frame(encode_xbee(answer), is_escaped=False)


def test_what_is_heard_comes_in_the_kind_of_frame_that_ao_asks_for() -> None:
    bench = a_formed_bench()
    bench.dongle.take_from_radio(received(b"one"), eui64=EUI64, now_ns=bench.now_ns)
    assert bench.hear() == [Receive(source64=EUI64, source16=NODE, options=1, payload=b"one")]
    bench.at("AO", b"\1")
    bench.dongle.take_from_radio(received(b"two"), eui64=EUI64, now_ns=bench.now_ns)
    assert bench.hear() == [Receive(source64=EUI64, source16=NODE, options=1, payload=b"two", endpoints=Endpoints())]


def test_a_node_that_joins_is_told_and_found() -> None:
    bench = a_formed_bench()
    for index in range(3):
        bench.dongle.node_joined(ShortAddress(NODE + index), eui64=EUI64 + index, now_ns=bench.now_ns)
    joined = bench.hear()
    assert [one.node16 for one in joined if isinstance(one, NodeIdentification)] == [NODE, NODE + 1, NODE + 2]
    assert bench.say(AtCommand(frame_id=9, command="ND")) == []
    found = bench.wait(500)
    assert [(one.frame_id, one.value[2:10]) for one in found if isinstance(one, AtResponse)] == [
        (9, (EUI64 + index).to_bytes(8, "big")) for index in range(3)
    ]
    name = found[1].value[10:].split(b"\0")[0] if isinstance(found[1], AtResponse) else b""
    bench.say(AtCommand(frame_id=9, command="ND", value=name))
    assert len(bench.wait(500)) == 1


def test_a_discovery_in_an_empty_network_finds_nothing() -> None:
    bench = a_formed_bench()
    assert bench.say(AtCommand(frame_id=9, command="ND")) == []
    assert bench.wait(500) == []


def test_a_network_reset_forms_the_network_anew() -> None:
    bench = a_formed_bench()
    assert bench.at("NR").status == AT_OK
    assert bench.at("AI").value == b"\xff"
    assert bench.wait(500) == [ModemStatus(status=6)]


def test_a_command_without_a_frame_id_is_obeyed_and_not_answered() -> None:
    bench = a_formed_bench()
    assert bench.say(AtCommand(frame_id=0, command="NI", value=b"MUTE")) == []
    assert bench.at("NI").value == b"MUTE"


def test_a_host_is_there_while_it_speaks() -> None:
    bench = a_formed_bench()
    seen = [bench.dongle.is_open]
    bench.at("VR")
    for wait_ms in (9_000, 2_000):
        bench.wait(wait_ms)
        seen.append(bench.dongle.is_open)
    assert seen == [False, True, False]


def test_what_a_host_should_not_say_is_counted() -> None:
    bench = a_formed_bench()
    for body in (b"\x92", b"\x10", encode_xbee(ModemStatus(status=0))):
        bench.dongle.feed(encode_frame(body, is_escaped=True), now_ns=bench.now_ns)
    bench.dongle.feed(b"\x7e\xff\xff", now_ns=bench.now_ns)
    assert bench.dongle.faults == {"unknown_frame_type": 1, "bad_frame_length": 1, "wrong_direction": 1, "too_long": 1}
    zdo = TransmitRequest(frame_id=1, destination64=UNKNOWN64, destination16=NODE, payload=b"x", endpoints=Endpoints(profile=0))
    assert [one.delivery for one in bench.say(zdo) if isinstance(one, TransmitStatus)] == [0x15]


@pytest.mark.parametrize(
    ("destination64", "destination16", "goes_to"),
    [
        (EUI64, UNKNOWN16, NODE),
        (EUI64, 0x1111, NODE),
        (UNKNOWN64, NODE, NODE),
        (BROADCAST64, UNKNOWN16, BROADCAST_ADDRESS),
        (UNKNOWN64, 0xFFFF, BROADCAST_ADDRESS),
        (UNKNOWN64, 0xFFFC, BROADCAST_ADDRESS),
        (0x0013A200AAAAAAAA, 0x2222, 0x2222),
        (0x0013A200AAAAAAAA, UNKNOWN16, 0x24),
        (UNKNOWN64, UNKNOWN16, 0x24),
        (0, UNKNOWN16, 0x23),
        (0x0013A20000000000, UNKNOWN16, 0x23),
    ],
)
def test_a_request_goes_where_its_addresses_say_or_is_refused(destination64: int, destination16: int, goes_to: int) -> None:
    bench = a_formed_bench()
    bench.dongle.node_joined(NODE, eui64=EUI64, now_ns=bench.now_ns)
    bench.hear()
    said = bench.say(TransmitRequest(frame_id=5, destination64=destination64, destination16=destination16, payload=b"x"))
    if goes_to < 0x100:
        assert said == [TransmitStatus(frame_id=5, destination16=0xFFFD, retries=0, delivery=goes_to, discovery=0)]
        assert not bench.dongle.requests
    else:
        assert [request.destination for request in bench.dongle.requests] == [goes_to]


@pytest.mark.parametrize("status", list(RadioStatus))
def test_a_confirm_becomes_the_delivery_status_of_the_requests_frame_id(status: RadioStatus) -> None:
    bench = a_formed_bench()
    for frame_id in (0, 5):
        bench.say(TransmitRequest(frame_id=frame_id, destination64=UNKNOWN64, destination16=NODE, payload=b"x"))
    for request in bench.dongle.requests:
        bench.dongle.confirm(request.handle, status, now_ns=bench.now_ns)
    (told,) = bench.hear()
    assert isinstance(told, TransmitStatus)
    assert told.frame_id == 5
    assert (told.delivery == 0) == (status is RadioStatus.SENT)


def test_what_has_no_room_is_answered_or_counted_and_memory_is_bounded() -> None:
    bench = a_formed_bench()
    for index in range(20):
        bench.dongle.feed(
            encode_frame(
                encode_xbee(TransmitRequest(frame_id=index + 1, destination64=UNKNOWN64, destination16=NODE, payload=b"x")), is_escaped=True
            ),
            now_ns=0,
        )
    assert [one.delivery for one in bench.hear() if isinstance(one, TransmitStatus)] == [0x32] * 4
    too_long = TransmitRequest(frame_id=1, destination64=UNKNOWN64, destination16=NODE, payload=bytes(85))
    assert [one.delivery for one in bench.say(too_long) if isinstance(one, TransmitStatus)] == [0x74]
    taken = sum(bench.dongle.take_from_radio(received(bytes(50)), eui64=EUI64, now_ns=0) for _ in range(1000))
    assert 50 < taken < 100
    assert bench.dongle.faults["uplink_full"] == 1000 - taken
    for _ in range(5000):
        bench.dongle.feed(encode_frame(encode_xbee(AtCommand(frame_id=1, command="VR")), is_escaped=True), now_ns=0)
    assert len(bench.dongle.take_bytes()) < 20_000
    for index in range(5000):
        bench.dongle.node_joined(ShortAddress(index), eui64=EUI64 + index, now_ns=0)
    assert len(bench.dongle._nodes) == 4096


def test_a_confirm_from_before_a_reset_is_forgotten() -> None:
    bench = a_formed_bench()
    bench.say(TransmitRequest(frame_id=5, destination64=UNKNOWN64, destination16=NODE, payload=b"x"))
    handle = bench.dongle.requests[0].handle
    bench.dongle.start(now_ns=bench.now_ns)
    bench.hear()
    bench.dongle.confirm(handle, RadioStatus.SENT, now_ns=bench.now_ns)
    assert bench.hear() == []


def test_command_mode_opens_between_two_silences_and_not_otherwise() -> None:
    bench = Bench(XBeeDongleConfig(memory={"CE": 1}))
    assert bench.text(b"ATNI\r", wait_ms=2_000) == b""
    assert bench.text(b"++", wait_ms=10) == b""
    assert bench.text(b"+", wait_ms=900) == b""
    assert bench.text(b"", wait_ms=200) == b"OK\r"
    assert bench.text(b"ATNI\r") == b"BASE\r"
    assert bench.text(b"atni roof\rATNI\r") == b"OK\rroof\r"
    assert bench.text(b"ATAO5\rATZZ\rHELLO\rATAO\r") == b"ERROR\rERROR\rERROR\r0\r"
    assert bench.text(b"ATAOx\rATND\r") == b"ERROR\rERROR\r"
    assert bench.text(b"ATVR,SL,AP,CN\rATNI\r") == b"100D\r0\r0\rOK\r"
    assert bench.text(b"ATNI\r", wait_ms=1_200) == b"", "it has left command mode, and this is data"
    assert bench.text(b"+++", wait_ms=500) == b""
    assert bench.text(b"x", wait_ms=1_500) == b"", "no silence after"
    assert bench.text(b"y+++", wait_ms=1_500) == b"", "no silence before"
    assert bench.text(b"+++", wait_ms=1_100) == b"OK\r"
    assert bench.text(b"", wait_ms=11_000) == b""
    assert bench.text(b"ATNI\r") == b"", "it ends by itself after CT"


def test_a_change_of_mode_in_command_mode_takes_effect_when_that_ends() -> None:
    bench = Bench(XBeeDongleConfig(memory={"CE": 1}))
    bench.text(b"", wait_ms=1_100)
    assert bench.text(b"+++", wait_ms=1_100) == b"OK\r"
    assert bench.text(b"ATAP2\r") == b"OK\r"
    assert bench.text(b"ATCN\r") == b"OK\r"
    question = encode_frame(encode_xbee(AtCommand(frame_id=1, command="AP")), is_escaped=True)
    answer = AtResponse(frame_id=1, command="AP", status=AT_OK, value=b"\2")
    assert bench.text(question) == encode_frame(encode_xbee(answer), is_escaped=True)


def test_in_transparent_mode_data_goes_both_ways_without_frames() -> None:
    bench = Bench(XBeeDongleConfig(memory={"CE": 1, "DL": 0xFFFF}))
    bench.text(b"", wait_ms=500)
    bench.dongle.take_from_radio(received(b"as it is"), eui64=EUI64, now_ns=bench.now_ns)
    assert bench.dongle.take_bytes() == b"as it is"
    bench.text(b"hello" * 20)
    assert [(one.destination, len(one.payload)) for one in bench.dongle.requests] == [(BROADCAST_ADDRESS, 84), (BROADCAST_ADDRESS, 16)]
    to_itself = Bench(XBeeDongleConfig(memory={"CE": 1}))
    to_itself.text(b"hello", wait_ms=500)
    assert not to_itself.dongle.requests
    assert to_itself.dongle.faults == {"transparent": 1}


@given(
    chunks=st.lists(st.binary(max_size=80) | st.sampled_from([b"+++", b"AT\r", b"ATCN\r", b"ATAP1,CN\r"]), max_size=12),
    mode=st.integers(0, 2),
)
def test_nothing_from_the_line_raises(chunks: list[bytes], mode: int) -> None:
    bench = Bench(XBeeDongleConfig(memory={"CE": 1, "AP": mode}))
    for chunk in chunks:
        bench.text(chunk, wait_ms=1_100)
    assert len(bench.dongle.take_bytes()) < 20_000
