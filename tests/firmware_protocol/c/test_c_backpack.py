"""The message side of a backpack in C, on an air that loses payloads both ways, against Python's codec at the base station."""

import ctypes
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.message_codec import decode_uplink, encode_downlink, encode_uplink
from firmware_protocol.messages import (
    Acknowledge,
    Action,
    ConfigurationRequest,
    Downlink,
    EncounterBatch,
    EncounterEntry,
    Hello,
    HelloRequest,
    MessageFault,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    TimeSyncRequest,
    Uplink,
    UplinkHeader,
    WireMode,
)
from firmware_protocol.messages import Stimulate as Command
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm
from studies.c_wire import Wire

NODE, BOOT = NodeId(77), BootId(5)
HEADER = UplinkHeader(node=NODE, boot=BOOT, sequence=0, sent_ms=Milliseconds(0))
HELLO = Hello(eui64=0x1122334455667788, firmware=0x0102, beacon_period_ms=100, capabilities=5, newest_version=1)
BODY_AT = 16  # of struct bb_uplink, behind the header, where pointers have 8 octets


def batch(number: int) -> EncounterBatch:
    entry = EncounterEntry(
        peer=NodeId(number), start_ms=Milliseconds(number), duration_ms=Milliseconds(5), rssi_dbm=RssiDbm(-60), is_ongoing=False
    )
    return EncounterBatch(entries=(entry,))


def command(number: int) -> Command:
    return Command(
        command=number, action=Action.START, ttl_ms=100, hold_ms=0, frequency_hz=50, pulse_width_us=200, amplitude_mv=900, duration_ms=300
    )


@dataclass
class Air:
    """A backpack and a base station that acknowledges what it has; payloads are lost as told, both ways; time passes in steps."""

    wire: Wire
    losses: list[bool] = field(default_factory=list)
    now_ms: int = 2**32 - 20_000
    taken: dict[int, Uplink] = field(default_factory=dict)
    others: list[tuple[UplinkHeader, Uplink]] = field(default_factory=list)
    copies: list[tuple[int, int]] = field(default_factory=list)
    acknowledges: bool = True

    def __post_init__(self) -> None:
        self.library = self.wire.library
        for name in ("report", "receive", "answer", "next_deadline"):
            getattr(self.library, f"bb_backpack_{name}").restype = ctypes.c_bool
        self.library.bb_backpack_next.restype = ctypes.c_uint8
        self.memory = ctypes.create_string_buffer(4096)
        self.payload = ctypes.create_string_buffer(57)
        self.message = ctypes.create_string_buffer(256)
        assert not isinstance(self.wire.decode_uplink(encode_uplink(HEADER, HELLO)), MessageFault)
        hello = ctypes.create_string_buffer(self.wire._memory.raw[BODY_AT : BODY_AT + 64])
        self.library.bb_backpack_start(self.memory, ctypes.c_uint16(NODE), ctypes.c_uint16(BOOT), hello)

    @property
    def now(self) -> ctypes.c_uint32:
        return ctypes.c_uint32(self.now_ms & 0xFFFF_FFFF)

    def report(self, message: Uplink) -> bool:
        assert not isinstance(self.wire.decode_uplink(encode_uplink(HEADER, message)), MessageFault)
        return bool(self.library.bb_backpack_report(self.memory, self.wire._memory, self.now))

    def tell(self, message: Downlink) -> bool:
        """Let the backpack hear a message; True: it is the owner's to answer."""
        payload = encode_downlink(3, message)
        return bool(self.library.bb_backpack_receive(self.memory, payload, ctypes.c_uint8(len(payload)), self.now, self.message))

    def answer(self, number: int, result: StimulationResult) -> bool:
        return bool(
            self.library.bb_backpack_answer(
                self.memory, ctypes.c_uint32(number), ctypes.c_uint8(result), self.now, ctypes.c_uint8(WireMode.CRW), self.now
            )
        )

    def next_deadline_ms(self) -> int | None:
        at = ctypes.c_uint32()
        is_set = self.library.bb_backpack_next_deadline(self.memory, self.now, ctypes.byref(at))
        return at.value if is_set else None

    def run(self, steps: int, *, step_ms: int = 100) -> None:
        for _ in range(steps):
            while size := self.library.bb_backpack_next(self.memory, self.now, ctypes.c_uint16(self.now_ms * 7919 % 65536), self.payload):
                self.hear(self.payload.raw[:size])
            if self.acknowledges and not self.is_lost():
                self.tell(self.acknowledgement())
            self.now_ms += step_ms

    def is_lost(self) -> bool:
        return bool(self.losses and self.losses.pop(0))

    def hear(self, payload: bytes) -> None:
        decoded = decode_uplink(payload)
        assert not isinstance(decoded, MessageFault)
        header, message = decoded
        assert (header.node, header.boot, header.sent_ms) == (NODE, BOOT, self.now_ms & 0xFFFF_FFFF)
        if isinstance(message, TimeSyncReply):
            self.others.append((header, message))
            return
        self.copies.append((header.sequence, self.now_ms))
        if not self.is_lost():
            assert self.taken.setdefault(header.sequence, message) == message

    def acknowledgement(self) -> Acknowledge:
        first = 0
        while first in self.taken:
            first += 1
        bitmap = sum(1 << i for i in range(32) if first + 1 + i in self.taken)
        return Acknowledge(boot=BOOT, next_sequence=first, bitmap=bitmap)


