"""One radio payload of each message of the wire format, from its golden vectors where they have it."""

import json
from pathlib import Path

from firmware_protocol.message_codec import decode_uplink, encode_uplink
from firmware_protocol.messages import EncounterBatch, EncounterEntry, MessageFault, UplinkHeader
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm

_VECTORS = Path(__file__).parents[2] / "firmware_protocol" / "vectors"


def _one_of_each(name: str) -> list[bytes]:
    """The first sound payload of each type byte."""
    found: dict[int, bytes] = {}
    for vector in json.loads((_VECTORS / f"{name}.json").read_text()):
        if vector.get("fault") is None:
            payload = bytes.fromhex(vector["hex"])
            found.setdefault(payload[0], payload)
    return list(found.values())


def _a_batch() -> bytes:
    header = UplinkHeader(node=NodeId(3), boot=BootId(9), sequence=17, sent_ms=Milliseconds(5000))
    entries = tuple(
        EncounterEntry(
            peer=NodeId(peer), start_ms=Milliseconds(100), duration_ms=Milliseconds(ms), rssi_dbm=RssiDbm(rssi), is_ongoing=False
        )
        for peer, ms, rssi in ((4, 70_000, -60), (5, 900, -61))
    )
    return encode_uplink(header, EncounterBatch(entries=entries))


def _is_batch(payload: bytes) -> bool:
    decoded = decode_uplink(payload)
    return not isinstance(decoded, MessageFault) and isinstance(decoded[1], EncounterBatch)


UPLINK_SAMPLES = [*(one for one in _one_of_each("uplink") if not _is_batch(one)), _a_batch()]
DOWNLINK_SAMPLES = _one_of_each("downlink")
