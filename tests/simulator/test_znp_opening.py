"""How the Z-Stack host opens a chip: new, formed, stubborn, or somebody else's."""

import pytest

from firmware_protocol.dialects.interface import (
    CoordinatorSaid,
    HostLost,
    HostOpened,
    LostWhy,
)
from firmware_protocol.dialects.znp import ZnpHost
from firmware_protocol.dialects.znp_opening import ZnpHostConfig
from firmware_protocol.framing.znp import encode_frame
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import Message
from firmware_protocol.znp.numbers import BIOBOT_CLUSTER, BIOBOT_ENDPOINT, Command, DeviceState, NvItem
from simulator.dongles.znp import ZnpDongleConfig
from simulator.dongles.znp_memory import ZnpNetwork
from tests.simulator.znp_bench import CC2531_WITH_LOADER, NODE, a_bench, every_chip, frame, opened


@every_chip
def test_a_new_chip_forms_the_network_that_is_wanted(config: ZnpDongleConfig) -> None:
    bench = opened(config, ZnpHostConfig(pan_id=0x0ABC, channel=26))
    hello = bench.identified().hello
    assert (hello.pan_id, hello.channel, hello.eui64) == (0x0ABC, 26, config.eui64)
    assert bench.dongle.memory.network == ZnpNetwork(pan_id=0x0ABC, channel=26)
    assert [one.name for one in bench.events if isinstance(one, CoordinatorSaid)].count("forming") == 1
    assert bench.events.index(HostOpened()) < bench.events.index(bench.identified())


@every_chip
def test_a_chip_that_may_choose_takes_a_pan_of_its_own(config: ZnpDongleConfig) -> None:
    assert opened(config).identified().hello.pan_id == config.pan_id


@every_chip
def test_a_reset_costs_the_opening_and_not_the_network(config: ZnpDongleConfig) -> None:
    bench = opened(config)
    before = bench.dongle.memory.network
    bench.dongle.start(now_ns=bench.now_ns)
    bench.run(100)
    if config.has_boot_loader:  # it says nothing before it is told to start; the watchdog finds out
        bench.run(20_000)
    else:
        bench.run(200)
    lost = [one for one in bench.events if isinstance(one, HostLost)]
    assert [one.why for one in lost] == [LostWhy.NO_ANSWER if config.has_boot_loader else LostWhy.RESTARTED]
    bench.open()
    bench.run_until_open()
    assert bench.dongle.memory.network == before
    assert len([one for one in bench.events if isinstance(one, CoordinatorSaid) and one.name == "forming"]) == 1


@every_chip
def test_a_second_base_station_finds_the_network_as_it_is_and_resets_nothing(config: ZnpDongleConfig) -> None:
    bench = opened(config)
    bench.asked.clear()
    bench.host = ZnpHost(config=ZnpHostConfig(pan_id=0x0DEF, channel=11))
    bench.open()
    bench.run_until_open(within_ms=2_000)
    assert bench.identified().hello.pan_id == config.pan_id
    assert not [one for one in bench.asked if isinstance(one, znp.ResetRequest | znp.NvWriteRequest)]


def test_a_network_that_somebody_else_has_formed_is_kept() -> None:
    bench = a_bench()
    bench.dongle.memory.found(ZnpNetwork(pan_id=0x1A62, channel=11))
    bench.open()
    bench.run_until_open()
    hello = bench.identified().hello
    assert (hello.pan_id, hello.channel) == (0x1A62, 11)


def test_a_router_of_somebody_elses_network_is_refused_with_what_to_do() -> None:
    bench = a_bench()
    bench.dongle.memory.found(ZnpNetwork(pan_id=0x1A62, channel=11))
    bench.dongle.memory.items[NvItem.LOGICAL_TYPE] = b"\x01"
    bench.open()
    bench.run(3_000)
    lost = bench.events[-1]
    assert isinstance(lost, HostLost)
    assert lost.why is LostWhy.REFUSED
    assert "erase its memory" in lost.detail


def test_a_boot_loader_does_nothing_before_its_byte_comes() -> None:
    bench = a_bench(CC2531_WITH_LOADER)
    bench.dongle.feed(frame(znp.PingRequest()), now_ns=0)
    bench.run(5_000)
    assert not bench.dongle.take_bytes()
    bench.open()
    bench.run_until_open(within_ms=10_000)
    assert bench.dongle.faults["not_running"] > 0


def test_a_boot_loader_that_is_left_alone_starts_after_a_minute() -> None:
    bench = a_bench(CC2531_WITH_LOADER)
    bench.run(61_000, step_ms=100)
    bench.dongle.feed(frame(znp.PingRequest()), now_ns=bench.now_ns)
    assert bench.dongle.take_bytes() == frame(znp.PingReply(capabilities=0x0179))


def test_an_opening_that_nobody_answers_waits_for_its_callers_patience_and_does_not_fill_memory() -> None:
    bench = a_bench()
    bench.is_cut = True
    bench.open()
    bench.run(60_000, step_ms=100)
    assert not bench.events
    bench.is_cut = False
    bench.run_until_open(within_ms=10_000)


def test_a_request_that_is_never_answered_ends_the_opening_after_three_attempts() -> None:
    bench = a_bench()
    bench.stubborn = {znp.VersionRequest: None}
    bench.open()
    bench.run(10_000)
    (lost,) = [one for one in bench.events if isinstance(one, HostLost)]
    assert (lost.why, lost.detail) == (LostWhy.NO_ANSWER, "no answer to SYS_VERSION")
    assert bench.asked.count(znp.VersionRequest()) == 3
    bench.stubborn = {}
    bench.open()
    bench.run_until_open()


