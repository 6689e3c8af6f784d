"""Laws of what backpacks are asked, and when."""

import asyncio
import time
from collections.abc import Awaitable, Callable

from firmware_protocol.messages import Downlink, HelloRequest, TimeSyncRequest
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.clocks import ClockBook
from gateway.downlink import DownlinkSender
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.inquiries import Inquirer
from gateway.nodes import NodeBook, NodeMemory
from gateway.radio import Fate, RadioOutcome
from tests.gateway.fake_radio import until


class _Air(DownlinkSender):
    """Takes every message, one timed one at a time, and tells what becomes of it when it is told to. ``n_waiting``: payloads under way."""

    def __init__(self, nodes: NodeBook) -> None:
        super().__init__(coordinators={}, nodes=nodes)
        self.sent: list[tuple[NodeId, Downlink]] = []
        self.waiting: list[asyncio.Future[RadioOutcome]] = []
        self.n_waiting = 0
        self.is_up = True

    def send(self, node: NodeId, message: Downlink, *, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":  # noqa: ARG002  # the sender's own signature
        self.sent.append((node, message))
        future: asyncio.Future[RadioOutcome] = asyncio.get_running_loop().create_future()
        future.set_result(RadioOutcome(fate=Fate.SENT))
        return future

    def send_timed(self, node: NodeId, make: Callable[[int], Downlink]) -> "asyncio.Future[RadioOutcome]":
        if not self.is_up or any(not one.done() for one in self.waiting):
            raise RadioUnavailableError(radio="r", reason="another one waits")
        self.sent.append((node, make(time.monotonic_ns())))
        self.waiting.append(asyncio.get_running_loop().create_future())
        return self.waiting[-1]

    def tell(self) -> None:
        self.waiting[-1].set_result(RadioOutcome(fate=Fate.SENT))

    def is_radio_up(self, radio: str) -> bool:  # noqa: ARG002  # as above
        return self.is_up

    def n_pending(self, node: NodeId) -> int:  # noqa: ARG002  # as above
        return self.n_waiting

    def asked(self, kind: type[Downlink]) -> list[int]:
        return [node for node, message in self.sent if isinstance(message, kind)]


class _Site:
    """An inquirer, and what it knows."""

    def __init__(self) -> None:
        self.nodes = NodeBook(gateway="g")
        self.clocks = ClockBook(window_ns=60 * NS_PER_S)
        self.air = _Air(self.nodes)
        self.inquirer = Inquirer(sender=self.air, nodes=self.nodes, clocks=self.clocks, sync_period_s=30, health=Health())

    def remember(self, places: list[tuple[int, int]]) -> None:
        memories = [
            NodeMemory(
                node=NodeId(node), boot=BootId(1), radio="r", address=ShortAddress(address), eui64=node, firmware=1, beacon_period_ms=0,
                capabilities=1, is_introduced=True,
            )
            for node, address in places
        ]  # fmt: skip
        self.nodes.restore(memories, heard_ns={}, now_ns=time.monotonic_ns())

    def hear(self, node: int, address: int, *, sent_ms: int = 1000, late_ms: int = 0) -> None:
        now_ns = time.monotonic_ns() + late_ms * NS_PER_MS
        self.nodes.heard(
            node=NodeId(node), boot=BootId(1), radio="r", address=ShortAddress(address), rssi_dbm=RssiDbm(-50), lqi=1,
            sent_ms=Milliseconds(sent_ms), now_ns=now_ns, now_wall_ns=Nanoseconds(1),
        )  # fmt: skip
        self.clocks.observe(node=NodeId(node), boot=BootId(1), sent_ms=Milliseconds(sent_ms), received_ns=now_ns)

    def answer(self, node: int, *, arrived_ms: int = 1000) -> None:
        (*_, message) = (one for name, one in self.air.sent if name == node and isinstance(one, TimeSyncRequest))
        assert isinstance(message, TimeSyncRequest)
        assert self.clocks.end_exchange(node=NodeId(node), boot=BootId(1), token=message.token, arrived_ms=Milliseconds(arrived_ms))


def _with_site(prepare: Callable[[_Site], None], story: Callable[[_Site], Awaitable[None]]) -> None:
    async def run() -> None:
        site = _Site()
        prepare(site)
        asking = asyncio.ensure_future(site.inquirer.run())
        try:
            await story(site)
        finally:
            asking.cancel()
            await asyncio.wait({asking})

    asyncio.run(run())


def test_a_biobot_of_an_earlier_process_is_asked_the_time_and_then_to_repeat_and_one_whose_address_is_in_doubt_is_not() -> None:
    def prepare(site: _Site) -> None:
        site.remember([(1, 7), (2, 8), (3, 8)])

    async def story(site: _Site) -> None:
        await until(lambda: bool(site.air.sent), what="somebody is asked")
        assert site.air.asked(TimeSyncRequest) == [1]
        assert site.air.asked(HelloRequest) == [], "what it said before its clock is known would not be taken"
        site.hear(1, 7)
        site.answer(1)
        await until(lambda: site.air.asked(HelloRequest) == [1], what="it is to repeat what it said to nobody")
        site.air.tell()
        site.hear(2, 9)
        site.inquirer.note_refused(NodeId(2))
        await until(lambda: 2 in site.air.asked(TimeSyncRequest), what="one that is heard is asked the time")
        assert 3 not in [node for node, _ in site.air.sent]

    _with_site(prepare, story)


def test_those_whose_clock_is_not_known_are_asked_in_turn_however_much_waits_and_one_at_a_time() -> None:
    def prepare(site: _Site) -> None:
        for node in range(1, 6):
            site.hear(node, node)
        site.air.n_waiting = 200

    async def story(site: _Site) -> None:
        for n_asked in range(1, 16):
            await until(lambda n=n_asked: len(site.air.sent) == n, what="the next one is asked")  # type: ignore[misc]
            site.air.tell()
        asked = site.air.asked(TimeSyncRequest)
        assert [sorted(asked[at : at + 5]) for at in (0, 5, 10)] == [[1, 2, 3, 4, 5]] * 3, "nobody twice before all others"
        assert site.air.asked(HelloRequest) == [], "who they are can wait"

    _with_site(prepare, story)


def test_when_its_clock_is_known_a_refused_biobot_is_told_once_to_repeat() -> None:
    def prepare(site: _Site) -> None:
        site.hear(1, 7)
        site.inquirer.note_refused(NodeId(1))
        site.nodes.all()[0].is_introduced = True

    async def story(site: _Site) -> None:
        await until(lambda: bool(site.air.sent), what="it is asked the time")
        assert site.air.asked(HelloRequest) == []
        site.answer(1)
        site.air.tell()
        await until(lambda: bool(site.air.asked(HelloRequest)), what="it is told to repeat")
        site.hear(2, 8)
        site.inquirer.note_refused(NodeId(2))
        await until(lambda: 2 in site.air.asked(TimeSyncRequest), what="others are looked after")
        assert site.air.asked(HelloRequest).count(1) == 1

    _with_site(prepare, story)


def test_when_a_radio_comes_back_those_that_it_did_not_hear_are_told_to_repeat() -> None:
    def prepare(site: _Site) -> None:
        site.hear(1, 7)
        site.hear(2, 8)
        for node in site.nodes.all():
            node.is_introduced = True

    async def story(site: _Site) -> None:
        for n_asked in (1, 2):
            await until(lambda n=n_asked: len(site.air.sent) == n, what="the time is asked")  # type: ignore[misc]
            site.answer(site.air.sent[-1][0])
            site.air.tell()
        site.air.is_up = False
        site.inquirer.note_refused(NodeId(9))
        site.nodes.all()[0].last_heard_ns -= 5 * NS_PER_S
        await asyncio.sleep(0)
        await until(lambda: site.inquirer._radios_up == {"r": False}, what="it is seen to be down")
        site.air.is_up = True
        await until(lambda: bool(site.air.asked(HelloRequest)), what="the silent one is told")
        assert site.air.asked(HelloRequest) == [1]

    _with_site(prepare, story)
