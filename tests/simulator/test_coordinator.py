"""Laws of the virtual coordinator and of the air, in memory, against the ground's own link."""

from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.dialects.interface import HostEvent, NodeSeen
from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.envelope import IdentifyRequest, RadioReceived, RadioSend, RadioStatus, encode_envelope
from firmware_protocol.message_codec import encode_uplink
from firmware_protocol.messages import MAX_RADIO_PAYLOAD, Acknowledge, Hello, HelloRequest, MessageFault, Uplink, UplinkHeader
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm, ShortAddress
from simulator import chance, draws
from simulator.clock import DriftingClock, SettableClock
from simulator.dongles.native import NativeDongle
from simulator.radios.air import Air
from simulator.radios.radio import Radio, RadioConfig, lqi
from tests.simulator.base_station import BaseStation

MS = 1_000_000


def uplink(sequence: int) -> RadioReceived:
    message: Uplink = Hello(eui64=sequence, firmware=1, beacon_period_ms=0, capabilities=1)
    header = UplinkHeader(node=NodeId(1), boot=BootId(1), sequence=sequence, sent_ms=Milliseconds(0))
    return RadioReceived(source=ShortAddress(4), rssi_dbm=RssiDbm(-60), lqi=90, payload=encode_uplink(header, message))


def sequences(base: BaseStation) -> list[int]:
    return sorted(base.ledgers[1, 1].messages)


