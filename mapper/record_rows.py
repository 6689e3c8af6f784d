"""Which records have which rows, and how they get there: many at a time, each identity once, in its highest revision.

What a group of records needs to know of those before it is asked for in one statement for each start in a gateway's journal, and what it
changes is written in two: a statement for each record would cost several times as much.
"""

import json
import sqlite3
from collections.abc import Sequence
from typing import Final, TypeAlias

from firmware_protocol.contract.records import JournalRecord, encode_journal_record

Fresh: TypeAlias = tuple[int, int, JournalRecord]
"""Row, number of the change, and the record that brought it about."""

_Start: TypeAlias = tuple[int, int]
"""Number of a gateway's journal, and the boot of one of the starts in it."""

_FIND: Final = """
SELECT sequence, id, revision, kind FROM record
WHERE source = ? AND boot = ? AND sequence IN (SELECT value FROM json_each(?))
"""
_INSERT: Final = "INSERT INTO record (id, source, boot, sequence, revision, kind, change, body) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"
_UPDATE: Final = "UPDATE record SET revision = ?, change = ?, body = ? WHERE id = ?"


class RecordRows:
    """The rows of records in a store that nobody else writes to."""

    def __init__(self, database: sqlite3.Connection) -> None:
        self._db = database
        (self.last,) = database.execute("SELECT coalesce(max(id), 0) FROM record").fetchone()
        self._newest: dict[_Start, int] = {}
        """Highest sequence number of each start that has been written to: what is beyond it is new, and need not be looked for."""

    def write(self, records: Sequence[tuple[int, int, JournalRecord]], *, change: int) -> list[Fresh]:
        """Write records inside the caller's transaction; ``settle`` is to be called after its end.

        Parameters
        ----------
        records
            Number of the gateway's journal, kind, and the record, in the order in which they came. One of another kind than before is left
            out.
        change
            Number of the last change before these.

        Returns
        -------
        list of Fresh
            Those that were new or had a higher revision than any before, each with a change of its own.
        """
        known = self._find(records)
        fresh: list[Fresh] = []
        last: dict[int, tuple[int, int, int, JournalRecord]] = {}
        next_row = self.last + 1
        for source, kind, record in records:
            rows = known[source, record.boot]
            before = rows.get(record.sequence)
            if before is None:
                row = next_row
                next_row += 1
            elif record.revision > before[1] and kind == before[2]:
                row = before[0]
            else:
                continue
            change += 1
            rows[record.sequence] = (row, record.revision, kind)
            last[row] = (source, kind, change, record)
            fresh.append((row, change, record))
        self._put(last)
        return fresh

    def settle(self, fresh: Sequence[Fresh], records: Sequence[tuple[int, int, JournalRecord]]) -> None:
        """Take note that what ``write`` took and returned is in the file for good."""
        if fresh:
            self.last = max(self.last, *(row for row, _, _ in fresh))
        newest = self._newest
        for source, _, record in records:
            start: _Start = (source, record.boot)
            newest[start] = max(newest[start], record.sequence)

    def _find(self, records: Sequence[tuple[int, int, JournalRecord]]) -> dict[_Start, dict[int, tuple[int, int, int]]]:
        """Return row, revision and kind of those of the records' identities that are known, by start and sequence number."""
        wanted: dict[_Start, list[int]] = {}
        newest = self._newest
        for source, _, record in records:
            start: _Start = (source, record.boot)
            sequences = wanted.get(start)
            if sequences is None:
                sequences = wanted[start] = []
                if start not in newest:
                    query = "SELECT coalesce(max(sequence), -1) FROM record WHERE source = ? AND boot = ?"
                    (newest[start],) = self._db.execute(query, start).fetchone()
            if record.sequence <= newest[start]:
                sequences.append(record.sequence)
        known: dict[_Start, dict[int, tuple[int, int, int]]] = {}
        for whose, sequences in wanted.items():
            found = self._db.execute(_FIND, (*whose, json.dumps(sequences))).fetchall() if sequences else []
            known[whose] = {sequence: (row, revision, kind) for sequence, row, revision, kind in found}
        return known

    def _put(self, last: dict[int, tuple[int, int, int, JournalRecord]]) -> None:
        first_new = self.last + 1
        inserts = [
            (row, source, record.boot, record.sequence, record.revision, kind, change, encode_journal_record(record))
            for row, (source, kind, change, record) in last.items()
            if row >= first_new
        ]
        updates = [
            (record.revision, change, encode_journal_record(record), row) for row, (_, _, change, record) in last.items() if row < first_new
        ]
        if inserts:
            self._db.executemany(_INSERT, inserts)
        if updates:
            self._db.executemany(_UPDATE, updates)
