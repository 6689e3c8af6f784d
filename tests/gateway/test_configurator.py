"""Laws of setting backpacks: until they say so, a bounded number of times, and refusals told once."""

import asyncio
from collections.abc import Callable

import pytest

from firmware_protocol.messages import (
    LEAVE_PERIOD,
    LEAVE_RSSI,
    Capability,
    ConfigurationReport,
    ConfigurationResult,
    Configure,
    Downlink,
    Hello,
)
from firmware_protocol.units import NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.config import BackpackTable
from gateway.configurator import Configurator
from gateway.downlink import DownlinkSender
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.nodes import Node, NodeBook
from gateway.radio import RadioOutcome

_NODE = NodeId(5)
_WANTED = BackpackTable(rssi_enter_dbm=-60, rssi_exit_dbm=-66, report_period_ms=2_000)


class _Air(DownlinkSender):
    """Takes every message, or none."""

    def __init__(self, nodes: NodeBook) -> None:
        super().__init__(coordinators={}, nodes=nodes)
        self.sent: list[Configure] = []
        self.is_up = True

    def send(self, node: NodeId, message: Downlink, *, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":  # noqa: ARG002  # the sender's own signature
        if not self.is_up:
            raise RadioUnavailableError(radio="r", reason="it is down")
        assert isinstance(message, Configure)
        self.sent.append(message)
        return asyncio.get_running_loop().create_future()

    def n_pending(self, node: NodeId) -> int:  # noqa: ARG002  # the sender's own signature
        return 0


class _Scene:
    def __init__(self, wanted: BackpackTable, *, first_token: int = 65_535) -> None:
        self.nodes = NodeBook(gateway="g")
        self.air = _Air(self.nodes)
        self.refusals: list[str] = []
        self.configurator = Configurator(
            sender=self.air,
            nodes=self.nodes,
            wanted=wanted,
            health=Health(),
            on_refused=lambda node, reason: self.refusals.append(f"{node}: {reason}"),
            first_token=first_token,
        )

    def hear(self, *, boot: int = 1, at_s: float = 0.0) -> Node:
        node, _ = self.nodes.heard(
            node=_NODE,
            boot=BootId(boot),
            radio="r",
            address=ShortAddress(1),
            rssi_dbm=RssiDbm(-50),
            lqi=1,
            sent_ms=Milliseconds(0),
            now_ns=int(at_s * NS_PER_S),
            now_wall_ns=Nanoseconds(1),
        )
        return node

    def greet(self, *, boot: int = 1, capabilities: Capability = Capability.CONFIGURE) -> None:
        self.nodes.introduce(self.hear(boot=boot), Hello(eui64=7, firmware=1, beacon_period_ms=0, capabilities=capabilities))

    def poll(self, at_s: float) -> None:
        self.configurator.poll(now_ns=int(at_s * NS_PER_S))

    def report(self, token: int, *, result: ConfigurationResult = ConfigurationResult.DONE, rssi_exit_dbm: int = -66) -> None:
        self.configurator.on_report(
            _NODE,
            ConfigurationReport(
                token=token,
                result=result,
                beacon_period_ms=1_000,
                rssi_enter_dbm=RssiDbm(-60),
                rssi_exit_dbm=RssiDbm(rssi_exit_dbm),
                gap_tolerance_ms=1_150,
                report_period_ms=2_000,
            ),
        )


def _run(story: Callable[[], None]) -> None:
    async def run() -> None:
        story()

    asyncio.run(run())


def test_a_backpack_is_asked_until_its_report_has_the_values_and_no_more_until_it_restarts() -> None:
    def story() -> None:
        scene = _Scene(_WANTED)
        scene.greet()
        scene.poll(0)
        scene.poll(1.9)
        scene.poll(2)
        assert [one.token for one in scene.air.sent] == [65_535, 0]
        first = scene.air.sent[0]
        assert (first.rssi_enter_dbm, first.rssi_exit_dbm, first.report_period_ms) == (-60, -66, 2_000)
        assert (first.beacon_period_ms, first.gap_tolerance_ms) == (LEAVE_PERIOD, LEAVE_PERIOD)
        scene.report(65_535)  # the answer to the first request is an answer too
        scene.report(0)
        for at_s in range(3, 100):
            scene.poll(at_s)
        assert len(scene.air.sent) == 2
        scene.greet(boot=2)
        scene.poll(101)
        assert len(scene.air.sent) == 3
        assert scene.refusals == []

    _run(story)


def test_a_backpack_that_never_answers_is_asked_five_times_and_told_of_once() -> None:
    def story() -> None:
        scene = _Scene(_WANTED)
        scene.greet()
        sent_at = []
        for at_s in range(100):
            before = len(scene.air.sent)
            scene.hear(at_s=at_s)
            scene.poll(at_s)
            sent_at += [at_s] * (len(scene.air.sent) - before)
        assert sent_at == [0, 2, 6, 14, 30]
        assert len(scene.refusals) == 1
        assert "5 requests" in scene.refusals[0]

    _run(story)


@pytest.mark.parametrize(
    ("result", "rssi_exit_dbm", "words"),
    [
        (ConfigurationResult.NOT_SUPPORTED, -90, ["not_supported", "rssi_exit_dbm is -90, wanted -66"]),
        (ConfigurationResult.BAD_PARAMETER, -66, ["bad_parameter"]),
        (ConfigurationResult.DONE, -90, ["says done", "rssi_exit_dbm is -90, wanted -66"]),
    ],
)
def test_a_backpack_that_says_no_is_left_alone_and_told_of_once(result: ConfigurationResult, rssi_exit_dbm: int, words: list[str]) -> None:
    def story() -> None:
        scene = _Scene(_WANTED, first_token=1)
        scene.greet()
        scene.poll(0)
        scene.report(7, result=result, rssi_exit_dbm=rssi_exit_dbm)  # of somebody else's request
        assert scene.refusals == []
        scene.report(1, result=result, rssi_exit_dbm=rssi_exit_dbm)
        scene.report(1, result=result, rssi_exit_dbm=rssi_exit_dbm)
        for at_s in range(1, 100):
            scene.poll(at_s)
        assert len(scene.air.sent) == 1
        assert len(scene.refusals) == 1
        assert all(word in scene.refusals[0] for word in words)

    _run(story)


def test_nobody_is_asked_who_cannot_be_set_or_is_silent_or_when_nothing_is_wanted() -> None:
    def story() -> None:
        scene = _Scene(_WANTED)
        scene.hear()
        scene.poll(0)
        scene.greet(capabilities=Capability.STIMULATION)
        scene.poll(1)
        scene.greet(boot=2)
        scene.poll(121)
        assert scene.air.sent == []
        nothing = _Scene(BackpackTable())
        nothing.greet()
        nothing.poll(0)
        assert nothing.air.sent == []

    _run(story)


def test_a_radio_that_is_down_costs_no_attempt() -> None:
    def story() -> None:
        scene = _Scene(BackpackTable(rssi_enter_dbm=-60))
        scene.greet()
        scene.air.is_up = False
        for at_s in range(50):
            scene.poll(at_s)
        scene.air.is_up = True
        scene.poll(50)
        assert len(scene.air.sent) == 1
        assert scene.air.sent[0].rssi_exit_dbm == LEAVE_RSSI
        assert scene.refusals == []

    _run(story)
