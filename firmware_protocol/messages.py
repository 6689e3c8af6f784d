"""What backpacks and base station say to each other over the radio (WIRE_FORMAT.md §5 and §6).

One frozen class for each message, with the fields of its layout in ``layouts.py``; their bytes are ``message_codec.py``'s. Every message
means the same whichever dongle carries it. They are msgspec structs and no dataclasses because a frozen dataclass takes ten times as long
to build, and a base station builds several for every frame.
"""

from enum import Enum, IntEnum, IntFlag
from typing import TypeAlias

from msgspec import Struct

from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm

PROTOCOL_VERSION = 1
"""Newest version of §5 and §6 that this code speaks; Hello and HelloRequest are of version 1 for ever (§7)."""

MAX_RADIO_PAYLOAD = 57
"""Octets that a ZigBee unicast with APS security still carries in one piece (WIRE_FORMAT.md §4)."""

MAX_ENCOUNTERS_PER_BATCH = 4
MAX_ENCOUNTERS_WITH_PATHS_PER_BATCH = 3
MAX_NEIGHBOURS_PER_PART = 10
MAX_ENCOUNTER_MS = (1 << 22) - 1
"""Longest encounter one entry can say [ms], about 70 minutes; a longer one is reported in pieces that touch."""

MAX_PATH_MM = 0xFFFE
"""Longest path that an entry can say [mm]; it stands for all longer ones too."""

OWN_CHANNEL = 0xFF
"""Stands for the electrode channel that the backpack itself uses for an action."""

LEAVE_PERIOD = 0
LEAVE_RSSI = RssiDbm(-128)
"""What stands in a Configure for a value that is to stay as it is: the first for periods and the gap tolerance, the second for RSSI."""

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
    FOLLOW_WALLS = 5
    """Only for backpacks with ``Capability.FOLLOW_WALLS``."""


class StimulationResult(IntEnum):
    """What a backpack did with a command."""

    DONE = 0
    ALREADY_DONE = 1
    EXPIRED = 2
    REFUSED_LIMIT = 3
    BAD_PARAMETER = 4


class Capability(IntFlag):
    """What a backpack can do, in its Hello."""

    STIMULATION = 1
    IMU = 2
    """It sends encounters with paths."""
    CONFIGURE = 4
    ELECTRODE_CHECK = 8
    """It measures its electrodes before a train, and refuses where they are loose."""
    FOLLOW_WALLS = 16
    """It can have its insect keep to walls."""


class Waveform(IntEnum):
    """Shape of one pulse; the first two put as much charge in as they take out."""

    SYMMETRIC_BIPHASIC = 0
    ASYMMETRIC_BIPHASIC = 1
    """The second phase is weaker and longer."""
    MONOPHASIC = 2
    """One phase, then the electrodes are shorted: the charge goes by itself."""


class ConfigurationResult(IntEnum):
    """What a receiver did with a configuration; on anything but DONE, nothing has changed."""

    DONE = 0
    BAD_PARAMETER = 1
    NOT_SUPPORTED = 2


class Level(IntEnum):
    """How much a log line matters."""

    DEBUG = 0
    INFO = 1
    WARNING = 2
    ERROR = 3


# --- uplink: backpack to base station -------------------------------------------------------------------------------


class UplinkHeader(Struct, frozen=True, kw_only=True, gc=False):
    """Stand in front of every uplink message (WIRE_FORMAT.md §5.1).

    ``sent_ms`` is the backpack's clock when the radio took this copy of the message: a repetition carries a new one.
    """

    node: NodeId
    boot: BootId
    sequence: int
    sent_ms: Milliseconds


class Hello(Struct, frozen=True, kw_only=True, gc=False):
    """Say who has started, and what it can do (§5.2)."""

    eui64: int
    firmware: int
    beacon_period_ms: int
    """0 where encounters are sensed continuously."""
    capabilities: int
    """Bits of ``Capability``; others are of a newer firmware."""
    newest_version: int = PROTOCOL_VERSION
    """Newest version of the messages that the backpack speaks."""


class EncounterEntry(Struct, frozen=True, kw_only=True, gc=False):
    """One encounter as one side sensed it (§5.3)."""

    peer: NodeId
    start_ms: Milliseconds
    duration_ms: Milliseconds
    rssi_dbm: RssiDbm
    is_ongoing: bool
    """True in a provisional report: the encounter has not ended, a longer report of it will follow."""
    path_mm: int | None = None
    """Path that the biobot's IMU measured from the start of its previous encounter of this boot to the start of this one [mm], at most
    ``MAX_PATH_MM``; None: not known. An EncounterBatch cannot say it."""


class EncounterBatch(Struct, frozen=True, kw_only=True, gc=False):
    """Report up to ``MAX_ENCOUNTERS_PER_BATCH`` encounters (§5.3)."""

    entries: tuple[EncounterEntry, ...]


