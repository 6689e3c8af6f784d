"""What is given to the journal, and what it gives back."""

from dataclasses import dataclass

from msgspec import Struct

from firmware_protocol.contract.records import JournalRecord
from firmware_protocol.first_use import prepare
from firmware_protocol.units import BootId, Nanoseconds, NodeId

STAGE = "stage"
"""Kind of an entry that is a stage of a command; ``SENT_AGAIN`` is a stop that was sent once more."""

SENT_AGAIN = "sent_again"


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
    """One entry of the audit log: a stage of a command, or something else that must be on record (docs/audit.md).

    The journal itself sets the last four when it writes it.
    """

    wall_ns: int
    """UTC of what it tells of."""
    command_id: str = ""
    wire_command: int | None = None
    stage: str = ""
    node: NodeId | None = None
    """None: it is of no biobot, or of all."""
    train_ms: int = 0
    """The stimulation that it admits, 0 for all but the admitting stage [ms]."""
    request: bytes = b""
    """The command as it came, as MessagePack."""
    body: bytes = b""
    """The stage, or the facts of another kind: a map, as MessagePack."""
    kind: str = STAGE
    operator: str = ""
    """Who wanted it, in the words of whoever asked: not to be trusted, nor printed as it is."""
    mono_ns: int | None = None
    """Monotonic clock when it happened; None: that is not known."""
    id: int = 0
    """Its place in the chain, from 1."""
    ran_ns: int = 0
    """How long gateways had run on the journal when it came to lie on disk."""
    boot: int = 0
    """Start of the gateway that wrote it; 0: of a journal that did not say so."""
    chain: bytes = b""
    """Its hash."""


prepare(AuditEntry)


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
    the machine booted, whose monotonic clock was this one. ``first_session`` begins this start's link session numbers. ``opened_ns`` and
    ``ran_ns``: monotonic clock at this start, and how long gateways had run by then, or a little less.
    """

    journal: str
    boot: BootId
    head_offset: int
    wall_anchor_ns: Nanoseconds
    earlier_anchors: tuple[Nanoseconds, ...]
    first_session: int
    opened_ns: int
    ran_ns: int
    clock_boot: BootId
    """First start whose monotonic clock was this one."""

    def instant_of(self, entry: AuditEntry) -> int:
        """Return the monotonic instant [ns] at which an entry of an earlier start happened, by this start's clock; no wall clock is asked.

        Where the machine was booted since, it is the latest that it can have been: time in which no gateway ran does not count.
        """
        if entry.mono_ns is not None and entry.boot >= self.clock_boot:
            return min(entry.mono_ns, self.opened_ns)
        return self.instant_of_run(entry.ran_ns)

    def instant_of_run(self, ran_ns: int) -> int:
        """Return the latest monotonic instant at which gateways can have run for so long [ns]: only time in which one ran is known."""
        return self.opened_ns - max(0, self.ran_ns - ran_ns)
