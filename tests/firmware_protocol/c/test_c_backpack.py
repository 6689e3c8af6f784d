"""The message side of a backpack in C, on an air that loses payloads both ways, against Python's codec at the base station."""

import ctypes
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from firmware_protocol.message_codec import decode_uplink, encode_downlink, encode_uplink
from firmware_protocol.messages import (
    Acknowledge,
    Action,
    ConfigurationReport,
    ConfigurationRequest,
    ConfigurationResult,
    Downlink,
    EncounterBatch,
    EncounterEntry,
    Hello,
    HelloRequest,
    Limits,
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
SETTINGS = ConfigurationReport(
    token=1, result=ConfigurationResult.DONE, beacon_period_ms=0, rssi_enter_dbm=RssiDbm(-128), rssi_exit_dbm=RssiDbm(-128),
    gap_tolerance_ms=0, report_period_ms=1_000,
)  # fmt: skip
LIMITS = Limits(
    channels=7, waveforms=1, max_frequency_hz=150, max_pulse_width_us=10_000, max_amplitude_mv=4_000, max_duration_ms=1_000, min_gap_ms=0,
    max_on_ms_per_minute=60_000, battery_mv=3_700, battery_empty_mv=3_000, encounter_capacity=256,
)  # fmt: skip
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
        for name in ("report", "receive", "owes_limits", "next_deadline"):
            getattr(self.library, f"bb_backpack_{name}").restype = ctypes.c_bool
        self.library.bb_backpack_next.restype = ctypes.c_uint8
        self.memory = ctypes.create_string_buffer(4096)
        self.payload = ctypes.create_string_buffer(57)
        self.message = ctypes.create_string_buffer(256)
        assert not isinstance(self.wire.decode_uplink(encode_uplink(HEADER, HELLO)), MessageFault)
        hello = ctypes.create_string_buffer(self.wire._memory.raw[BODY_AT : BODY_AT + 64])
        self.library.bb_backpack_start(self.memory, ctypes.c_uint16(NODE), ctypes.c_uint16(BOOT), hello, self.now)

    @property
    def now(self) -> ctypes.c_uint32:
        return ctypes.c_uint32(self.now_ms & 0xFFFF_FFFF)

    def report(self, message: Uplink) -> bool:
        assert not isinstance(self.wire.decode_uplink(encode_uplink(HEADER, message)), MessageFault)
        return bool(self.library.bb_backpack_report(self.memory, self.wire._memory, self.now))

    def tell(self, message: Downlink, *, is_broadcast: bool = False, chance: int = 0x8000) -> bool:
        """Let the backpack hear a message; True: it is the owner's to answer."""
        return self.tell_payload(encode_downlink(3, message), is_broadcast=is_broadcast, chance=chance)

    def tell_payload(self, payload: bytes, *, is_broadcast: bool = False, chance: int = 0x8000) -> bool:
        return bool(
            self.library.bb_backpack_receive(
                self.memory, payload, ctypes.c_uint8(len(payload)), ctypes.c_bool(is_broadcast), self.now, ctypes.c_uint16(chance),
                self.message,
            )
        )  # fmt: skip

    def answer(self, number: int, result: StimulationResult) -> None:
        self.library.bb_backpack_answer(
            self.memory, ctypes.c_uint32(number), ctypes.c_uint8(result), self.now, ctypes.c_uint8(WireMode.CRW), self.now
        )

    def describe(self, hello: Hello) -> None:
        assert not isinstance(self.wire.decode_uplink(encode_uplink(HEADER, hello)), MessageFault)
        body = ctypes.create_string_buffer(self.wire._memory.raw[BODY_AT : BODY_AT + 64])
        self.library.bb_backpack_describe(self.memory, body, self.now)

    @property
    def owes_limits(self) -> bool:
        return bool(self.library.bb_backpack_owes_limits(self.memory))

    def answers(self) -> list[tuple[int, StimulationResult]]:
        return [(reply.command, reply.result) for reply in self.taken.values() if isinstance(reply, StimulateReply)]

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


def test_room_for_answers_is_kept_and_what_has_none_is_said_when_there_is(wire: Wire) -> None:
    """Of eight slots the hello takes one, reports may fill up to the last two."""
    air = Air(wire, acknowledges=False)
    air.run(1)
    assert [air.report(batch(number)) for number in range(7)] == [True] * 5 + [False] * 2
    for number, result in ((1, StimulationResult.DONE), (2, StimulationResult.REFUSED_LIMIT), (3, StimulationResult.DONE)):
        assert air.tell(command(number))
        air.answer(number, result)
    air.run(1)
    assert sorted(air.taken) == list(range(8))
    assert air.answers() == [(1, StimulationResult.DONE), (2, StimulationResult.REFUSED_LIMIT)]

    air.acknowledges = True
    air.run(1)

    assert air.next_deadline_ms() == air.now_ms & 0xFFFF_FFFF
    air.run(2)
    assert air.answers()[2:] == [(3, StimulationResult.DONE)]
    assert len(air.taken) == 9
    assert air.next_deadline_ms() is None


@given(st.lists(st.sampled_from(["hello", "stop", "report", "settings", "time"]), max_size=60), st.booleans())
def test_nothing_that_is_said_while_nobody_acknowledges_keeps_a_stop_from_being_confirmed(
    wire: Wire, acts: list[str], is_broadcast: bool
) -> None:
    air = Air(wire, acknowledges=False)
    air.tell(command(7))
    air.answer(7, StimulationResult.DONE)
    for number, act in enumerate(acts):
        match act:
            case "hello":
                air.tell(HelloRequest(), is_broadcast=is_broadcast)
            case "stop":
                air.tell(command(7))
            case "report":
                air.report(batch(number))
            case "settings":
                air.report(SETTINGS)
            case _:
                air.run(3)
    air.tell(command(8))
    air.answer(8, StimulationResult.EXPIRED)
    air.run(20)

    assert air.answers() == [(7, StimulationResult.DONE), (8, StimulationResult.EXPIRED)]
    assert list(air.taken.values()).count(HELLO) == 1


def test_reports_leave_two_numbers_of_the_window_and_the_last_is_for_commands_alone(wire: Wire) -> None:
    """The base station has all but number 0, the hello's: slots are free, and numbers are not."""
    air = Air(wire, acknowledges=False)
    taken = 0
    while air.report(batch(taken)):
        taken += 1
        air.tell(Acknowledge(boot=BOOT, next_sequence=0, bitmap=2**32 - 1))
    assert taken == 30
    air.describe(HELLO)
    air.tell(HelloRequest())
    assert not air.report(SETTINGS)
    air.tell(command(1))
    air.answer(1, StimulationResult.DONE)
    air.run(1)
    assert sorted(air.taken) == [0, 31, 32]
    assert [type(air.taken[number]) for number in (31, 32)] == [Hello, StimulateReply]


def test_a_command_is_handed_out_once_and_a_repetition_is_answered(wire: Wire) -> None:
    """By the answer that is under way; by another once that is acknowledged."""
    air = Air(wire)
    assert air.tell(command(9))
    assert not air.tell(command(9))  # its owner has not answered yet
    air.answer(9, StimulationResult.DONE)
    assert not air.tell(command(9))
    air.run(1)
    assert not air.tell(command(9))
    assert air.tell(command(10))
    air.answer(10, StimulationResult.EXPIRED)
    air.answer(10, StimulationResult.DONE)  # decided once
    air.run(1)
    assert not air.tell(command(10))

    air.run(3)

    assert air.answers() == [
        (9, StimulationResult.DONE),
        (9, StimulationResult.ALREADY_DONE),
        (10, StimulationResult.EXPIRED),
        (10, StimulationResult.EXPIRED),
    ]


def test_a_repeated_command_brings_its_answer_again_at_once(wire: Wire) -> None:
    air = Air(wire, acknowledges=False)
    air.tell(command(9))
    air.answer(9, StimulationResult.DONE)
    air.run(400)
    before = len(air.copies)
    air.tell(command(9))
    air.run(1)
    assert [sequence for sequence, _ in air.copies[before:]] == [1]


def test_a_command_is_forgotten_after_32_newer_ones(wire: Wire) -> None:
    air = Air(wire)
    for number in range(33):
        assert air.tell(command(number))
        air.answer(number, StimulationResult.DONE)
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


def test_a_boot_begins_with_a_hello_and_owes_the_limits(wire: Wire) -> None:
    air = Air(wire)
    assert air.owes_limits
    assert air.report(LIMITS)
    owes_limits: bool = air.owes_limits
    assert not owes_limits
    air.run(1)
    assert [air.taken[number] for number in sorted(air.taken)] == [HELLO, LIMITS]


def test_a_hello_request_hurries_what_is_under_way_and_brings_no_second_hello(wire: Wire) -> None:
    air = Air(wire, acknowledges=False)
    air.report(batch(1))
    air.report(LIMITS)
    air.run(200)
    before = len(air.copies)

    air.tell(HelloRequest())
    air.run(1)

    assert [sequence for sequence, _ in air.copies[before:]] == [0, 1, 2]
    assert not air.owes_limits


def test_a_hello_request_brings_another_hello_and_its_limits_once_the_last_one_is_acknowledged(wire: Wire) -> None:
    air = Air(wire)
    air.report(LIMITS)
    air.run(2)
    air.tell(HelloRequest())
    assert air.owes_limits
    assert air.report(LIMITS)
    air.run(2)
    assert [air.taken[number] for number in sorted(air.taken)] == [HELLO, LIMITS, HELLO, LIMITS]


def test_a_hello_that_says_something_new_goes_beside_the_one_under_way(wire: Wire) -> None:
    air = Air(wire, acknowledges=False)
    air.run(1)
    news = replace(HELLO, beacon_period_ms=300)
    air.describe(news)
    air.tell(HelloRequest())
    air.run(1)
    assert [air.taken[number] for number in sorted(air.taken)] == [HELLO, news]


@given(chance=st.integers(0, 0xFFFF))
def test_a_broadcast_is_answered_after_a_random_wait_of_up_to_a_second_and_a_unicast_at_once(wire: Wire, chance: int) -> None:
    for is_broadcast in (False, True):
        air = Air(wire)
        air.report(LIMITS)
        air.run(2)
        air.copies.clear()
        asked_ms = air.now_ms
        air.tell(HelloRequest(), is_broadcast=is_broadcast, chance=chance)
        assert air.report(LIMITS)
        air.run(1_100, step_ms=1)
        waits = {at_ms - asked_ms for sequence, at_ms in air.copies if sequence in (2, 3)}
        assert waits == {1_000 * chance >> 16 if is_broadcast else 0}


@settings(max_examples=20)
@given(chance=st.integers(0, 0xFFFF), again_ms=st.integers(0, 900))
def test_a_stop_by_broadcast_is_the_owners_once_and_answered_after_a_random_wait(wire: Wire, chance: int, again_ms: int) -> None:
    """Asked again by itself alone, it is answered at once; any other action that came by broadcast is nobody's."""
    stop = replace(command(1), action=Action.STOP)
    for is_asked_again in (False, True):
        air = Air(wire)
        air.run(2)
        assert not air.tell(command(2), is_broadcast=True)
        asked_ms = air.now_ms
        assert air.tell(stop, is_broadcast=True, chance=chance)
        air.answer(1, StimulationResult.DONE)
        if is_asked_again:
            air.run(again_ms + 1, step_ms=1)
            again_at_ms = air.now_ms
            assert not air.tell(stop)
            air.run(1, step_ms=1)
        air.run(1_100, step_ms=1)
        (first_ms, *_) = [at_ms for sequence, at_ms in air.copies if sequence == 1]
        wait_ms = 1_000 * chance >> 16
        assert first_ms - asked_ms == (min(wait_ms, again_at_ms - asked_ms) if is_asked_again else wait_ms)
        assert air.answers()[0] == (1, StimulationResult.DONE)
        assert {number for number, _ in air.answers()} == {1}


@given(chance=st.integers(0, 0xFFFF))
def test_a_broadcast_of_a_configuration_is_answered_after_a_random_wait(wire: Wire, chance: int) -> None:
    air = Air(wire)
    air.run(2)
    asked_ms = air.now_ms
    assert air.tell(ConfigurationRequest(token=1), is_broadcast=True, chance=chance)
    assert air.report(SETTINGS)
    assert air.report(batch(1))  # no answer: at once
    air.run(1_100, step_ms=1)
    assert [(sequence, at_ms - asked_ms) for sequence, at_ms in sorted(air.copies)[1:]] == [(1, 1_000 * chance >> 16), (2, 0)]


def test_progress_brings_distant_repetitions_forward_to_about_a_second(wire: Wire) -> None:
    """WIRE_FORMAT.md section 5.12: 0.75 to 1.25 s after the Acknowledge, and 2 s after that."""
    air = Air(wire, acknowledges=False)
    air.report(batch(1))
    air.run(600)
    before, heard_ms = len(air.copies), air.now_ms
    air.tell(Acknowledge(boot=BOOT, next_sequence=1, bitmap=0))
    air.run(40)
    waits = [at_ms - heard_ms for sequence, at_ms in air.copies[before:] if sequence == 1]
    assert 750 <= waits[0] <= 1_350
    assert 1_500 <= waits[1] - waits[0] <= 2_600


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
    air.tell_payload(payload)

    air.run(3)

    assert list(air.taken.values()) == [HELLO]


def test_a_question_for_the_owner_is_handed_on(wire: Wire) -> None:
    assert Air(wire).tell(ConfigurationRequest(token=1))
