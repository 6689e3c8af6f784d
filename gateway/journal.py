"""What was heard and decided, on disk before anyone is told (SQLite, WAL, synchronous=FULL, group commit).

Writes are taken in order and committed in groups: while one group is being synced, the next one gathers, so a lone write waits
for nothing and a flood shares its syncs (``commit_pace``). A commit that fails (full disk) is tried again until it succeeds: nothing
behind it is published or acknowledged in between, and nothing is lost. A write that can never be stored costs itself alone.
"""

import asyncio
import sqlite3
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Self

from firmware_protocol.units import BootId
from gateway.commit_pace import CommitPace
from gateway.errors import JournalFullError
from gateway.health import Health
from gateway.journal_file import (
    PROGRESS,
    ChainHead,
    Committed,
    Damage,
    JournalFile,
    JournalIdentity,
    JournalReader,
    JournalWrite,
    Retention,
    SegmentBuilder,
    Upkeep,
    open_journal_file,
)
from gateway.log import EventLog
from gateway.machine_boot import read_machine_boot

_log = EventLog(__name__)

MAX_GROUP = 1024
"""Writes committed together; the loop tells as many at once when they are on disk."""

MAX_GROUP_SIZE = 4 << 20
"""Octets of records and reports, after which a group takes no further write."""

MAX_WAITING = 65_536
"""Writes that may wait for the disk. Dongles stall for a moment only (``receipts``), but a backpack has at most 33 messages outstanding,
and a repetition is no write: it takes a flood of commands, or two thousand biobots, to come near."""

_UNSTORABLE = (OverflowError, TypeError, ValueError, struct.error)
"""What adding a write to a group raises where it can never be stored. What SQLite raises is the disk's, and is waited out."""

_FIRST_RETRY_S, _MAX_RETRY_S = 0.1, 2.0
_KEEP_ALL = Retention()
_TIDY_PERIOD_S, _TIDY_AGAIN_S = 1.0, 0.02
_TIDY_AFTER = 64
"""Commits after which small segments are looked through."""

_ALARM_PERIOD_S = 60.0
"""Records that a mapper lacks and that go are told of once in so long; they are counted all the while."""

_MAX_TOLD_DAMAGE, _MAX_MAPPERS = 1024, 64
"""Damaged segments that are told of, once each; and mappers whose progress is remembered."""


@dataclass(slots=True, kw_only=True)
class _Group:
    """Writes that are committed together, and the futures of those who wait for them."""

    done: asyncio.Future[None]
    segment: SegmentBuilder
    waiting: list[asyncio.Future[None]] = field(default_factory=list)

    @property
    def is_closed(self) -> bool:
        return self.segment.n_writes >= MAX_GROUP or self.segment.size >= MAX_GROUP_SIZE


