"""Probing: every family is told from its own answers, boot loaders are told as such, and the port is left as it was."""

import asyncio
import os
import termios
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.crc import append_crc
from gateway.probing.asking import Pace
from gateway.probing.findings import Finding, Verdict
from gateway.probing.probe import probe_port
from gateway.probing.recognition import (
    TEST_FRAMES,
    Family,
    is_can_adapter,
    mt_bodies,
    mt_request,
    recognise,
    xbee_answers,
    xbee_bodies,
    xbee_query,
)
from simulator.dongles.choice import DIALECTS
from tests.gateway.virtual_dongles import dongle_on_pty, dongle_on_tcp, some_payloads

FAST = Pace(answer_s=0.1, boot_s=0.15, silence_s=0.1, identify_s=5.0)
_SERIAL = [dialect for dialect in DIALECTS if "can" not in dialect]


def mt(cmd0: int, cmd1: int, data: bytes = b"") -> bytes:
    frame = bytes((len(data), cmd0, cmd1)) + data
    check = 0
    for byte in frame:
        check ^= byte
    return b"\xfe" + frame + bytes((check,))


class Cc253xBootLoader:
    """The serial boot loader of a CC2530 or CC2531: knows its handshake and 0xEF; behind it, if there is any, Z-Stack firmware."""

    def __init__(self, *, has_firmware: bool) -> None:
        self._has_firmware = has_firmware
        self._runs_firmware = False

    def __call__(self, data: bytes) -> bytes:
        if b"\xef" in data and self._has_firmware:
            self._runs_firmware = True
            return mt(0x41, 0x80, bytes((0, 2, 0, 2, 6, 3)))  # SYS_RESET_IND
        requests = [body for body in mt_bodies(data) if body[0] in {0x21, 0x25, 0x27, 0x4D}]
        if not self._runs_firmware:
            return b"".join(mt(0x4D, 0x84, b"\x00") for body in requests if body == b"\x4d\x04")
        answers = {
            b"\x21\x01": mt(0x61, 0x01, b"\x79\x07"),
            b"\x21\x02": mt(0x61, 0x02, bytes((2, 0, 2, 6, 3)) + (20190608).to_bytes(4, "little")),
            b"\x27\x00": mt(0x67, 0x00, b"\x00" + bytes(range(8)) + b"\x00\x00\x07\x09\x00"),
            b"\x25\x50": mt(0x65, 0x50, bytes((0, 0, 0x34, 0x12, 0, 0)) + bytes(16) + bytes((15,))),
        }
        return b"".join(answers.get(body, b"") for body in requests)


def rom_boot_loader(data: bytes) -> bytes:
    return b"\x00\xcc" if data == b"\x55\x55" else b""


def ezsp(data: bytes) -> bytes:
    return append_crc(b"\xc1\x02\x0b") + b"\x7e" if b"\x1a\xc0\x38\xbc\x7e" in data else b""


def menu(data: bytes) -> bytes:
    return b"\r\nGecko Bootloader v1.12\r\n1. upload gbl\r\n2. run\r\n3. ebl info\r\nBL > " if data == b"\r" else b""


def transparent_xbee(data: bytes) -> bytes:
    answers = {b"+++": b"OK\r", b"ATVR\r": b"4061\r", b"ATHV\r": b"1E46\r", b"ATAP\r": b"0\r", b"ATCN\r": b"OK\r"}
    return answers.get(data, b"")


def api_xbee(data: bytes) -> bytes:
    """An XBee in API mode 2 that knows the parameters a probe asks for."""
    values = {
        b"AP": b"\x02",
        b"VR": b"\x40\x61",
        b"HV": b"\x1e\x46",
        b"SH": b"\x00\x13\xa2\x00",
        b"SL": b"\x40\x7d\x11\x13",
        b"AI": b"\x00",
        b"OI": b"\xbe\xef",
        b"CH": b"\x14",
    }
    out = b""
    for body in xbee_bodies(data):
        if body[0] == 0x08 and body[2:4] in values:
            answer = b"\x88" + body[1:4] + b"\x00" + values[body[2:4]]
            rest = bytes((0, len(answer))) + answer + bytes((0xFF - sum(answer) % 256,))
            out += b"\x7e" + b"".join(bytes((0x7D, one ^ 0x20)) if one in {0x7E, 0x7D, 0x11, 0x13} else bytes((one,)) for one in rest)
    return out


