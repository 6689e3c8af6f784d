"""What is given to the journal, and what it gives back."""

from dataclasses import dataclass

from msgspec import Struct

from firmware_protocol.contract.records import JournalRecord
from firmware_protocol.units import BootId, Nanoseconds, NodeId


class UplinkReport(Struct, frozen=True, kw_only=True, gc=False):
    """An uplink message as it came, and its backpack's window after it."""

    node: NodeId
    boot: BootId
    number: int
    """Unwrapped sequence number."""
    next_number: int
    """All numbers below it are done."""
    received_wall_ns: int
    radio: str
    address: int
    rssi_dbm: int
    lqi: int
    payload: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditEntry:
    """A stage of a command. ``train_ms`` is the stimulation it admits, 0 for all but the admitting stage."""

    wall_ns: int
    command_id: str
    wire_command: int | None
    stage: str
    node: NodeId
    train_ms: int
    request: bytes
    body: bytes


class JournalWrite(Struct, frozen=True, kw_only=True, gc=False):
    """What belongs together: all of it is on disk, or nothing. Its records are handed over: the journal writes their offsets into them."""

    records: tuple[JournalRecord, ...] = ()
    report: UplinkReport | None = None
    node: tuple[NodeId, bytes] | None = None
    audit: AuditEntry | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Committed:
    """Records that have just come to lie on disk, in the order of their offsets; ``bodies`` are the same, as MessagePack."""

    records: tuple[JournalRecord, ...]
    bodies: tuple[bytes, ...]
    head_offset: int
    oldest_offset: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """Offsets whose records are lost: their bytes are no longer those that were written. ``last`` < ``first``: messages alone."""

    first: int
    last: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalIdentity:
    """Name of the file's history, number of this start, and how far the history goes.

    ``wall_anchor_ns`` is UTC minus monotonic clock, read at this start; ``earlier_anchors`` are those of earlier starts since
    the machine booted, whose monotonic clock was this one. ``first_session`` begins this start's link session numbers.
    """

    journal: str
    boot: BootId
    head_offset: int
    wall_anchor_ns: Nanoseconds
    earlier_anchors: tuple[Nanoseconds, ...]
    first_session: int
