"""Laws of the transports, on real ptys and sockets."""

import asyncio
import fcntl
import os
import socket
import sys
import termios
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dialects.interface import NetworkWish
from gateway.errors import TransportClosedError, TransportOpenError, TransportSpecError
from gateway.transports.interface import Transport
from gateway.transports.memory import connected_pair
from gateway.transports.serial_port import SerialTransport, list_serial_ports, open_serial
from gateway.transports.spec import SerialSpec, TcpSpec, open_transport, parse_port_spec
from gateway.transports.tcp import open_tcp


@asynccontextmanager
async def _serial_pair() -> AsyncIterator[tuple[Transport, int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    transport = await open_serial(path=path, baud=115_200)
    try:
        yield transport, master, path
    finally:
        await transport.aclose()
        os.close(master)


async def _read(transport: Transport, size: int) -> bytes:
    data = b""
    while len(data) < size:
        data += await transport.read()
    return data


def test_all_bytes_pass_a_serial_port_both_ways() -> None:
    async def story() -> None:
        everything = bytes(range(256)) * 64
        async with _serial_pair() as (transport, master, _):
            reading = asyncio.ensure_future(_read(transport, 3000))
            assert await asyncio.to_thread(os.write, master, everything[:3000]) == 3000
            assert await reading == everything[:3000]
            sending = asyncio.ensure_future(transport.write(everything))
            received = b""
            while len(received) < len(everything):
                received += await asyncio.to_thread(os.read, master, 4096)
            await sending
            assert received == everything

    asyncio.run(story())


def test_what_nobody_reads_stays_in_the_serial_port_but_for_a_few_kilobytes() -> None:
    async def story() -> None:
        async with _serial_pair() as (transport, master, _):
            reading = asyncio.ensure_future(_read(transport, 1))
            os.write(master, b"a")
            assert await reading == b"a"
            os.set_blocking(master, False)
            sent = b""
            while True:  # the loop may read as it likes; only when it has stopped does the line fill up
                try:
                    sent += bytes(os.write(master, b"x" * 1000))
                except BlockingIOError:
                    ready = asyncio.get_running_loop().create_future()
                    asyncio.get_running_loop().call_later(0.05, ready.set_result, None)
                    await ready
                    try:
                        sent += bytes(os.write(master, b"x" * 1000))
                    except BlockingIOError:
                        break
                await asyncio.sleep(0)
            assert len(sent) < 100_000
            assert await _read(transport, len(sent)) == b"x" * len(sent)

    asyncio.run(story())


class _SlowPort(serial.Serial):
    """A port whose line is a pipe: what nobody has taken out of it waits in the driver."""

    def __init__(self, *, line: int, far_end: int) -> None:
        super().__init__(port=None, baudrate=4_000_000)
        self._line, self._far_end = line, far_end

    def fileno(self) -> int:
        return self._line

    @property
    def out_waiting(self) -> int:
        return int.from_bytes(fcntl.ioctl(self._far_end, termios.FIONREAD, bytes(4)), sys.byteorder)


@given(sizes=st.lists(st.integers(1, 255), min_size=1, max_size=12), takes=st.lists(st.integers(1, 400), min_size=1, max_size=12))
def test_no_frame_stands_behind_more_than_about_one_other_on_a_serial_line(sizes: list[int], takes: list[int]) -> None:
    async def story() -> None:
        far_end, line = os.pipe()
        os.set_blocking(line, False)
        port = _SlowPort(line=line, far_end=far_end)
        transport, behind = SerialTransport(name="slow", port=port), list[int]()

        async def send() -> None:
            for size in sizes:
                await transport.write(bytes(size))
                behind.append(port.out_waiting - size)

        sending, at = asyncio.ensure_future(send()), 0
        while not sending.done():
            await asyncio.sleep(0)
            if port.out_waiting:
                os.read(far_end, takes[at % len(takes)])
                at += 1
        await sending
        assert max(behind) <= 100
        await transport.aclose()
        os.close(line)
        os.close(far_end)

    asyncio.run(story())


def test_an_unplugged_serial_port_ends_reading_and_writing() -> None:
    async def story() -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        transport = await open_serial(path=os.ttyname(slave), baud=9600)
        os.close(slave)
        reading = asyncio.ensure_future(transport.read())
        await asyncio.sleep(0)
        os.close(master)
        with pytest.raises(TransportClosedError, match="unplugged"):
            await reading
        with pytest.raises(TransportClosedError):
            await transport.write(b"x")
        await transport.aclose()
        await transport.aclose()
        with pytest.raises(TransportClosedError):
            await transport.read()

    asyncio.run(story())


def test_a_serial_port_is_opened_once_and_what_is_wrong_is_told() -> None:
    async def story() -> None:
        async with _serial_pair() as (_, _, path):
            with pytest.raises(TransportOpenError, match="in use by this gateway already"):
                await open_serial(path=path, baud=115_200)
        with pytest.raises(TransportOpenError, match="there is no /dev/not-there"):
            await open_serial(path="/dev/not-there", baud=115_200)

    asyncio.run(story())


def test_tcp_passes_bytes_and_ends_when_the_other_end_does() -> None:
    async def story() -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            transport = await open_tcp(host="127.0.0.1", port=server.getsockname()[1])
            peer, _ = server.accept()
            await transport.write(b"hello")
            assert peer.recv(100) == b"hello"
            peer.sendall(b"world")
            assert await transport.read() == b"world"
            peer.close()
            with pytest.raises(TransportClosedError):
                await transport.read()
            await transport.aclose()
            port = server.getsockname()[1]
        with pytest.raises(TransportOpenError):
            await open_tcp(host="127.0.0.1", port=port)

    asyncio.run(story())


def test_the_memory_pair_passes_bytes_and_closes_both_ends() -> None:
    async def story() -> None:
        one, other = connected_pair()
        await one.write(b"a")
        await one.write(b"b")
        assert await _read(other, 2) == b"ab"
        await other.write(b"last")
        await other.aclose()
        assert await one.read() == b"last"
        with pytest.raises(TransportClosedError):
            await one.read()
        with pytest.raises(TransportClosedError):
            await one.write(b"x")

    asyncio.run(story())


def test_port_names_mean_what_they_say() -> None:
    assert parse_port_spec("serial:/dev/ttyACM0") == SerialSpec(path="/dev/ttyACM0", baud=115_200)
    assert parse_port_spec("serial:/dev/serial/by-id/usb-TI_CC2531-if00?baud=9600").name == "serial:/dev/serial/by-id/usb-TI_CC2531-if00"
    assert parse_port_spec("tcp:example.org:6638") == TcpSpec(host="example.org", port=6638)
    assert parse_port_spec("tcp:[::1]:6638") == TcpSpec(host="::1", port=6638)


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("/dev/ttyACM0", "names no kind of port: it must begin with serial:, tcp: or can:; did you mean serial:/dev/ttyACM0?"),
        ("usb:0", "unknown kind 'usb'"),
        ("can:can0", "must be can:INTERFACE:CHANNEL"),
        ("serial:", "names no device"),
        ("serial:/dev/x?baud=fast", "baud is 'fast'"),
        ("serial:/dev/x?baud=0", "baud is '0'"),
        ("serial:/dev/x?parity=E", "unknown option 'parity'"),
        ("serial:/dev/x?baud", "not of the form"),
        ("tcp:host", "must be tcp:HOST:PORT"),
        ("tcp::80", "must be tcp:HOST:PORT"),
        ("tcp:host:99999", "the port is '99999'"),
        ("", "names no kind of port"),
        ("tcp:a..b:77", "nothing between two dots"),
        (f"tcp:{'a' * 64}.org:77", "more than 63 characters"),
        (f"tcp:{'.'.join(['a' * 60] * 5)}:77", "at most 253"),
        ("tcp:a\0b:77", "control characters"),
        ("tcp:a b:77", "blanks"),
        ("serial:/dev/a\0b", "null character"),
        (f"serial:/dev/x?baud={'9' * 5000}", "from 1 to 4000000"),
        (f"tcp:host:{'9' * 5000}", "from 1 to 65535"),
        (f"can:socketcan:can0?unit={'9' * 5000}", "from 0 to 31"),
        ("serial:/dev/x?baud=0x2580", "baud is '0x2580'"),
        ("serial:/dev/x?baud=\u0669", "must be a number"),
        ("serial:/dev/x?dialect=znp&channel=0b1011", "channel is '0b1011'"),
        ("serial:/dev/x?dialect=znp&channel=1_5", "channel is '1_5'"),
        ("serial:/dev/x?dialect=znp&channel=+15", "channel is ' 15'"),
        (f"serial:/dev/x?dialect=znp&pan_id=0x{'0' * 5000}", "from 0 to 65534"),
        ("can:slcan:/dev/x?settle=1_0", "settle is '1_0'"),
        ("can:slcan:/dev/x?settle=nan", "settle is 'nan'"),
    ],
)
def test_a_wrong_port_name_is_refused_with_reason_and_examples(spec: str, reason: str) -> None:
    with pytest.raises(TransportSpecError, match="examples: serial:/dev/ttyACM0") as caught:
        parse_port_spec(spec)
    assert reason in str(caught.value)


