"""Laws of what backpacks are asked."""

import asyncio
import time

from firmware_protocol.messages import Downlink, HelloRequest, TimeSyncRequest
from firmware_protocol.units import NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.clocks import ClockBook
from gateway.downlink import DownlinkSender
from gateway.health import Health
from gateway.inquiries import Inquirer
from gateway.nodes import NodeBook, NodeMemory
from gateway.radio import Fate, RadioOutcome
from tests.gateway.fake_radio import until


class _Air(DownlinkSender):
    """Takes every message."""

    def __init__(self, nodes: NodeBook) -> None:
        super().__init__(coordinators={}, nodes=nodes)
        self.sent: list[tuple[NodeId, Downlink]] = []

    def send(self, node: NodeId, message: Downlink, *, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":  # noqa: ARG002  # the sender's own signature
        self.sent.append((node, message))
        future: asyncio.Future[RadioOutcome] = asyncio.get_running_loop().create_future()
        future.set_result(RadioOutcome(fate=Fate.SENT))
        return future


def test_a_biobot_of_an_earlier_process_is_asked_who_is_there_and_one_whose_address_is_in_doubt_is_not() -> None:
    async def story() -> None:
        nodes = NodeBook(gateway="g")
        nodes.restore(
            NodeMemory(
                node=NodeId(node),
                boot=BootId(1),
                radio="r",
                address=ShortAddress(address),
                eui64=node,
                firmware=1,
                beacon_period_ms=0,
                capabilities=1,
                is_introduced=True,
            )
            for node, address in ((1, 7), (2, 8), (3, 8))
        )
        air = _Air(nodes)
        inquirer = Inquirer(sender=air, nodes=nodes, clocks=ClockBook(window_ns=60 * NS_PER_S), sync_period_s=30, health=Health())
        asking = asyncio.ensure_future(inquirer.run())
        await until(lambda: bool(air.sent), what="somebody is asked")
        assert [(node, type(message)) for node, message in air.sent] == [(1, HelloRequest)]
        nodes.heard(
            node=NodeId(2),
            boot=BootId(1),
            radio="r",
            address=ShortAddress(9),
            rssi_dbm=RssiDbm(-50),
            lqi=1,
            sent_ms=Milliseconds(1),
            now_ns=time.monotonic_ns(),
            now_wall_ns=Nanoseconds(1),
        )
        inquirer.wake()
        await until(
            lambda: (2, TimeSyncRequest) in [(node, type(message)) for node, message in air.sent],
            what="one that is heard is asked the time",
        )
        assert 3 not in [node for node, _ in air.sent]
        asking.cancel()
        await asyncio.wait({asking})

    asyncio.run(story())
