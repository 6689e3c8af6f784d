"""One radio's trouble is its own: hanging openings, floods, silence, flapping, and thousands of attempts."""

import asyncio
import logging
import os
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.dialects.xbee import XBeeHost
from firmware_protocol.dialects.xbee_frames import ModemStatus, encode_xbee
from firmware_protocol.dialects.xbee_meanings import HARDWARE_RESET
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.framing.xbee import encode_frame as encode_xbee_frame
from firmware_protocol.units import NS_PER_S
from gateway.backoff import Backoff
from gateway.config import LinkTable
from gateway.coordinator import Coordinator
from gateway.errors import TransportHangsError, TransportOpenError, TransportSpecError
from gateway.health import Health, RadioState
from gateway.log_ration import LogRation
from gateway.transports.can_port import BlockingBus, CanBuses
from gateway.transports.can_spec import CanSpec
from gateway.transports.fair_share import BEGUN, OVER, FairShare, LoopLoad
from gateway.transports.interface import Transport
from gateway.transports.memory import MemoryTransport, connected_pair
from gateway.transports.own_thread import OverdueError, call_in_own_thread
from gateway.transports.serial_port import open_serial
from gateway.transports.spec import open_transport, parse_port_spec, port_problems
from simulator.dongles.choice import make_dongle
from tests.gateway.fake_radio import until
from tests.gateway.virtual_dongles import dongle_on_pty

_QUICK = LinkTable(first_backoff_s=0.001, max_backoff_s=0.002, open_timeout_s=0.001)


def _a_radio(
    open_port: Callable[[], Awaitable[Transport]],
    *,
    dialect: str = "native",
    config: LinkTable = _QUICK,
    health: Health | None = None,
    reset_port: Callable[[], Awaitable[Transport]] | None = None,
    idle_ns: int | None = None,
) -> Coordinator:
    return Coordinator(
        radio="r",
        make_host=partial(make_host, dialect, idle_ns=idle_ns),
        open_port=open_port,
        on_radio=lambda _: None,
        config=config,
        health=health or Health(),
        first_session=1,
        reset_port=reset_port,
    )


async def _end(*tasks: asyncio.Task[Any]) -> None:
    pending = set(tasks)
    while pending:
        for task in tasks:
            task.cancel()  # once more where it met a port's closing in the same step, and was lost (Python 3.11)
        _, pending = await asyncio.wait(pending, timeout=0.1)


def _n_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_what_comes_back_too_late_is_disposed_of_and_said_to_be_over() -> None:
    async def story() -> None:
        let_go, disposed = threading.Event(), list[str]()

        def hang() -> str:
            let_go.wait()
            return "late"

        with pytest.raises(OverdueError) as caught:
            await call_in_own_thread(hang, name="t", timeout_s=0.01, dispose=disposed.append)
        assert not caught.value.is_over()
        cancelled = asyncio.ensure_future(call_in_own_thread(hang, name="t", timeout_s=60, dispose=disposed.append))
        await asyncio.sleep(0)
        await _end(cancelled)
        let_go.set()
        await until(lambda: disposed == ["late", "late"] and caught.value.is_over(), what="both are disposed of")

        with pytest.raises(TimeoutError, match="its own"):
            await call_in_own_thread(partial(_raise, TimeoutError("its own")), name="t", timeout_s=60)
        assert await call_in_own_thread(lambda: 7, name="t", timeout_s=60) == 7

    asyncio.run(story())


def _raise(error: Exception) -> None:
    raise error