class Cable:
    """A line between base station and coordinator that spoils the bytes whose turn is in ``spoiled``."""

    def __init__(self, base: BaseStation, coordinator: NativeDongle, *, spoiled: dict[int, int] | None = None) -> None:
        self.base, self.coordinator, self.now_ns = base, coordinator, 0
        self._spoiled = spoiled or {}
        self._n_carried = 0

    def run(self, for_ms: int, *, step_ms: int = 10) -> None:
        for _ in range(for_ms // step_ms):
            self.now_ns += step_ms * MS
            self.base.tick(self.now_ns)
            self.coordinator.feed(self._carry(self.base.take_outgoing()), now_ns=self.now_ns)
            deadline_ns = self.coordinator.next_deadline_ns()
            if deadline_ns is not None and deadline_ns <= self.now_ns:
                self.coordinator.handle_deadline(now_ns=self.now_ns)
            self.base.feed(self._carry(self.coordinator.take_bytes()), now_ns=self.now_ns)

    def _carry(self, data: bytes) -> bytes:
        spoiled = bytearray(data)
        for at in range(len(data)):
            spoiled[at] ^= self._spoiled.get(self._n_carried + at, 0)
        self._n_carried += len(data)
        return bytes(spoiled)


@given(spoiled=st.dictionaries(st.integers(0, 6_000), st.integers(1, 255), max_size=150), n=st.integers(1, 60))
@example(spoiled={62: 1}, n=1)  # the delimiter after the first message, before another: its frame has one zero more, which no check sees
def test_noise_on_the_line_costs_no_payload_that_has_its_zeros_and_doubles_none(spoiled: dict[int, int], n: int) -> None:
    """What a frame's own check cannot see (WIRE_FORMAT.md §2) is seen by that of the message, and the backpack tells it again."""
    base, coordinator = BaseStation(refused=[]), NativeDongle()
    coordinator.start(now_ns=0)
    cable = Cable(base, coordinator, spoiled=spoiled)
    for sequence in range(n):
        assert coordinator.take_from_radio(uplink(sequence), eui64=1, now_ns=cable.now_ns)
        cable.run(20)
    cable.run(60_000, step_ms=50)
    assert base.refused is not None
    assert set(base.refused) <= {MessageFault.BAD_CRC}
    assert len(base.refused) <= sum(mask == 1 for mask in spoiled.values())
    assert len(sequences(base)) + len(base.refused) == n
    assert len(base.hellos) >= 1


def test_while_no_base_station_is_there_memory_is_bounded_and_what_was_taken_arrives_later_in_order() -> None:
    base, coordinator = BaseStation(), NativeDongle()
    coordinator.start(now_ns=0)
    taken = [sequence for sequence in range(2_000) if coordinator.take_from_radio(uplink(sequence), eui64=1, now_ns=0)]
    assert taken == list(range(len(taken)))
    assert 100 < len(taken) < 512
    assert coordinator.faults["uplink_full"] == 2_000 - len(taken)
    cable = Cable(base, coordinator)
    cable.run(5_000)
    assert sequences(base) == taken
    assert coordinator.take_from_radio(uplink(len(taken)), eui64=1, now_ns=cable.now_ns)


def test_every_request_reaches_the_radio_once_and_is_confirmed_with_its_handle() -> None:
    base, coordinator = BaseStation(), NativeDongle()
    cable = Cable(base, coordinator)
    cable.run(100)
    handles = []
    for number in range(40):
        message = Acknowledge(boot=BootId(1), next_sequence=number, bitmap=0)
        handles.append(base.send(9, message, now_ns=cable.now_ns))
        cable.run(50)
        request = coordinator.requests.popleft()
        assert request.destination == 9
        coordinator.confirm(request.handle, RadioStatus.NO_ACK, now_ns=cable.now_ns)
    cable.run(200)
    assert not coordinator.requests
    assert [(one.handle, one.status) for one in base.confirms] == [(handle, RadioStatus.NO_ACK) for handle in handles]


def test_a_request_too_long_or_too_many_is_answered_and_not_sent() -> None:
    base, coordinator = BaseStation(), NativeDongle()
    cable = Cable(base, coordinator)
    cable.run(100)
    long_request = RadioSend(handle=1, destination=ShortAddress(9), payload=bytes(MAX_RADIO_PAYLOAD + 1))
    base.link.send(encode_envelope(long_request), now_ns=cable.now_ns)
    cable.run(100)
    assert not coordinator.requests
    assert [one.status for one in base.confirms] == [RadioStatus.TOO_LONG]
    for _ in range(70):
        base.send(9, HelloRequest(), now_ns=cable.now_ns)
        cable.run(20)
    assert len(coordinator.requests) == 64
    assert [one.status for one in base.confirms[1:]] == [RadioStatus.QUEUE_FULL] * 6


def test_a_node_that_joins_is_told_of_to_a_base_station_that_is_there_and_costs_nobody_a_place() -> None:
    coordinator, host = NativeDongle(), NativeHost()
    coordinator.node_joined(ShortAddress(4), eui64=7, now_ns=0)
    host.open(session=1, now_ns=0)
    events: list[HostEvent] = []
    for step in range(4):
        coordinator.feed(b"".join(host.take_frames()), now_ns=step)
        if step == 2:
            coordinator.node_joined(ShortAddress(5), eui64=8, now_ns=step)
        events += host.feed(coordinator.take_bytes(), now_ns=step)
    assert [event for event in events if isinstance(event, NodeSeen)] == [NodeSeen(address=ShortAddress(5), eui64=8)]
    assert coordinator.faults == host.faults == {}


def test_the_coordinator_says_who_it_is_when_asked() -> None:
    base, coordinator = BaseStation(), NativeDongle()
    cable = Cable(base, coordinator)
    cable.run(100)
    known = len(base.hellos)
    base.link.send(encode_envelope(IdentifyRequest()), now_ns=cable.now_ns)
    cable.run(100)
    assert len(base.hellos) == known + 1
    assert base.hellos[-1].max_radio_payload == MAX_RADIO_PAYLOAD


@given(chunks=st.lists(st.binary(max_size=300), max_size=20))
def test_no_bytes_from_the_line_raise(chunks: list[bytes]) -> None:
    coordinator = NativeDongle()
    coordinator.start(now_ns=0)
    for chunk in chunks:
        coordinator.feed(chunk, now_ns=0)
    coordinator.take_bytes()


@given(seed=st.integers(0, 2**64 - 1), biobot=st.integers(0, 2**63), stream=st.integers(0, 10_000), index=st.integers(0, 2**40))
def test_single_draws_are_the_draws_of_whole_arrays(seed: int, biobot: int, stream: int, index: int) -> None:
    import numpy as np  # noqa: PLC0415  # only this test needs arrays

    words = draws.words(seed=seed, biobot=np.array([biobot], dtype=np.uint64), stream=stream, index=np.array([index], dtype=np.uint64))
    assert chance.word(seed=seed, biobot=biobot, stream=stream, index=index) == int(words[0])


def test_the_share_of_payloads_lost_is_the_probability_asked_for() -> None:
    """Of 20,000 payloads at p = 0.2, 4,000 are expected with a standard deviation of 57; five of those are allowed."""
    radio = Radio(seed=3, config=RadioConfig(loss=0.2))
    flights = [radio.fly_up(node) for node in range(200) for _ in range(100)]
    assert abs(sum(not flight.is_delivered for flight in flights) - 4_000) < 285
    unconfirmed = sum(flight.is_delivered and not flight.is_acknowledged for flight in flights)
    assert abs(unconfirmed - 3_200) < 270


def test_one_biobots_luck_does_not_depend_on_anothers_traffic() -> None:
    alone, busy = Radio(seed=3, config=RadioConfig(loss=0.5)), Radio(seed=3, config=RadioConfig(loss=0.5))
    expected = [alone.fly_up(1) for _ in range(50)]
    mixed = []
    for _ in range(50):
        busy.fly_up(2)
        busy.fly_down(1)
        mixed.append(busy.fly_up(1))
    assert mixed == expected


@given(near_m=st.floats(0, 1e4), far_m=st.floats(0, 1e4))
def test_a_signal_never_grows_with_distance_and_fits_its_byte(near_m: float, far_m: float) -> None:
    radio = Radio(seed=0)
    strong, weak = radio.rssi_dbm(min(near_m, far_m)), radio.rssi_dbm(max(near_m, far_m))
    assert -128 <= weak <= strong <= 127
    assert 0 <= lqi(weak) <= lqi(strong) <= 255


@given(start_ms=st.integers(0, 10**9), drift_ppb=st.integers(-1_000_000, 1_000_000), elapsed_ns=st.integers(0, 10**16))
def test_a_drifting_clock_and_its_inverse_agree(start_ms: int, drift_ppb: int, elapsed_ns: int) -> None:
    clock = DriftingClock(start_ms=start_ms, drift_ppb=drift_ppb)
    shown = clock.read_ms(elapsed_ns)
    first_ns = clock.elapsed_ns(shown)
    assert first_ns <= elapsed_ns
    assert clock.read_ms(first_ns) == shown
    assert clock.read_ms(first_ns - 1) == shown - 1


def test_a_settable_clock_moves_only_when_moved() -> None:
    clock = SettableClock(wall_start_ns=5)
    clock.move(10)
    assert (clock.monotonic_ns(), clock.wall_ns()) == (10, 15)


@given(seed=st.integers(0, 2**64 - 1))
def test_short_addresses_differ_and_are_never_the_coordinators_or_a_broadcast(seed: int) -> None:
    nodes = [NodeId(one) for one in range(1, 2_000)]
    air = Air(nodes, radio=Radio(seed=seed), seed=seed)
    for node in [*nodes, *nodes[:500]]:  # some join again
        air.join(node, 0)
    addresses = [air.address_of(node) for node in nodes]
    assert len(set(addresses)) == 1_999
    assert all(0 < one < 0xFFF8 for one in addresses)
