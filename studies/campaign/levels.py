"""How far the mapper's store has come with each gateway's journal, read from their files while both are in use."""

import contextlib
import shutil
import sqlite3
import tempfile
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
    """Return the newest offset of a journal; 0 where there is none yet, or it cannot be read now."""
    if not journal.exists():
        return 0
    try:
        with closing(JournalReader(journal)) as reader:
            return reader.read_records(from_offset=_BEYOND, limit=1)[1]
    except sqlite3.Error:
        return 0  # it is just being made, or waits for its gateway to recover it


def read_watermarks(store: Path, *, window: Path | None) -> dict[str, int]:
    """Return the watermark of each gateway's newest journal in a mapper's store; empty where there is none yet, or it cannot be read now.

    The mapper holds its file locked for itself. So this looks past the lock, through a ``window`` in which nothing can be written (an
    ordinary reader that is the last to leave may remove the log behind the writer's back), or at a copy where there is no window. It may
    see a moment ago, which is good enough here: the account is made of the file when the mapper has ended.
    """
    if not store.exists():
        return {}
    try:
        if window is not None:
            return _query(window / store.name)
        with tempfile.TemporaryDirectory() as directory:
            for name in (f"{store.name}-wal", store.name):
                with contextlib.suppress(FileNotFoundError):
                    shutil.copyfile(store.with_name(name), Path(directory) / name)
            return _query(Path(directory) / store.name)
    except (sqlite3.Error, OSError):
        return {}  # it is just being made, or its disk is full


def _query(store: Path) -> dict[str, int]:
    query = "SELECT gateway.name, watermark FROM source JOIN gateway ON gateway.id = source.gateway ORDER BY source.id"
    with closing(sqlite3.connect(f"file:{store}?mode=ro&vfs=unix-none", uri=True)) as database:
        database.execute("PRAGMA locking_mode = EXCLUSIVE")  # with an index of the log in its own memory
        return dict(database.execute(query).fetchall())


def read_levels(journals: dict[str, Path], store: Path, *, window: Path | None) -> dict[str, Level]:
    """Return the level of every gateway."""
    watermarks = read_watermarks(store, window=window)
    return {name: Level(head=read_head(path), watermark=watermarks.get(name, 0)) for name, path in journals.items()}