def test_an_opening_that_hangs_costs_one_thread_however_long_it_is_tried() -> None:
    async def story() -> None:
        let_go, health = threading.Event(), Health()

        async def open_port() -> Transport:
            try:
                await call_in_own_thread(let_go.wait, name="hangs", timeout_s=0.01)
            except OverdueError as error:
                raise TransportHangsError(name="r", timeout_s=0.01, is_over=error.is_over) from error
            raise TransportOpenError(name="r", reason="it came back")

        task = asyncio.ensure_future(_a_radio(open_port, health=health).run())
        await until(lambda: health.counters().get("radio.attempts", 0) >= 30, what="thirty attempts")
        assert [one.name for one in threading.enumerate()].count("hangs") == 1
        assert health.counters()["radio.hanging_openings"] == 1
        assert "has not opened it within" in health.radio_conditions()["r"].reason
        let_go.set()
        await until(lambda: "came back" in health.radio_conditions()["r"].reason, what="it is opened again")
        await _end(task)

    asyncio.run(story())


def test_a_bus_that_hangs_keeps_no_other_from_being_opened() -> None:
    async def story() -> None:
        let_go, n_opened = threading.Event(), 0

        def open_bus(spec: CanSpec) -> BlockingBus:
            nonlocal n_opened
            if spec.channel == "sick":
                n_opened += 1
                let_go.wait()
            raise TransportOpenError(name=spec.bus_name, reason="it is not there")

        buses = CanBuses(open_bus=open_bus, open_timeout_s=0.05)
        units = [asyncio.ensure_future(buses.open(CanSpec(interface="virtual", channel="sick", unit=unit))) for unit in range(3)]
        with pytest.raises(TransportOpenError, match="not there"):
            await buses.open(CanSpec(interface="virtual", channel="well"))
        assert not any(unit.done() for unit in units)
        for unit in units:
            with pytest.raises(TransportHangsError):
                await unit
        assert n_opened == 1, "three units of one bus wait for one opening"
        let_go.set()

    asyncio.run(story())


@given(first=st.floats(0.001, 60), limit=st.floats(0.001, 60), n=st.integers(1, 40))
def test_pauses_grow_to_the_limit_and_never_beyond(first: float, limit: float, n: int) -> None:
    backoff = Backoff(first_s=first, max_s=limit)
    for _ in range(2):
        for k in range(n):
            longest = min(first * 2**k, limit)
            assert longest / 2 <= backoff.take_s() <= longest
        backoff.start_anew()


@given(moments=st.lists(st.integers(0, 300), max_size=200).map(sorted))
def test_no_period_has_more_lines_than_its_ration_and_all_others_are_counted(moments: list[int]) -> None:
    ration, said, n_told = LogRation(n_lines=3, period_s=60), list[int](), 0
    for moment in moments:
        n_unsaid = ration.ask(now_ns=moment * NS_PER_S)
        if n_unsaid is not None:
            said.append(moment)
            n_told += n_unsaid
    assert all(sum(at <= other < at + 60 for other in said) <= 6 for at in said), "any minute meets two periods at most"
    assert len(said) + n_told <= len(moments)
    last = ration.ask(now_ns=1_000 * NS_PER_S)
    assert last is not None
    assert len(said) + n_told + last == len(moments)


def test_a_thousand_reopenings_leave_no_descriptor_and_no_thread_behind(caplog: pytest.LogCaptureFixture) -> None:
    """Three ptys and a TCP port, 250 times each, behind which nobody answers; the log says so once for each."""

    async def story() -> None:
        masters, paths = list[int](), list[str]()
        for _ in range(3):
            master, slave = os.openpty()
            tty.setraw(slave)
            masters.append(master)
            paths.append(os.ttyname(slave))
            os.close(slave)

        async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.transport.abort()

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        tcp = f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}"
        specs = [parse_port_spec(text) for text in (tcp, *(f"serial:{path}" for path in paths))]
        healths = [Health() for _ in specs]
        for spec in specs:
            await (await open_transport(spec)).aclose()
        before, n_threads = _n_descriptors(), threading.active_count()
        tasks = [
            asyncio.ensure_future(_a_radio(partial(open_transport, spec), health=health).run())
            for spec, health in zip(specs, healths, strict=True)
        ]
        await until(lambda: all(one.counters().get("radio.attempts", 0) > 250 for one in healths), what="250 attempts each", timeout_s=60)
        await _end(*tasks)
        await until(lambda: _n_descriptors() <= before and threading.active_count() <= n_threads, what="nothing is left")
        server.close()
        for master in masters:
            os.close(master)

    with caplog.at_level(logging.INFO, logger="gateway"):
        asyncio.run(story())
    assert [record.getMessage() for record in caplog.records] == ["radio.down"] * 4


