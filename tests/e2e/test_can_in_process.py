"""Gateway and virtual coordinators on one CAN bus in one process, and a port that is unplugged and plugged in again."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

import can
import pytest

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.envelope import RadioReceived, RadioStatus
from firmware_protocol.framing.can_frame import CanFrame, RecordReader, encode_record
from firmware_protocol.units import RssiDbm, ShortAddress
from gateway.config import LinkTable
from gateway.coordinator import Coordinator
from gateway.errors import TransportClosedError, TransportOpenError
from gateway.health import Health
from gateway.radio import Fate, RadioMessage
from gateway.transports.can_port import CanBuses
from gateway.transports.can_spec import CanSpec
from gateway.transports.spec import open_transport, parse_port_spec
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from simulator.lines.slcan_port import SlcanEnd
from tests.gateway.fake_radio import until

NODE = ShortAddress(0x1234)
EUI64 = 0x00124B00000000AA


class VirtualNode:
    """A virtual coordinator as a node of its own on python-can's virtual bus; its radio sends whatever it is asked to."""

    def __init__(self, dialect: str, *, channel: str) -> None:
        self.dongle: Dongle = make_dongle(dialect, index=0)
        self.sent: list[bytes] = []
        self._bus = can.Bus(interface="virtual", channel=channel, ignore_config=True)
        self._out = RecordReader()
        self.dongle.start(now_ns=0)

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            while True:
                now_ns = int(loop.time() * 1e9)
                while (message := self._bus.recv(0)) is not None:
                    frame = CanFrame(can_id=message.arbitration_id, data=bytes(message.data), is_fd=message.is_fd)
                    self.dongle.feed(encode_record(frame), now_ns=now_ns)
                while self.dongle.requests:
                    request = self.dongle.requests.popleft()
                    self.sent.append(request.payload)
                    self.dongle.confirm(request.handle, RadioStatus.SENT, now_ns=now_ns)
                self.dongle.handle_deadline(now_ns=now_ns)
                for one in self._out.feed(self.dongle.take_bytes()):
                    assert isinstance(one, CanFrame)
                    self._bus.send(can.Message(arbitration_id=one.can_id, data=one.data, is_extended_id=True, is_fd=one.is_fd))
                await asyncio.sleep(0.001)
        finally:
            self._bus.shutdown()

    def offer(self, payload: bytes) -> bool:
        received = RadioReceived(source=NODE, rssi_dbm=RssiDbm(-60), lqi=90, payload=payload)
        return self.dongle.take_from_radio(received, eui64=EUI64, now_ns=0)


@asynccontextmanager
async def running(*tasks: asyncio.Task[None]) -> AsyncIterator[None]:
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@pytest.mark.parametrize("is_fd", [False, True])
def test_three_coordinators_on_one_bus_serve_one_gateway(is_fd: bool) -> None:
    async def story() -> None:
        channel, buses = f"shared-{is_fd}", CanBuses()
        specs = [parse_port_spec(f"can:virtual:{channel}?unit={unit}&fd={int(is_fd)}") for unit in (1, 2, 30)]
        heard: dict[str, list[bytes]] = {spec.name: [] for spec in specs}

        def take(message: RadioMessage) -> None:
            heard[message.radio].append(message.payload)

        nodes = {spec.name: VirtualNode(spec.dialect, channel=channel) for spec in specs}
        coordinators = {
            spec.name: Coordinator(
                radio=spec.name,
                make_host=partial(make_host, spec.dialect),
                open_port=partial(open_transport, spec, can_buses=buses),
                on_radio=take,
                config=LinkTable(),
                health=Health(),
                first_session=1,
            )
            for spec in specs
        }
        tasks = [asyncio.create_task(one.run()) for one in coordinators.values()] + [
            asyncio.create_task(one.run()) for one in nodes.values()
        ]
        async with running(*tasks):
            await until(lambda: all(one.is_up for one in coordinators.values()), what="all are up")
            payloads = [bytes([number]) * 57 for number in range(100)]
            for name, node in nodes.items():
                assert all(node.offer(name.encode()[-8:] + payload[:49]) for payload in payloads)
            outcomes = [
                await coordinator.send(destination=NODE, payload=name.encode()[-8:] + bytes([number]))
                for number in range(10)
                for name, coordinator in coordinators.items()
            ]
            await until(lambda: all(len(one) >= 100 for one in heard.values()), what="all is heard")
            for name, node in nodes.items():
                assert heard[name] == [name.encode()[-8:] + payload[:49] for payload in payloads]
                assert node.sent == [name.encode()[-8:] + bytes([number]) for number in range(10)]
            assert {outcome.fate for outcome in outcomes} == {Fate.SENT}

    asyncio.run(story())


async def feed_for_ever(end: SlcanEnd, into: bytearray) -> None:
    while True:
        into += await end.read()


async def repeat(end: SlcanEnd, records: bytes) -> None:
    while True:
        await end.write(records)
        await asyncio.sleep(0.05)


def test_an_slcan_adapter_is_unplugged_and_plugged_in_again_and_no_second_process_has_it(tmp_path: Path) -> None:
    async def story() -> None:
        path, buses = tmp_path / "can", CanBuses()
        spec = parse_port_spec(f"can:slcan:{path}?unit=1")
        assert isinstance(spec, CanSpec)
        with pytest.raises(TransportOpenError, match="there is no"):
            await buses.open(spec)
        for _ in range(2):
            end, came = SlcanEnd(path, dialect="can:1"), bytearray()
            port = await buses.open(spec)
            async with running(asyncio.create_task(feed_for_ever(end, came))):
                with pytest.raises(TransportOpenError, match="in use by another process"):
                    await CanBuses().open(spec)
                there = b"".join(encode_record(CanFrame(can_id=0x18DC0000 | 1 << 21, data=bytes([number] * 8))) for number in range(20))
                await port.write(there)
                await until(lambda: len(came) == len(there), what="all frames arrive")  # noqa: B023
                assert came == there
                back = encode_record(CanFrame(can_id=0x1C3C0000, data=b"\x30\x00\x00"))
                await end._pty.write(b"Tnonsense\r\xff\xfe\rT1\r")  # noise of an adapter that starts
                async with (
                    asyncio.timeout(60),
                    running(asyncio.create_task(repeat(end, back))),
                ):  # clearing its buffer, python-can may take one
                    assert await port.read() == back
            await end.aclose()
            with pytest.raises(TransportClosedError):
                await port.read()
            with contextlib.suppress(TransportClosedError):
                await port.write(there)
            await port.aclose()

    asyncio.run(story())