class EncounterBatchWithPaths(Struct, frozen=True, kw_only=True, gc=False):
    """Report up to ``MAX_ENCOUNTERS_WITH_PATHS_PER_BATCH`` encounters and the paths between them (§5.9)."""

    entries: tuple[EncounterEntry, ...]


class Status(Struct, frozen=True, kw_only=True, gc=False):
    """Tell the mode, since when and why, and the state of battery and buffer (§5.4)."""

    mode: WireMode
    cause: WireCause
    mode_since_ms: Milliseconds
    battery_mv: int
    buffered: int
    dropped: int
    """Encounters lost because the buffer was full, since boot, modulo 2**16."""


class Neighbour(Struct, frozen=True, kw_only=True, gc=False):
    """A biobot heard within communication range."""

    node: NodeId
    rssi_dbm: RssiDbm


class Neighbours(Struct, frozen=True, kw_only=True, gc=False):
    """Tell a part of who is within communication range (§5.5)."""

    part: int
    n_parts: int
    neighbours: tuple[Neighbour, ...]


class TimeSyncReply(Struct, frozen=True, kw_only=True, gc=False):
    """Answer a time sync request: when it came; when this left is in the header (§5.6)."""

    token: int
    received_ms: Milliseconds


class StimulateReply(Struct, frozen=True, kw_only=True, gc=False):
    """Tell what became of a command (§5.7)."""

    command: int
    result: StimulationResult
    executed_ms: Milliseconds
    mode: WireMode


class Limits(Struct, frozen=True, kw_only=True, gc=False):
    """Say what the stimulator can do and refuses to exceed, and how much the backpack holds (§5.8)."""

    channels: int
    """Bit i: electrode channel i is there."""
    waveforms: int
    """Bit i: waveform i can be made."""
    max_frequency_hz: int
    max_pulse_width_us: int
    max_amplitude_mv: int
    max_duration_ms: int
    min_gap_ms: int
    max_on_ms_per_minute: int
    battery_mv: int
    battery_empty_mv: int
    """The backpack stops at this."""
    encounter_capacity: int


class Diagnostic(Struct, frozen=True, kw_only=True, gc=False):
    """Report something that a person may want to know (§5.10). The codes are the firmware's own."""

    level: Level
    code: int
    argument: int
    at_ms: Milliseconds
    text: str = ""


class ConfigurationReport(Struct, frozen=True, kw_only=True, gc=False):
    """Tell what became of a Configure, and all values in force (§5.11).

    A value that the backpack does not have is ``LEAVE_PERIOD`` or ``LEAVE_RSSI``.
    """

    token: int
    """Of the Configure or ConfigurationRequest."""
    result: ConfigurationResult
    beacon_period_ms: int
    rssi_enter_dbm: RssiDbm
    rssi_exit_dbm: RssiDbm
    gap_tolerance_ms: int
    report_period_ms: int


# --- downlink: base station to backpack -----------------------------------------------------------------------------


class HelloRequest(Struct, frozen=True, kw_only=True, gc=False):
    """Ask for a hello (§6.2)."""

    newest_version: int = PROTOCOL_VERSION
    """Newest version of the messages that the base station speaks."""


class Acknowledge(Struct, frozen=True, kw_only=True, gc=False):
    """Say which uplink messages are safe on disk (§6.3).

    All messages of ``boot`` before ``next_sequence`` (modulo 2**16) are; bit i of ``bitmap`` stands for
    ``next_sequence + 1 + i``.
    """

    boot: BootId
    next_sequence: int
    bitmap: int


class TimeSyncRequest(Struct, frozen=True, kw_only=True, gc=False):
    """Ask for the backpack's clock (§6.4)."""

    token: int


class Stimulate(Struct, frozen=True, kw_only=True, gc=False):
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
    channel: int = OWN_CHANNEL
    waveform: Waveform = Waveform.SYMMETRIC_BIPHASIC


class Configure(Struct, frozen=True, kw_only=True, gc=False):
    """Set how encounters are sensed and reported (§6.6); all of it or nothing, and answered with a ConfigurationReport."""

    token: int
    beacon_period_ms: int = LEAVE_PERIOD
    rssi_enter_dbm: RssiDbm = LEAVE_RSSI
    rssi_exit_dbm: RssiDbm = LEAVE_RSSI
    gap_tolerance_ms: int = LEAVE_PERIOD
    report_period_ms: int = LEAVE_PERIOD


class ConfigurationRequest(Struct, frozen=True, kw_only=True, gc=False):
    """Ask for a ConfigurationReport (§6.7)."""

    token: int


Uplink: TypeAlias = (
    Hello
    | EncounterBatch
    | Status
    | Neighbours
    | TimeSyncReply
    | StimulateReply
    | Limits
    | EncounterBatchWithPaths
    | Diagnostic
    | ConfigurationReport
)
Downlink: TypeAlias = HelloRequest | Acknowledge | TimeSyncRequest | Stimulate | Configure | ConfigurationRequest
