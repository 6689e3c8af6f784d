"""Which gateway writes a journal. It stays the same: mappers know records by gateway and journal, and lose those of another name."""

import sqlite3
from pathlib import Path

from firmware_protocol.contract.records import decode_journal_record
from firmware_protocol.errors import RecordError
from gateway.errors import JournalUnfitError
from gateway.journal_file.blobs import RECORDS_COMPRESSED, DamagedSegmentError, decompress, unpack_records
from gateway.journal_file.schema import FIRST_SCHEMA_VERSION

_LOOKED_AT = 8
"""Newest segments that are tried, where some are damaged."""


def expect_owner(connection: sqlite3.Connection, *, path: Path, gateway: str, schema_version: int) -> None:
    """Raise ``JournalUnfitError`` where a journal is of a gateway of another name."""
    owner = _owner_of(connection, schema_version=schema_version)
    if owner is not None and owner != gateway:
        raise JournalUnfitError(
            path=str(path),
            reason=f"is of gateway {owner!r}, but this gateway is called {gateway!r}: mappers would lose what it has of {owner!r}",
            advice=f'set name = "{owner}", or name another journal',
        )


def remember_owner(connection: sqlite3.Connection, gateway: str) -> None:
    """Write down the gateway's name."""
    connection.execute("INSERT OR REPLACE INTO meta VALUES ('gateway', ?)", (gateway,))


def _owner_of(connection: sqlite3.Connection, *, schema_version: int) -> str | None:
    """Return the gateway's name, of a file that does not have it that of the newest record; None: there is none that can be read."""
    row = connection.execute("SELECT value FROM meta WHERE key = 'gateway'").fetchone()
    if row is not None:
        return str(row[0])
    if schema_version == FIRST_SCHEMA_VERSION:
        row = connection.execute("SELECT body FROM entries ORDER BY offset DESC LIMIT 1").fetchone()
        return None if row is None else decode_journal_record(row[0]).gateway
    rows = connection.execute(
        "SELECT s.encoding, c.records FROM segments s JOIN contents c ON c.segment = s.segment WHERE s.n_records > 0 "
        "ORDER BY s.first_offset DESC LIMIT ?",
        (_LOOKED_AT,),
    )
    for encoding, records in rows:
        try:
            return decode_journal_record(unpack_records(decompress(records, is_compressed=bool(encoding & RECORDS_COMPRESSED)))[-1]).gateway
        except (DamagedSegmentError, RecordError, IndexError):
            continue
    return None