@asynccontextmanager
async def device(path: Path, respond: Callable[[bytes], bytes], *, baud: int | None = None) -> AsyncIterator[None]:
    """Put a device on a pseudo-terminal; it understands and answers only at its own speed, if it has one."""
    master, slave = os.openpty()
    tty.setraw(slave)
    path.symlink_to(os.ttyname(slave))  # noqa: ASYNC240  # a blocking call of microseconds, in a test
    os.set_blocking(master, False)
    speed = None if baud is None else getattr(termios, f"B{baud}")

    def on_readable() -> None:
        try:
            data = os.read(master, 4096)
        except OSError:
            return
        if speed is None or termios.tcgetattr(master)[4] == speed:
            os.write(master, respond(data))

    loop = asyncio.get_running_loop()
    loop.add_reader(master, on_readable)
    try:
        yield
    finally:
        loop.remove_reader(master)
        os.close(slave)
        os.close(master)


def probed(
    tmp_path: Path, respond: Callable[[bytes], bytes], *, query: str = "", baud: int | None = None, is_intrusive: bool = False
) -> Finding:
    path = tmp_path / "port"

    async def run() -> Finding:
        async with device(path, respond, baud=baud):
            return await probe_port(f"serial:{path}{query}", is_intrusive=is_intrusive, pace=FAST)

    return asyncio.run(run())


@pytest.mark.parametrize("dialect", _SERIAL)
def test_every_virtual_dongle_is_told_with_its_network_and_the_spec_to_use(dialect: str, tmp_path: Path) -> None:
    path = tmp_path / "dongle"

    async def run() -> list[Finding]:
        async with dongle_on_pty(dialect, path):
            found = [await probe_port(str(path), pace=FAST)]
        async with dongle_on_tcp(dialect) as (_, spec):
            return [*found, await probe_port(spec.split("?")[0], pace=FAST)]

    on_pty, on_tcp = asyncio.run(run())

    assert (on_pty.verdict, on_pty.baud, on_tcp.baud) == (Verdict.ANSWERS, 115_200, None)
    assert on_pty.family == on_tcp.family == dialect.rstrip("12")
    assert on_pty.firmware
    assert on_pty.spec == f"serial:{path}?baud=115200&dialect={on_pty.family}"
    assert on_tcp.spec.endswith(f"?dialect={on_tcp.family}")
    assert on_pty.facts["pan"]


def test_what_a_native_dongle_holds_is_not_lost_by_a_probe_that_comes_too_late_for_it(tmp_path: Path) -> None:
    """The dongle tells who it is behind what it holds; a full window of payloads does not keep it from that."""
    path = tmp_path / "dongle"

    async def run() -> Finding:
        async with dongle_on_pty("native", path, payloads=some_payloads(40)):
            return await probe_port(str(path), pace=FAST)

    assert asyncio.run(run()).facts["channel"] == "20"


def test_a_boot_loader_with_firmware_behind_it_is_left_by_itself(tmp_path: Path) -> None:
    found = probed(tmp_path, Cc253xBootLoader(has_firmware=True))

    assert (found.verdict, found.family) == (Verdict.ANSWERS, "znp")
    assert "2.6.3" in found.firmware
    assert found.facts == {"eui64": "0706050403020100", "short_address": "0000", "pan": "1234", "channel": "15"}


@pytest.mark.parametrize(
    ("respond", "verdict", "family", "word"),
    [
        (Cc253xBootLoader(has_firmware=False), Verdict.BOOT_LOADER, "cc253x_boot_loader", "flash"),
        (rom_boot_loader, Verdict.BOOT_LOADER, "cc26x2_boot_loader", "without pressing"),
        (menu, Verdict.BOOT_LOADER, "menu_boot_loader", "run"),
        (ezsp, Verdict.UNSUPPORTED, "ezsp", "EZSP"),
        (lambda _: b"", Verdict.SILENT, "", "plugged in"),
        (lambda _: b"$GPGGA,123519\r\n", Verdict.SILENT, "", "24 47 50"),
    ],
)
def test_what_does_not_serve_is_told_with_what_to_do(
    respond: Callable[[bytes], bytes], verdict: Verdict, family: str, word: str, tmp_path: Path
) -> None:
    found = probed(tmp_path, respond, query="?baud=115200")

    assert (found.verdict, found.family, found.spec) == (verdict, family, "")
    assert word in found.advice


def test_an_xbee_in_api_mode_is_found_at_its_own_speed(tmp_path: Path) -> None:
    found = probed(tmp_path, api_xbee, baud=9_600)

    assert (found.verdict, found.family, found.baud) == (Verdict.ANSWERS, "xbee", 9_600)
    assert found.facts == {"mode": "API mode 2", "eui64": "0013a200407d1113", "pan": "beef", "channel": "20"}


