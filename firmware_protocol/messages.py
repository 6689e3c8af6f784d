"""What backpacks and base station say to each other over the radio (WIRE_FORMAT.md §5 and §6).

One frozen class for each message; their bytes are ``message_codec.py``'s. Every message means the same whichever dongle
carries it.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import TypeAlias

from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm

PROTOCOL_VERSION = 1

MAX_RADIO_PAYLOAD = 57
"""Octets that a ZigBee unicast with APS security still carries in one piece (WIRE_FORMAT.md §4)."""

MAX_ENCOUNTERS_PER_BATCH = 4
MAX_NEIGHBOURS_PER_PART = 10
MAX_ENCOUNTER_MS = (1 << 22) - 1
"""Longest encounter one entry can say [ms], about 70 minutes; a longer one is reported in pieces that touch."""

BROADCAST_NODE = NodeId(0xFFFF)


class MessageFault(Enum):
    """Why a radio payload is not a message."""

    BAD_CRC = "bad_crc"
    TOO_LONG = "too_long"
    UNKNOWN_VERSION = "unknown_version"
    UNKNOWN_TYPE = "unknown_type"
    BAD_LENGTH = "bad_length"
    BAD_VALUE = "bad_value"


class WireMode(IntEnum):
    """Whether the insect walks by itself or stands still ([Dir16] III.A)."""

    CRW = 0
    S = 1


class WireCause(IntEnum):
    """Why the insect is in its mode: by itself or by command."""

    NATURAL = 0
    COMMAND = 1


class Action(IntEnum):
    """What a stimulus asks of the insect ([Dir16] III.A, controlled motion)."""

    START = 1
    STOP = 2
    TURN_LEFT = 3
    TURN_RIGHT = 4


class StimulationResult(IntEnum):
    """What a backpack did with a command."""

    DONE = 0
    ALREADY_DONE = 1
    EXPIRED = 2
    REFUSED_LIMIT = 3
    BAD_PARAMETER = 4


# --- uplink: backpack to base station -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class UplinkHeader:
    """Stand in front of every uplink message (WIRE_FORMAT.md §5.1).

    ``sent_ms`` is the backpack's clock when the radio took this copy of the message: a repetition carries a new one.
    """

    node: NodeId
    boot: BootId
    sequence: int
    sent_ms: Milliseconds


@dataclass(frozen=True, slots=True, kw_only=True)
class Hello:
    """Say who has started, and what it can do (§5.2)."""

    eui64: int
    firmware: int
    beacon_period_ms: int
    """0 where encounters are sensed continuously."""
    capabilities: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterEntry:
    """One encounter as one side sensed it (§5.3)."""

    peer: NodeId
    start_ms: Milliseconds
    duration_ms: Milliseconds
    rssi_dbm: RssiDbm
    is_ongoing: bool
    """True in a provisional report: the encounter has not ended, a longer report of it will follow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterBatch:
    """Report up to ``MAX_ENCOUNTERS_PER_BATCH`` encounters (§5.3)."""

    entries: tuple[EncounterEntry, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """Tell the mode, since when and why, and the state of battery and buffer (§5.4)."""

    mode: WireMode
    cause: WireCause
    mode_since_ms: Milliseconds
    battery_mv: int
    buffered: int
    dropped: int
    """Encounters lost because the buffer was full, since boot, modulo 2**16."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbour:
    """A biobot heard within communication range."""

    node: NodeId
    rssi_dbm: RssiDbm


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbours:
    """Tell a part of who is within communication range (§5.5)."""

    part: int
    n_parts: int
    neighbours: tuple[Neighbour, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSyncReply:
    """Answer a time sync request: when it came; when this left is in the header (§5.6)."""

    token: int
    received_ms: Milliseconds


@dataclass(frozen=True, slots=True, kw_only=True)
class StimulateReply:
    """Tell what became of a command (§5.7)."""

    command: int
    result: StimulationResult
    executed_ms: Milliseconds
    mode: WireMode


# --- downlink: base station to backpack -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class HelloRequest:
    """Ask for a hello (§6.2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Acknowledge:
    """Say which uplink messages are safe on disk (§6.3).

    All messages of ``boot`` before ``next_sequence`` (modulo 2**16) are; bit i of ``bitmap`` stands for
    ``next_sequence + 1 + i``.
    """

    boot: BootId
    next_sequence: int
    bitmap: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSyncRequest:
    """Ask for the backpack's clock (§6.4)."""

    token: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Stimulate:
    """Command a stimulus (§6.5). Obeyed once: a repeated ``command`` is answered, not executed again."""

    command: int
    action: Action
    ttl_ms: int
    """The backpack refuses the command if it waited longer than this in its own queue [ms]."""
    hold_ms: int
    """Controlled motion ends by itself after this [ms]; 0: until another command."""
    frequency_hz: int
    pulse_width_us: int
    amplitude_mv: int
    duration_ms: int


Uplink: TypeAlias = Hello | EncounterBatch | Status | Neighbours | TimeSyncReply | StimulateReply
Downlink: TypeAlias = HelloRequest | Acknowledge | TimeSyncRequest | Stimulate
