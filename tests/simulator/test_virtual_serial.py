"""Laws of the lines a gateway opens: real pseudo-terminals and real sockets."""

import asyncio
import os
import socket
import termios
import time
import tty
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
import serial

from simulator.errors import LineError, ParameterError
from simulator.lines.carrier import open_line
from simulator.lines.line import LineSpec, SerialEnd, parse_line
from simulator.lines.serial_port import SerialPortEnd
from simulator.lines.tcp_port import TcpEnd
from simulator.lines.virtual_serial import PtyEnd

DEADLINE_S = 60.0


async def within(awaitable: Awaitable[bytes]) -> bytes:
    return await asyncio.wait_for(awaitable, DEADLINE_S)


async def read_all(end: SerialEnd, n: int) -> bytes:
    data = b""
    while len(data) < n:
        data += await within(end.read())
    return data


async def until(claim: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + DEADLINE_S
    while not claim():
        assert time.monotonic() < deadline_s
        await asyncio.sleep(0.01)


async def in_thread(read: Callable[[], bytes]) -> bytes:
    return await asyncio.to_thread(read)


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("pty:/tmp/a dongle", LineSpec(kind="pty", target="/tmp/a dongle")),
        ("pty:d?baud=115200", LineSpec(kind="pty", target="d", baud=115_200)),
        ("tcp:127.0.0.1:0", LineSpec(kind="tcp", target="127.0.0.1", port=0)),
        ("tcp:[::1]:7000", LineSpec(kind="tcp", target="::1", port=7000)),
        ("serial:/dev/ttyUSB0?baud=57600", LineSpec(kind="serial", target="/dev/ttyUSB0", baud=57_600)),
    ],
)
def test_a_specification_says_what_it_names(text: str, spec: LineSpec) -> None:
    assert parse_line(text) == spec


@pytest.mark.parametrize(
    "text", ["", "pty", "pty:", "can:vcan0", "tcp:7000", "tcp:h:70000", "tcp:h:x", "pty:a?baud=0", "pty:a?b=1", "pty:a?baud=²"]
)
def test_a_faulty_specification_is_refused_with_what_is_wanted(text: str) -> None:
    with pytest.raises(ParameterError, match="link"):
        parse_line(text)


