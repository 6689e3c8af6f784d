"""Let zigpy-znp connect to a Z-Stack dongle, as it does in a home, and tell what it found: one line of JSON.

Run by the tests with the Python of .venv-wire-peers (make wire-peers): python znp_connect.py PORT
zigpy-znp is under the GPL; nothing of the project imports it, and this program imports nothing of the project.
"""

import asyncio
import json
import sys

import zigpy_znp.commands as c
import zigpy_znp.config as conf
from zigpy_znp.api import ZNP
from zigpy_znp.commands.af import LatencyReq

PATIENCE_S = 30


async def main(port: str) -> None:
    """Connect, ask for the network, register an endpoint, hang up."""
    znp = ZNP(conf.CONFIG_SCHEMA({conf.CONF_DEVICE: {conf.CONF_DEVICE_PATH: port}}))
    try:
        async with asyncio.timeout(PATIENCE_S):
            await znp.connect()
            version = await znp.request(c.SYS.Version.Req())
            address = await znp.request(c.SYS.GetExtAddr.Req())
            info = await znp.request(c.UTIL.GetDeviceInfo.Req())
            registered = await znp.request(
                c.AF.Register.Req(
                    Endpoint=1, ProfileId=0x0104, DeviceId=5, DeviceVersion=0, LatencyReq=LatencyReq.NoLatencyReqs,
                    InputClusters=[6], OutputClusters=[6],
                )
            )  # fmt: skip
            found = {
                "capabilities": int(znp.capabilities),
                "zstack": float(znp.version),
                "product": int(version.ProductId),
                "ieee": str(address.ExtAddr),
                "state": int(info.DeviceState),
                "registered": int(registered.Status),
            }
    finally:
        await znp.disconnect()
    print(json.dumps(found))


asyncio.run(main(sys.argv[1]))
