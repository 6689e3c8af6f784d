"""Radio payloads that look like life, and what each dialect makes of them on its line."""

import random
from collections.abc import Callable

from firmware_protocol.dialects.xbee_frames import Receive, encode_xbee
from firmware_protocol.envelope import RadioReceived, encode_envelope
from firmware_protocol.message_codec import encode_uplink
from firmware_protocol.messages import EncounterBatch, EncounterEntry, UplinkHeader
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm, ShortAddress
from firmware_protocol.znp.codec import encode_command
from firmware_protocol.znp.frames import IncomingMessage

_LINK_DATA = 3
_SESSION = 0x1234


def make_payloads(n: int, *, n_entries: int = 1, seed: int = 1) -> list[bytes]:
    """Return ``n`` different encounter batches of ``n_entries`` encounters each: 24 bytes with one, 54 with four."""
    draw = random.Random(seed)
    return [
        encode_uplink(
            UplinkHeader(
                node=NodeId(draw.randrange(1, 500)), boot=BootId(3), sequence=count % 65536, sent_ms=Milliseconds(1_000_000 + count)
            ),
            EncounterBatch(
                entries=tuple(
                    EncounterEntry(
                        peer=NodeId(draw.randrange(1, 500)),
                        start_ms=Milliseconds(draw.randrange(1_000_000)),
                        duration_ms=Milliseconds(draw.randrange(60_000)),
                        rssi_dbm=RssiDbm(-draw.randrange(30, 90)),
                        is_ongoing=False,
                    )
                    for _ in range(n_entries)
                )
            ),
        )
        for count in range(n)
    ]


def link_body(payload: bytes, count: int) -> bytes:
    """Return the native link's DATA frame for a payload that was heard (WIRE_FORMAT.md §3.1 and §4.5)."""
    received = RadioReceived(source=ShortAddress(1 + count % 500), rssi_dbm=RssiDbm(-60), lqi=120, payload=payload)
    return bytes((_LINK_DATA, _SESSION & 0xFF, _SESSION >> 8, count % 256)) + encode_envelope(received)


def xbee_body(payload: bytes, count: int) -> bytes:
    """Return the Receive Packet (0x90) for a payload that was heard."""
    return encode_xbee(Receive(source64=0x0013A20000000000 + count % 500, source16=1 + count % 500, options=1, payload=payload))


def znp_body(payload: bytes, count: int) -> bytes:
    """Return AF_INCOMING_MSG for a payload that was heard."""
    message = IncomingMessage(
        group=0, cluster=0x0B10, source=1 + count % 500, source_endpoint=1, destination_endpoint=1, was_broadcast=0, lqi=120, security=0,
        timestamp=count, sequence=count % 256, data=payload,
    )  # fmt: skip
    return encode_command(message)


BODY_OF: dict[str, Callable[[bytes, int], bytes]] = {
    "native": link_body, "xbee": xbee_body, "znp": znp_body, "can": link_body, "canfd": link_body
}  # fmt: skip
"""By dialect: the frame body for a payload and its count."""
