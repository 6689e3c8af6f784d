"""zigpy-xbee, in a process and an environment of its own, takes the virtual XBee on a pty for a real one."""

import asyncio
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.envelope import RadioReceived, RadioStatus
from firmware_protocol.units import NS_PER_S, RssiDbm, ShortAddress
from simulator.dongles.xbee import XBeeDongle, XBeeDongleConfig
from simulator.lines.virtual_serial import PtyEnd

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".venv-wire-peers" / "bin" / "python"
PROGRAM = ROOT / "scripts" / "wire_peers" / "xbee_connect.py"

NODE, EUI64 = ShortAddress(0x7D84), 0x0013A20040522BAA
QUESTION, ANSWER = b"\x7e\x7d\x11\x13 question", b"\x7e\x7d\x11\x13 answer"

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.skipif(not PYTHON.exists(), reason=f"zigpy-xbee is not installed in {PYTHON.parents[1]} (make wire-peers)"),
]


async def serve(dongle: XBeeDongle, line: PtyEnd, *, tend: Callable[[int], None]) -> None:
    """Be the module on a line until cancelled; ``tend`` is called after every step."""
    dongle.start(now_ns=time.monotonic_ns())
    reading = asyncio.ensure_future(line.read())
    try:
        while True:
            await asyncio.wait({reading}, timeout=0.02)
            now_ns = time.monotonic_ns()
            if reading.done():
                dongle.feed(reading.result(), now_ns=now_ns)
                reading = asyncio.ensure_future(line.read())
            dongle.handle_deadline(now_ns=now_ns)
            tend(now_ns)
            if data := dongle.take_bytes():
                await line.write(data)
    finally:
        reading.cancel()


@pytest.mark.parametrize("mode", [0, 1])
def test_zigpy_xbee_takes_the_virtual_module_for_its_coordinator_and_both_hear_each_other(tmp_path: Path, mode: int) -> None:
    """It works in mode 2, and makes the mode so itself: over frames from mode 1, and with command mode from transparent mode.

    The network it looks for is one of ZigBee 3 with its security: EE = 1, EO = 2 and ZS = 2.
    """
    dongle = XBeeDongle(config=XBeeDongleConfig(memory={"AP": mode, "CE": 1, "EE": 1, "EO": 2, "ZS": 2}))
    sent: list[tuple[int, bytes]] = []
    said_ns = 0

    def tend(now_ns: int) -> None:
        nonlocal said_ns
        if dongle.settings.number("AO") and not sent and now_ns - said_ns > NS_PER_S // 5:  # it can hear when it has asked for endpoints
            said_ns = now_ns
            say(QUESTION, now_ns)
        while dongle.requests:
            request = dongle.requests.popleft()
            sent.append((request.destination, request.payload))
            dongle.confirm(request.handle, RadioStatus.SENT, now_ns=now_ns)
            if request.destination == NODE:
                say(ANSWER, now_ns)

    def say(payload: bytes, now_ns: int) -> None:
        received = RadioReceived(source=NODE, rssi_dbm=RssiDbm(-60), lqi=90, payload=payload)
        dongle.take_from_radio(received, eui64=EUI64, now_ns=now_ns)

    async def story() -> Any:
        line = PtyEnd(tmp_path / "dongle")
        serving = asyncio.ensure_future(serve(dongle, line, tend=tend))
        try:
            peer = await asyncio.create_subprocess_exec(
                str(PYTHON), str(PROGRAM), str(tmp_path / "dongle"), EUI64.to_bytes(8, "big").hex(":"), QUESTION.hex(),
                stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
            )  # fmt: skip
            told, complained = await peer.communicate()
            assert peer.returncode == 0, complained.decode()[-2000:]
            return json.loads(told)
        finally:
            serving.cancel()
            await asyncio.wait({serving})
            await line.aclose()

    found = asyncio.run(story())
    assert found["ieee"] == "00:13:a2:00:00:00:00:00"
    assert (found["nwk"], found["pan_id"], found["channel"], found["profile"]) == (0, 0xB10B, 20, 0xC105)
    assert found["heard"][0] == [NODE, QUESTION.hex()]
    assert ANSWER.hex() in {payload for _, payload in found["heard"]}
    assert (NODE, QUESTION) in sent
    assert set(dongle.faults) <= {"transparent"}  # the first frame to a module that does not speak frames yet
