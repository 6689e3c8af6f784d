"""What a reader of tables hands on: contacts between codes of ids, what stood behind the codes, and what was met on the way."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mapper.reading.column_names import Layout
from mapper.types import IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RawLog:
    """Rows of a log, shape (n,) each.

    ``start_ns`` and ``end_ns`` [ns of the log's clock]; equal where the log has instants. ``code1`` and ``code2`` stand for the ids in
    ``texts1`` and ``texts2``, which are one table unless the second ids are places; None: they are the ids themselves. Rows of one node
    with itself are left out: ``n_selves`` of them, the first in line ``self_line``. ``notes`` say how times were understood.
    """

    kind: str
    layout: Layout
    start_ns: IntArray
    end_ns: IntArray
    code1: IntArray
    code2: IntArray
    texts1: Mapping[int, str] | None = None
    texts2: Mapping[int, str] | None = None
    n_selves: int = 0
    self_line: int | None = None
    notes: tuple[str, ...] = ()
    lacks_zone: bool = False


@dataclass(slots=True, kw_only=True, eq=False)
class Pieces:
    """Columns that grow piece by piece."""

    _columns: list[tuple[IntArray, ...]] = field(default_factory=list)

    def add(self, *columns: IntArray) -> None:
        """Append a piece of every column."""
        self._columns.append(columns)

    def join(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Return the four columns whole; the pieces are gone then."""
        pieces, self._columns = self._columns, []
        if not pieces:
            return tuple(np.zeros(0, dtype=np.int64) for _ in range(4))  # type: ignore[return-value]  # four of them
        start, end, code1, code2 = (np.concatenate([piece[k] for piece in pieces]) for k in range(4))
        return start, end, code1, code2


@dataclass(slots=True, kw_only=True)
class Faults:
    """Faults of one file: the first ones in words, the others counted."""

    limit: int = 10
    shown: list[str] = field(default_factory=list)
    count: int = 0

    def add(self, place: int, reason: str, *, what: str = "line") -> None:
        """Note one."""
        self.count += 1
        if len(self.shown) < self.limit:
            self.shown.append(f"{what} {place}: {reason}")