def test_a_by_id_link_is_followed_to_wherever_the_dongle_comes_back(tmp_path: Path) -> None:
    async def story() -> None:
        link, health = tmp_path / "usb-TI_CC2531-if00", Health()
        spec = parse_port_spec(f"serial:{link}")
        radio = _a_radio(partial(open_transport, spec), config=LinkTable(first_backoff_s=0.01, max_backoff_s=0.05), health=health)
        task = asyncio.ensure_future(radio.run())
        await until(lambda: "there is no" in health.radio_conditions()["r"].reason, what="it says what is missing")
        async with AsyncExitStack() as later:
            async with dongle_on_pty("native", link):
                first = link.readlink()
                await until(lambda: radio.is_up, what="it is found")
                condition = health.radio_conditions()["r"]
                assert (condition.state, condition.reason) == (RadioState.UP, "")
                await until(lambda: "native firmware" in health.radio_conditions()["r"].firmware, what="it has said who it is")
                # Made while the first is there, so that it has another number, whoever else opens terminals.
                elsewhere = tmp_path / "elsewhere"
                await later.enter_async_context(dongle_on_pty("native", elsewhere))
            await until(lambda: not radio.is_up, what="it is pulled out")
            assert elsewhere.readlink() != first
            elsewhere.rename(link)
            await until(lambda: radio.is_up, what="it is found under another number")
        await _end(task)

    asyncio.run(story())


class _Dongle:
    """A virtual dongle behind cables in memory; hung, it takes all and says nothing until it is reset."""

    def __init__(self, dialect: str) -> None:
        self._dongle = make_dongle(dialect, index=0)
        self._dongle.start(now_ns=time.monotonic_ns())
        self.is_hung = False
        self.n_opened = self.n_reset = 0
        self._far: MemoryTransport | None = None

    async def open(self) -> Transport:
        self.n_opened += 1
        near, self._far = connected_pair()
        return near

    async def reset(self) -> Transport:
        self.n_reset += 1
        self.is_hung = False
        self._dongle.start(now_ns=time.monotonic_ns())
        return await self.open()

    async def run(self) -> None:
        while True:
            far = self._far
            if far is not None:
                reading = asyncio.ensure_future(far.read())
                await asyncio.wait({reading}, timeout=0.002)
                if not reading.done():
                    reading.cancel()
                elif reading.exception() is None and not self.is_hung:
                    self._dongle.feed(reading.result(), now_ns=time.monotonic_ns())
            else:
                await asyncio.sleep(0.002)
            if not self.is_hung:
                self._dongle.handle_deadline(now_ns=time.monotonic_ns())
                if (said := self._dongle.take_bytes()) and far is not None and far is self._far:
                    await asyncio.gather(far.write(said), return_exceptions=True)


