"""The hash chain of the audit log: the hash of each row is over that of the row before and all of its own columns (docs/audit.md). Pure."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import msgspec

from gateway.journal_file.writes import AuditEntry

Cell = int | float | str | bytes | None
"""What SQLite may hold in a column."""

COLUMNS = "id, kind, wall_ns, ran_ns, boot, mono_ns, operator, node, command_id, wire_command, stage, train_ms, request, body"
"""What is hashed of a row, in this order; the column ``chain`` has the hash."""

HASH_SIZE = hashlib.sha256().digest_size

_MAX_INTEGER = (1 << 63) - 1  # SQLite's


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainHead:
    """How far a chain goes: rows that were ever written, and the hash of the last one."""

    n_rows: int
    chain: bytes

    def text(self) -> str:
        """Return it as ``meta`` has it."""
        return f"{self.n_rows}:{self.chain.hex()}"

    @classmethod
    def of_text(cls, text: str) -> Self | None:
        """Return what ``text`` wrote; None: it is no head."""
        number, _, digits = text.partition(":")
        try:
            return cls(n_rows=int(number), chain=bytes.fromhex(digits))
        except ValueError:
            return None


def genesis(journal: str) -> ChainHead:
    """Return the head of a chain without rows, of a journal of that name."""
    return ChainHead(n_rows=0, chain=hashlib.sha256(b"biobot audit log 1 of journal " + journal.encode()).digest())


def link(chain: bytes, row: Sequence[Cell]) -> bytes:
    """Return the hash of a row after one whose hash is ``chain``: SHA-256 of that and of the row as a MessagePack array, shortest forms.

    Raises
    ------
    UnicodeEncodeError, OverflowError
        A cell is none that this program writes: text that is no UTF-8, or too large.
    """
    return hashlib.sha256(chain + msgspec.msgpack.encode(row)).digest()


def row_of(entry: AuditEntry, *, number: int, ran_ns: int, boot: int) -> tuple[Cell, ...]:
    """Return an entry as the row of that number in the chain."""
    return (
        number,
        entry.kind,
        entry.wall_ns,
        ran_ns,
        boot,
        entry.mono_ns,
        entry.operator,
        storable_node(entry),
        entry.command_id,
        entry.wire_command,
        entry.stage,
        entry.train_ms,
        entry.request,
        entry.body,
    )


def storable_node(entry: AuditEntry) -> int | None:
    """Return an entry's biobot as SQLite can hold it: a command may name a larger number, and its request says which."""
    return None if entry.node is None else min(entry.node, _MAX_INTEGER)


def entry_of(row: Sequence[Cell]) -> AuditEntry:
    """Return a row, with its hash behind its columns, as what was written."""
    return msgspec.convert(dict(zip((*COLUMNS.split(", "), "chain"), row, strict=True)), AuditEntry)
