"""Laws of CAN ports, on python-can's own buses: virtual ones in this process, and ones that fail in python-can's own way."""

import asyncio
import errno
import itertools
import logging
import socket
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import can
import pytest

from firmware_protocol.framing.can import CanDecoder, encode_message
from firmware_protocol.framing.can_frame import CanFrame, Direction, RecordReader, configuration_id, encode_record
from gateway.errors import TransportClosedError, TransportOpenError, TransportSpecError
from gateway.transports.can_bus import CanBus, open_bus
from gateway.transports.can_port import _MAX_WAITING, CanBuses, CanTransport
from gateway.transports.can_spec import CanSpec
from gateway.transports.spec import open_transport, parse_port_spec
from tests.gateway.fake_radio import until

UP, DOWN = Direction.FROM_COORDINATOR, Direction.TO_COORDINATOR
_names = (f"bus{number}" for number in itertools.count())


def a_body(number: int, size: int = 59) -> bytes:
    return bytes([3]) + number.to_bytes(2, "little") + bytes([number % 256]) + bytes(number % 251 for _ in range(size))


def a_spec(name: str, *, unit: int = 1, is_fd: bool = False) -> CanSpec:
    spec = parse_port_spec(f"can:virtual:{name}?unit={unit}&fd={int(is_fd)}")
    assert isinstance(spec, CanSpec)
    return spec


@asynccontextmanager
async def a_port(
    *, open_bus: Callable[[CanSpec], CanBus] = open_bus, patience_s: float = 5.0
) -> AsyncIterator[tuple[CanTransport, can.BusABC]]:
    """Yield a port and another node's end of its bus."""
    name = next(_names)
    with can.Bus(interface="virtual", channel=name, ignore_config=True) as far:
        port = await CanBuses(open_bus=open_bus, patience_s=patience_s).open(a_spec(name))
        try:
            yield port, far
        finally:
            await port.aclose()


async def read_bodies(port: CanTransport, count: int, *, unit: int = 1) -> list[bytes]:
    decoder = CanDecoder(unit=unit, direction=UP)
    found: list[bytes] = []
    while len(found) < count:
        found += [one for one in decoder.feed(await port.read()) if isinstance(one, bytes)]
    return found


def sent_by(far: can.BusABC, count: int, *, unit: int | None = 1) -> list[bytes]:
    """Return the next bodies that the other node hears, for one unit or for all."""
    decoder = CanDecoder(unit=unit, direction=DOWN)
    found: list[bytes] = []
    while len(found) < count:
        message = far.recv(5.0)
        assert message is not None, f"only {len(found)} of {count} came"
        frame = CanFrame(can_id=message.arbitration_id, data=bytes(message.data), is_fd=message.is_fd)
        found += [one for one in decoder.feed(encode_record(frame)) if isinstance(one, bytes)]
    return found


def say(far: can.BusABC, body: bytes, *, unit: int = 1, is_fd: bool = False) -> None:
    for one in frames_of(encode_message(body, unit=unit, direction=UP, is_fd=is_fd)):
        far.send(can.Message(arbitration_id=one.can_id, data=one.data, is_extended_id=True, is_fd=one.is_fd))


def frames_of(records: bytes) -> list[CanFrame]:
    return [one for one in RecordReader().feed(records) if isinstance(one, CanFrame)]


@pytest.mark.parametrize("is_fd", [False, True])
def test_units_share_a_bus_and_each_hears_its_own_coordinator_alone(is_fd: bool) -> None:
    async def story() -> None:
        name, buses = next(_names), CanBuses()
        with can.Bus(interface="virtual", channel=name, ignore_config=True) as far:
            ports = {unit: await open_transport(a_spec(name, unit=unit, is_fd=is_fd), can_buses=buses) for unit in (0, 5, 31)}
            for number in range(60):
                say(far, a_body(number), unit=(0, 5, 31)[number % 3], is_fd=is_fd)
            for offset, (unit, port) in enumerate(ports.items()):
                assert isinstance(port, CanTransport)
                assert await read_bodies(port, 20, unit=unit) == [a_body(number) for number in range(offset, 60, 3)]
            for unit, port in ports.items():
                await port.write(encode_message(a_body(unit), unit=unit, direction=DOWN, is_fd=is_fd))
                assert sent_by(far, 1, unit=unit) == [a_body(unit)]
            for port in ports.values():
                await port.aclose()
                await port.aclose()
            with pytest.raises(TransportClosedError):
                await ports[5].read()
            with pytest.raises(TransportClosedError):
                await ports[5].write(b"")

        def have_its_threads_ended() -> bool:
            return not any(name in one.name.split()[0].split(":") for one in threading.enumerate())

        await until(have_its_threads_ended, what="its threads have ended")

    asyncio.run(story())


