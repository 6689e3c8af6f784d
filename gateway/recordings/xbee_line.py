"""API frames of an XBee, looked at from beside the line (WIRE_FORMAT.md §8)."""

import re
from dataclasses import dataclass, field

from firmware_protocol.dialects.xbee_frames import (
    DIGI_PROFILE,
    AtResponse,
    Endpoints,
    Receive,
    TransmitRequest,
    XBeeFault,
    decode_xbee,
)
from firmware_protocol.framing.interface import FrameDecoder, FrameFault
from firmware_protocol.framing.xbee import make_decoder
from firmware_protocol.units import ShortAddress
from gateway.recordings.dissection import Dialect, Dissection, NetworkFacts, RadioPayload
from gateway.recordings.plain_values import fields_of


@dataclass(slots=True)
class EitherModeDecoder:
    """Cuts a stream of mode 1 or 2 into bodies, without being told which.

    Frames without a byte that mode 2 escapes are the same in both. Where one mode gives frames that the other does not, that one is
    believed from then on; a stream begins as mode 2, which the gateway's host sets.
    """

    _believed: FrameDecoder = field(default_factory=lambda: make_decoder(is_escaped=True))
    _other: FrameDecoder = field(default_factory=lambda: make_decoder(is_escaped=False))

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        """Take the next bytes of the stream; see ``FrameDecoder``."""
        results, others = self._believed.feed(chunk), self._other.feed(chunk)
        if _n_bodies(others) > _n_bodies(results):
            self._believed, self._other = self._other, self._believed
            return others
        return results


def dissect_xbee(body: bytes, is_outgoing: bool) -> Dissection:  # noqa: FBT001  # the interface's
    """Say what an API frame means."""
    frame = decode_xbee(body)
    if isinstance(frame, XBeeFault):
        return Dissection(is_outgoing=is_outgoing, name=f"0x{body[0]:02x}", fields={"hex": body.hex()}, fault=f"xbee.{frame.value}")
    told = fields_of(frame)
    payload: RadioPayload | None = None
    network: NetworkFacts | None = None
    match frame:
        case Receive(source16=source, payload=data, endpoints=endpoints):
            del told["payload"]
            if _is_data(endpoints):
                payload = RadioPayload(address=ShortAddress(source), data=data)
            else:
                told["hex"] = data.hex()
        case TransmitRequest(destination16=destination, payload=data):
            del told["payload"]
            payload = RadioPayload(address=ShortAddress(destination), data=data)
        case AtResponse(command="OI", status=0, value=value):
            network = NetworkFacts(pan_id=int.from_bytes(value, "big") & 0xFFFF)
        case AtResponse(command="CH", status=0, value=value):
            network = NetworkFacts(channel=int.from_bytes(value, "big") & 0xFF)
    return Dissection(is_outgoing=is_outgoing, name=type(frame).__name__, fields=told, payload=payload, network=network)


def _is_data(endpoints: Endpoints | None) -> bool:
    return endpoints is None or endpoints.profile == DIGI_PROFILE


def _n_bodies(results: list[bytes | FrameFault]) -> int:
    return sum(isinstance(one, bytes) for one in results)


_TEXT = re.compile(rb"\+\+\+|(AT[ -~]{1,80}\r)+")
"""What switches a module in transparent mode to API mode: ``+++``, and commands in its command mode."""

XBEE = Dialect(make_decoder=EitherModeDecoder, dissect=dissect_xbee, text=_TEXT)
