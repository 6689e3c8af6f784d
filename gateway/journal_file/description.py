"""What a journal is, and what is in it, without reading its contents."""

import sqlite3
from datetime import UTC, datetime
from pathlib import Path

from firmware_protocol.units import NS_PER_S
from gateway.errors import JournalUnfitError
from gateway.journal_file.owner import expect_owner
from gateway.journal_file.schema import SCHEMA_VERSION, head_offset, oldest_offset, schema_version_of, unfit


def expect_journal(path: Path) -> None:
    """Raise ``JournalUnfitError`` where a file is no journal of this version; it is only read."""
    if path.is_dir():
        raise JournalUnfitError(path=str(path), reason="is a directory", advice="name the file in it that the gateway writes (--journal)")
    if not path.is_file():
        raise JournalUnfitError(path=str(path), reason="is not there", advice="name the file that the gateway writes (--journal)")
    try:
        connection = _open(path)
        try:
            version = schema_version_of(connection, path=path)
        finally:
            connection.close()
    except sqlite3.DatabaseError as error:
        raise unfit(path, error) from error
    if version != SCHEMA_VERSION:
        reason = "is empty" if not version else f"has schema version {version}"
        raise JournalUnfitError(path=str(path), reason=reason, advice="start a gateway with it once, which brings it up to date")


def expect_fit_to_open(path: Path, *, gateway: str) -> None:
    """Raise ``JournalUnfitError`` where a file could not be this gateway's journal; nothing is written, made or locked."""
    try:
        connection = _open(path, leaves_nothing=True)
        try:
            version = schema_version_of(connection, path=path)
            if version:
                expect_owner(connection, path=path, gateway=gateway, schema_version=version)
        finally:
            connection.close()
    except sqlite3.DatabaseError as error:
        raise unfit(path, error) from error


def describe_journal(path: Path) -> dict[str, object]:
    """Return what ``biobot-gateway journal info`` prints; raises ``sqlite3.Error``."""
    connection = _open(path)
    try:
        connection.execute("BEGIN")
        totals = "SELECT count(*), coalesce(sum(n_records), 0), coalesce(sum(n_reports), 0), min(wall_ns), max(wall_ns) FROM segments"
        n_segments, n_records, n_reports, first_ns, last_ns = connection.execute(totals).fetchone()
        kinds = {kind: connection.execute("SELECT count(*) FROM states WHERE kind = ?", (kind,)).fetchone()[0] for kind in (1, 2)}
        meta = dict(connection.execute("SELECT key, value FROM meta"))
        pages = {name: connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_size", "page_count", "freelist_count")}
        return {
            "journal": meta["journal"],
            "starts_boot": int(meta["boot"]),
            "oldest_offset": oldest_offset(connection),
            "head_offset": head_offset(connection),
            "records": n_records,
            "modes_at_hand": kinds[1],
            "mission_phases": kinds[2],
            "reports": n_reports,
            "segments": n_segments,
            "first_commit": _utc(first_ns),
            "last_commit": _utc(last_ns),
            "biobots": connection.execute("SELECT count(*) FROM nodes").fetchone()[0],
            "audit_rows": connection.execute("SELECT count(*) FROM audit").fetchone()[0],
            "watermarks": dict(connection.execute("SELECT mapper, offset FROM watermarks ORDER BY mapper")),
            "size_octets": pages["page_size"] * pages["page_count"],
            "free_octets": pages["page_size"] * pages["freelist_count"],
        }
    finally:
        connection.close()


def _open(path: Path, *, leaves_nothing: bool = False) -> sqlite3.Connection:
    # Even who only reads makes -wal and -shm, unless told that nobody writes; without a log beside it nobody does.
    is_still = leaves_nothing and not path.with_name(path.name + "-wal").exists()
    how = "mode=ro&immutable=1" if is_still else "mode=ro"
    return sqlite3.connect(f"{path.absolute().as_uri()}?{how}", uri=True, isolation_level=None, timeout=5.0)


def _utc(wall_ns: int | None) -> str | None:
    return None if wall_ns is None else datetime.fromtimestamp(wall_ns / NS_PER_S, tz=UTC).isoformat(timespec="milliseconds")
