"""The records on the bus: what gateway and mapper both mean (CONTRACT.md §3 and §4). Commands and orders have modules of their own.

Journaled records (encounters, modes, mission phases) share a head: an identity ``(gateway, journal, boot, sequence)`` that
never changes, a revision that grows with each correction, and an offset in the gateway's journal without gaps. Readers ignore
unknown fields, so a field can be added without a new version. Instants are integer nanoseconds.
"""

from enum import Enum
from typing import Annotated, TypeAlias, TypeVar

import msgspec

from firmware_protocol.errors import RecordError
from firmware_protocol.first_use import prepare
from firmware_protocol.units import BootId, Nanoseconds, NodeId, RssiDbm

_Offset = Annotated[int, msgspec.Meta(ge=1)]
_Count = Annotated[int, msgspec.Meta(ge=0)]
AnyNode = Annotated[NodeId, msgspec.Meta(ge=0)]
"""Decoding refuses what has more than 64 bits."""

RecordIdentity: TypeAlias = tuple[str, str, BootId, int]
"""Gateway, journal, boot and sequence: two journals of one gateway may number their starts alike."""


class Mode(Enum):
    """Whether a biobot walks (correlated random walk) or stands still ([Dir16] III)."""

    CRW = "CRW"
    S = "S"


class Cause(Enum):
    """Why a biobot is in its mode."""

    COMMAND = "command"
    NATURAL = "natural"


class MissionPhase(Enum):
    """The exploration protocol's phases ([Dir16] IV)."""

    IDLE = "idle"
    DISPERSION = "dispersion"
    LANDMARK_SELECTION = "landmark_selection"
    EXPLORATION = "exploration"
    PAUSED = "paused"
    """By an operator, or by a stop of all; what was interrupted goes on when it is resumed."""
    DONE = "done"


