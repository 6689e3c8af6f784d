"""How far the mapper's store has come with each gateway's journal, read from their files while both are in use."""

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from gateway.journal_file import JournalReader

_BEYOND = 1 << 62


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """Of one gateway: the newest offset of its journal, and up to where the store has everything."""

    head: int
    watermark: int

    @property
    def is_level(self) -> bool:
        """Whether the store has all that there is."""
        return self.watermark >= self.head


def read_head(journal: Path) -> int:
    """Return the newest offset of a journal; 0 where there is none yet."""
    if not journal.exists():
        return 0
    try:
        with closing(JournalReader(journal)) as reader:
            return reader.read_records(from_offset=_BEYOND, limit=1)[1]
    except sqlite3.Error:
        return 0  # it is just being made


def read_watermarks(store: Path) -> dict[str, int]:
    """Return the watermark of each gateway's newest journal in a mapper's store; empty where there is none yet, or it cannot be read now.

    The mapper holds its file locked for itself, so this reads past the lock, writes nothing, and may see a moment ago: good enough to
    see how far it has come. The account is made of the file when the mapper has ended.
    """
    if not store.exists():
        return {}
    query = "SELECT gateway.name, watermark FROM source JOIN gateway ON gateway.id = source.gateway ORDER BY source.id"
    try:
        with closing(sqlite3.connect(f"file:{store}?mode=ro&vfs=unix-none", uri=True)) as database:
            database.execute("PRAGMA locking_mode = EXCLUSIVE")  # with an index of the log in its own memory
            return dict(database.execute(query).fetchall())
    except sqlite3.Error:
        return {}  # it is just being made, or its disk is full


def read_levels(journals: dict[str, Path], store: Path) -> dict[str, Level]:
    """Return the level of every gateway."""
    watermarks = read_watermarks(store)
    return {name: Level(head=read_head(path), watermark=watermarks.get(name, 0)) for name, path in journals.items()}