def test_a_units_port_is_opened_once_and_all_units_of_a_bus_with_the_same_options() -> None:
    async def story() -> None:
        name, buses = next(_names), CanBuses()
        first = await buses.open(a_spec(name, unit=1))
        with pytest.raises(TransportOpenError, match="open already"):
            await buses.open(a_spec(name, unit=1))
        with pytest.raises(TransportOpenError, match="other options"):
            await buses.open(a_spec(name, unit=2, is_fd=True))
        await first.aclose()
        again = await buses.open(a_spec(name, unit=2, is_fd=True))
        await again.aclose()

    asyncio.run(story())


def test_what_is_no_frame_of_a_coordinator_is_passed_over() -> None:
    async def story() -> None:
        async with a_port() as (port, far):
            far.send(can.Message(arbitration_id=0x123, data=b"other", is_extended_id=False))
            far.send(can.Message(arbitration_id=1, is_extended_id=True, is_remote_frame=True))
            say(far, a_body(1), unit=2)
            for frame in frames_of(encode_message(a_body(2), unit=1, direction=DOWN, is_fd=False)):
                far.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=True))
            say(far, a_body(3))
            assert await read_bodies(port, 1) == [a_body(3)]

    asyncio.run(story())


class FullNowAndThen(can.BusABC):
    """A virtual bus whose controller's queue is full each time ``is_full`` says so, as python-can's socketcan tells it."""

    def __init__(self, name: str, is_full: Callable[[], bool], error: can.CanOperationError) -> None:
        self._inner = can.Bus(interface="virtual", channel=name, ignore_config=True)
        self._is_full = is_full
        self._error = error
        super().__init__(channel=name)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self._inner.recv(timeout), True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self._is_full():
            raise self._error
        self._inner.send(msg, timeout)

    def shutdown(self) -> None:
        super().shutdown()
        self._inner.shutdown()


NO_BUFFER_SPACE = can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
BUFFER_FULL = can.CanOperationError("Transmit buffer full")


@pytest.mark.parametrize("error", [NO_BUFFER_SPACE, BUFFER_FULL])
def test_a_full_queue_costs_time_and_no_frame(error: can.CanOperationError) -> None:
    turns = itertools.cycle([True, True, False, True, False, False])

    async def story() -> None:
        async with a_port(open_bus=lambda spec: CanBus(FullNowAndThen(spec.channel, lambda: next(turns), error), name="x")) as (port, far):
            for number in range(10):
                await port.write(encode_message(a_body(number), unit=1, direction=DOWN, is_fd=False))
            assert sent_by(far, 10) == [a_body(number) for number in range(10)]

    asyncio.run(story())


@pytest.mark.parametrize("closes", [False, True])
def test_of_a_write_that_was_cancelled_nothing_goes_out_later(closes: bool) -> None:
    """Else what was under way before a port was opened anew would come before the new opening's RESET."""

    async def story() -> None:
        name, is_full = next(_names), True
        buses = CanBuses(open_bus=lambda spec: CanBus(FullNowAndThen(spec.channel, lambda: is_full, NO_BUFFER_SPACE), name="x"))
        with can.Bus(interface="virtual", channel=name, ignore_config=True) as far:
            port, other = [await buses.open(a_spec(name, unit=unit)) for unit in (1, 2)]
            writes = [
                asyncio.ensure_future(one.write(encode_message(a_body(number), unit=unit, direction=DOWN, is_fd=False)))
                for one, unit, number in ((port, 1, 7), (other, 2, 8))
            ]
            await asyncio.sleep(0)
            writes[0].cancel()
            await asyncio.gather(writes[0], return_exceptions=True)
            if closes:
                await port.aclose()
                port = await buses.open(a_spec(name, unit=1))
            is_full = False
            await writes[1]
            await port.write(encode_message(a_body(9), unit=1, direction=DOWN, is_fd=False))
            assert sent_by(far, 2, unit=None) == [a_body(8), a_body(9)]
            await port.aclose()
            await other.aclose()

    asyncio.run(story())


