"""MT commands of a Z-Stack network processor, looked at from beside the line (WIRE_FORMAT.md §9)."""

from firmware_protocol.framing.znp import ZnpDecoder
from firmware_protocol.units import ShortAddress
from firmware_protocol.znp.codec import decode_command
from firmware_protocol.znp.frames import DataRequest, IncomingMessage, NetworkInfoReply, RpcError, StatusReply, ZnpFault
from firmware_protocol.znp.numbers import Command
from gateway.recordings.dissection import Dialect, Dissection, NetworkFacts, RadioPayload
from gateway.recordings.plain_values import fields_of


def dissect_znp(body: bytes, is_outgoing: bool) -> Dissection:  # noqa: FBT001  # the interface's
    """Say what an MT command means."""
    message = decode_command(body)
    if isinstance(message, ZnpFault):
        name = f"command 0x{int.from_bytes(body[:2], 'big'):04x}"
        return Dissection(is_outgoing=is_outgoing, name=name, fields={"hex": body[2:].hex()}, fault=f"znp.{message.value}")
    told = fields_of(message)
    payload: RadioPayload | None = None
    network: NetworkFacts | None = None
    match message:
        case IncomingMessage(source=source, lqi=lqi, data=data):
            del told["data"]
            payload = RadioPayload(address=ShortAddress(source), data=data, lqi=lqi)
        case DataRequest(destination=destination, data=data):
            del told["data"]
            payload = RadioPayload(address=ShortAddress(destination), data=data)
        case NetworkInfoReply(pan_id=pan_id, channel=channel):
            network = NetworkFacts(pan_id=pan_id, channel=channel)
        case StatusReply() | RpcError():
            told["command"] = _command_name(message.command)
    return Dissection(is_outgoing=is_outgoing, name=type(message).__name__, fields=told, payload=payload, network=network)


def _command_name(number: int) -> str:
    try:
        return Command(number).name
    except ValueError:
        return f"0x{number:04x}"


ZNP = Dialect(make_decoder=ZnpDecoder, dissect=dissect_znp)