class Journal:
    """The journal of a running gateway; see the module's description. Belongs to one event loop."""

    def __init__(self, *, path: Path, file: JournalFile, health: Health, retention: Retention = _KEEP_ALL) -> None:
        self._path, self._file, self._health = path, file, health
        self._groups: deque[_Group] = deque()
        self._n_waiting = 0
        self._under_way: _Group | None = None
        self._wake = asyncio.Event()
        self._pace = CommitPace()
        self._head_offset = file.identity.head_offset
        self._next_offset = self._head_offset + 1
        self._oldest_offset = file.oldest_offset()
        self._last_group: asyncio.Future[None] | None = None
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="journal")
        self._listeners: list[Callable[[Committed], None]] = []
        self._fault: str | None = None
        self._commit_begun_s: float | None = None
        self._on_fault: Callable[[str | None], None] | None = None
        self._retention = retention
        self._watermarks = file.watermarks()
        self._new_watermarks: dict[str, int] = {}
        self._tidied_at, self._n_untidied = 0.0, 0
        self._is_oversized = False
        self._n_undelivered, self._undelivered_told_at = 0, -_ALARM_PERIOD_S
        self._is_behind = self._is_behind_untold = False
        self._damage_told: set[int] = set()
        self._on_alarm: Callable[[str, Mapping[str, str]], None] | None = None

    @classmethod
    def open(cls, path: Path, *, health: Health, retention: Retention = _KEEP_ALL, gateway: str | None = None) -> Self:
        """Open or make the journal at ``path``, of a gateway of that name (None: whichever); raises ``JournalUnfitError``."""
        boot = read_machine_boot()
        file = open_journal_file(path, now_wall_ns=time.time_ns(), now_ns=time.monotonic_ns(), machine_boot=boot, gateway=gateway)
        return cls(path=path, file=file, health=health, retention=retention)

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
    def ran_ns(self) -> int:
        """How long gateways have run on this journal [ns]; after a process was killed, as far as was written down."""
        return self._file.ran_ns()

    @property
    def head_offset(self) -> int:
        """Newest offset on disk."""
        return self._head_offset

    @property
    def oldest_offset(self) -> int:
        """Oldest offset that is still on disk; where there is none, the next one."""
        return self._oldest_offset

    @property
    def audit_head(self) -> ChainHead:
        """Where the audit log's chain ends, of what is on disk."""
        return self._file.audit_head

    @property
    def is_full(self) -> bool:
        """Whether ``append`` would raise now."""
        return self._n_waiting >= MAX_WAITING

    @property
    def fault(self) -> str | None:
        """Why the disk takes nothing now, or None."""
        return self._fault

    @property
    def commit_s(self) -> float:
        """How long the commit under way has taken [s], with all its attempts; 0: there is none."""
        return 0.0 if self._commit_begun_s is None else time.monotonic() - self._commit_begun_s

    def unwritten(self) -> Mapping[str, int]:
        """Return how many records, messages and rows of the audit log are not on disk, of what was appended."""
        groups = [*self._groups] if self._under_way is None else [self._under_way, *self._groups]
        counts = [group.segment.counts() for group in groups]
        return {name: sum(one[name] for one in counts) for name in ("records", "messages", "audit_rows")}

    def reader(self) -> JournalReader:
        """Return a connection that reads what is committed; its owner closes it."""
        return JournalReader(self._path)

    def listen(self, listener: Callable[[Committed], None]) -> None:
        """Have ``listener`` called in the loop with the records of each committed group, before its futures resolve."""
        self._listeners.append(listener)

    def listen_for_fault(self, listener: Callable[[str | None], None]) -> None:
        """Have ``listener`` called with the reason when the disk refuses, and with None when it takes records again."""
        self._on_fault = listener

    def listen_for_alarm(self, listener: Callable[[str, Mapping[str, str]], None]) -> None:
        """Have ``listener(kind, facts)`` called when records that a mapper lacks were dropped, or the size cannot be kept."""
        self._on_alarm = listener

    def note_damage(self, damage: Damage) -> None:
        """Tell, once, that records can no longer be read: whoever lacks them does without them."""
        if damage.first in self._damage_told or len(self._damage_told) >= _MAX_TOLD_DAMAGE:
            return
        self._damage_told.add(damage.first)
        self._health.count("journal.damaged_records", max(0, damage.last - damage.first + 1))
        self._alarm("journal.damaged", first_offset=damage.first, last_offset=damage.last, reason=damage.reason)

    @property
    def watermarks(self) -> Mapping[str, int]:
        """How far each known mapper has said to have everything on its disk."""
        return self._watermarks

    def note_watermark(self, mapper: str, offset: int) -> None:
        """Remember, on disk within a second or two, that a mapper has everything up to ``offset``.

        Where that is more than there is, the journal is an older copy of itself; it has another name from the next start on.
        """
        if offset > self._head_offset and not self._is_behind:
            self._is_behind = self._is_behind_untold = True
            advice = "this journal is an older copy of itself: restart the gateway, which gives it a new name"
            self._alarm("journal.behind", mapper=mapper, mapper_has=offset, head_offset=self._head_offset, advice=advice)
        if mapper not in self._watermarks and len(self._watermarks) >= _MAX_MAPPERS:
            self._health.count("journal.mappers_ignored")
            return
        offset = min(offset, self._head_offset)
        self._watermarks[mapper] = self._new_watermarks[mapper] = offset

    def append(self, write: JournalWrite) -> asyncio.Future[None]:
        """Queue a write; the future resolves when it is on disk, and fails where it can never be stored.

        Its records get the next offsets, in order.

        Raises
        ------
        JournalFullError
            ``MAX_WAITING`` writes wait already.
        """
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        group = self._add(write, failing=done)
        if group is not None:
            group.waiting.append(done)
            self._pace.hurry()
        return done

    def join(self, write: JournalWrite) -> asyncio.Future[None]:
        """Queue a write as ``append`` does, and return the future of all that is committed with it: for callbacks, never to be cancelled.

        Raises
        ------
        JournalFullError
            As of ``append``.
        """
        failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        group = self._add(write, failing=failed)
        return failed if group is None else group.done

    def barrier(self) -> asyncio.Future[None]:
        """Return a future that resolves when all that was appended so far is on disk, but for what can never be stored."""
        if self._last_group is None:
            self._last_group = asyncio.get_running_loop().create_future()
            self._last_group.set_result(None)
        return self._last_group

    async def run(self) -> None:
        """Commit what is appended, for ever; cancelling lets the commit under way finish."""
        while True:
            if not self._groups:
                try:
                    async with asyncio.timeout(_TIDY_AGAIN_S if self._n_untidied >= _TIDY_AFTER else _TIDY_PERIOD_S):
                        await self._wake.wait()
                except TimeoutError:
                    await self._tidy()
                    continue
            self._wake.clear()
            while self._groups:
                await self._pace.wait(is_urgent=bool(self._groups[0].waiting) or len(self._groups) > 1)
                group = self._groups.popleft()
                if group.segment.n_writes:
                    await self._commit(group)
                if self._n_untidied >= _TIDY_AFTER or time.monotonic() - self._tidied_at >= _TIDY_PERIOD_S:
                    await self._tidy()

    async def drain(self) -> None:
        """Wait until all that was appended is on disk."""
        while self._n_waiting:
            self._pace.hurry()
            await self.barrier()

    def close(self) -> None:
        """Close the file; what was not committed is dropped, and was acknowledged to nobody."""
        self._executor.shutdown(wait=True)
        self._file.close()

    def _add(self, write: JournalWrite, *, failing: asyncio.Future[None]) -> _Group | None:
        """Add a write to a group; where it can never be stored, let a future fail and return None."""
        if self.is_full:
            raise JournalFullError(limit=MAX_WAITING)
        group = self._gathering()
        try:
            group.segment.add(write)
        except _UNSTORABLE as error:
            self._health.count("journal.unstorable_writes")
            _log.error("journal.unstorable", path=self._path, reason=f"{type(error).__name__}: {error}")
            failing.set_exception(error)
            failing.exception()  # marked as seen: not everyone who appends waits
            return None
        self._next_offset = group.segment.next_offset
        self._n_waiting += 1
        self._last_group = group.done
        self._wake.set()
        return group

    def _gathering(self) -> _Group:
        """Return the group that takes the next write."""
        if not self._groups or self._groups[-1].is_closed:
            segment = SegmentBuilder(first_offset=self._next_offset, windows=self._file.windows)
            self._groups.append(_Group(done=asyncio.get_running_loop().create_future(), segment=segment))
        return self._groups[-1]

    async def _commit(self, group: _Group) -> None:
        """Commit a group in one transaction, as often as it takes, then tell of it."""
        loop, segment, retry_s = asyncio.get_running_loop(), group.segment, _FIRST_RETRY_S
        self._commit_begun_s, self._under_way = time.monotonic(), group
        self._pace.begin(segment.n_writes, now_s=loop.time())
        while True:
            try:
                await asyncio.shield(loop.run_in_executor(self._executor, self._file.commit, segment))
                break
            except sqlite3.Error as error:  # full disk, I/O error, locked, damaged: nobody is told of what it did not take
                self._enter_fault(str(error))
            await self._tidy()  # may make room
            await asyncio.sleep(retry_s)
            retry_s = min(2 * retry_s, _MAX_RETRY_S)
        self._leave_fault()
        self._n_untidied += 1
        self._health.observe("journal.commit", self.commit_s)
        self._commit_begun_s = self._under_way = None
        self._n_waiting -= segment.n_writes
        self._health.set_level("journal.waiting", self._n_waiting)
        self._health.count("journal.commits")
        self._health.count("journal.writes", segment.n_writes)
        if segment.bodies:
            self._head_offset = segment.next_offset - 1
            committed = Committed(
                records=tuple(segment.records),
                bodies=tuple(segment.bodies),
                head_offset=self._head_offset,
                oldest_offset=self._oldest_offset,
            )
            for listener in self._listeners:
                listener(committed)
        for done in group.waiting:
            if not done.done():
                done.set_result(None)
        group.done.set_result(None)

    async def _tidy(self) -> None:
        """Take a step of upkeep; what the disk refuses of it is tried again later."""
        self._tidied_at, self._n_untidied = time.monotonic(), 0
        watermarks, is_behind = self._new_watermarks, self._is_behind_untold
        self._new_watermarks, self._is_behind_untold = {}, False
        step = partial(self._file.tidy, self._retention, watermarks, is_behind=is_behind)
        done = await asyncio.shield(asyncio.get_running_loop().run_in_executor(self._executor, step))
        for name, reason in done.refused.items():
            self._health.count("journal.refused_upkeep")
            _log.debug("journal.refused_upkeep", step=name, reason=reason)
        if PROGRESS in done.refused:
            self._new_watermarks = {**watermarks, **self._new_watermarks}
            self._is_behind_untold = self._is_behind_untold or is_behind
        if done.has_more:
            self._n_untidied = _TIDY_AFTER  # goes on after the next commit, or in a while
        self._tell_upkeep(done)

    def _tell_upkeep(self, done: Upkeep) -> None:
        if done.n_dropped:
            self._health.count("journal.expired_records", done.n_dropped)
        if done.oldest_offset is not None:
            self._oldest_offset = done.oldest_offset
        for damage in done.damage:
            self.note_damage(damage)
        if done.n_undelivered:
            self._health.count("journal.undelivered_dropped", done.n_undelivered)
            self._n_undelivered += done.n_undelivered
            if time.monotonic() - self._undelivered_told_at >= _ALARM_PERIOD_S:
                self._undelivered_told_at = time.monotonic()
                self._alarm("journal.undelivered_dropped", records=self._n_undelivered, oldest_offset=self._oldest_offset)
        if done.is_oversized and not self._is_oversized:
            self._alarm("journal.oversized", limit=self._retention.max_size, keep_s=self._retention.keep_ns // 1_000_000_000)
        self._is_oversized = done.is_oversized

    def _alarm(self, kind: str, **facts: object) -> None:
        _log.error(kind, path=self._path, **facts)
        if self._on_alarm is not None:
            self._on_alarm(kind, {name: str(value) for name, value in facts.items()})

    def _enter_fault(self, reason: str) -> None:
        self._health.count("journal.refused_commits")
        self._health.set_level("journal.waiting", self._n_waiting)
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