def test_a_queue_that_stays_full_closes_the_port_and_says_why() -> None:
    async def story() -> None:
        always_full = lambda spec: CanBus(FullNowAndThen(spec.channel, lambda: True, NO_BUFFER_SPACE), name="x")  # noqa: E731
        async with a_port(open_bus=always_full, patience_s=0.4) as (port, _):
            with pytest.raises(TransportClosedError, match=r"queue was full for 0\.4 s: no other node acknowledges"):
                await port.write(encode_message(a_body(1), unit=1, direction=DOWN, is_fd=False))

    asyncio.run(story())


@pytest.mark.parametrize(
    ("error", "words"), [(can.CanOperationError("x", errno.ENETDOWN), "ip link set"), (can.CanOperationError("unplugged"), "unplugged")]
)
def test_an_adapter_that_is_gone_closes_the_port(error: can.CanOperationError, words: str) -> None:
    async def story() -> None:
        async with a_port(open_bus=lambda spec: CanBus(FullNowAndThen(spec.channel, lambda: True, error), name="x")) as (port, _):
            with pytest.raises(TransportClosedError, match=words):
                await port.write(encode_message(a_body(1), unit=1, direction=DOWN, is_fd=False))

    asyncio.run(story())


def error_frame(classes: int, controller: int = 0) -> can.Message:
    return can.Message(arbitration_id=classes, is_extended_id=False, is_error_frame=True, data=bytes([0, controller, 0, 0, 0, 0, 0, 0]))


def test_bus_off_closes_the_port_and_it_can_be_opened_again() -> None:
    async def story() -> None:
        name, buses = next(_names), CanBuses()
        with can.Bus(interface="virtual", channel=name, ignore_config=True) as far:
            port = await buses.open(a_spec(name))
            other = await buses.open(a_spec(name, unit=2))
            far.send(error_frame(0x40))
            for one in (port, other):
                with pytest.raises(TransportClosedError, match=r"bus-off.*restart-ms"):
                    await one.read()
            again = await buses.open(a_spec(name))
            say(far, a_body(9))
            assert await read_bodies(again, 1) == [a_body(9)]
            for one in (port, other, again):
                await one.aclose()

    asyncio.run(story())


def test_a_controllers_state_is_told_when_it_changes(caplog: pytest.LogCaptureFixture) -> None:
    name = next(_names)
    far = can.Bus(interface="virtual", channel=name, ignore_config=True)
    bus = open_bus(a_spec(name))
    states = []
    with caplog.at_level(logging.INFO):
        for message in (error_frame(0x04, 0x08), error_frame(0x04, 0x08), error_frame(0x20), error_frame(0x04, 0x20), error_frame(0x100)):
            far.send(message)
            assert bus.receive(1.0) is None
            states.append(bus.state)
    bus.close()
    far.shutdown()

    assert states == ["warning", "warning", "warning", "passive", "active"]
    assert bus.faults["error_frame"] == 5
    assert [record.levelname for record in caplog.records if "can.controller" in record.getMessage()] == ["WARNING", "WARNING", "INFO"]


class Dying(can.BusABC):
    """A bus whose ``recv`` fails as it is told."""

    def __init__(self, fail: Callable[[], None]) -> None:
        self._fail = fail
        super().__init__(channel="dying")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002  # python-can's signature
        self._fail()
        return None, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        pass


def test_a_receiving_thread_that_dies_closes_the_port() -> None:
    def fail() -> None:
        raise RuntimeError("a driver's bug")

    async def story() -> None:
        async with a_port(open_bus=lambda _: CanBus(Dying(fail), name="x")) as (port, _):
            with pytest.raises(TransportClosedError, match="died of RuntimeError: a driver's bug"):
                await port.read()

    asyncio.run(story())


def test_a_receiving_thread_that_hangs_closes_the_port() -> None:
    released = threading.Event()

    def hang() -> None:
        released.wait(20)

    async def story() -> None:
        async with a_port(open_bus=lambda _: CanBus(Dying(hang), name="x"), patience_s=0.4) as (port, _):
            with pytest.raises(TransportClosedError, match="hangs"):
                await port.read()
            released.set()

    asyncio.run(story())


