"""The audit log's table, as the journal's one writer sees it: where its chain ends, rows put behind that, rows that go by age.

Everything here is done within a transaction of the caller's.
"""

import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass

import msgspec

from firmware_protocol.first_use import prepare
from gateway.journal_file.audit_chain import COLUMNS, ChainHead, genesis, link, row_of
from gateway.journal_file.schema import read_meta
from gateway.journal_file.writes import SENT_AGAIN, STAGE, AuditEntry

HEAD, GENESIS, PRUNED, WIRE_COMMAND = "audit_head", "audit_genesis", "audit_pruned", "wire_command"
"""Keys of ``meta``: head of the chain; the journal's name when it began; head of what went by age; the last number on the wire of that."""

PRUNED_KIND = "pruned"
JOURNAL_KIND = "journal"
"""Kinds of the rows that the journal writes of itself."""

_PRUNED_TOGETHER = 4096
_PRUNED_AT_ONCE = 1024
"""So many rows that are over age go when there are so many; fewer wait for a part of their age, or a day."""

_OVERDUE_SHARE = 4
_MAX_OVERDUE_NS = 86_400_000_000_000

_INSERT = f"INSERT INTO audit ({COLUMNS}, chain) VALUES ({', '.join('?' * (COLUMNS.count(',') + 2))})"  # noqa: S608  # constants


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamp:
    """When rows are written: how long gateways have run on the journal, the start of the gateway, UTC."""

    ran_ns: int
    boot: int
    wall_ns: int


def read_head(connection: sqlite3.Connection) -> ChainHead:
    """Return where the chain ends. A row of another hand behind that is not overwritten: the chain goes on after its number."""
    head = ChainHead.of_text(read_meta(connection, HEAD) or "") or read_genesis(connection)
    (newest,) = connection.execute("SELECT coalesce(max(id), 0) FROM audit").fetchone()
    return head if newest <= head.n_rows else ChainHead(n_rows=int(newest), chain=head.chain)


def read_genesis(connection: sqlite3.Connection) -> ChainHead:
    """Return the head that the first row ever followed."""
    return genesis(read_meta(connection, GENESIS) or "")


def append_entries(connection: sqlite3.Connection, entries: Iterable[AuditEntry], *, stamp: Stamp, keeps_stamps: bool = False) -> ChainHead:
    """Put entries behind the last row; return the new head. ``keeps_stamps``: they were written before, and say when themselves."""
    head = read_head(connection)
    for number, entry in enumerate(entries, start=head.n_rows + 1):
        ran_ns, boot = (entry.ran_ns, entry.boot) if keeps_stamps else (stamp.ran_ns, stamp.boot)
        row = row_of(entry, number=number, ran_ns=ran_ns, boot=boot)
        head = ChainHead(n_rows=number, chain=link(head.chain, row))
        connection.execute(_INSERT, (*row, head.chain))
    connection.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (HEAD, head.text()))
    return head


def note_of_journal(kind: str, facts: dict[str, object], *, stamp: Stamp) -> AuditEntry:
    """Return an entry that the journal makes of itself."""
    return AuditEntry(wall_ns=stamp.wall_ns, kind=kind, body=msgspec.msgpack.encode(facts))


def chain_old_rows(connection: sqlite3.Connection, old: Iterable[tuple[object, ...]], *, from_version: int, stamp: Stamp) -> ChainHead:
    """Copy rows of a journal whose audit log had no chain, and say so behind them.

    ``old``: wall_ns, command_id, wire_command, stage, node, train_ms, request, body, ran_ns.
    """
    head = append_entries(connection, map(_old_entry, old), stamp=stamp, keeps_stamps=True)
    facts: dict[str, object] = {"event": "brought over", "from_version": from_version, "rows_without_chain": head.n_rows}
    return append_entries(connection, [note_of_journal(JOURNAL_KIND, facts, stamp=stamp)], stamp=stamp)


def prune(connection: sqlite3.Connection, *, age_ns: int, stamp: Stamp) -> ChainHead | None:
    """Drop the oldest rows where they are over age, keep the hash of the last one, and say so in a row; None: nothing went.

    They go many at a time: each time adds a row.
    """
    first = connection.execute("SELECT id, ran_ns FROM audit ORDER BY id LIMIT 1").fetchone()
    before_ns = stamp.ran_ns - age_ns
    if first is None or first[1] >= before_ns:
        return None
    query = "SELECT max(id) FROM (SELECT id, ran_ns FROM audit ORDER BY id LIMIT ?) WHERE ran_ns < ?"
    (last,) = connection.execute(query, (_PRUNED_TOGETHER, before_ns)).fetchone()
    is_due = last - first[0] >= _PRUNED_AT_ONCE or first[1] < before_ns - min(_MAX_OVERDUE_NS, age_ns // _OVERDUE_SHARE)
    others = connection.execute("SELECT 1 FROM audit WHERE id <= ? AND kind <> ? LIMIT 1", (last, PRUNED_KIND)).fetchone()
    if not is_due or others is None:
        return None
    (chain,) = connection.execute("SELECT chain FROM audit WHERE id = ?", (last,)).fetchone()
    wire = connection.execute("SELECT wire_command FROM audit WHERE id <= ? AND wire_command IS NOT NULL ORDER BY id DESC LIMIT 1", (last,))
    for (number,) in wire.fetchall():
        connection.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (WIRE_COMMAND, str(number)))
    gone = ChainHead(n_rows=last, chain=bytes(chain))
    connection.execute("DELETE FROM audit WHERE id <= ?", (last,))
    connection.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (PRUNED, gone.text()))
    facts: dict[str, object] = {"from": first[0], "until": last, "chain": gone.chain.hex(), "age_days": age_ns / _MAX_OVERDUE_NS}
    return append_entries(connection, [note_of_journal(PRUNED_KIND, facts, stamp=stamp)], stamp=stamp)


def _old_entry(row: tuple[object, ...]) -> AuditEntry:
    names = ("wall_ns", "command_id", "wire_command", "stage", "node", "train_ms", "request", "body", "ran_ns")
    facts = dict(zip(names, row, strict=True))
    kind = SENT_AGAIN if facts["stage"] == SENT_AGAIN else STAGE
    return msgspec.convert({**facts, "kind": kind, "operator": _operator_of(facts["request"])}, AuditEntry)


class _Signed(msgspec.Struct):
    operator: str = ""


prepare(_Signed)


def _operator_of(request: object) -> str:
    try:
        return msgspec.msgpack.decode(request, type=_Signed).operator if isinstance(request, bytes) else ""
    except (msgspec.DecodeError, UnicodeDecodeError):
        return ""
