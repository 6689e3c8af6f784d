"""A journal of an earlier version becomes one of this version.

One of version 1 (one row a record) is written anew beside the old file, and takes its place: the disk must have room for both. Those of
versions 2 and 3 are changed in place, in one transaction. Bounded memory; a process that is killed on the way leaves the file as it was.
"""

import contextlib
import os
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path

from firmware_protocol.contract.records import decode_journal_record
from firmware_protocol.units import BootId, NodeId
from gateway.journal_file.audit_table import GENESIS, HEAD, Stamp, chain_old_rows
from gateway.journal_file.schema import COMMIT, FIRST_SCHEMA_VERSION, make_tables, renew_tables
from gateway.journal_file.segments import SegmentBuilder, Windows
from gateway.journal_file.writes import JournalWrite, UplinkReport

_A_SEGMENT = 2048
"""Records or reports."""

_TOLD_FROM = 50_000
"""Rows; fewer are brought over in a moment."""

_SAME = {
    "meta": "SELECT key, value FROM meta WHERE key <> 'commits'",
    "nodes": "SELECT node, body FROM nodes",
}
"""Tables that are copied as they are."""

_AUDIT = "SELECT wall_ns, command_id, wire_command, stage, node, train_ms, request, body, {ran_ns} FROM {table} ORDER BY id"

_REPORTS = """
SELECT r.node, r.boot, r.sequence, coalesce(w.next, r.sequence + 1), r.received_wall_ns, r.radio, r.address, r.rssi_dbm, r.lqi, r.payload
FROM reports r LEFT JOIN windows w ON (w.node, w.boot) = (r.node, r.boot) ORDER BY r.received_wall_ns"""


def renew(connection: sqlite3.Connection, *, version: int, stamp: Stamp) -> None:
    """Make a journal of version 2 or 3 one of this version; raises ``sqlite3.DatabaseError``, and then it is as it was."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        renew_tables(connection, version=version)
        old = connection.execute(_AUDIT.format(ran_ns="ran_ns", table="old_audit"))
        chain_old_rows(connection, old, from_version=version, stamp=stamp)
        connection.execute("DROP TABLE old_audit")
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def bring_over(path: Path, *, stamp: Stamp) -> None:
    """Replace a journal of version 1 by one of this version with the same history.

    Raises
    ------
    sqlite3.DatabaseError
        The old file cannot be read, or the disk has no room for the new one; the old file is as it was.
    """
    new_path = path.with_name(path.name + ".new")
    _remove(new_path)
    try:
        with (
            contextlib.closing(sqlite3.connect(path, isolation_level=None)) as old,
            contextlib.closing(sqlite3.connect(new_path, isolation_level=None)) as new,
        ):
            old.execute("BEGIN IMMEDIATE")
            _copy(old, new, stamp)
            old.execute("ROLLBACK")
            new.execute("PRAGMA journal_mode = DELETE")  # all of it in one file, which can be renamed
            old.execute("PRAGMA journal_mode = DELETE")  # fails where somebody reads it still, who would be left behind
    except BaseException:
        _remove(new_path)
        raise
    with new_path.open("rb") as written:
        os.fsync(written.fileno())
    new_path.replace(path)
    directory = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


def _copy(old: sqlite3.Connection, new: sqlite3.Connection, stamp: Stamp) -> None:
    make_tables(new)
    new.execute("PRAGMA synchronous = OFF")  # it is synced as a whole before it counts
    (n_records,) = old.execute("SELECT count(*) FROM entries").fetchone()
    (n_reports,) = old.execute("SELECT count(*) FROM reports").fetchone()
    with contextlib.closing(_Teller(n_records + n_reports)) as tell:
        new.execute("BEGIN")
        for table, query in _SAME.items():
            rows = old.execute(query)
            places = ", ".join("?" * len(rows.description))
            new.executemany(f"INSERT OR REPLACE INTO {table} VALUES ({places})", rows)  # noqa: S608  # names of this file
        new.execute("INSERT OR REPLACE INTO meta SELECT ?, value FROM meta WHERE key = 'journal'", (GENESIS,))
        new.execute("DELETE FROM meta WHERE key = ?", (HEAD,))  # it follows from that name
        old_audit = old.execute(_AUDIT.format(ran_ns=0, table="audit"))
        head = chain_old_rows(new, old_audit, from_version=FIRST_SCHEMA_VERSION, stamp=stamp)
        new.execute("COMMIT")
        n_done = 0
        windows = Windows()
        for segment, (wall_ns, builder) in enumerate(_segments(old, windows), start=1):
            new.execute(COMMIT, builder.seal(segment=segment, now_wall_ns=wall_ns, ran_ns=0, boot=0, audit_head=head).row())
            n_done += builder.n_writes
            tell.tell(n_done)


def _segments(old: sqlite3.Connection, windows: Windows) -> Iterator[tuple[int, SegmentBuilder]]:
    """Yield the reports by time, then the records by offset; each segment with the time at which it was committed, about."""
    rows = old.execute(_REPORTS)
    while chunk := rows.fetchmany(_A_SEGMENT):
        builder = SegmentBuilder(first_offset=1, windows=windows)
        for node, boot, number, next_number, received, radio, address, rssi_dbm, lqi, payload in chunk:
            report = UplinkReport(
                node=NodeId(node),
                boot=BootId(boot),
                number=number,
                next_number=next_number,
                received_wall_ns=received,
                radio=radio,
                address=address,
                rssi_dbm=rssi_dbm,
                lqi=lqi,
                payload=payload,
            )
            builder.add(JournalWrite(report=report))
        yield chunk[-1][4], builder
    wall_ns = 0
    rows = old.execute("SELECT offset, end_wall_ns, body FROM entries ORDER BY offset")
    while chunk := rows.fetchmany(_A_SEGMENT):
        builder = SegmentBuilder(first_offset=chunk[0][0], windows=windows)
        for _, end_wall_ns, body in chunk:
            wall_ns = max(wall_ns, end_wall_ns or 0)
            builder.add(JournalWrite(records=(decode_journal_record(body),)))
        yield wall_ns, builder


class _Teller:
    """Tells on stderr how far it has come, where it takes long: every tenth, or in one line on a terminal."""

    def __init__(self, n_rows: int) -> None:
        self._n_rows = n_rows
        self._tenths = 0
        self._is_terminal = sys.stderr.isatty()

    def tell(self, n_done: int) -> None:
        tenths = 10 * n_done // max(1, self._n_rows)
        if self._n_rows < _TOLD_FROM or tenths == self._tenths:
            return
        self._tenths = tenths
        begin, end = ("\r\033[K", "") if self._is_terminal else ("", "\n")
        text = f"{begin}biobot-gateway: bringing the journal over to its new form: {10 * tenths} %"
        print(text, end=end, file=sys.stderr, flush=True)  # noqa: T201  # a person waits

    def close(self) -> None:
        if self._tenths and self._is_terminal:
            print("\r\033[K", end="", file=sys.stderr, flush=True)  # noqa: T201  # same


def _remove(path: Path) -> None:
    for suffix in ("", "-wal", "-shm", "-journal"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
