"""Numbers of commands on the wire: none is used twice, over restarts too, for a backpack takes the second for a repetition of the first.

Where they begin is put on record when the gate opens. Until that is on disk, and so where the disk takes nothing, they are drawn at random:
the next process could not know which were used.
"""

import asyncio
import sqlite3
from collections.abc import Callable

import msgspec

from gateway.errors import JournalFullError
from gateway.journal_file import AuditEntry, JournalWrite
from gateway.log import EventLog
from gateway.stimulation.outside import AuditReader, CommandJournal

_log = EventLog(__name__)

GATE = "gate"
"""Kind of the rows that say when the gate opens and closes."""

OPENED, CLOSED = "opened", "closed"
"""Their stages. Between the two a stop may have given a train that did not come to disk any more."""

_SKIPPED = 1 << 16
"""Numbers that a restart leaves out: the process before may have sent stops that did not come to disk."""

_N_NUMBERS = 1 << 32
_NO_FACTS = msgspec.msgpack.encode({})


def last_number(reader: AuditReader) -> int | None:
    """Return the last number on record; None where there is none, or where the journal does not say."""
    try:
        return reader.read_last_wire_command()
    except sqlite3.Error as error:
        _log.error("command.unread_journal", kind=GATE, reason=str(error))
        return None


class WireNumbers:
    """Gives commands their numbers. ``last`` is the last one on record, None in a new journal; ``draw`` gives one of 31 bits at random."""

    def __init__(
        self,
        *,
        journal: CommandJournal,
        last: int | None,
        draw: Callable[[], int],
        now_ns: Callable[[], int],
        wall_clock: Callable[[], int],
    ) -> None:
        self._journal = journal
        self._draw = draw
        self._now_ns = now_ns
        self._wall_clock = wall_clock
        # A new journal must not begin at a number that a backpack remembers from an old one.
        self._next = draw() if last is None else last + _SKIPPED
        self._opened = self._write(OPENED)

    @property
    def are_on_record(self) -> bool:
        """Whether it is on disk that the gate is open, and where its numbers begin."""
        opened = self._opened
        return opened is not None and opened.done() and not opened.cancelled() and opened.exception() is None

    def take(self) -> int:
        """Return the number of a new command."""
        if not self.are_on_record:
            return self._draw()
        number, self._next = self._next % _N_NUMBERS, self._next + 1
        return number

    def close(self) -> None:
        """Put on record that the gate closes: no train is given any more."""
        self._write(CLOSED)

    def _write(self, stage: str) -> "asyncio.Future[None] | None":
        entry = AuditEntry(
            wall_ns=self._wall_clock(),
            mono_ns=self._now_ns(),
            kind=GATE,
            stage=stage,
            wire_command=(self._next - 1) % _N_NUMBERS,
            body=_NO_FACTS,
        )
        try:
            return self._journal.append(JournalWrite(audit=entry))
        except JournalFullError as error:
            _log.error("command.not_journaled", kind=GATE, stage=stage, reason=str(error))
            return None


def was_killed(last: AuditEntry | None) -> bool:
    """Whether the process before this one ended without closing its gate; ``last`` is the newest row of kind ``GATE``."""
    return last is not None and last.stage == OPENED