def test_an_xbee_in_transparent_mode_is_found_only_by_an_intrusive_probe(tmp_path: Path) -> None:
    assert probed(tmp_path, transparent_xbee, query="?baud=9600").verdict is Verdict.SILENT
    (tmp_path / "port").unlink()
    found = probed(tmp_path, transparent_xbee, query="?baud=9600", is_intrusive=True)

    assert (found.verdict, found.family, found.facts) == (Verdict.ANSWERS, "xbee", {"mode": "transparent"})
    assert found.spec.endswith("?baud=9600&dialect=xbee")


def test_a_probe_leaves_the_ports_settings_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "port"

    async def run() -> tuple[list[object], list[object]]:
        async with device(path, lambda _: b""):
            fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
            settings = termios.tcgetattr(fd)
            settings[4] = settings[5] = termios.B19200
            termios.tcsetattr(fd, termios.TCSANOW, settings)
            before = termios.tcgetattr(fd)
            await probe_port(str(path), pace=Pace(answer_s=0.01, boot_s=0.01, silence_s=0.01))
            after = termios.tcgetattr(fd)
            os.close(fd)
            return before, after

    before, after = asyncio.run(run())

    assert after == before


def test_a_port_that_is_not_there_or_is_taken_is_told(tmp_path: Path) -> None:
    found = asyncio.run(probe_port(str(tmp_path / "nothing"), pace=FAST))

    assert (found.verdict, "list-ports" in found.advice) == (Verdict.NOT_OPENED, True)
    assert asyncio.run(probe_port("tcp:127.0.0.1:1", pace=FAST)).verdict is Verdict.NOT_OPENED


@given(st.binary(max_size=200))
def test_no_bytes_raise_in_recognition(data: bytes) -> None:
    assert recognise(data) in {None, *Family}
    xbee_answers(data)


def test_our_own_test_frames_echoed_back_are_no_dongle(tmp_path: Path) -> None:
    """A cable with its ends joined, or a modem that echoes, must not look like a dongle."""
    assert recognise(TEST_FRAMES) is None
    found = probed(tmp_path, lambda data: data, query="?baud=9600")
    assert (found.verdict, "sends back" in found.advice) == (Verdict.SILENT, True)
    assert recognise(mt_request(0x21, 0x01) + xbee_query("AP", frame_id=0x21)) is None


def test_bytes_without_meaning_are_no_dongle_whatever_frames_they_look_like(tmp_path: Path) -> None:
    """Frames with sound 8-bit checks are common among random bytes; only answers to what was asked prove a dongle."""
    random = Random(1)
    chance = [mt(0x41 + random.randrange(31), 0x80 + random.randrange(128), random.randbytes(random.randrange(9, 30))) for _ in range(40)]
    chance += [mt(0x60 + random.randrange(8), random.randrange(2, 256), random.randbytes(4)) for _ in range(40)]
    assert {recognise(one) for one in chance} == {None}
    assert recognise(random.randbytes(100_000)) is None

    found = probed(tmp_path, lambda _: b"".join(chance) + random.randbytes(2000), query="?baud=115200")
    assert (found.verdict, found.spec) == (Verdict.SILENT, "")
    assert "--intrusive" in found.advice, "an XBee in transparent mode passes on what it hears"


def test_what_answers_once_but_never_tells_who_it_is_is_not_offered_for_use(tmp_path: Path) -> None:
    found = probed(tmp_path, lambda _: mt(0x61, 0x01, b"\x79\x07"), query="?baud=115200")

    assert (found.verdict, found.spec) == (Verdict.SILENT, "")
    assert "looks like znp" in found.advice


@pytest.mark.parametrize("version", [b"V1013\r", b"CANable-1.2 github.com/normaldotcom/canable-fw\r", b"\a"])
def test_a_can_adapter_is_told_by_its_path_with_the_spec_of_its_bus(version: bytes, tmp_path: Path) -> None:
    def slcan(data: bytes) -> bytes:
        return b"".join(version if line == b"V" else b"\a" if line else b"\r" for line in data.split(b"\r")[:-1])

    found = probed(tmp_path, slcan)

    assert (found.verdict, found.family) == (Verdict.ANSWERS, "slcan")
    assert found.spec == f"can:slcan:{tmp_path / 'port'}?unit=1&bitrate=500000"
    assert "bit rate" in found.advice


@given(st.binary(max_size=60))
def test_no_other_bytes_than_an_adapters_make_a_can_adapter(data: bytes) -> None:
    assert not is_can_adapter(data) or b"\a" in data or b"V" in data or b"can" in data.lower()
    assert not is_can_adapter(b"V\r"), "an echo"