@given(st.lists(st.integers(0, 9).map(lambda n: n < 4), max_size=300), st.integers(0, 120))
def test_every_report_arrives_with_its_number_and_none_is_further_ahead_than_an_acknowledgement_reaches(
    wire: Wire, losses: list[bool], n_reports: int
) -> None:
    air = Air(wire, losses=losses)
    numbers = iter(range(n_reports))
    wanted = next(numbers, None)
    for _ in range(3_000):
        while wanted is not None and air.report(batch(wanted)):
            wanted = next(numbers, None)
        air.run(1)
        given_so_far = max((sequence for sequence, _ in air.copies), default=0)
        assert given_so_far - air.acknowledgement().next_sequence <= 32
        if wanted is None and len(air.taken) == n_reports + 1:
            break

    assert sorted(air.taken) == list(range(n_reports + 1))
    batches = [
        message.entries[0].peer for _, message in sorted(air.taken.items(), key=lambda item: item[0]) if isinstance(message, EncounterBatch)
    ]
    assert batches == list(range(n_reports))


def test_what_is_not_acknowledged_is_repeated_after_a_second_and_ever_more_rarely(wire: Wire) -> None:
    """Waits of 1, 2, 4, 8, 16, 30, 30 s, each times 0.75 to 1.25; looked at every 100 ms."""
    air = Air(wire, acknowledges=False)

    air.run(1_500)

    at = [moment for sequence, moment in air.copies if sequence == 0]
    waits = [later - earlier for earlier, later in pairwise(at)]
    for wait, nominal in zip(waits, (1_000, 2_000, 4_000, 8_000, 16_000, 30_000, 30_000), strict=False):
        assert 0.75 * nominal <= wait <= 1.25 * nominal + 100
    assert len(waits) >= 6
    assert len(set(waits)) > 1


def test_room_for_answers_is_kept_and_nothing_that_has_a_number_is_dropped(wire: Wire) -> None:
    """Of eight slots the hello takes one, reports may fill up to the last two."""
    air = Air(wire, acknowledges=False)
    air.run(1)
    assert [air.report(batch(number)) for number in range(7)] == [True] * 5 + [False] * 2
    assert air.tell(command(1))
    assert air.answer(1, StimulationResult.DONE)
    assert air.tell(command(2))
    assert air.answer(2, StimulationResult.REFUSED_LIMIT)
    assert air.tell(command(3))
    assert not air.answer(3, StimulationResult.DONE)
    air.run(1)
    assert sorted(air.taken) == list(range(8))

    air.acknowledges = True
    air.run(2)

    assert air.answer(3, StimulationResult.DONE)
    assert air.next_deadline_ms() == air.now_ms & 0xFFFF_FFFF
    air.run(2)
    assert len(air.taken) == 9
    assert air.next_deadline_ms() is None


def test_a_command_is_handed_out_once_and_a_repetition_is_answered(wire: Wire) -> None:
    air = Air(wire)
    assert air.tell(command(9))
    assert not air.tell(command(9))  # its owner has not answered yet
    assert air.answer(9, StimulationResult.DONE)
    assert not air.tell(command(9))
    assert air.tell(command(10))
    assert air.answer(10, StimulationResult.EXPIRED)
    assert not air.tell(command(10))

    air.run(3)

    replies = [(reply.command, reply.result) for reply in air.taken.values() if isinstance(reply, StimulateReply)]
    assert sorted(replies) == [
        (9, StimulationResult.DONE),
        (9, StimulationResult.ALREADY_DONE),
        (10, StimulationResult.EXPIRED),
        (10, StimulationResult.EXPIRED),
    ]


def test_a_command_is_forgotten_after_32_newer_ones(wire: Wire) -> None:
    air = Air(wire)
    for number in range(33):
        assert air.tell(command(number))
        assert air.answer(number, StimulationResult.DONE)
        air.run(1)

    assert not air.tell(command(1))
    assert air.tell(command(0))


def test_a_time_sync_is_answered_with_both_instants_and_not_repeated(wire: Wire) -> None:
    air = Air(wire, now_ms=1_000)
    assert not air.tell(TimeSyncRequest(token=600))
    air.now_ms = 1_250
    air.run(50)

    ((header, message),) = air.others
    assert message == TimeSyncReply(token=600, received_ms=Milliseconds(1_000))
    assert (header.sequence, header.sent_ms) == (0, 1_250)


def test_a_hello_request_brings_a_hello_and_hurries_the_rest(wire: Wire) -> None:
    air = Air(wire, acknowledges=False)
    air.report(batch(1))
    air.run(200)
    before = len(air.copies)

    air.tell(HelloRequest())
    air.run(1)

    assert [sequence for sequence, _ in air.copies[before:]] == [0, 1, 2]
    assert list(air.taken.values()).count(HELLO) == 2


@pytest.mark.parametrize(("boot", "first"), [(6, 1), (5, 3), (4, 0)])
def test_an_acknowledgement_of_another_boot_or_of_numbers_never_given_is_ignored(wire: Wire, boot: int, first: int) -> None:
    air = Air(wire, acknowledges=False)
    air.run(1)
    air.tell(Acknowledge(boot=BootId(boot), next_sequence=first, bitmap=0xFFFF_FFFF))

    air.run(20)

    assert len(air.copies) == 2


@given(st.binary(max_size=80))
def test_what_makes_no_sense_is_counted_and_changes_nothing(wire: Wire, payload: bytes) -> None:
    air = Air(wire)
    air.library.bb_backpack_receive(air.memory, payload, ctypes.c_uint8(len(payload)), air.now, air.message)

    air.run(3)

    assert list(air.taken.values()) == [HELLO]


def test_a_question_for_the_owner_is_handed_on(wire: Wire) -> None:
    assert Air(wire).tell(ConfigurationRequest(token=1))