def test_numbers_of_a_network_are_decimal_or_begin_with_0x() -> None:
    for pan_id, channel in (("4660", "15"), ("0x1234", "0xF"), ("0X1234", "015")):
        spec = parse_port_spec(f"serial:/dev/x?dialect=znp&pan_id={pan_id}&channel={channel}")
        assert isinstance(spec, SerialSpec)
        assert spec.network == NetworkWish(pan_id=0x1234, channel=15)


@given(host=st.text(min_size=1, max_size=80))
def test_whatever_is_named_as_a_host_is_refused_or_can_be_asked_for(host: str) -> None:
    try:
        spec = parse_port_spec(f"tcp:{host}:77")
    except TransportSpecError:
        return
    assert isinstance(spec, TcpSpec)
    spec.host.encode("idna")  # what asking for it begins with


def test_a_host_that_cannot_be_asked_for_is_a_port_that_cannot_be_opened_now() -> None:
    async def story() -> None:
        for host in ("a..b", "a" * 64, "a\0b"):
            with pytest.raises(TransportOpenError):
                await open_tcp(host=host, port=77)

    asyncio.run(story())


def test_a_spec_opens_its_transport() -> None:
    async def story() -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            spec = parse_port_spec(f"tcp:127.0.0.1:{server.getsockname()[1]}")
            transport = await open_transport(spec)
            assert transport.name == spec.name
            await transport.aclose()

    asyncio.run(story())


def test_listing_ports_never_fails() -> None:
    assert all(port.spec.startswith("serial:/dev/") for port in list_serial_ports())
