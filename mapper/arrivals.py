"""What comes in from the bus, decoded: any key with any bytes becomes a value, or nothing."""

from dataclasses import dataclass
from typing import Final, TypeAlias

from firmware_protocol.contract.announcements import GatewayEvent, NeighbourReport
from firmware_protocol.contract.commands import CommandStage, StimulationAccount
from firmware_protocol.contract.keys import Key, Stream, parse_key
from firmware_protocol.contract.presence import Token, parse_token_key
from firmware_protocol.contract.records import GatewayStatus, NodeStatus, RecordBatch, decode_record
from firmware_protocol.errors import KeyExpressionError, RecordError
from mapper.log import EventLog

_log = EventLog(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Presence:
    """A gateway, one of its radios, a mapper or a commander came to the bus, or left it."""

    token: Token
    is_alive: bool


_Published: TypeAlias = RecordBatch | GatewayStatus | NodeStatus | NeighbourReport | GatewayEvent | CommandStage | StimulationAccount
Arrival: TypeAlias = _Published | Presence

# Of these, what is told is said by the content; elsewhere the key names the biobot, or none is meant.
_ABOUT_ANY_BIOBOT: Final = Stream.STAGES


def decode_arrival(key_text: str, payload: bytes | bool) -> Arrival | None:  # noqa: FBT001  # the payload of a token is its kind
    """Return what a sample says, or None for one that is no record, or comes from another gateway than its key says."""
    try:
        if isinstance(payload, bool):
            return Presence(token=parse_token_key(key_text), is_alive=payload)
        key = parse_key(key_text)
        arrival = _decode_payload(key, payload)
    except (KeyExpressionError, RecordError) as error:
        _log.debug("bus.unfit", key=key_text, reason=str(error))
        return None
    is_of_its_key = arrival.gateway == key.gateway
    if key.stream is not _ABOUT_ANY_BIOBOT:
        is_of_its_key = is_of_its_key and getattr(arrival, "node", None) == key.node
    return arrival if is_of_its_key else None


def _decode_payload(key: Key, payload: bytes) -> _Published:
    match key.stream:
        case Stream.STATUS if key.node is None:
            return decode_record(payload, GatewayStatus)
        case Stream.STATUS:
            return decode_record(payload, NodeStatus)
        case Stream.NEIGHBOURS:
            return decode_record(payload, NeighbourReport)
        case Stream.EVENTS:
            return decode_record(payload, GatewayEvent)
        case Stream.STAGES:
            return decode_record(payload, CommandStage)
        case Stream.STIMULATION:
            return decode_record(payload, StimulationAccount)
        case _:
            return decode_record(payload, RecordBatch)
