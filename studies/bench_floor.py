"""What encoding, a journal's insert and a store's upsert of one encounter cost without a gateway around them: something to compare with."""

import sqlite3
import time
from pathlib import Path
from typing import Final

from firmware_protocol.contract.records import EncounterRecord, EncounterSide, encode_journal_record
from firmware_protocol.units import BootId, Nanoseconds, NodeId, RssiDbm

_N: Final = 50_000
_GROUP: Final = 500


def measure_floor(directory: Path) -> dict[str, float]:
    """Return processor time per record [us], by what is done with it."""
    directory.mkdir(parents=True, exist_ok=True)
    records = [_record(number) for number in range(_N)]
    begun = time.process_time()
    bodies = [encode_journal_record(record) for record in records]
    encoding = time.process_time() - begun
    return {
        "encoding a record with msgspec": encoding / _N * 1e6,
        "inserting it into a SQLite table by number": _fill(directory / "floor.sqlite", bodies, "(number INTEGER PRIMARY KEY, body BLOB)"),
        "and into one with a unique key of three numbers": _fill(
            directory / "floor_keyed.sqlite", bodies, "(number INTEGER, body BLOB, a INTEGER DEFAULT 1, UNIQUE (a, number))"
        ),
    }


def _fill(path: Path, bodies: list[bytes], columns: str) -> float:
    path.unlink(missing_ok=True)
    database = sqlite3.connect(path, isolation_level=None)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute(f"CREATE TABLE record {columns}")
    begun = time.process_time()
    for at in range(0, len(bodies), _GROUP):
        database.execute("BEGIN")
        database.executemany("INSERT INTO record (number, body) VALUES (?, ?)", enumerate(bodies[at : at + _GROUP], start=at))
        database.execute("COMMIT")
    spent = time.process_time() - begun
    database.close()
    return spent / len(bodies) * 1e6


def _record(number: int) -> EncounterRecord:
    start_ns, end_ns = Nanoseconds(number * 1_000_000), Nanoseconds(number * 1_000_000 + 200_000_000)
    sides = tuple(EncounterSide(node=NodeId(node), t_start_ns=start_ns, t_end_ns=end_ns, rssi_dbm=RssiDbm(-60)) for node in (1, 2))
    return EncounterRecord(
        gateway="gateway1", journal="0123abcd", offset=number + 1, boot=BootId(1), sequence=number, revision=1, node_a=NodeId(1),
        wall_anchor_ns=Nanoseconds(1_700_000_000_000_000_000), node_b=NodeId(2), t_start_ns=start_ns, t_end_ns=end_ns,
        error_ns=Nanoseconds(5_000_000), is_reciprocal=True, sides=sides,
    )  # fmt: skip
