"""Does the audit log's chain hold? Every row is looked at, in bounded memory; the first one that does not fit is told.

A chain shows what was changed by somebody who did not write it anew from there on. Whoever did so is found by a hash that was noted
elsewhere (docs/audit.md).
"""

import math
import sqlite3
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import msgspec

from gateway.journal_file.audit_chain import Cell, ChainHead
from gateway.journal_file.audit_diagnosis import CHAIN, ROWS, diagnose, fits, numbers
from gateway.journal_file.audit_table import HEAD, PRUNED, PRUNED_KIND, read_genesis
from gateway.journal_file.schema import read_meta

_KIND, _BODY = 1, -2
_TOLD_EVERY = 8192


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditFindings:
    """What a chain is like. ``n_rows``: those that fit; ``n_pruned``: those before them, which went by age."""

    n_rows: int
    n_pruned: int
    head: ChainHead
    """Of the last row that fits."""
    fault: str | None
    """The first row that does not, and what was changed; None: all fit."""
    witness_at: int | None = None
    """Number of the row whose hash was asked for; 0: the beginning of all. None: there is none, or none was asked for."""


def verify_audit(connection: sqlite3.Connection, *, witness: str = "", tell: Callable[[str], None]) -> AuditFindings:
    """Follow the chain from its beginning, or from where rows went by age, to its end; look for a hash on the way.

    Parameters
    ----------
    connection
        Is the caller's; how it gives texts is changed.
    witness
        A hash that was noted, or the first digits of one, hexadecimal.

    Raises
    ------
    sqlite3.Error
        The file cannot be read.
    """
    # Text that is no UTF-8 must be found altered, not end the walk.
    connection.text_factory = partial(str, encoding="utf-8", errors="surrogateescape")
    pruned = ChainHead.of_text(read_meta(connection, PRUNED) or "")
    head = pruned or read_genesis(connection)
    n_pruned = head.n_rows
    witness_at = _matching(head, witness)
    is_pruning_told = pruned is None
    fault = None
    (total,) = connection.execute("SELECT count(*) FROM audit").fetchone()
    # Numbers are from 1; a row of another hand may have any.
    for n_done, row in enumerate(connection.execute(ROWS, (-math.inf,)), start=1):
        if row[0] != head.n_rows + 1 or not fits(head.chain, row):
            fault = diagnose(connection, head, row)
            break
        head = ChainHead(n_rows=row[0], chain=row[CHAIN])
        witness_at = witness_at if witness_at is not None else _matching(head, witness)
        is_pruning_told = is_pruning_told or (row[_KIND] == PRUNED_KIND and _tells(row[_BODY], pruned))
        if n_done % _TOLD_EVERY == 0:
            tell(f"{100 * n_done // total} % of {total} rows")
    if fault is None:
        fault = _fault_of_end(connection, head)
    if fault is None and not is_pruning_told:
        fault = f"the rows up to {n_pruned} are missing: no row says that they went by age"
    return AuditFindings(n_rows=head.n_rows - n_pruned, n_pruned=n_pruned, head=head, fault=fault, witness_at=witness_at)


def _matching(head: ChainHead, witness: str) -> int | None:
    return head.n_rows if witness and head.chain.hex().startswith(witness.lower()) else None


def _tells(body: Cell, pruned: ChainHead | None) -> bool:
    """Return whether a row is the one that was written when the rows up to ``pruned`` went."""
    try:
        facts = msgspec.msgpack.decode(body, type=dict[str, object]) if isinstance(body, bytes) else {}
    except (msgspec.DecodeError, UnicodeDecodeError):
        return False
    return pruned is not None and (facts.get("until"), facts.get("chain")) == (pruned.n_rows, pruned.chain.hex())


def _fault_of_end(connection: sqlite3.Connection, head: ChainHead) -> str | None:
    """Return what is wrong behind the last row, or None."""
    told = ChainHead.of_text(read_meta(connection, HEAD) or "")
    if told is None:
        return f"row {head.n_rows} fits, but what the journal says of the log's end (meta, {HEAD}) is altered or missing"
    if told.n_rows > head.n_rows:
        return f"{numbers(head.n_rows + 1, told.n_rows)} missing: the end was cut off"
    if told.n_rows < head.n_rows:
        return f"{numbers(told.n_rows + 1, head.n_rows)} inserted: the gateway wrote none after row {told.n_rows}"
    if told.chain != head.chain:
        return f"row {head.n_rows} is not the one that the gateway wrote last, or what the journal says of it (meta, {HEAD}) was altered"
    return None
