"""Tell whether every meeting of a timetable is in the mapper's store, once and unaltered, and how long each report took to get there."""

import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from firmware_protocol.units import NS_PER_MS

_CHUNK: Final = 20_000
_TOLERANCE_NS: Final = 150 * NS_PER_MS
"""A backpack's clock is known at least this well, and a pair meets again much later."""

_RATE_NS: Final = NS_PER_MS // 10
"""A meeting's duration is told to the millisecond, and stretched by the rate of its backpack's clock."""

IntArray = npt.NDArray[np.int64]


class _Side(msgspec.Struct, frozen=True, gc=False):
    node: int
    t_start_ns: int
    t_end_ns: int


class _Lean(msgspec.Struct, frozen=True, gc=False, tag="encounter"):
    node_a: int
    node_b: int
    t_start_ns: int
    t_end_ns: int
    is_reciprocal: bool
    is_void: bool = False
    sides: tuple[_Side, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """How the store compares with the timetable; ``latency_ns`` is of every meeting that is there, from its last report's sending."""

    n_expected: int
    n_found: int
    n_lost: int
    n_duplicated: int
    n_altered: int
    latency_ns: IntArray

    @property
    def is_good(self) -> bool:
        """Everything is there once and as it was said."""
        return not (self.n_lost or self.n_duplicated or self.n_altered)


def check_store(store: Path, timetable: Path, *, seen: Path | None) -> Verdict:
    """Compare a store that no process has open with a timetable.

    Parameters
    ----------
    seen
        When the store had come how far, by ``store_watch``; None: no latencies are asked for.
    """
    with np.load(timetable) as arrays:
        n_biobots, _, n_sides, per_message, n_messages, duration_ms = arrays["shape"].tolist()
        round_ns, sent_ns = arrays["round_ns"], arrays["sent_ns"]
    n_rounds, n_shifts = n_messages * per_message, n_biobots // 2 - 1
    changes, columns, n_altered = _read(store, duration_ns=duration_ms * NS_PER_MS, n_sides=n_sides)
    node_a, node_b, start_ns = columns
    ahead = (node_b - node_a) % n_biobots
    is_first = ahead <= n_shifts  # which of the two has the other so many places after it
    first = np.where(is_first, node_a, node_b)
    shift = np.where(is_first, ahead, n_biobots - ahead)
    # Of the rounds in which this pair meets, the one that began nearest.
    found_round = _nearest_round(round_ns[:n_rounds], shift - 1, start_ns, step=n_shifts)
    is_known = found_round >= 0
    n_altered += int(np.count_nonzero(~is_known))
    key = found_round[is_known] * n_biobots + (first[is_known] - 1)
    times = np.bincount(key, minlength=n_rounds * n_biobots)
    latency = np.empty(0, dtype=np.int64)
    if seen is not None:
        progress = np.load(seen)
        at = np.searchsorted(progress[:, 1], changes[is_known])
        message = found_round[is_known] // per_message
        said_ns = sent_ns[first[is_known] - 1, message]
        if n_sides == 2:
            other = (first[is_known] - 1 + shift[is_known]) % n_biobots
            said_ns = np.maximum(said_ns, sent_ns[other, message])
        latency = progress[np.minimum(at, len(progress) - 1), 0] - said_ns
    return Verdict(
        n_expected=n_rounds * n_biobots,
        n_found=len(key),
        n_lost=int(np.count_nonzero(times == 0)),
        n_duplicated=int(np.sum(np.maximum(times - 1, 0))),
        n_altered=n_altered,
        latency_ns=latency,
    )


def _nearest_round(round_ns: IntArray, residue: IntArray, start_ns: IntArray, *, step: int) -> IntArray:
    """Return the round of each meeting: of those congruent to its residue the one that begins nearest; -1 where none is near."""
    found = np.full(len(start_ns), -1, dtype=np.int64)
    for rest in range(min(step, len(round_ns))):
        rounds = np.arange(rest, len(round_ns), step)
        members = np.flatnonzero(residue == rest)
        right = np.searchsorted(round_ns[rounds], start_ns[members]).clip(1, max(len(rounds) - 1, 1))
        left = right - 1
        right = np.minimum(right, len(rounds) - 1)
        nearer = np.where(
            np.abs(round_ns[rounds[left]] - start_ns[members]) <= np.abs(round_ns[rounds[right]] - start_ns[members]), left, right
        )
        chosen = rounds[nearer]
        is_near = np.abs(round_ns[chosen] - start_ns[members]) <= _TOLERANCE_NS
        found[members[is_near]] = chosen[is_near]
    return found


def _read(store: Path, *, duration_ns: int, n_sides: int) -> tuple[IntArray, tuple[IntArray, IntArray, IntArray], int]:
    """Return the changes of all encounters that count, their pairs and starts, and how many are not as they were said."""
    decoder = msgspec.msgpack.Decoder(_Lean)
    parts: list[npt.NDArray[np.int64]] = []
    n_altered = 0
    database = sqlite3.connect(f"file:{store}?mode=ro", uri=True)
    try:
        cursor = database.execute("SELECT change, body FROM record WHERE kind = 0")
        while chunk := cursor.fetchmany(_CHUNK):
            rows: list[tuple[int, int, int, int]] = []
            for change, body in chunk:
                record = decoder.decode(body)
                if record.is_void:
                    continue
                is_whole = len(record.sides) == n_sides and record.is_reciprocal == (n_sides == 2)
                n_altered += not (is_whole and all(abs(side.t_end_ns - side.t_start_ns - duration_ns) <= _RATE_NS for side in record.sides))
                rows.append((change, record.node_a, record.node_b, record.t_start_ns))
            if rows:
                parts.append(np.array(rows, dtype=np.int64))
    finally:
        database.close()
    whole = np.concatenate(parts) if parts else np.empty((0, 4), dtype=np.int64)
    return whole[:, 0], (whole[:, 1], whole[:, 2], whole[:, 3]), n_altered
