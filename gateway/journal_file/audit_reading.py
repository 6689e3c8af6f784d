"""The audit log as people ask for it: rows by biobot, operator, command, kind and time, and each biobot's dose. Only read."""

import contextlib
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from firmware_protocol.units import NodeId
from gateway.journal_file.audit_chain import COLUMNS, entry_of
from gateway.journal_file.audit_table import read_head
from gateway.journal_file.audit_verify import AuditFindings, verify_audit
from gateway.journal_file.writes import AuditEntry

_A_PAGE = 512
"""Rows read in one moment of the file: a gateway that writes meanwhile needs no more disk for whoever reads slowly."""

_DOSES = """
WITH unsent AS (
  SELECT command_id, node, max(id) AS last FROM audit
  WHERE command_id <> '' AND (kind = 'taken_back' OR (kind = 'stage' AND stage IN ('refused', 'failed'))) GROUP BY command_id, node),
told AS (
  SELECT node, train_ms, wall_ns, kind, stage, train_ms > 0 AND coalesce(last, 0) < id AS is_given
  FROM audit LEFT JOIN unsent USING (command_id, node)
  WHERE command_id <> '' AND node IS NOT NULL)
SELECT node, sum(is_given), sum(train_ms * is_given), max(CASE WHEN is_given THEN wall_ns END), sum(kind = 'stage' AND stage = 'accepted'),
  sum(kind = 'stage' AND stage = 'biobot_confirmed'), sum(kind = 'stage' AND stage = 'refused'), sum(kind = 'stage' AND stage = 'failed'),
  sum(kind = 'stage' AND stage = 'unknown')
FROM told GROUP BY node HAVING sum(kind = 'stage' AND stage = 'accepted') OR node IN (SELECT node FROM nodes) ORDER BY node"""
"""A train counts from when it is admitted, unless a later row of its command says that it never left. A number that no biobot has, and that
somebody has commanded in vain, is left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditSelection:
    """Which rows are wanted; None: whatever they have there."""

    node: int | None = None
    operator: str | None = None
    command_id: str | None = None
    kind: str | None = None
    since_wall_ns: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class UnreadableRow:
    """A row that this program did not write so, or some rows whose pages are damaged: from ``id`` to ``last``."""

    id: int
    last: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Dose:
    """How a biobot was stimulated, as far as the log goes back: trains and their time, commands by what became of them."""

    node: NodeId
    n_trains: int
    on_ms: int
    last_train_wall_ns: int | None
    n_accepted: int
    n_confirmed: int
    n_refused: int
    n_failed: int
    n_unknown: int


def read_audit_rows(path: Path, selection: AuditSelection, *, after: int = 0) -> Iterator[AuditEntry | UnreadableRow]:
    """Yield the rows that are wanted, from the one behind number ``after`` on, in order; raises ``sqlite3.Error``.

    Where pages of the file are damaged, rows are asked for one by one, so that those of whole pages are found; of the others nobody knows
    whether they are wanted.
    """
    wanted = {
        "node = ?": selection.node,
        "operator = ?": selection.operator,
        "command_id = ?": selection.command_id,
        "kind = ?": selection.kind,
        "wall_ns >= ?": selection.since_wall_ns,
    }
    asked = {condition: value for condition, value in wanted.items() if value is not None}
    where = "".join(f" AND {condition}" for condition in asked)
    values = tuple(asked.values())
    query = f"SELECT {COLUMNS}, chain FROM audit WHERE id > ?{where} ORDER BY id LIMIT {_A_PAGE}"  # noqa: S608  # parts of this file
    with contextlib.closing(_open(path)) as connection:
        try:
            while page := connection.execute(query, (after, *values)).fetchall():
                after = page[-1][0]
                yield from map(_read, page)
        except sqlite3.DatabaseError as error:
            if not _is_damage(error):
                raise
            yield from _read_one_by_one(connection, where, values, after=after)


def _read_one_by_one(
    connection: sqlite3.Connection, where: str, values: Sequence[object], *, after: int
) -> Iterator[AuditEntry | UnreadableRow]:
    query = f"SELECT {COLUMNS}, chain FROM audit WHERE id = ?{where}"  # noqa: S608  # parts of this file
    first, reason, last = None, "", read_head(connection).n_rows
    for number in range(after + 1, last + 1):
        try:
            row = connection.execute(query, (number, *values)).fetchone()
        except sqlite3.DatabaseError as error:
            if not _is_damage(error):
                raise
            first, reason = first or number, str(error)
            continue
        if first is not None:
            yield UnreadableRow(id=first, last=number - 1, reason=reason)
            first = None
        if row is not None:
            yield _read(row)
    if first is not None:
        yield UnreadableRow(id=first, last=last, reason=reason)


def _read(row: Sequence[Any]) -> AuditEntry | UnreadableRow:
    try:
        return entry_of(row)
    except (msgspec.ValidationError, TypeError) as error:
        return UnreadableRow(id=row[0], last=row[0], reason=str(error))


def _is_damage(error: sqlite3.DatabaseError) -> bool:
    return getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_CORRUPT


def read_audit_kinds(path: Path) -> list[str]:
    """Return the kinds of rows that there are, in order; raises ``sqlite3.Error``."""
    with contextlib.closing(_open(path)) as connection:
        return [kind for (kind,) in connection.execute("SELECT DISTINCT kind FROM audit ORDER BY kind")]


def read_doses(path: Path) -> list[Dose]:
    """Return the dose of every biobot that was ever commanded, by number; raises ``sqlite3.Error``."""
    with contextlib.closing(_open(path)) as connection:
        rows = connection.execute(_DOSES).fetchall()
    names = Dose.__dataclass_fields__
    return [Dose(**dict(zip(names, (NodeId(node), *counts), strict=True))) for node, *counts in rows]


def verify_audit_of(path: Path, *, witness: str = "", tell: Callable[[str], None]) -> AuditFindings:
    """Verify the chain of a journal's audit log in one moment of the file; raises ``sqlite3.Error``."""
    with contextlib.closing(_open(path)) as connection:
        connection.execute("BEGIN")
        return verify_audit(connection, witness=witness, tell=tell)


def _open(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None, timeout=5.0)
    connection.text_factory = partial(str, encoding="utf-8", errors="backslashreplace")
    return connection
