"""What backpacks put into their messages, on disk before it goes on the air: rows of one fixed size, whole after any kill."""

import os
from pathlib import Path
from types import TracebackType
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

ROW = np.dtype(
    [
        ("is_mode", "u1"), ("node", "<u2"), ("boot", "<u2"), ("sequence", "<u2"), ("peer", "<u2"), ("rssi_dbm", "i1"), ("flag", "u1"),
        ("start_ms", "<u4"), ("duration_ms", "<u4"), ("start_ns", "<i8"), ("end_ns", "<i8"),
    ]
)  # fmt: skip
"""A reported encounter: ``flag`` is 1 where it went on; ``start_ns`` and ``end_ns`` are true, on the machine's monotonic clock.
A reported mode (``is_mode``): ``peer`` is the mode's number, ``flag`` its cause's, ``start_ms`` and ``start_ns`` when it began."""

Rows: TypeAlias = NDArray[np.void]
Row: TypeAlias = tuple[int, int, int, int, int, int, int, int, int, int, int]


class Ledger:
    """A file of rows that is added to."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._waiting: list[Row] = []
        self.n_rows = 0

    def add(self, row: Row) -> None:
        """Take a row; it is on disk after the next ``flush``."""
        self._waiting.append(row)

    def flush(self) -> None:
        """Hand what waits to the operating system."""
        if self._waiting:
            data = np.array(self._waiting, dtype=ROW).tobytes()
            while data:
                data = data[os.write(self._fd, data) :]
            self.n_rows += len(self._waiting)
            self._waiting.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.flush()
        os.close(self._fd)


def read_ledger(path: Path) -> Rows:
    """Return all whole rows of a file."""
    data = path.read_bytes()
    return np.frombuffer(data[: len(data) // ROW.itemsize * ROW.itemsize], dtype=ROW)
