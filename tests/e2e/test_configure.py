"""``biobot-gateway configure`` on virtual coordinators behind real lines: by the link, and on CAN by ISO-TP."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from firmware_protocol.envelope import CoordinatorConfigured, RadioReceived
from firmware_protocol.units import RssiDbm, ShortAddress
from gateway.__main__ import main
from gateway.coordinator_setup import configuration_request, configure
from gateway.errors import TransportClosedError, TransportSpecError
from gateway.transports.spec import parse_port_spec
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from simulator.lines.carrier import open_line
from simulator.lines.line import SerialEnd, parse_line


@asynccontextmanager
async def a_dongle(link: str) -> AsyncIterator[tuple[Dongle, str]]:
    """Run a virtual coordinator behind a line; yield it and the port that a gateway opens."""
    spec = parse_line(link)
    end, dongle = await open_line(spec), make_dongle(spec.dialect, index=0)
    tasks = [asyncio.create_task(hear(end, dongle)), asyncio.create_task(speak(end, dongle))]
    try:
        yield dongle, end.address
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await end.aclose()


def now_ns() -> int:
    return int(asyncio.get_running_loop().time() * 1e9)


async def hear(end: SerialEnd, dongle: Dongle) -> None:
    while True:
        dongle.feed(await end.read(), now_ns=now_ns())


async def speak(end: SerialEnd, dongle: Dongle) -> None:
    while True:
        dongle.handle_deadline(now_ns=now_ns())
        await end.write(dongle.take_bytes())
        await asyncio.sleep(0.002)


every_line = pytest.mark.parametrize("link", ["pty:{}", "tcp:127.0.0.1:0", "slcan:{}?unit=3", "slcan:{}?fd=1"])


@every_line
def test_a_coordinator_is_configured_and_says_what_is_in_force(link: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    async def story() -> None:
        async with a_dongle(link.format(tmp_path / "radio")) as (_, port):
            arguments = ["configure", "--port", port, "--pan-id", "0x1234", "--channel", "15", "--permit-join", "60"]
            assert await asyncio.to_thread(main, arguments) == 0
            answer = json.loads(capsys.readouterr().out)
            assert answer | {"permit_join_s": 60} == {"result": "done", "pan_id": "0x1234", "channel": 15, "permit_join_s": 60}
            assert 0 < answer["permit_join_s"] <= 60
            kept = await configure(parse_port_spec(port), configuration_request(pan_id=None, channel=None, permit_join_s=254))
            assert (kept.result, kept.pan_id, kept.channel, kept.permit_join_s) == (0, 0x1234, 15, 254)

    asyncio.run(story())


def test_what_waits_in_the_dongle_is_no_hindrance(tmp_path: Path) -> None:
    async def story() -> CoordinatorConfigured:
        async with a_dongle(f"pty:{tmp_path / 'radio'}") as (dongle, port):
            for number in range(200):
                received = RadioReceived(source=ShortAddress(1), rssi_dbm=RssiDbm(-60), lqi=90, payload=bytes([number]) * 40)
                assert dongle.take_from_radio(received, eui64=1, now_ns=0)
            return await configure(parse_port_spec(port), configuration_request(pan_id=1, channel=None, permit_join_s=None))

    assert asyncio.run(story()).pan_id == 1


def test_nobody_who_answers_is_told_with_the_reason(tmp_path: Path) -> None:
    async def story() -> None:
        request = configuration_request(pan_id=1, channel=None, permit_join_s=None)
        async with a_dongle(f"slcan:{tmp_path / 'radio'}?unit=3") as (_, port):
            with pytest.raises(TransportClosedError, match=r"no answer within 0\.3 s"):
                await configure(parse_port_spec(port.replace("unit=3", "unit=4")), request, timeout_s=0.3)

    asyncio.run(story())


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ([], "nothing to set"),
        (["--channel", "10"], "--channel is 10, but must be 11 to 26"),
        (["--pan-id", "0xFFFF"], "--pan-id is 65535, but must be 0x0000 to 0xFFFE"),
        (["--permit-join", "255"], "--permit-join is 255"),
    ],
)
def test_a_value_out_of_range_is_refused_before_the_port_is_opened(
    flags: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["configure", "--port", "serial:/dev/not-there", *flags]) == 2
    assert words in capsys.readouterr().err


def test_a_dialect_without_that_question_is_refused() -> None:
    request = configuration_request(pan_id=1, channel=None, permit_join_s=None)
    for dialect, advice in (("xbee", "Set-up without XCTU"), ("znp", "channel=15&pan_id=0x1234"), ("can", "docs/dongles.md")):
        with pytest.raises(TransportSpecError, match=advice):
            asyncio.run(configure(parse_port_spec(f"tcp:127.0.0.1:9?dialect={dialect}"), request))
