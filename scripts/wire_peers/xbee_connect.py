"""Let zigpy-xbee take an XBee as its coordinator, as it does in a home, hear a node and send to it; tell what it found: one line of JSON.

Run by the tests with the Python of .venv-wire-peers (make wire-peers): python xbee_connect.py PORT NODE HEX,
where NODE is the 64-bit address of the node and HEX what is sent to it.
zigpy-xbee is under the GPL; nothing of the project imports it, and this program imports nothing of the project.
"""

import asyncio
import json
import sys

import zigpy.types as t
from zigpy_xbee.zigbee.application import ControllerApplication

PATIENCE_S = 40
ENDPOINT, CLUSTER, PROFILE = 0xE8, 0x0011, 0xC105


async def main(port: str, node: str, payload: bytes) -> None:
    """Connect, take the network over, hear a payload, send one back, hear the answer, hang up."""
    heard: asyncio.Queue[t.ZigbeePacket] = asyncio.Queue()
    app = ControllerApplication(
        {"device": {"path": port, "baudrate": 9600}, "database_path": None, "ota": {"enabled": False}, "startup_energy_scan": False}
    )
    app.packet_received = heard.put_nowait
    try:
        async with asyncio.timeout(PATIENCE_S):
            await app.connect()
            await app.load_network_info()
            await app.start_network()
            first = await heard.get()
            app.add_device(ieee=t.EUI64.convert(node), nwk=first.src.address)
            await app.send_packet(
                t.ZigbeePacket(
                    src=t.AddrModeAddress(addr_mode=t.AddrMode.NWK, address=0x0000), src_ep=ENDPOINT,
                    dst=first.src, dst_ep=ENDPOINT, tsn=1, profile_id=PROFILE, cluster_id=CLUSTER, data=t.SerializableBytes(payload),
                )
            )  # fmt: skip
            answer = await heard.get()
            found = {
                "ieee": str(app.state.node_info.ieee),
                "nwk": int(app.state.node_info.nwk),
                "pan_id": int(app.state.network_info.pan_id),
                "channel": int(app.state.network_info.channel),
                "profile": int(first.profile_id),
                "heard": [[int(one.src.address), one.data.serialize().hex()] for one in (first, answer)],
            }
    finally:
        await app.disconnect()
    print(json.dumps(found))


asyncio.run(main(sys.argv[1], sys.argv[2], bytes.fromhex(sys.argv[3])))
