"""Which encounters of each start of a gateway its clock is judged by: a bounded draw, the same pairs of biobots everywhere. Pure."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mapper.clock_votes import ClockSample
from mapper.types import IntArray

MAX_SAMPLE: Final = 8_192
"""Rows drawn from one start of a gateway, at most."""
_FEW_PAIRS: Final = 16


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledRows:
    """What a sample is made of, by row: shape (m,). ``is_usable``: it counts, and its end is final."""

    source: IntArray
    pair: IntArray
    middle_ns: IntArray
    length_ns: IntArray
    is_usable: NDArray[np.bool_]


def number_pairs(low: IntArray, high: IntArray) -> IntArray:
    """Return a number for each two ids, spread evenly over 64 bits; which pairs are drawn goes by it.

    References
    ----------
    The finalizer of SplitMix64, Steele, Lea and Flood 2014, applied to one id after the other. Two of a million pairs share a number
    with a chance of 3e-8; a wrong vote is all that comes of it.
    """
    return _mix(_mix(low.view(np.uint64)) + high.view(np.uint64)).view(np.int64)


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: NDArray[np.uint64] = x ^ (x >> np.uint64(31))
    return mixed


@dataclass(slots=True)
class SourceSample:
    """The rows drawn from one source: all of them, then of every second pair, every fourth, ... as they become too many.

    Where there are few pairs, the newest encounters are kept instead: a pair more or less would be all or nothing.
    """

    level: int = 0
    version: int = 0
    """Grows with every change."""
    _rows: list[int] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, rows: IntArray, pairs: IntArray) -> None:
        """Take rows of this source that are new, or have changed; those not drawn are passed over."""
        drawn = rows[is_drawn(pairs, level=self.level)]
        if len(drawn):
            self._rows += drawn.tolist()
            self.version += 1

    @property
    def rows(self) -> IntArray:
        """The rows, ascending, each once."""
        rows = np.sort(np.array(self._rows, dtype=np.int64))
        return rows[np.append(True, rows[1:] != rows[:-1])] if len(rows) else rows

    def thin(self, rows: IntArray, facts: SampledRows, *, source: int) -> tuple[IntArray, SampledRows]:
        """Drop what left the source, and what is too much; return what is left."""
        stays = facts.source == source
        rows, facts = rows[stays], _choose(facts, stays)
        while len(rows) > MAX_SAMPLE:
            if len(np.unique(facts.pair)) > _FEW_PAIRS:
                self.level += 1
                stays = is_drawn(facts.pair, level=self.level)
            else:
                stays = np.zeros(len(rows), dtype=np.bool_)
                stays[np.lexsort((rows, facts.middle_ns))[-MAX_SAMPLE // 2 :]] = True
            rows, facts = rows[stays], _choose(facts, stays)
        self._rows = rows.tolist()
        return rows, facts


def is_drawn(pairs: IntArray, *, level: int) -> NDArray[np.bool_]:
    """Say of each pair whether it is drawn: one of 2**level is."""
    drawn: NDArray[np.bool_] = pairs.view(np.uint64) >> np.uint64(64 - level) == 0 if level else np.ones(len(pairs), dtype=np.bool_)
    return drawn


def make_sample(facts: SampledRows, *, level: int) -> ClockSample:
    """Make what is compared; ``level`` is the higher of the two sources'."""
    chosen = facts.is_usable & is_drawn(facts.pair, level=level)
    return ClockSample(pair=facts.pair[chosen], middle_ns=facts.middle_ns[chosen], length_ns=facts.length_ns[chosen])


def _choose(facts: SampledRows, stays: NDArray[np.bool_]) -> SampledRows:
    return SampledRows(
        source=facts.source[stays],
        pair=facts.pair[stays],
        middle_ns=facts.middle_ns[stays],
        length_ns=facts.length_ns[stays],
        is_usable=facts.is_usable[stays],
    )