def test_a_reader_that_is_far_behind_loses_the_newest_frames_and_they_are_counted() -> None:
    async def story() -> None:
        async with a_port() as (port, far):
            ack = bytes([4, 1, 0, 7])
            for _ in range(_MAX_WAITING + 50):
                say(far, ack)
            await until(lambda: port.n_dropped == 50, what="the rest is dropped")
            assert await read_bodies(port, _MAX_WAITING) == [ack] * _MAX_WAITING

    asyncio.run(story())


def test_a_configuration_frame_passes_as_any_other() -> None:
    async def story() -> None:
        async with a_port() as (port, far):
            frame = CanFrame(can_id=configuration_id(unit=1, direction=UP), data=b"\x30\x00\x00")
            far.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=True))
            assert await port.read() == encode_record(frame)

    asyncio.run(story())


HAS_AF_CAN = hasattr(socket, "AF_CAN")
if HAS_AF_CAN:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        HAS_AF_CAN = False


@pytest.mark.skipif(not HAS_AF_CAN, reason="this kernel has no CAN sockets (AF_CAN), so no vcan0 either")
def test_frames_pass_a_socketcan_interface() -> None:
    async def story() -> None:
        spec = parse_port_spec("can:socketcan:vcan0?unit=4&fd=1")
        try:
            port = await open_transport(spec)
        except TransportOpenError as error:
            pytest.skip(f"no vcan0 (`ip link add vcan0 type vcan && ip link set vcan0 mtu 72 up` makes one): {error}")
        assert isinstance(port, CanTransport)
        with can.Bus(interface="socketcan", channel="vcan0", fd=True, ignore_config=True) as far:
            for number in range(50):
                await port.write(encode_message(a_body(number), unit=4, direction=DOWN, is_fd=True))
            assert sent_by(far, 50, unit=4) == [a_body(number) for number in range(50)]
            say(far, a_body(1), unit=4, is_fd=True)
            assert await read_bodies(port, 1, unit=4) == [a_body(1)]
        await port.aclose()

    asyncio.run(story())


@pytest.mark.skipif(HAS_AF_CAN, reason="this kernel has CAN sockets")
def test_a_kernel_without_can_is_named() -> None:
    with pytest.raises(TransportOpenError, match="this kernel has no CAN sockets"):
        asyncio.run(open_transport(parse_port_spec("can:socketcan:can0")))


def test_port_names_of_can_mean_what_they_say() -> None:
    assert parse_port_spec("can:socketcan:can0?fd=1&unit=3") == CanSpec(interface="socketcan", channel="can0", unit=3, is_fd=True)
    spec = parse_port_spec("can:slcan:/dev/ttyACM0?bitrate=1000000&settle=2")
    assert spec == CanSpec(interface="slcan", channel="/dev/ttyACM0", bitrate=1_000_000, settle_s=2.0)
    assert spec.name == "can:slcan:/dev/ttyACM0?unit=1"
    assert spec.dialect == "can:1"
    assert parse_port_spec("can:virtual:x?unit=31&fd=1").dialect == "canfd:31"


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("can:can0", "must be can:INTERFACE:CHANNEL"),
        ("can:pcan:x", "must be can:INTERFACE:CHANNEL"),
        ("can:socketcan:", "must be can:INTERFACE:CHANNEL"),
        ("can:socketcan:can0?unit=32", "unit is '32', but must be a number from 0 to 31"),
        ("can:socketcan:can0?fd=yes", "fd is 'yes'"),
        ("can:socketcan:can0?bitrate=500000", "bitrate is an option of slcan alone"),
        ("can:slcan:/dev/x?bitrate=1", "bitrate is '1', but must be one of"),
        ("can:slcan:/dev/x?dbitrate=2000000", "needs fd=1"),
        ("can:slcan:/dev/x?settle=long", "settle is 'long'"),
        ("can:slcan:/dev/x?baud=1", "unknown option 'baud'"),
    ],
)
def test_a_wrong_name_of_a_can_port_is_refused_with_its_reason(spec: str, reason: str) -> None:
    with pytest.raises(TransportSpecError) as caught:
        parse_port_spec(spec)
    assert reason in str(caught.value)
