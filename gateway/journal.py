"""What was heard and decided, on disk before anyone is told (SQLite, WAL, synchronous=FULL, group commit).

Writes are taken in order and committed in groups: while one group is being synced, the next one gathers, so a lone write waits
for nothing and a flood shares its syncs. A commit that fails (full disk) is tried again until it succeeds: nothing behind it
is published or acknowledged in between, and nothing is lost. A write that can never be stored costs itself alone.
"""

import asyncio
import itertools
import sqlite3
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import msgspec

from firmware_protocol.contract.records import JournalRecord
from firmware_protocol.units import BootId
from gateway.errors import JournalFullError
from gateway.health import Health
from gateway.journal_file import JournalFile, JournalIdentity, JournalReader, JournalWrite, open_journal_file
from gateway.log import EventLog

_log = EventLog(__name__)

MAX_GROUP = 256
"""Writes committed together."""

MAX_WAITING = 65_536
"""Writes that may wait for the disk. A native dongle stalls at 16 unconfirmed payloads; XBee and Z-Stack take no confirmation and never
stall, but a backpack has at most 33 messages outstanding, and a repetition is no write. So it takes a flood of commands, or two thousand
biobots, to come near."""

_UNSTORABLE = (OverflowError, TypeError, ValueError, sqlite3.IntegrityError, sqlite3.DataError)
"""What a write raises that can never be stored. Every other error of SQLite is the disk's, and is waited out."""

_MACHINE_BOOT = Path("/proc/sys/kernel/random/boot_id")
_FIRST_RETRY_S = 0.1
_MAX_RETRY_S = 2.0


@dataclass(slots=True, kw_only=True)
class _Group:
    """Writes that are committed together."""

    done: asyncio.Future[None]
    writes: list[tuple[JournalWrite, asyncio.Future[None]]] = field(default_factory=list)


