"""Laws of what drives one radio, with real hosts and virtual dongles on lines in memory."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import pytest

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.dialects.interface import Host, HostEvent
from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.envelope import RadioReceived, RadioStatus
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.message_codec import decode_downlink
from firmware_protocol.messages import HelloRequest
from firmware_protocol.units import BROADCAST, LAST_NODE_ADDRESS, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.config import LinkTable
from gateway.coordinator import Coordinator
from gateway.downlink import DownlinkSender
from gateway.errors import RadioUnavailableError, TransportClosedError
from gateway.health import Health, RadioState
from gateway.nodes import NodeBook
from gateway.radio import Fate, RadioMessage, outcome_of
from gateway.transports.interface import Transport
from gateway.transports.memory import connected_pair
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from tests.gateway.fake_radio import until
from tests.gateway.virtual_dongles import hand_over, some_payloads

_LINK = LinkTable(first_backoff_s=0.05, max_backoff_s=0.2)


@dataclass(kw_only=True)
class _Plug:
    """A dongle and its port; each opening of the port is another cable."""

    dongle: Dongle
    opened: asyncio.Queue[Transport] = field(default_factory=asyncio.Queue)

    async def open(self) -> Transport:
        ours, theirs = connected_pair()
        await self.opened.put(theirs)
        return ours

    async def run(self) -> None:
        """Move bytes of the newest cable."""
        line = await self.opened.get()
        reading = asyncio.ensure_future(line.read())
        try:
            while True:
                now_ns = time.monotonic_ns()
                while self.dongle.requests and self.dongle.requests[0].destination == 0xFFF7:
                    self.dongle.confirm(self.dongle.requests.popleft().handle, RadioStatus.SENT, now_ns=now_ns)
                self.dongle.handle_deadline(now_ns=now_ns)
                if data := self.dongle.take_bytes():
                    with contextlib.suppress(TransportClosedError):  # what is written to a cable that is out is lost
                        await line.write(data)
                if not self.opened.empty():
                    reading.cancel()
                    line = self.opened.get_nowait()
                    reading = asyncio.ensure_future(line.read())
                await asyncio.wait({reading}, timeout=0.002)
                if reading.done() and reading.exception() is None:
                    self.dongle.feed(reading.result(), now_ns=time.monotonic_ns())
                    reading = asyncio.ensure_future(line.read())
        finally:
            reading.cancel()


def _a_plug(dialect: str = "native") -> _Plug:
    dongle = make_dongle(dialect, index=0)
    dongle.start(now_ns=time.monotonic_ns())
    return _Plug(dongle=dongle)


def _a_coordinator(
    open_port: Callable[[], Awaitable[Transport]],
    *,
    on_radio: Callable[[RadioMessage], "asyncio.Future[None] | None"] = lambda _: None,
    make: Callable[[], Host] | None = None,
    health: Health | None = None,
    on_state: Callable[[str, RadioState, str], None] | None = None,
    radio: str = "r",
) -> Coordinator:
    return Coordinator(
        radio=radio,
        make_host=make or partial(make_host, "native"),
        open_port=open_port,
        on_radio=on_radio,
        config=_LINK,
        health=health or Health(),
        first_session=1,
        on_state=on_state,
    )


@asynccontextmanager
async def _running(*parts: Awaitable[None]) -> AsyncIterator[None]:
    tasks = [asyncio.ensure_future(part) for part in parts]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def test_nothing_is_sent_to_an_address_of_many_or_of_nobody() -> None:
    async def story() -> None:
        plug = _a_plug()
        coordinator = _a_coordinator(plug.open)
        async with _running(coordinator.run(), plug.run()):
            await until(lambda: coordinator.is_up, what="the radio is up")
            for address in range(LAST_NODE_ADDRESS + 1, 0x10000):
                with pytest.raises(RadioUnavailableError, match="is no biobot's address"):
                    coordinator.send(destination=ShortAddress(address), payload=b"start", is_urgent=address % 2 == 0)
            outcome = await coordinator.send(destination=LAST_NODE_ADDRESS, payload=b"start")
            assert outcome.fate is Fate.SENT
            assert not plug.dongle.requests, "nothing else went out"

    asyncio.run(story())


def test_a_payload_that_the_gateway_fails_at_costs_itself_alone() -> None:
    async def story() -> None:
        plug, health, heard = _a_plug(), Health(), list[bytes]()
        payloads = some_payloads(40)

        def take(message: RadioMessage) -> None:
            if message.payload == payloads[3]:
                raise ValueError("a fault nobody thought of")
            heard.append(message.payload)

        coordinator = _a_coordinator(plug.open, on_radio=take, health=health)
        async with _running(coordinator.run(), plug.run()):
            await until(lambda: coordinator.is_up, what="the radio is up")
            for payload in payloads:  # more than a native dongle sends without a confirmation
                assert hand_over(plug.dongle, payload)
            await until(lambda: len(heard) == 39, what="all others are taken")
            assert heard == payloads[:3] + payloads[4:]
            assert coordinator.is_up
            assert health.counters()["message.broken"] == 1
            assert health.counters()["radio.sessions"] == 1

    asyncio.run(story())


class _FailingOnce(NativeHost):
    """A host with a fault that shows at the first payload from the radio and stays."""

    def __init__(self, is_broken: list[bool]) -> None:
        super().__init__()
        self._is_broken = is_broken.pop()

    def feed(self, chunk: bytes, *, now_ns: int) -> list[HostEvent]:
        if self._is_broken:
            raise RuntimeError("a fault nobody thought of")
        return super().feed(chunk, now_ns=now_ns)


def test_a_fault_that_nobody_thought_of_in_port_or_host_is_told_and_tried_again() -> None:
    async def story() -> None:
        plug, health, n_tries = _a_plug(), Health(), 0
        are_broken = [False, True, False]  # the last is taken first, and replaced after the port's fault

        async def open_port() -> Transport:
            nonlocal n_tries
            n_tries += 1
            if n_tries == 1:
                raise UnicodeError("label too long")
            return await plug.open()

        coordinator = _a_coordinator(open_port, make=partial(_FailingOnce, are_broken), health=health)
        async with _running(coordinator.run(), plug.run()):
            await until(lambda: coordinator.is_up, what="the radio is up")
            assert health.counters()["radio.broken"] == 2
            assert not are_broken

    asyncio.run(story())


def test_a_dongle_that_restarts_again_and_again_is_asked_less_and_less() -> None:
    async def story() -> None:
        ours, theirs = connected_pair()
        asked_s, states = list[float](), list[RadioState]()

        async def open_port() -> Transport:
            return ours

        async def restart_for_ever() -> None:
            """Answer each RESET, and say at once that the session is unknown: the reset of its firmware (WIRE_FORMAT.md §3.2)."""
            decoder = CobsDecoder()
            while True:
                for body in decoder.feed(await theirs.read()):
                    if isinstance(body, bytes) and body[0] == 1:
                        asked_s.append(time.monotonic())
                        await theirs.write(encode_frame(b"\x02" + body[1:3] + b"\x00\x01") + encode_frame(b"\x06\x00\x00\x00"))

        def note(_radio: str, state: RadioState, _reason: str) -> None:
            states.append(state)

        coordinator = _a_coordinator(open_port, on_state=note)
        async with _running(coordinator.run(), restart_for_ever()):
            await until(lambda: len(asked_s) >= 5, what="it was opened five times")
        pauses_s = [after - before for before, after in pairwise(asked_s)]
        assert all(pause_s >= least_s for pause_s, least_s in zip(pauses_s, (0.05, 0.1, 0.2, 0.2), strict=False))
        assert states[:8] == [RadioState.UP, RadioState.DOWN] * 4, "one of each a pause"

    asyncio.run(story())


def test_an_urgent_message_goes_over_every_radio_that_heard_the_biobot_of_late_and_no_other_does() -> None:
    async def story() -> None:
        plugs = {name: _a_plug() for name in ("a", "b", "c")}
        coordinators = {name: _a_coordinator(plug.open, radio=name) for name, plug in plugs.items()}
        nodes = NodeBook(gateway="g")

        def hear(node: int, radio: str, address: int, *, sent_ms: int) -> None:
            nodes.heard(
                node=NodeId(node),
                boot=BootId(1),
                radio=radio,
                address=ShortAddress(address),
                rssi_dbm=RssiDbm(-50),
                lqi=1,
                sent_ms=Milliseconds(sent_ms),
                now_ns=time.monotonic_ns(),
                now_wall_ns=Nanoseconds(1),
            )

        def asked() -> dict[str, list[int]]:
            return {name: [request.destination for request in plug.dongle.requests] for name, plug in plugs.items()}

        sender = DownlinkSender(coordinators=coordinators, nodes=nodes)
        async with _running(*(one.run() for one in coordinators.values()), *(plug.run() for plug in plugs.values())):
            await until(lambda: all(one.is_up for one in coordinators.values()), what="all are up")
            hear(7, "a", 0x10, sent_ms=1)
            hear(7, "b", 0x20, sent_ms=2)
            hear(7, "a", 0x10, sent_ms=1)  # kept by a dongle that was away
            hear(7, "c", 0x30, sent_ms=1)
            hear(8, "c", 0x30, sent_ms=1)  # and that address is another's by now
            sender.send(NodeId(7), HelloRequest())
            sender.send(NodeId(7), HelloRequest(), is_urgent=True)
            assert len(sender.send_elsewhere(NodeId(7), HelloRequest())) == 1
            await until(lambda: sum(map(len, asked().values())) == 3, what="the radios were asked")
            assert asked() == {"a": [0x10], "b": [0x20, 0x20], "c": []}
            assert all(not isinstance(decode_downlink(plug.dongle.requests[0].payload), str) for name, plug in plugs.items() if name != "c")
            hear(9, "b", 0x20, sent_ms=1)
            with pytest.raises(RadioUnavailableError, match="another biobot's now"):
                sender.send(NodeId(7), HelloRequest())
            assert len(sender.send_elsewhere(NodeId(7), HelloRequest())) == 1, "a STOP still goes where the biobot may be"

    asyncio.run(story())


def test_a_message_to_all_goes_out_by_broadcast_over_every_radio_that_is_up() -> None:
    async def story() -> None:
        plugs = {name: _a_plug(dialect) for name, dialect in (("a", "native"), ("b", "xbee"), ("c", "znp"), ("down", "native"))}
        coordinators = {
            name: _a_coordinator(plug.open, radio=name, make=partial(make_host, "native" if name == "down" else dialect))
            for (name, plug), dialect in zip(plugs.items(), ("native", "xbee", "znp", ""), strict=True)
        }
        sender = DownlinkSender(coordinators=coordinators, nodes=NodeBook(gateway="g"))
        up = ("a", "b", "c")
        async with _running(*(coordinators[name].run() for name in up), *(plugs[name].run() for name in up)):
            await until(lambda: all(coordinators[name].is_up for name in up), what="three are up")
            sendings = sender.send_to_all(HelloRequest())
            assert sorted(sendings) == ["a", "b", "c"]
            await until(lambda: all(plugs[name].dongle.requests for name in up), what="the radios were asked")
            assert {request.destination for name in up for request in plugs[name].dongle.requests} == {BROADCAST}

    asyncio.run(story())


def test_what_is_withdrawn_in_the_step_in_which_it_was_sent_was_never_sent_and_says_so() -> None:
    async def story() -> None:
        plug = _a_plug()
        coordinator = _a_coordinator(plug.open)
        async with _running(coordinator.run(), plug.run()):
            await until(lambda: coordinator.is_up, what="the radio is up")
            start = coordinator.send(destination=ShortAddress(0x10), payload=b"start")
            assert coordinator.withdraw(start)
            timed = coordinator.send_timed(destination=ShortAddress(0x10), make=lambda _: b"timed")
            assert coordinator.withdraw(timed)
            assert (await start).fate is (await timed).fate is Fate.NOT_SENT
            assert coordinator.n_pending == 0
            stop = coordinator.send(destination=LAST_NODE_ADDRESS, payload=b"stop", is_urgent=True)
            assert (await stop).fate is Fate.SENT
            assert not coordinator.withdraw(stop)
            assert not plug.dongle.requests

    asyncio.run(story())


def test_a_dongle_without_confirmations_fills_no_memory_while_the_disk_is_full() -> None:
    async def story() -> None:
        plug, health = _a_plug("xbee"), Health()
        write: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        coordinator = Coordinator(
            radio="r",
            make_host=partial(make_host, "xbee"),
            open_port=plug.open,
            on_radio=lambda _: write,
            config=_LINK,
            health=health,
            first_session=1,
        )
        async with _running(coordinator.run(), plug.run()):
            await until(lambda: coordinator.is_up, what="the radio is up")
            n_offered, payload = 0, some_payloads(1)[0]
            received = RadioReceived(source=ShortAddress(0x1007), rssi_dbm=RssiDbm(-60), lqi=9, payload=payload)
            while n_offered < 2_000:
                n_offered += plug.dongle.take_from_radio(received, eui64=7, now_ns=time.monotonic_ns())
                await asyncio.sleep(0)
                if n_offered == 1:
                    await until(lambda: coordinator.n_unconfirmed == 1, what="the first one waits for its write")
            await until(lambda: health.counters()["radio.messages_in"] >= 2_000, what="all were taken")
            assert coordinator.n_unconfirmed <= 1, "none where the dongle was opened anew meanwhile, as on a machine that stood still"

    asyncio.run(story())


def test_a_busy_channel_is_no_proof_that_nothing_went_out() -> None:
    fates = {status: outcome_of(status).fate for status in RadioStatus}
    assert fates[RadioStatus.CHANNEL_BUSY] is Fate.UNKNOWN
    assert {status for status, fate in fates.items() if fate is Fate.NOT_SENT} == {
        RadioStatus.UNKNOWN_ADDRESS,
        RadioStatus.QUEUE_FULL,
        RadioStatus.TOO_LONG,
    }


def test_a_timed_payload_is_made_when_the_port_takes_it_and_overtakes_what_waits_at_the_dongle() -> None:
    async def story() -> None:
        plug = _a_plug()
        coordinator = _a_coordinator(plug.open)
        made: list[int] = []

        def make(now_ns: int) -> bytes:
            made.append(now_ns)
            return b"timed"

        async with _running(coordinator.run(), plug.run()):
            await until(lambda: coordinator.is_up, what="the radio is up")
            others = [coordinator.send(destination=ShortAddress(0x1000), payload=bytes([at])) for at in range(40)]
            asked_ns = time.monotonic_ns()
            timed = coordinator.send_timed(destination=ShortAddress(0x1000), make=make)
            assert made == [], "it waits for the port"
            with pytest.raises(RadioUnavailableError, match="another timed payload waits"):
                coordinator.send_timed(destination=ShortAddress(0x1000), make=make)
            await until(lambda: any(one.payload == b"timed" for one in plug.dongle.requests), what="it arrives")
            payloads = [one.payload for one in plug.dongle.requests]
            assert asked_ns <= made[0]
            assert payloads.index(b"timed") < 39, "it did not wait for all that was sent before it"
            assert not any(one.done() for one in [*others, timed])
            coordinator.send_timed(destination=ShortAddress(0x1000), make=make)
        assert (await timed).fate is Fate.UNKNOWN, "the port was closed"

    asyncio.run(story())
