"""Frames of the native dialect, looked at from beside the line (WIRE_FORMAT.md §2 to §4)."""

import struct

from firmware_protocol.envelope import CoordinatorHello, EnvelopeFault, RadioReceived, RadioSend, decode_envelope
from firmware_protocol.framing.cobs import CobsDecoder
from firmware_protocol.units import RSSI_UNKNOWN
from gateway.recordings.dissection import Dialect, Dissection, NetworkFacts, RadioPayload
from gateway.recordings.plain_values import fields_of

_HEADER = struct.Struct("<BHB")  # kind, session, sequence (§3.1)
_DATA = 3
_RESETS = (1, 2)
KINDS = {1: "RESET", 2: "RESET_ACK", _DATA: "DATA", 4: "ACK", 5: "PING", 6: "NEED_RESET"}
"""Link frames by their kind (§3.1)."""


def dissect_native(body: bytes, is_outgoing: bool) -> Dissection:  # noqa: FBT001  # the interface's
    """Say what a link frame means."""
    if len(body) < _HEADER.size:
        return Dissection(is_outgoing=is_outgoing, name="fault", fault="link.too_short", fields={"hex": body.hex()})
    kind, session, sequence = _HEADER.unpack_from(body)
    rest = body[_HEADER.size :]
    fields: dict[str, object] = {"session": session, "sequence": sequence}
    if kind not in KINDS:
        return Dissection(is_outgoing=is_outgoing, name=f"kind {kind}", fields=fields | {"hex": rest.hex()}, fault="link.unknown_kind")
    if kind != _DATA:
        if kind in _RESETS and rest:
            fields["link_version"] = rest[0]
        return Dissection(is_outgoing=is_outgoing, name=KINDS[kind], fields=fields)
    return _dissect_envelope(rest, is_outgoing=is_outgoing, fields=fields)


def _dissect_envelope(body: bytes, *, is_outgoing: bool, fields: dict[str, object]) -> Dissection:
    envelope = decode_envelope(body)
    if isinstance(envelope, EnvelopeFault):
        fault = f"envelope.{envelope.value}"
        return Dissection(is_outgoing=is_outgoing, name="DATA", fields=fields | {"hex": body.hex()}, fault=fault)
    payload: RadioPayload | None = None
    network: NetworkFacts | None = None
    told = fields_of(envelope)
    match envelope:
        case RadioReceived(source=source, rssi_dbm=rssi_dbm, lqi=lqi, payload=data):
            payload = RadioPayload(address=source, data=data, rssi_dbm=None if rssi_dbm == RSSI_UNKNOWN else rssi_dbm, lqi=lqi)
            told = {}
        case RadioSend(destination=destination, payload=data, handle=handle):
            payload = RadioPayload(address=destination, data=data)
            told = {"handle": handle}
        case CoordinatorHello(pan_id=pan_id, channel=channel):
            network = NetworkFacts(pan_id=pan_id, channel=channel)
    fields = fields | {"envelope": type(envelope).__name__} | told
    return Dissection(is_outgoing=is_outgoing, name="DATA", fields=fields, payload=payload, network=network)


NATIVE = Dialect(make_decoder=CobsDecoder, dissect=dissect_native, delimiter=b"\x00")