class Journal:
    """The journal of a running gateway; see the module's description. Belongs to one event loop."""

    def __init__(self, *, path: Path, file: JournalFile, health: Health) -> None:
        self._path = path
        self._file = file
        self._health = health
        self._groups: deque[_Group] = deque()
        self._n_waiting = 0
        self._wake = asyncio.Event()
        self._head_offset = file.identity.head_offset
        self._last_group: asyncio.Future[None] | None = None
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="journal")
        self._listeners: list[Callable[[tuple[JournalRecord, ...], int], None]] = []
        self._fault: str | None = None
        self._on_fault: Callable[[str | None], None] | None = None

    @classmethod
    def open(cls, path: Path, *, health: Health) -> Self:
        """Open or make the journal at ``path``; raises ``JournalUnfitError``."""
        file = open_journal_file(path, now_wall_ns=time.time_ns(), now_ns=time.monotonic_ns(), machine_boot=_read_machine_boot())
        return cls(path=path, file=file, health=health)

    @property
    def identity(self) -> JournalIdentity:
        """What was settled when it was opened."""
        return self._file.identity

    @property
    def journal_id(self) -> str:
        """Random name of this journal's history."""
        return self._file.identity.journal

    @property
    def boot(self) -> BootId:
        """Number of this start of the gateway, larger than every earlier one."""
        return self._file.identity.boot

    @property
    def head_offset(self) -> int:
        """Newest offset on disk."""
        return self._head_offset

    @property
    def is_full(self) -> bool:
        """Whether ``append`` would raise now."""
        return self._n_waiting >= MAX_WAITING

    @property
    def fault(self) -> str | None:
        """Why the disk takes nothing now, or None."""
        return self._fault

    def reader(self) -> JournalReader:
        """Return a connection that reads what is committed; its owner closes it."""
        return JournalReader(self._path)

    def listen(self, listener: Callable[[tuple[JournalRecord, ...], int], None]) -> None:
        """Have ``listener(records, head_offset)`` called in the loop for each committed group, before its future resolves."""
        self._listeners.append(listener)

    def listen_for_fault(self, listener: Callable[[str | None], None]) -> None:
        """Have ``listener`` called with the reason when the disk refuses, and with None when it takes records again."""
        self._on_fault = listener

    def append(self, write: JournalWrite) -> asyncio.Future[None]:
        """Queue a write; the future resolves when it is on disk, and fails where it can never be stored.

        Its records get the next offsets, in order.

        Raises
        ------
        JournalFullError
            ``MAX_WAITING`` writes wait already.
        """
        if self.is_full:
            raise JournalFullError(limit=MAX_WAITING)
        loop = asyncio.get_running_loop()
        if not self._groups or len(self._groups[-1].writes) >= MAX_GROUP:
            self._groups.append(_Group(done=loop.create_future()))
            self._wake.set()
        group = self._groups[-1]
        done: asyncio.Future[None] = loop.create_future()
        group.writes.append((write, done))
        self._n_waiting += 1
        self._last_group = group.done
        return done

    def barrier(self) -> asyncio.Future[None]:
        """Return a future that resolves when all that was appended so far is on disk, but for what can never be stored."""
        if self._last_group is None:
            done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            done.set_result(None)
            return done
        return self._last_group

    async def run(self) -> None:
        """Commit what is appended, for ever; cancelling lets the commit under way finish."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._groups:
                await self._commit(self._groups.popleft())

    async def drain(self) -> None:
        """Wait until all that was appended is on disk."""
        while self._n_waiting:
            await self.barrier()

    def close(self) -> None:
        """Close the file; what was not committed is dropped, and was acknowledged to nobody."""
        self._executor.shutdown(wait=True)
        self._file.close()

    async def _commit(self, group: _Group) -> None:
        try:
            await self._commit_together(group.writes)
        except _UNSTORABLE:
            for one in group.writes:
                await self._commit_alone(*one)
        group.done.set_result(None)

    async def _commit_alone(self, write: JournalWrite, done: asyncio.Future[None]) -> None:
        try:
            await self._commit_together([(write, done)])
        except _UNSTORABLE as error:
            self._health.count("journal.unstorable_writes")
            _log.error("journal.unstorable", path=self._path, reason=f"{type(error).__name__}: {error}")
            self._n_waiting -= 1
            done.set_exception(error)
            done.exception()  # marked as seen: not everyone who appends waits

    async def _commit_together(self, members: list[tuple[JournalWrite, asyncio.Future[None]]]) -> None:
        """Commit in one transaction, as often as it takes; raises one of ``_UNSTORABLE``, and then nothing is on disk."""
        loop = asyncio.get_running_loop()
        writes = _number([write for write, _ in members], first_offset=self._head_offset + 1)
        retry_s = _FIRST_RETRY_S
        while True:
            try:
                await asyncio.shield(loop.run_in_executor(self._executor, self._file.commit, writes))
                break
            except _UNSTORABLE:
                raise
            except sqlite3.Error as error:  # full disk, I/O error, locked, damaged: nobody is told of what it did not take
                self._enter_fault(str(error))
            await asyncio.sleep(retry_s)
            retry_s = min(2 * retry_s, _MAX_RETRY_S)
        self._leave_fault()
        self._n_waiting -= len(writes)
        records = tuple(record for write in writes for record in write.records)
        self._health.count("journal.commits")
        self._health.count("journal.writes", len(writes))
        if records:
            self._head_offset = records[-1].offset
            for listener in self._listeners:
                listener(records, self._head_offset)
        for _, done in members:
            if not done.done():
                done.set_result(None)

    def _enter_fault(self, reason: str) -> None:
        self._health.count("journal.refused_commits")
        if self._fault is None:
            _log.error("journal.fault", path=self._path, reason=reason, waiting=self._n_waiting)
            self._fault = reason
            if self._on_fault is not None:
                self._on_fault(reason)

    def _leave_fault(self) -> None:
        if self._fault is not None:
            _log.info("journal.recovered", path=self._path, was=self._fault)
            self._fault = None
            if self._on_fault is not None:
                self._on_fault(None)


def _read_machine_boot() -> str:
    """Return the kernel's name for the time since the machine booted; empty where it gives none."""
    try:
        return _MACHINE_BOOT.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _number(writes: list[JournalWrite], *, first_offset: int) -> list[JournalWrite]:
    """Give the records their offsets; only now, so that a write that was dropped leaves no gap."""
    offsets = itertools.count(first_offset)
    return [
        JournalWrite(
            records=tuple(msgspec.structs.replace(record, offset=next(offsets)) for record in write.records),
            report=write.report,
            node=write.node,
            audit=write.audit,
        )
        if write.records
        else write
        for write in writes
    ]