def test_a_pty_carries_every_byte_both_ways_and_survives_a_reader_that_goes_and_comes_back(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "dongle"
        end = PtyEnd(path)
        await end.write(b"nobody is there: this is lost")
        every_byte = bytes(range(256))
        for _ in range(3):
            reading = asyncio.ensure_future(read_all(end, 256))
            with serial.Serial(str(path), 115_200, timeout=DEADLINE_S, exclusive=True) as port:
                port.write(every_byte)
                assert await reading == every_byte
                await end.write(every_byte)
                assert await in_thread(lambda: port.read(256)) == every_byte  # awaited within the loop's turn
        await end.aclose()
        assert not path.is_symlink()

    asyncio.run(story())


def test_hanging_up_ends_the_readers_wait(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "dongle"
        end = PtyEnd(path)
        with serial.Serial(str(path), 115_200, timeout=DEADLINE_S) as port:
            waiting = asyncio.ensure_future(in_thread(lambda: port.read(1)))
            await asyncio.sleep(0)
            await end.aclose()
            with pytest.raises(OSError):  # noqa: PT011  # pyserial words it in several ways
                await asyncio.wait_for(waiting, DEADLINE_S)

    asyncio.run(story())


def test_a_reader_that_does_not_read_stalls_the_writer_and_its_leaving_frees_it(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "dongle"
        end = PtyEnd(path)
        reader = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(reader, termios.TCSANOW)
        writing = asyncio.ensure_future(end.write(bytes(1_000_000)))
        done, _ = await asyncio.wait({writing}, timeout=0.3)
        assert not done
        os.close(reader)
        await asyncio.wait_for(writing, DEADLINE_S)
        await end.aclose()

    asyncio.run(story())


def test_a_second_simulator_is_refused_the_name_until_the_first_has_ended(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "dongle"
        older = PtyEnd(path)
        target = path.readlink()
        with pytest.raises(LineError, match="another simulator"):
            PtyEnd(path)
        assert path.readlink() == target
        await older.aclose()
        newer = PtyEnd(path)
        with serial.Serial(str(path), timeout=DEADLINE_S) as port:
            await newer.write(b"here")
            assert await in_thread(lambda: port.read(4)) == b"here"
        await newer.aclose()
        assert os.listdir(tmp_path) == []  # noqa: PTH208

    asyncio.run(story())


def test_a_name_that_is_no_link_to_a_terminal_is_never_replaced(tmp_path: Path) -> None:
    file = tmp_path / "data"
    file.write_text("mine")
    link = tmp_path / "link"
    link.symlink_to(file)
    for path in (file, link, tmp_path / "no" / "such" / "directory"):
        with pytest.raises(LineError, match="pty:"):
            PtyEnd(path)
    assert file.read_text() == "mine"
    assert link.readlink() == file


def test_a_paced_line_takes_the_time_that_its_speed_needs(tmp_path: Path) -> None:
    """960 bytes of ten bits at 9600 baud take 1 s."""

    async def story() -> None:
        end = PtyEnd(tmp_path / "dongle", baud=9_600)
        with serial.Serial(str(tmp_path / "dongle"), timeout=DEADLINE_S) as port:
            began_s = time.monotonic()
            reading = asyncio.ensure_future(in_thread(lambda: port.read(960)))
            await end.write(bytes(960))
            assert await reading == bytes(960)
            assert time.monotonic() - began_s > 0.9
        await end.aclose()

    asyncio.run(story())


def test_a_tcp_port_takes_one_gateway_at_a_time_and_the_next_when_it_has_gone() -> None:
    async def story() -> None:
        end = await TcpEnd.listen("127.0.0.1", 0)
        host, port = end.address.removeprefix("tcp:").rsplit(":", 1)
        await end.write(b"nobody is there: this is lost")
        for number in range(3):
            reader, writer = await asyncio.open_connection(host, int(port))
            writer.write(b"up%d" % number)
            assert await read_all(end, 3) == b"up%d" % number
            await end.write(b"down")
            assert await within(reader.readexactly(4)) == b"down"
            second_reader, second_writer = await asyncio.open_connection(host, int(port))
            assert await within(second_reader.read()) == b""
            second_writer.close()
            await second_writer.wait_closed()
            writer.close()
            await writer.wait_closed()
            waiting = asyncio.ensure_future(end.read())
            await until(lambda: not end.is_connected)
            waiting.cancel()
        await end.aclose()

    asyncio.run(story())


def test_a_gateway_that_does_not_read_cannot_hold_the_port_after_leaving() -> None:
    async def story() -> None:
        end = await TcpEnd.listen("127.0.0.1", 0)
        _, port = end.address.removeprefix("tcp:").rsplit(":", 1)
        rude = socket.create_connection(("127.0.0.1", int(port)))
        await until(lambda: end.is_connected)
        waiting = asyncio.ensure_future(end.read())
        writing = asyncio.ensure_future(end.write(bytes(50_000_000)))
        done, _ = await asyncio.wait({writing}, timeout=0.2)
        assert not done
        rude.close()
        await asyncio.wait_for(writing, DEADLINE_S)
        await until(lambda: not end.is_connected)
        waiting.cancel()
        await end.aclose()

    asyncio.run(story())


def test_a_port_that_is_taken_is_refused_with_its_name() -> None:
    async def story() -> None:
        end = await TcpEnd.listen("127.0.0.1", 0)
        with pytest.raises(LineError, match="cannot listen"):
            await open_line(parse_line(end.address))
        await end.aclose()

    asyncio.run(story())


def test_a_real_serial_port_is_opened_again_after_it_was_unplugged(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "ttyUSB0"
        device = PtyEnd(path)
        end = SerialPortEnd(str(path), baud=1_000_000)
        await end.write(b"first")
        assert await read_all(device, 5) == b"first"
        reading = asyncio.ensure_future(end.read())
        await device.aclose()
        await until(lambda: not end.is_open)
        await end.write(b"into the void")
        device = PtyEnd(path)
        await until(lambda: end.is_open)
        await device.write(b"again")
        data = await within(reading)
        while len(data) < 5:
            data += await within(end.read())
        assert data == b"again"
        await end.aclose()
        await device.aclose()

    asyncio.run(story())


def test_a_serial_port_that_is_not_there_is_refused_with_its_name(tmp_path: Path) -> None:
    with pytest.raises(LineError, match="no-such-port"):
        SerialPortEnd(str(tmp_path / "no-such-port"), baud=115_200)
