"""The mission's records on their way to the journal: a phase, and its revisions while it goes on."""

import asyncio
import time
from collections import deque
from dataclasses import replace
from functools import partial

from firmware_protocol.contract.records import MissionRecord
from gateway.errors import JournalFullError
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import JournalWrite
from gateway.mission.states import record_phase, revise_phase
from gateway.mission.steps import MissionState

_MAX_UNWRITTEN = 256
"""Records that wait while the journal's queue is full; of more the oldest go, which later revisions say again."""


class Chronicle:
    """Writes the mission down, in order. Belongs to one event loop."""

    def __init__(self, *, issuer: RecordIssuer, journal: Journal) -> None:
        self._issuer = issuer
        self._journal = journal
        self._record: MissionRecord | None = None
        self._unwritten: deque[MissionRecord] = deque(maxlen=_MAX_UNWRITTEN)
        self._promise: asyncio.Future[None] | None = None
        self._on_disk: asyncio.Future[None] | None = None

    @property
    def on_disk(self) -> "asyncio.Future[None] | None":
        """Done when all that was told so far is on disk; None: nothing was told yet."""
        return self._promise or self._on_disk

    def resume(self, record: MissionRecord) -> None:
        """Go on with a record of an earlier process. One of an earlier name of the journal is another history's, and is not revised."""
        self._record = record if record.journal == self._issuer.journal else None

    def begin(self, state: MissionState) -> None:
        """Write down a phase that begins."""
        self._record = record_phase(state, issuer=self._issuer, now_ns=time.monotonic_ns())
        self._unwritten.append(self._record)
        self.write()

    def revise(self, state: MissionState) -> bool:
        """Write down what has changed within the phase; return whether there is more to tell of it than the record did."""
        if self._record is None:
            self.begin(replace(state, is_continued=True))
            return False
        has_more = self._record.reason != state.reason
        self._record = revise_phase(self._record, state)
        self._unwritten.append(self._record)
        self.write()
        return has_more

    def write(self) -> None:
        """Hand what waits to the journal; what does not find room there is handed over by a later call."""
        while self._unwritten:
            try:
                self._on_disk = self._journal.append(JournalWrite(records=(self._unwritten[0],)))
            except JournalFullError:
                self._promise = self._promise or asyncio.get_running_loop().create_future()
                return
            self._unwritten.popleft()
        if self._promise is not None and self._on_disk is not None:
            self._on_disk.add_done_callback(partial(_keep, self._promise))
            self._promise = None


def _keep(promise: "asyncio.Future[None]", _: "asyncio.Future[None]") -> None:
    if not promise.done():
        promise.set_result(None)