class Struct(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """Common options of what crosses the bus. Not watched by the garbage collector: what never changes is in no cycle."""


class OwnSpan(msgspec.Struct, frozen=True, gc=False, array_like=True):
    """What a backpack reports on its own clock, the same whenever and to whom it is told; no tuple: collectors of garbage watch those."""

    boot: BootId
    """Count of the backpack's starts; its clock begins at 0 with each."""
    start_ms: int
    end_ms: int


class EncounterSide(Struct, frozen=True, kw_only=True):
    """What one of the two reported, on the gateway's clock."""

    node: AnyNode
    t_start_ns: Nanoseconds
    t_end_ns: Nanoseconds
    rssi_dbm: RssiDbm
    """127: not known."""
    path_mm: int | None = None
    """Path that its IMU measured since the start of its encounter before [mm], at most 65,534; None: not known."""
    error_ns: Nanoseconds | None = None
    """Neither instant is wrong by more than this, by the fit of its clock; None: not known, but not more than the record's."""
    own_clock: OwnSpan | msgspec.UnsetType = msgspec.UNSET
    """What it reported on its own clock, which no gateway's clock can falsify. Left out where the gateway does not tell."""


class RecordHead(Struct, frozen=True, kw_only=True):
    """Identity and place of a journaled record.

    ``offset`` numbers the entries of the gateway's ``journal`` from 1 without gaps; a correction is a new entry with the
    same identity and a higher revision. Times of a record are on the gateway's monotonic clock; adding
    ``wall_anchor_ns`` gives UTC.
    """

    gateway: str
    journal: str
    offset: _Offset
    boot: BootId
    sequence: _Count
    revision: _Count
    wall_anchor_ns: Nanoseconds

    @property
    def identity(self) -> RecordIdentity:
        """The name of the thing recorded, the same for all its revisions."""
        return (self.gateway, self.journal, self.boot, self.sequence)


class EncounterRecord(RecordHead, frozen=True, kw_only=True, tag="encounter"):
    """Two biobots were within detection range ([Dir16] eq. 2); ``node_a < node_b``."""

    node_a: AnyNode
    node_b: AnyNode
    t_start_ns: Nanoseconds
    t_end_ns: Nanoseconds
    error_ns: Nanoseconds
    """Neither end of the interval is wrong by more than this: by the fit of the backpacks' clocks, and by what no beacon tells."""
    is_reciprocal: bool
    """Both sides reported it."""
    is_ongoing: bool = False
    """The newest report said that it had not ended."""
    is_void: bool = False
    """This record turned out to be a part of another one, and no longer counts."""
    margin_ns: _Count = 0
    """Reports no further than this from the interval, and as much from their own, belong to the same encounter."""
    sides: tuple[EncounterSide, ...] = ()


class ModeRecord(RecordHead, frozen=True, kw_only=True, tag="mode", omit_defaults=True):
    """A biobot was in one mode from ``t_start_ns``, to ``t_end_ns`` or (None) until further notice."""

    node: AnyNode
    mode: Mode
    cause: Cause
    t_start_ns: Nanoseconds
    t_end_ns: Nanoseconds | None
    error_ns: Nanoseconds
    is_halted: bool = False
    """It stands because all were stopped, and was not told to by itself: no landmark. Left out where it is not so."""


class LandmarkCluster(Struct, frozen=True, kw_only=True):
    """A connected part of the communication graph, and the landmarks that it gave."""

    size: _Count
    picks: tuple[NodeId, ...]
    """In the order of choice."""
    radius: _Count
    """No biobot of it is more hops away from a pick; 0 where it gave none."""


class LandmarkChoice(Struct, frozen=True, kw_only=True):
    """Who was chosen to stand still, and out of whom."""

    n_wanted: _Count
    candidates: tuple[NodeId, ...]
    left_out: dict[str, tuple[NodeId, ...]] = {}
    """Why, and who."""
    clusters: tuple[LandmarkCluster, ...] = ()
    awaited: tuple[NodeId, ...] = ()
    """Asked to stand still, and not known to yet."""
    failed: tuple[NodeId, ...] = ()
    """Did not do so."""


class LandmarkChange(Struct, frozen=True, kw_only=True):
    """A landmark is one no more."""

    node: AnyNode
    replacement: AnyNode | None
    """None: nobody could take its place."""
    reason: str
    wall_ns: Nanoseconds


class WallPhase(Struct, frozen=True, kw_only=True):
    """Of an exploration: the newest of its wall phases, and who was told to follow walls and not yet to walk as before."""

    number: _Count
    following: dict[int, int] = {}
    """And when that was decided, as ``ran_ns``."""


class MissionRecord(RecordHead, frozen=True, kw_only=True, tag="mission"):
    """A phase of the mission began at ``t_start_ns``; a revision tells how its landmarks changed meanwhile."""

    phase: MissionPhase
    t_start_ns: Nanoseconds
    landmarks: tuple[NodeId, ...] = ()
    reason: str = ""
    operator: str = ""
    """Who ordered it; empty: the mission went on by itself, or the gateway is older than this field, as all below."""
    order_id: str = ""
    round: _Count = 0
    """Dispersions of this mission so far."""
    is_continued: bool = False
    """It goes on after a pause: time 0 is that of the record before the pause."""
    interrupted: MissionPhase | None = None
    """Of a pause: what it interrupts."""
    choice: LandmarkChoice | None = None
    changes: tuple[LandmarkChange, ...] = ()
    """The newest ones, oldest first."""
    releasing: dict[int, int] = {}
    """Who is to be let walk again, and when that was decided, as ``ran_ns``."""
    ran_ns: int | None = None
    """How long gateways had run on the journal when it began [ns]; the lengths of phases are told by that clock."""
    spent_ns: int = 0
    """How long the phase had run before, up to a pause [ns]."""
    explored_ns: int = 0
    """How long the explorations of earlier rounds were, together [ns]."""
    walls: WallPhase | msgspec.UnsetType = msgspec.UNSET
    """Left out where there was no wall phase."""


JournalRecord: TypeAlias = EncounterRecord | ModeRecord | MissionRecord


class RecordBatch(Struct, frozen=True, kw_only=True):
    """Journaled records on their way: a publication, or a part of the answer to a history query.

    ``head_offset`` is the newest offset in the journal when the batch was made; a reader that knows less has a gap. Those
    below ``oldest_offset`` are no longer there: asking for them brings nothing.
    """

    gateway: str
    journal: str
    head_offset: _Count
    records: tuple[JournalRecord, ...]
    oldest_offset: _Offset = 1


class EncodedBatch(Struct, frozen=True, kw_only=True):
    """A RecordBatch made of records that are MessagePack already; encoded, it is one."""

    gateway: str
    journal: str
    head_offset: _Count
    records: tuple[msgspec.Raw, ...]
    oldest_offset: _Offset = 1


class HistoryRequest(Struct, frozen=True, kw_only=True):
    """Ask a gateway for the records of its journal from an offset on."""

    from_offset: _Offset = 1
    limit: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 10_000


class RadioReport(Struct, frozen=True, kw_only=True):
    """What a gateway tells of one of its radios, for people."""

    state: str
    """connecting, up or down."""
    since_wall_ns: Nanoseconds
    reason: str = ""
    """Why it is down."""
    attempts: _Count = 0
    """How often it was tried since."""
    firmware: str = ""
    """What its dongle last said that it is."""
    n_messages: _Count = 0
    """Payloads that came from it since the gateway started."""
    n_bytes: _Count = 0
    """Bytes that came from it since then."""
    n_faults: _Count = 0
    """How often it was lost, or could not be opened, since then."""


class GatewayStatus(Struct, frozen=True, kw_only=True):
    """State of a gateway; published every second and not journaled."""

    gateway: str
    journal: str
    boot: BootId
    head_offset: _Count
    wall_ns: Nanoseconds
    radios: dict[str, str]
    """Radio's name to its state: connecting, up or down."""
    counters: dict[str, int]
    oldest_offset: _Offset = 1
    """See RecordBatch."""
    watermarks: dict[str, int] = {}
    """Mapper's name to the offset up to which it has said to have everything on disk."""
    radio_reports: dict[str, RadioReport] = {}
    """More of each radio; empty: the gateway is older than this field."""
    started_wall_ns: Nanoseconds = Nanoseconds(0)
    n_biobots: _Count = 0
    """Biobots that it knows since it started."""
    journal_bytes: int | None = None
    """Bytes that the journal's files take."""
    disk_free_bytes: int | None = None
    """Bytes that the gateway may still write where the journal lies."""
    faults: tuple[str, ...] = ()
    """What is wrong, in words; a person may have to act."""
    missing: tuple[str, ...] = ()
    """What it waits for until it is of use: a radio, a router."""
    audit_rows: _Count = 0
    audit_head: str = ""
    """Rows that its audit log ever had, and the newest one's hash, hexadecimal: whoever notes both sees later whether it was cut."""


class Watermark(Struct, frozen=True, kw_only=True):
    """A mapper says how far it has all records of a gateway's journal on its own disk; published again every few seconds."""

    mapper: Annotated[str, msgspec.Meta(min_length=1, max_length=63)]
    journal: str
    offset: _Count


class BackpackLimits(Struct, frozen=True, kw_only=True):
    """What a backpack says that its stimulator can do and refuses to exceed (WIRE_FORMAT.md §5.8)."""

    channels: _Count
    """Bit i: electrode channel i is there."""
    waveforms: _Count
    """Bit i: waveform i can be made."""
    max_frequency_hz: _Count
    max_pulse_width_us: _Count
    max_amplitude_mv: _Count
    max_duration_ms: _Count
    min_gap_ms: _Count
    max_on_ms_per_minute: _Count


class BackpackConfiguration(Struct, frozen=True, kw_only=True):
    """How a backpack senses and reports encounters now; None: it has no such value, or has not told (WIRE_FORMAT.md §5.11)."""

    beacon_period_ms: int | None = None
    rssi_enter_dbm: int | None = None
    rssi_exit_dbm: int | None = None
    gap_tolerance_ms: int | None = None
    report_period_ms: int | None = None


class NodeStatus(Struct, frozen=True, kw_only=True):
    """Last known state of a biobot; published when it changes and not journaled."""

    gateway: str
    radio: str
    node: AnyNode
    eui64: int
    boot: BootId
    mode: Mode
    cause: Cause
    battery_mv: _Count
    rssi_dbm: RssiDbm
    lqi: _Count
    last_heard_wall_ns: Nanoseconds
    buffered: _Count
    dropped: _Count
    firmware: _Count = 0
    capabilities: _Count = 0
    """Bits of WIRE_FORMAT.md §5.2."""
    limits: BackpackLimits | None = None
    configuration: BackpackConfiguration | None = None
    encounter_capacity: _Count = 0
    """Encounters that its buffer holds; 0: not known."""


_encoder = msgspec.msgpack.Encoder()
prepare(RecordBatch, EncodedBatch, HistoryRequest, GatewayStatus, Watermark, NodeStatus)
_StructT = TypeVar("_StructT", bound=Struct)


def encode_record(record: Struct) -> bytes:
    """Return any record of this module as MessagePack."""
    return _encoder.encode(record)


def decode_record(data: bytes, record_type: type[_StructT]) -> _StructT:
    """Return the record of a known type in ``data``.

    Raises
    ------
    RecordError
        ``data`` is not MessagePack, or lacks a field, or has a value of a wrong type or range.
    """
    try:
        return msgspec.msgpack.decode(data, type=record_type)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordError(record=record_type.__name__, reason=str(error)) from error


def encode_journal_record(record: JournalRecord) -> bytes:
    """Return a journaled record with its type tag, as it lies in journal and store."""
    return _encoder.encode(record)


def decode_journal_record(data: bytes) -> JournalRecord:
    """Return the journaled record in ``data``, whichever it is.

    Raises
    ------
    RecordError
        ``data`` is none of them.
    """
    try:
        record: JournalRecord = msgspec.msgpack.decode(data, type=JournalRecord)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordError(record="journal record", reason=str(error)) from error
    return record