@pytest.mark.parametrize(
    ("kind", "answer", "detail"),
    [
        (znp.DeviceInfoRequest, znp.RpcError(error=2, command=Command.UTIL_GET_DEVICE_INFO), "does not know UTIL_GET_DEVICE_INFO"),
        (znp.NvWriteRequest, znp.StatusReply(command=Command.SYS_OSAL_NV_WRITE, status=10), "does not write STARTUP_OPTION: status 0x0A"),
        (znp.RegisterRequest, znp.StatusReply(command=Command.AF_REGISTER, status=0x10), "does not register endpoint 0xB1: status 0x10"),
        (znp.CommissioningRequest, znp.StatusReply(command=Command.APP_CNF_BDB_START_COMMISSIONING, status=1), "status 0x01"),
    ],
)
def test_a_chip_that_does_not_do_its_part_is_refused_with_what_it_said(kind: type[Message], answer: Message, detail: str) -> None:
    bench = a_bench()
    bench.stubborn = {kind: answer}
    bench.open()
    bench.run(6_000)
    (lost,) = [one for one in bench.events if isinstance(one, HostLost)]
    assert lost.why is LostWhy.REFUSED
    assert detail in lost.detail


def test_a_chip_that_does_not_come_back_from_a_reset_is_told_again_and_then_given_up() -> None:
    bench = a_bench()
    bench.stubborn = {znp.ResetRequest: None}
    bench.open()
    bench.run(40_000, step_ms=50)
    (lost,) = [one for one in bench.events if isinstance(one, HostLost)]
    assert (lost.why, lost.detail) == (LostWhy.NO_ANSWER, "it did not come back from a reset within 10 s")
    assert bench.asked.count(znp.ResetRequest(kind=1)) == 3


def test_a_network_that_never_forms_is_given_up_after_a_minute_and_said_meanwhile() -> None:
    bench = a_bench()
    bench.stubborn = {znp.CommissioningRequest: znp.StatusReply(command=Command.APP_CNF_BDB_START_COMMISSIONING, status=0)}
    bench.open()
    bench.run(70_000, step_ms=100)
    (lost,) = [one for one in bench.events if isinstance(one, HostLost)]
    assert lost.why is LostWhy.REFUSED
    assert "60 s after it was told to start" in lost.detail
    assert [one.name for one in bench.events if isinstance(one, CoordinatorSaid)].count("starting") == 30


def test_a_network_that_is_up_without_a_word_is_found_by_looking() -> None:
    bench = a_bench()
    bench.dongle.memory.found(ZnpNetwork(pan_id=0x1A62, channel=11))
    bench.stubborn = {znp.StartupRequest: znp.StatusReply(command=Command.ZDO_STARTUP_FROM_APP, status=0)}
    bench.open()
    bench.run(1_000)
    bench.dongle._stack._state = DeviceState.COORDINATOR
    bench.run_until_open(within_ms=3_000)


def test_a_chip_that_is_starting_is_waited_for() -> None:
    bench = a_bench()
    bench.dongle.memory.found(ZnpNetwork(pan_id=0x1A62, channel=11))
    bench.run(200)
    bench.dongle.feed(frame(znp.StartupRequest(delay_ms=0)), now_ns=bench.now_ns)
    bench.open()
    bench.run_until_open(within_ms=1_000)
    assert znp.StartupRequest(delay_ms=100) not in bench.asked


def test_a_chip_whose_network_is_not_what_it_said_is_asked_anew() -> None:
    bench = a_bench()
    none = znp.NetworkInfoReply(address=0xFFFE, state=0, pan_id=0xFFFF, parent=0, extended_pan_id=0, extended_parent=0, channel=0)
    bench.stubborn = {znp.NetworkInfoRequest: none}
    bench.open()
    bench.run(3_000)
    (lost,) = [one for one in bench.events if isinstance(one, HostLost)]
    assert "it said that it had a network, and has none" in lost.detail


def test_what_comes_in_while_a_dongle_is_not_open_is_counted_by_name() -> None:
    bench = opened()
    message = znp.IncomingMessage(
        group=0, cluster=BIOBOT_CLUSTER, source=NODE, source_endpoint=BIOBOT_ENDPOINT, destination_endpoint=BIOBOT_ENDPOINT,
        was_broadcast=0, lqi=1, security=0, timestamp=0, sequence=0, data=b"x",
    )  # fmt: skip
    bench.host.open(session=1, now_ns=bench.now_ns)
    assert not bench.host.feed(frame(message), now_ns=bench.now_ns)
    idle = ZnpHost()
    noise = b"\x00" + encode_frame(b"\x45\x7f") + frame(message)
    assert not idle.feed(noise, now_ns=0)
    assert not idle.handle_deadline(now_ns=0)
    assert bench.host.faults == {"znp.heard_while_opening": 1}
    assert idle.faults == {"frame.noise": 1, "znp.unknown_command": 1, "znp.not_open": 1}


def test_calling_too_early_does_nothing() -> None:
    bench = a_bench()
    bench.open()
    assert not bench.host.handle_deadline(now_ns=bench.now_ns)
    bench.run_until_open()
    bench.host.take_frames()
    before = bench.host.next_deadline_ns()
    assert not bench.host.handle_deadline(now_ns=bench.now_ns)
    assert bench.host.next_deadline_ns() == before
    bench.host.send(destination=NODE, payload=b"x", now_ns=bench.now_ns)
    assert not bench.host.handle_deadline(now_ns=bench.now_ns + 1)
