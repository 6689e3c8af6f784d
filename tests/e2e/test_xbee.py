"""The virtual XBee on a pty: with the unmodified gateway, and with Digi's own library."""

import asyncio
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from digi.xbee.devices import RemoteZigBeeDevice, XBeeDevice, ZigBeeDevice
from digi.xbee.models.address import XBee64BitAddress
from digi.xbee.models.mode import OperatingMode
from digi.xbee.models.options import RemoteATCmdOptions
from digi.xbee.models.protocol import Role, XBeeProtocol
from digi.xbee.models.status import TransmitStatus

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.message_codec import decode_uplink, encode_downlink
from firmware_protocol.messages import HelloRequest, MessageFault, TimeSyncReply, TimeSyncRequest
from tests.e2e.simulation import RECORDED, current, end_of, ready, simulating
from tests.gateway.fake_radio import until
from tests.gateway.harness import a_config, a_request, command, listening, running

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(200)]


def test_the_gateway_hears_every_encounter_through_an_xbee_and_a_stop_reaches_its_biobot(tmp_path: Path) -> None:
    source, ready_file = tmp_path / "dish.csv", tmp_path / "ready"
    source.write_text(RECORDED)

    async def story() -> int:
        with simulating(
            "replay", str(source), "--link", f"pty:{tmp_path / 'dongle'}?dialect=xbee", "--speed", "6", "--renumber",
            "--report-period-s", "0.2", "--drain-s", "100", "--ready-file", str(ready_file),
        ) as process:  # fmt: skip
            (address,) = await ready(process, ready_file)
            config = a_config(tmp_path, f"{address}&baud=9600")
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    await until(lambda: len({one.node for one in peer.node_statuses}) == 7, what="all biobots are known")
                    stages = await command(peer, a_request(4, StimulationAction.STOP))
                    assert [one.stage for one in stages] == [Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED]
                    await end_of(process)
                    await until(lambda: len(current(peer.records)) >= 11, what="all encounters published")
                return len(current(peer.records))

    assert asyncio.run(story()) == len(RECORDED.splitlines()) - 1


@contextmanager
def a_virtual_xbee(tmp_path: Path, dialect: str) -> Iterator[str]:
    port, ready_file = tmp_path / "dongle", tmp_path / "ready"
    with simulating(
        "serve", "--scenario", "no-obstacle", "--seed", "1", "--biobots", "3", "--duration", "200", "--ready-file", str(ready_file),
        "--link", f"pty:{port}?dialect={dialect}",
    ) as process:  # fmt: skip
        asyncio.run(ready(process, ready_file))
        yield str(port)


@contextmanager
def opened(device: Any) -> Iterator[Any]:
    device.open()
    try:
        yield device
    finally:
        device.close()


@pytest.mark.parametrize(
    ("dialect", "mode"), [("xbee", OperatingMode.ESCAPED_API_MODE), ("xbee-ap1", OperatingMode.API_MODE)], ids=["AP=2", "AP=1"]
)
def test_digis_own_library_opens_the_virtual_module_and_talks_with_a_backpack(tmp_path: Path, dialect: str, mode: OperatingMode) -> None:
    with a_virtual_xbee(tmp_path, dialect) as port:
        with opened(XBeeDevice(port, 9600)) as plain:
            assert plain.get_protocol() is XBeeProtocol.ZIGBEE
            assert plain.operating_mode is mode
            while plain.get_parameter("AI") != b"\0":
                pass  # it forms its network
        with opened(ZigBeeDevice(port, 9600)) as device:
            assert str(device.get_64bit_addr()) == "0013A20000000000"
            assert str(device.get_16bit_addr()) == "0000"
            assert device.get_node_id() == "BASE"
            assert bytes(device.get_firmware_version()).hex() == "100d"
            assert device.get_hardware_version().code == 0x42
            assert bytes(device.get_pan_id()).hex() == "000000000000b10b"
            assert device.get_role() is Role.COORDINATOR
            device.set_node_id("ROOF")
            assert device.get_parameter("NI") == b"ROOF"
            heard: queue.Queue[tuple[str, bytes]] = queue.Queue()
            device.add_data_received_callback(lambda message: heard.put((str(message.remote_device.get_64bit_addr()), bytes(message.data))))
            assert device.send_data_broadcast(encode_downlink(0, HelloRequest())).transmit_status is TransmitStatus.SUCCESS
            address, _ = uplink(heard)
            remote = RemoteZigBeeDevice(device, XBee64BitAddress.from_hex_string(address))
            status = device.send_data(remote, encode_downlink(1, TimeSyncRequest(token=0x7E7D)), RemoteATCmdOptions.NONE.value)
            assert status.transmit_status is TransmitStatus.SUCCESS
            while not isinstance((found := uplink(heard))[1], TimeSyncReply):
                pass
            assert found[0] == address
            assert found[1].token == 0x7E7D


def uplink(heard: "queue.Queue[tuple[str, bytes]]") -> tuple[str, Any]:
    """Return the next message and the 64-bit address it comes from."""
    source, payload = heard.get(timeout=60)
    decoded = decode_uplink(payload)
    assert not isinstance(decoded, MessageFault)
    return source, decoded[1]