def test_a_dongle_that_hangs_is_noticed_reset_by_its_line_and_opened_again() -> None:
    async def story(dialect: str) -> None:
        dongle, health = _Dongle(dialect), Health()
        config = LinkTable(first_backoff_s=0.01, open_timeout_s=2.0)
        radio = _a_radio(dongle.open, reset_port=dongle.reset, dialect=dialect, config=config, health=health, idle_ns=NS_PER_S // 2)
        tasks = [asyncio.ensure_future(one) for one in (radio.run(), dongle.run())]
        await until(lambda: radio.is_up, what=f"{dialect} is up")
        dongle.is_hung = True
        # Counted, for it may be up again before one looks.
        await until(lambda: health.counters().get("radio.faults", 0) > 0, what=f"the {dialect} dongle's silence is noticed")
        await until(lambda: radio.is_up, what=f"{dialect} is up again")
        assert (dongle.n_opened, dongle.n_reset) == (2, 1)
        assert health.counters()["radio.line_reset"] == 1
        await _end(*tasks)

    async def stories() -> None:
        await asyncio.gather(*(story(dialect) for dialect in ("native", "xbee", "znp")))

    asyncio.run(stories())


def test_a_dongle_is_reset_only_after_so_many_silences_as_the_configuration_says() -> None:
    async def story() -> None:
        for limit, wanted in ((0, "never"), (3, "from the fourth opening on")):
            openings, health = list[str](), Health()

            async def open_as(kind: str, into: list[str] = openings) -> Transport:
                into.append(kind)
                return connected_pair()[0]

            config = LinkTable(first_backoff_s=0.001, max_backoff_s=0.002, open_timeout_s=0.002, silences_before_reset=limit)
            radio = _a_radio(partial(open_as, "open"), reset_port=partial(open_as, "reset"), config=config, health=health)
            task = asyncio.ensure_future(radio.run())
            await until(partial(_has_six, openings), what="six openings")
            await _end(task)
            assert openings[:6] == ["open"] * (limit or 6) + ["reset"] * (6 - (limit or 6)), wanted

    asyncio.run(story())


def _has_six(openings: list[str]) -> bool:
    return len(openings) >= 6


class _Flooding:
    """Always has more to say, and never waits."""

    name = "flood"

    def __init__(self, chunk: bytes, *, n_chunks: int = 1_000_000) -> None:
        self._chunk = chunk
        self._n_left = n_chunks

    async def read(self) -> bytes:
        if not self._n_left:
            await asyncio.get_running_loop().create_future()
        self._n_left -= 1
        return self._chunk

    async def write(self, data: bytes) -> None:
        raise AssertionError(data)

    def write_at_once(self, data: bytes) -> bytes:
        raise AssertionError(data)

    async def aclose(self) -> None:
        pass


@given(chunks=st.lists(st.binary(min_size=1, max_size=5_000), min_size=1, max_size=5))
def test_a_fair_share_changes_no_byte(chunks: list[bytes]) -> None:
    async def story() -> bytes:
        near, far = connected_pair()
        share = FairShare(radio="r", load=LoopLoad(n_radios=8), max_bytes_per_s=1e9, health=Health())
        transport = await share.opening(partial(_give, near))()
        data, wanted = b"", 0
        for chunk in chunks:
            await far.write(chunk)
            wanted += len(chunk)
            while len(data) < wanted:
                data += await transport.read()
        return data

    assert asyncio.run(story()) == b"".join(chunks)


async def _give(transport: Transport) -> Transport:
    return transport


def test_a_flood_leaves_all_others_a_turn_between_its_pieces_and_is_told_when_it_begins_and_when_it_is_over() -> None:
    async def story() -> None:
        told, health, n_turns, n_bytes, longest = list[str](), Health(), 0, 0, 0
        share = FairShare(
            radio="r",
            load=LoopLoad(n_radios=8),
            max_bytes_per_s=100_000,
            health=health,
            on_flood=lambda *facts: told.append(facts[1]),
            over_s=0.2,
        )
        transport = await share.opening(partial(_give, _Flooding(bytes(4096), n_chunks=10)))()

        async def read() -> None:
            nonlocal n_bytes, longest
            while True:
                n_before = n_turns
                n_bytes += len(await transport.read())
                assert n_turns > n_before or n_bytes <= 4_096, "another task had its turn"
                longest = max(longest, share.piece)

        async def take_turns() -> None:
            nonlocal n_turns
            while True:
                n_turns += 1
                await asyncio.sleep(0)

        began_s = time.monotonic()
        tasks = [asyncio.ensure_future(one()) for one in (take_turns, read)]
        await until(lambda: n_bytes == 10 * 4096, what="all was read")
        assert time.monotonic() - began_s >= 0.3, "25,000 bytes at once, the other 15,960 at a fifth of the pace"
        await until(lambda: told == [BEGUN, OVER], what="it is over")
        assert health.counters()["radio.floods"] == 1
        await _end(*tasks)

    asyncio.run(story())


def test_what_a_dongle_repeats_without_end_fills_no_memory_and_is_answered_once() -> None:
    host = NativeHost()
    host.open(session=5, now_ns=0)
    host.feed(encode_frame(b"\x02\x05\x00\x00\x01"), now_ns=0)
    host.take_frames()
    host.feed(encode_frame(b"\x05\x05\x00\x00") * 10_000, now_ns=1)
    answers = [body for frame in host.take_frames() for body in CobsDecoder().feed(frame)]
    assert answers == [b"\x04\x05\x00\x00"]

    module = XBeeHost()
    module.open(session=1, now_ns=0)
    event = encode_xbee_frame(encode_xbee(ModemStatus(status=HARDWARE_RESET)), is_escaped=True)
    for at_ms in range(1_000):
        module.feed(event * 10, now_ns=at_ms * 1_000_000)
        module.handle_deadline(now_ns=at_ms * 1_000_000)
    assert len(module.take_frames()) <= 60, "asked every 50 ms at most, and knocked at now and then"


def test_a_port_that_another_process_has_is_told_so(tmp_path: Path) -> None:
    async def story() -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        path = os.ttyname(slave)
        os.close(slave)
        holding = "import serial, sys; port = serial.Serial(sys.argv[1], exclusive=True); print('held', flush=True); sys.stdin.read()"
        with subprocess.Popen(  # noqa: ASYNC220  # another process, which nothing here waits for in vain
            [sys.executable, "-c", holding, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as other:
            assert other.stdout is not None
            assert other.stdin is not None
            assert other.stdout.readline() == b"held\n"
            with pytest.raises(TransportOpenError, match="in use by another process"):
                await open_serial(path=path, baud=115_200)
            other.stdin.close()
            assert other.wait() == 0
        link = tmp_path / "by-id"
        link.symlink_to(path)
        transport = await open_serial(path=path, baud=115_200)
        with pytest.raises(TransportOpenError, match="in use by this gateway already"):
            await open_serial(path=str(link), baud=115_200)
        await transport.aclose()
        os.close(master)
        link.unlink()

    asyncio.run(story())


def test_two_names_of_one_device_are_one_too_many(tmp_path: Path) -> None:
    device, link = tmp_path / "ttyUSB0", tmp_path / "usb-Silicon_Labs-if00"
    device.touch()
    link.symlink_to(device)
    assert port_problems([f"serial:{device}", f"serial:{link}"]) == [
        f"port serial:{link} is the same device as serial:{device}, {device}: name it once"
    ]
    assert "is named twice" in port_problems([f"serial:{device}", f"serial:{device}?baud=9600"])[0]
    assert "is the same device as" in port_problems([f"can:slcan:{device}", f"serial:{link}"])[0]
    assert "is the same device as" in port_problems([f"can:slcan:{device}?unit=1", f"can:slcan:{link}?unit=2"])[0]
    assert port_problems([f"can:slcan:{device}?unit=1", f"can:slcan:{device}?unit=2", "tcp:a:1", "tcp:b:1", f"serial:{tmp_path}/x"]) == []
    assert len(port_problems(["usb:0", "serial:"])) == 2


def test_how_a_line_resets_its_dongle_is_named_in_the_port() -> None:
    specs = [
        parse_port_spec(f"serial:/dev/x?dialect={dialect}{more}")
        for dialect, more in (("znp", ""), ("znp", "&reset=none"), ("native", "&reset=dtr"))
    ]
    assert [spec.reset.value for spec in specs if hasattr(spec, "reset")] == ["rts", "none", "dtr"]
    with pytest.raises(TransportSpecError, match="reset is 'usb', but must be one of none, rts, dtr, break"):
        parse_port_spec("serial:/dev/x?reset=usb")
