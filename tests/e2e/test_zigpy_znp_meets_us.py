"""zigpy-znp, as a program of its own, against the Z-Stack dialect: it connects to the virtual chip, and frames mean the same to both.

zigpy-znp is under the GPL: it is never imported here. ``make wire-peers`` installs it.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.framing.znp import ZnpDecoder, encode_frame
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import Message, decode_command, encode_command
from firmware_protocol.znp.numbers import Command

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".venv-wire-peers" / "bin" / "python"

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.timeout(120),
    pytest.mark.skipif(not PYTHON.exists(), reason=f"{PYTHON.parent.parent.name} is not there: make wire-peers installs zigpy-znp"),
]

EUI64 = 0x00124B00000000AA
EUI64_HEX = EUI64.to_bytes(8, "little").hex()

# Our value, and zigpy-znp's name for the command with its fields in order.
SAME: list[tuple[Message, str, list[object]]] = [
    (znp.ResetRequest(kind=1), "SYS.ResetReq.Req", [1]),
    (znp.PingRequest(), "SYS.Ping.Req", []),
    (znp.PingReply(capabilities=0x0659), "SYS.Ping.Rsp", [0x0659]),
    (znp.VersionRequest(), "SYS.Version.Req", []),
    (znp.ExtendedAddressReply(eui64=EUI64), "SYS.GetExtAddr.Rsp", [EUI64_HEX]),
    (znp.NvInitRequest(item=0x0F00, length=1, value=b"\x55"), "SYS.OSALNVItemInit.Req", [0x0F00, 1, "55"]),
    (znp.NvReadRequest(item=0x87), "SYS.OSALNVRead.Req", [0x87, 0]),
    (znp.NvReadReply(status=0, value=b"\x00\x01"), "SYS.OSALNVRead.Rsp", [0, "0001"]),
    (znp.NvWriteRequest(item=0x83, value=b"\xff\xff"), "SYS.OSALNVWrite.Req", [0x83, 0, "ffff"]),
    (znp.StatusReply(command=Command.SYS_OSAL_NV_WRITE, status=0), "SYS.OSALNVWrite.Rsp", [0]),
    (znp.NvDeleteRequest(item=0x0F00, length=1), "SYS.OSALNVDelete.Req", [0x0F00, 1]),
    (znp.NvLengthRequest(item=0x83), "SYS.OSALNVLength.Req", [0x83]),
    (znp.NvLengthReply(length=2), "SYS.OSALNVLength.Rsp", [2]),
    (
        znp.RegisterRequest(endpoint=0xB1, profile=0xCB10, device=0, device_version=0, latency=0, in_clusters=(1,), out_clusters=(1, 2)),
        "AF.Register.Req",
        [0xB1, 0xCB10, 0, 0, 0, [1], [1, 2]],
    ),
    (znp.StatusReply(command=Command.AF_REGISTER, status=0xB8), "AF.Register.Rsp", [0xB8]),
    (
        znp.DataRequest(
            destination=0x1234, destination_endpoint=0xB1, source_endpoint=0xB1, cluster=1, transaction=7, options=0x20, radius=30,
            data=b"abc",
        ),
        "AF.DataRequest.Req",
        [0x1234, 0xB1, 0xB1, 1, 7, 0x20, 30, "616263"],
    ),
    (znp.StatusReply(command=Command.AF_DATA_REQUEST, status=0x11), "AF.DataRequest.Rsp", [0x11]),
    (znp.DataConfirm(status=0xE9, endpoint=0xB1, transaction=7), "AF.DataConfirm.Callback", [0xE9, 0xB1, 7]),
    (znp.StartupRequest(delay_ms=100), "ZDO.StartupFromApp.Req", [100]),
    (znp.StateChange(state=9), "ZDO.StateChangeInd.Callback", [9]),
    (znp.DeviceAnnounced(source=1, address=1, eui64=EUI64, capabilities=0x80), "ZDO.EndDeviceAnnceInd.Callback", [1, 1, EUI64_HEX, 0x80]),
    (znp.DeviceTrusted(address=1, eui64=EUI64, parent=0), "ZDO.TCDevInd.Callback", [1, EUI64_HEX, 0]),
    (
        znp.PermitJoinRequest(address_mode=0x0F, destination=0xFFFC, duration_s=254, trust_center=0),
        "ZDO.MgmtPermitJoinReq.Req",
        [0x0F, 0xFFFC, 254, 0],
    ),
    (znp.PermitJoinAnswered(source=0, status=0), "ZDO.MgmtPermitJoinRsp.Callback", [0, 0]),
    (
        znp.DeviceInfoReply(status=0, eui64=EUI64, address=0, kind=7, state=9, associated=(1, 2)),
        "UTIL.GetDeviceInfo.Rsp",
        [0, EUI64_HEX, 0, 7, 9, [1, 2]],
    ),
    (znp.SetChannelRequest(is_primary=1, channels=1 << 20), "AppConfig.BDBSetChannel.Req", [1, 1 << 20]),
    (znp.CommissioningRequest(mode=4), "AppConfig.BDBStartCommissioning.Req", [4]),
    (znp.CommissioningReport(status=0, mode=4, remaining=0), "AppConfig.BDBCommissioningNotification.Callback", [0, 4, 0]),
    (znp.RequireKeyExchangeRequest(is_required=0), "AppConfig.BDBSetTcRequireKeyExchange.Req", [0]),
]  # fmt: skip


def peer(program: str, *arguments: str, given: str = "") -> Any:
    """Run a peer program and return the JSON that it prints."""
    command = [str(PYTHON), str(ROOT / "scripts" / "wire_peers" / program), *arguments]
    done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_frames_mean_the_same_to_zigpy_znp_both_ways() -> None:
    ours = [encode_frame(encode_command(message)) for message, _, _ in SAME]
    heard = znp.IncomingMessage(
        group=0, cluster=1, source=0x1234, source_endpoint=0xB1, destination_endpoint=0xB1, was_broadcast=0, lqi=90, security=0,
        timestamp=7, sequence=9, data=bytes(57),
    )  # fmt: skip
    trailer = b"\x34\x12\x1e"
    asked = {
        "decode": [frame.hex() for frame in (*ours, encode_frame(encode_command(heard) + trailer))],
        "encode": [[name, values] for _, name, values in SAME],
    }

    told = peer("znp_frames.py", given=json.dumps(asked))

    assert [bytes.fromhex(frame) for frame in told["encode"]] == ours, "the same bytes, one by one"
    assert told["decode"][:-1] == [[name, values] for _, name, values in SAME]
    assert told["decode"][-1] == ["AF.IncomingMsg.Callback", [0, 1, 0x1234, 0xB1, 0xB1, 0, 90, 0, 7, 9, bytes(57).hex(), 0x1234, 30]]
    theirs = ZnpDecoder().feed(b"".join(map(bytes.fromhex, told["encode"])))
    assert [decode_command(body) for body in theirs if isinstance(body, bytes)] == [message for message, _, _ in SAME]


def test_zigpy_znp_connects_to_the_virtual_chip_over_a_terminal(tmp_path: Path) -> None:
    port, ready = tmp_path / "znp", tmp_path / "ready"
    command = [sys.executable, "-m", "simulator", "serve", "--scenario", "no-obstacle", "--biobots", "5", "--seed", "1"]
    command += ["--link", f"pty:{port}?dialect=znp", "--ready-file", str(ready)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as simulator:
        try:
            assert simulator.stderr is not None
            while not ready.exists():
                assert simulator.stderr.readline(), "the simulator ended before it was ready"
            told = peer("znp_connect.py", str(port))
        finally:
            simulator.kill()
    assert told == {
        "capabilities": 0x0659, "zstack": 3.3, "product": 1, "ieee": "00:12:4b:00:00:00:00:00", "state": 0, "registered": 0,
    }  # fmt: skip
