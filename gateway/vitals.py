"""How the gateway itself does: whether its event loop moves, its disk answers, and it has what it needs.

The gateway writes on its event loop; the monitor reads on a thread of its own, also while the loop hangs.
"""

import asyncio
import contextlib
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, ModeRecord, RadioReport
from firmware_protocol.units import NS_PER_S, Nanoseconds
from gateway.health import Health, RadioState

_BEAT_S = 0.25
_MAX_STILL_S = 5.0
"""An event loop that has not moved for so long hangs: the longest thing done in one go takes some milliseconds."""

_DISK_PERIOD_S = 2.0
_MAX_DISK_WAIT_S = 10.0
_SCARCE_BYTES = 128 * 2**20
"""Below this free space a person is told: an hour of 1,000 encounters a second, at some 30 bytes each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskUse:
    """What the journal takes, and what is left for it [bytes]."""

    journal_bytes: int
    free_bytes: int


def measure_disk(journal: Path) -> DiskUse:
    """Measure the journal's file, and those beside it whose names begin with its own; raises ``OSError``."""
    sizes = []
    for entry in os.scandir(journal.parent):
        if entry.name.startswith(journal.name):
            with contextlib.suppress(FileNotFoundError):
                sizes.append(entry.stat().st_size)
    space = os.statvfs(journal.parent)
    return DiskUse(journal_bytes=sum(sizes), free_bytes=space.f_bavail * space.f_frsize)


class Vitals:
    """See the module. What is not open yet is missing.

    Parameters
    ----------
    journal
        The journal's file.
    connect
        Endpoints that the bus is to be connected to; with none it waits for nobody.
    clock
        Seconds that only grow.
    """

    def __init__(
        self, *, health: Health, journal: Path, connect: tuple[str, ...] = (), clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.health = health
        self.started_wall_ns = time.time_ns()
        self.disk: DiskUse | None = None
        self.n_biobots = 0
        self.head_offset: int | None = None
        """Newest offset of the journal, or None: it is not open."""
        self.journal_fault: str | None = None
        self.commit_s = 0.0
        """How long the journal's commit under way has taken [s]."""
        self.watermarks: dict[str, int] = {}
        """Mapper's name to the offset up to which it has everything."""
        self.n_links: int | None = None
        """Zenoh sessions that are connected, or None: the bus is not open."""
        self.why_alone: str | None = None
        """Why nobody is connected on the bus, endpoint by endpoint, or None: somebody is, or the reason is not known yet."""
        self.is_stopping = False
        self._journal = journal
        self._connect = connect
        self._clock = clock
        self._beat_s = clock()
        self._disk_asked_s: float | None = None
        self._disk_fault: str | None = None

    @property
    def still_s(self) -> float:
        """How long the event loop has not moved [s]."""
        return max(0.0, self._clock() - self._beat_s - _BEAT_S)

    def beat(self) -> None:
        """Say that the event loop moves."""
        self._beat_s = self._clock()

    async def run(self) -> None:
        """Beat, and measure how late the event loop is and what the disk has left, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._watch_disk())
            while True:
                begun_s = self._clock()
                self.beat()
                await asyncio.sleep(_BEAT_S)
                self.health.observe("loop.late", max(0.0, self._clock() - begun_s - _BEAT_S))

    def take_records(self, records: Sequence[JournalRecord], head_offset: int) -> None:
        """Count what was journaled, and note the widest error bound of its encounters."""
        self.head_offset = head_offset
        n_new = n_revised = n_modes = widest_ns = 0
        for record in records:
            if isinstance(record, EncounterRecord):
                n_new += not record.revision
                n_revised += bool(record.revision)
                widest_ns = max(widest_ns, record.error_ns)
            elif isinstance(record, ModeRecord):
                n_modes += 1
        for name, n in (("encounter.new", n_new), ("encounter.revised", n_revised), ("mode.new", n_modes)):
            if n:
                self.health.count(name, n)
        if n_new or n_revised:
            self.health.observe("encounter.error", widest_ns / NS_PER_S)

    def radio_reports(self) -> dict[str, RadioReport]:
        """Return what is told of each radio, by its name."""
        counted = self.health.radio_counters()
        reports = {}
        for name, one in self.health.radio_conditions().items():
            counters = counted.get(name, {})
            reports[name] = RadioReport(
                state=one.state.value,
                since_wall_ns=Nanoseconds(one.since_wall_ns),
                reason=one.reason,
                attempts=one.n_attempts,
                firmware=one.firmware,
                n_messages=counters.get("radio.messages_in", 0),
                n_bytes=counters.get("radio.bytes_in", 0),
                n_faults=counters.get("radio.faults", 0),
            )
        return reports

    def faults(self) -> list[str]:
        """Return what keeps the gateway from its work, in words; empty: nothing."""
        found = []
        if self.still_s > _MAX_STILL_S:
            found.append(f"the event loop has not moved for {self.still_s:.0f} s; the process hangs and must be started anew")
        if self.journal_fault is not None:
            found.append(f"the journal {self._journal} takes nothing: {self.journal_fault}; nothing is acknowledged until it does")
        elif self.commit_s > _MAX_DISK_WAIT_S:
            found.append(f"the journal {self._journal} has been writing for {self.commit_s:.0f} s; its disk hangs or is far too slow")
        asked_s = self._disk_asked_s
        if asked_s is not None and self._clock() - asked_s > _MAX_DISK_WAIT_S:
            found.append(f"the disk of {self._journal} has not answered for {self._clock() - asked_s:.0f} s")
        if self._disk_fault is not None:
            found.append(f"the directory of {self._journal} cannot be read: {self._disk_fault}")
        return found

    def warnings(self) -> list[str]:
        """Return what will become a fault if nobody acts, in words."""
        disk = self.disk
        if disk is None or disk.free_bytes >= _SCARCE_BYTES:
            return []
        return [f"only {disk.free_bytes / 2**20:.0f} MiB are free where the journal lies; make room"]

    def missing(self) -> list[str]:
        """Return what the gateway waits for until it is of use, in words; empty: nothing."""
        found = []
        if self.is_stopping:
            found.append("the gateway is stopping")
        if self.head_offset is None:
            found.append("the journal is not open yet")
        if self.n_links is None:
            found.append("the bus is not open yet")
        elif self._connect and not self.n_links:
            reason = self.why_alone or f"no router or gateway answers at {', '.join(self._connect)}"
            found.append(f"nobody is connected on the bus: {reason}")
        conditions = self.health.radio_conditions()
        if not any(one.state is RadioState.UP for one in conditions.values()):
            reasons = [f"{name} is {one.state.value}{f' ({one.reason})' if one.reason else ''}" for name, one in conditions.items()]
            found.append(f"no radio is up: {'; '.join(reasons) or 'none is started yet'}")
        return found

    def headline(self) -> str:
        """Return one line for people: radios, journal, and the first of what is wrong or missing."""
        conditions = self.health.radio_conditions()
        n_up = sum(one.state is RadioState.UP for one in conditions.values())
        line = f"{n_up} of {len(conditions)} radios up, {self.n_biobots} biobots, journal at {self.head_offset or 0}"
        wrong = [*self.faults(), *self.warnings(), *self.missing()]
        return f"{line}; {wrong[0]}" if wrong else line

    async def _watch_disk(self) -> None:
        while True:
            self._disk_asked_s = self._clock()
            try:
                self.disk = await asyncio.to_thread(measure_disk, self._journal)
                self._disk_fault = None
            except OSError as error:
                self._disk_fault = error.strerror or str(error)
            self._disk_asked_s = None
            await asyncio.sleep(_DISK_PERIOD_S)
