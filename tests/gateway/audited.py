"""Journals with an audit log, and what somebody may do to one."""

import contextlib
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import msgspec

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import encode_record
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.journal_file import AuditEntry, JournalFile, JournalWrite, SegmentBuilder, open_journal_file

WALL_NS = 1_795_000_000 * 10**9
_COLUMNS = "kind, wall_ns, ran_ns, boot, mono_ns, operator, node, command_id, wire_command, stage, train_ms, request, body, chain"


def a_stage(number: int, *, node: int = 3, operator: str = "ann", stage: Stage = Stage.ACCEPTED, reason: str = "") -> AuditEntry:
    """Return a stage of command ``c{number}``, a turn to the left; 500 ms where it is accepted."""
    wall_ns = WALL_NS + number * 10**9
    request = StimulationRequest(
        command_id=f"c{number}",
        node=NodeId(node),
        action=StimulationAction.TURN_LEFT,
        operator=operator,
        issued_wall_ns=Nanoseconds(wall_ns),
    )
    told = CommandStage(
        command_id=f"c{number}",
        gateway="g",
        node=NodeId(node),
        action=StimulationAction.TURN_LEFT,
        stage=stage,
        wall_ns=Nanoseconds(wall_ns),
        reason=reason,
        operator=operator,
    )
    return AuditEntry(
        wall_ns=wall_ns,
        command_id=request.command_id,
        wire_command=100 + number,
        stage=stage.value,
        node=request.node,
        train_ms=500 if stage is Stage.ACCEPTED else 0,
        request=encode_record(request),
        body=encode_record(told),
        operator=operator,
        mono_ns=number * 10**9,
    )


def a_note(number: int, **facts: object) -> AuditEntry:
    return AuditEntry(wall_ns=WALL_NS + number, kind="order", operator="ben", body=msgspec.msgpack.encode({"number": number, **facts}))


def commit(file: JournalFile, entries: Iterable[AuditEntry]) -> None:
    """Commit entries together."""
    builder = SegmentBuilder(first_offset=1, windows=file.windows)
    for entry in entries:
        builder.add(JournalWrite(audit=entry))
    file.commit(builder)


def write_audited(path: Path, n_rows: int) -> None:
    """Write a journal with stages, and a note after each second one; one to three rows a commit."""
    file = open_journal_file(path, now_wall_ns=WALL_NS, now_ns=0, machine_boot="m", gateway="g")
    rows = [a_note(number) if number % 3 == 2 else a_stage(number, node=number % 4) for number in range(n_rows)]
    while rows:
        size = 1 + len(rows) % 3
        commit(file, rows[:size])
        del rows[:size]
    file.close()


class Image:
    """A closed journal, to be opened in memory as often as wanted."""

    def __init__(self, path: Path) -> None:
        # In memory there is no write-ahead log: SQLite's file format, 1.3.3.
        octets = bytearray(path.read_bytes())
        octets[18:20] = b"\x01\x01"
        self._octets = bytes(octets)

    @contextlib.contextmanager
    def opened(self) -> Iterator[sqlite3.Connection]:
        with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as database:
            database.deserialize(self._octets)
            yield database


def delete(first: int, last: int, *, is_closed_up: bool = False) -> Callable[[sqlite3.Connection], None]:
    """Take rows out; ``is_closed_up``: those behind get their numbers."""

    def edit(database: sqlite3.Connection) -> None:
        database.execute("DELETE FROM audit WHERE id BETWEEN ? AND ?", (first, last))
        if is_closed_up:
            _shift(database, after=last, by=first - last - 1)

    return edit


def swap(one: int, other: int) -> Callable[[sqlite3.Connection], None]:
    """Exchange the numbers of two rows."""

    def edit(database: sqlite3.Connection) -> None:
        for was, becomes in ((one, 0), (other, one), (0, other)):
            database.execute("UPDATE audit SET id = ? WHERE id = ?", (becomes, was))

    return edit


def insert(number: int, *, copy_of: int) -> Callable[[sqlite3.Connection], None]:
    """Put a copy of a row at a number, and let those from there on move up."""

    def edit(database: sqlite3.Connection) -> None:
        row = database.execute(f"SELECT {_COLUMNS} FROM audit WHERE id = ?", (copy_of,)).fetchone()  # a constant
        _shift(database, after=number - 1, by=1)
        database.execute(f"INSERT INTO audit (id, {_COLUMNS}) VALUES (?{', ?' * len(row)})", (number, *row))  # a constant

    return edit


def _shift(database: sqlite3.Connection, *, after: int, by: int) -> None:
    numbers = [number for (number,) in database.execute("SELECT id FROM audit WHERE id > ? ORDER BY id", (after,))]
    for number in numbers if by < 0 else reversed(numbers):
        database.execute("UPDATE audit SET id = ? WHERE id = ?", (number + by, number))
