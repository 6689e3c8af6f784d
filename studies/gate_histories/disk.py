"""The journal of the histories: group commits that take time, a disk that is full for a while, rows that a SIGKILL loses.

The rows lie in memory (``MemoryRows``) or in the journal's own file (``StoredRows``).
"""

import asyncio
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from firmware_protocol.units import NS_PER_MS, BootId, Nanoseconds, NodeId
from gateway.journal_file import AuditEntry, JournalFile, JournalIdentity, JournalReader, JournalWrite, SegmentBuilder, open_journal_file
from gateway.stimulation import AuditReader
from studies.gate_histories.virtual_time import TrueTime

_FIRST_RETRY_NS, _MAX_RETRY_NS = 100 * NS_PER_MS, 2_000 * NS_PER_MS


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """What a life of the gateway has of the rows before it: what it reads, and what places a row on its monotonic clock."""

    reader: AuditReader
    identity: JournalIdentity


class Rows(Protocol):
    """What is on disk. ``open`` begins a life of the gateway, ``close`` ends it."""

    def open(self, *, wall_clock: Callable[[], int], clock: Callable[[], int], machine_boot: str) -> Opened:
        """Begin a life; its monotonic clock counts from what ``machine_boot`` names."""
        ...

    def commit(self, writes: list[JournalWrite]) -> None:
        """Put writes on disk."""
        ...

    def close(self) -> None:
        """End a life."""
        ...


@dataclass(slots=True, kw_only=True)
class _MemoryReader:
    _audits: list[AuditEntry]

    def read_audit(self, *, command_id: str) -> list[AuditEntry]:
        return [one for one in self._audits if one.command_id == command_id]

    def read_newest_audit(self, *, limit: int) -> list[AuditEntry]:
        return [one for one in self._audits[-limit:] if one.command_id]

    def read_last_audit(self, *, kind: str) -> AuditEntry | None:
        return next((one for one in reversed(self._audits) if one.kind == kind), None)

    def read_last_wire_command(self) -> int | None:
        return next((one.wire_command for one in reversed(self._audits) if one.wire_command is not None), None)


class MemoryRows:
    """Rows in memory, stamped as the file stamps them."""

    def __init__(self) -> None:
        self._audits: list[AuditEntry] = []
        self._clock: Callable[[], int] = int
        self._machine_boot = ""
        self._identity: JournalIdentity | None = None

    def open(self, *, wall_clock: Callable[[], int], clock: Callable[[], int], machine_boot: str) -> Opened:
        """Begin a life."""
        before, self._clock = self._identity, clock
        boot = BootId(1 if before is None else before.boot + 1)
        self._identity = JournalIdentity(
            journal="memory",
            boot=boot,
            head_offset=0,
            wall_anchor_ns=Nanoseconds(wall_clock() - clock()),
            earlier_anchors=(),
            first_session=0,
            opened_ns=clock(),
            ran_ns=self._audits[-1].ran_ns if self._audits else 0,
            clock_boot=boot if before is None or machine_boot != self._machine_boot else before.clock_boot,
        )
        self._machine_boot = machine_boot
        return Opened(reader=_MemoryReader(_audits=self._audits), identity=self._identity)

    def commit(self, writes: list[JournalWrite]) -> None:
        """Keep writes."""
        identity = self._identity
        assert identity is not None
        ran_ns = identity.ran_ns + self._clock() - identity.opened_ns
        for write in writes:
            if write.audit is not None:
                self._audits.append(dataclasses.replace(write.audit, id=len(self._audits) + 1, ran_ns=ran_ns, boot=identity.boot))

    def close(self) -> None:
        """End a life."""


class StoredRows:
    """Rows in a file of the journal's own."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: JournalFile | None = None
        self._reader: JournalReader | None = None

    def open(self, *, wall_clock: Callable[[], int], clock: Callable[[], int], machine_boot: str) -> Opened:
        """Open the file, and begin a boot in it."""
        self._file = open_journal_file(
            self._path, now_wall_ns=wall_clock(), now_ns=clock(), machine_boot=machine_boot, wall_clock=wall_clock, clock=clock
        )
        self._reader = JournalReader(self._path)
        return Opened(reader=self._reader, identity=self._file.identity)

    def commit(self, writes: list[JournalWrite]) -> None:
        """Commit a segment."""
        assert self._file is not None
        segment = SegmentBuilder(first_offset=self._file.identity.head_offset + 1, windows=self._file.windows)
        for write in writes:
            segment.add(write)
        self._file.commit(segment)

    def close(self) -> None:
        """Close the file."""
        for one in (self._reader, self._file):
            if one is not None:
                one.close()


@dataclass(slots=True, kw_only=True)
class Disk:
    """How the disk is now, and what it has taken: it outlives the gateway's processes."""

    rows: Rows
    commit_ms: int = 2
    is_full: bool = False
    committed: list[tuple[int, AuditEntry]] = field(default_factory=list)
    """With the instants of true time at which they were on disk."""
    nodes: dict[NodeId, bytes] = field(default_factory=dict)


class LiveJournal:
    """The journal of one life of the gateway."""

    def __init__(self, *, loop: asyncio.AbstractEventLoop, disk: Disk, true_time: TrueTime, appended: list[tuple[int, AuditEntry]]) -> None:
        self._loop = loop
        self._disk = disk
        self._true_time = true_time
        self._gathering: list[tuple[JournalWrite, asyncio.Future[None]]] = []
        self._is_committing = False
        self._is_over = False
        self._retry_ns = _FIRST_RETRY_NS
        self._fault: str | None = None
        self._appended = appended

    @property
    def fault(self) -> str | None:
        """Why the disk takes nothing now, or None."""
        return self._fault

    @property
    def is_full(self) -> bool:
        """Whether ``append`` would raise now: never in a history."""
        return False

    def append(self, write: JournalWrite) -> "asyncio.Future[None]":
        """Queue a write; the future resolves when it is on disk."""
        done: asyncio.Future[None] = self._loop.create_future()
        if self._is_over:
            return done
        if write.audit is not None:
            self._appended.append((self._true_time.now_ns, write.audit))
        self._gathering.append((write, done))
        if not self._is_committing:
            self._is_committing = True
            self._true_time.after(0, self._begin)
        return done

    def kill(self) -> None:
        """Lose what is not on disk."""
        self._is_over = True

    def _begin(self) -> None:
        group, self._gathering = self._gathering, []
        self._true_time.after(self._disk.commit_ms * NS_PER_MS, lambda: self._end(group))

    def _end(self, group: "list[tuple[JournalWrite, asyncio.Future[None]]]") -> None:
        if self._is_over:
            return
        if self._disk.is_full:
            self._fault = "database or disk is full"
            self._true_time.after(self._retry_ns, lambda: self._end(group))
            self._retry_ns = min(2 * self._retry_ns, _MAX_RETRY_NS)
            return
        self._fault, self._retry_ns = None, _FIRST_RETRY_NS
        self._disk.rows.commit([write for write, _ in group])
        for write, done in group:
            if write.audit is not None:
                self._disk.committed.append((self._true_time.now_ns, write.audit))
            if write.node is not None:
                self._disk.nodes[write.node[0]] = write.node[1]
            if not done.done():
                done.set_result(None)
        self._is_committing = bool(self._gathering)
        if self._gathering:
            self._begin()
