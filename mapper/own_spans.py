"""What the two biobots of an encounter told of it on their own clocks: what no gateway's clock can falsify. Pure.

A backpack's clock starts anew with each of its starts, and starts are counted (WIRE_FORMAT.md §1). A *place* is a tick of the life of a
backpack: the count of its starts times 2**32, and the tick. What is told again, to whichever gateway, is at the same place.
"""

from collections.abc import Sequence
from typing import Final, Protocol

import msgspec
import numpy as np

from firmware_protocol.contract.records import OwnSpan
from firmware_protocol.units import NS_PER_MS
from mapper.types import IntArray

N_NUMBERS: Final = 8
"""Of the biobot with the lower id, then of the other: first and last place (-1: not told), when its clock showed 0 by the gateway's wall
clock [ns], and how wrong that may be [ns]."""

ZEROS: Final = [2, 6]
"""Which of them are instants."""

ERRORS: Final = [3, 7]
"""Which of them are errors; 0 where nothing was told."""

SETTLED_NS: Final = 100_000_000
"""A biobot's clock that is known so well is believed, as `gateway.clocks` has it."""

PLACES_A_LIFE: Final = 1 << 32
_MAX_BOOT: Final = 0xFFFF
_MAX_INTEGER: Final = 2**63
_MAX_WALL_NS: Final = 2**62
_MAX_ERROR_NS: Final = 40_000_000_000


class Side(Protocol):
    """The part of an `EncounterSide` that is looked at."""

    @property
    def node(self) -> int: ...  # noqa: D102
    @property
    def t_start_ns(self) -> int: ...  # noqa: D102
    @property
    def error_ns(self) -> int | None: ...  # noqa: D102
    @property
    def own_clock(self) -> OwnSpan | msgspec.UnsetType: ...  # noqa: D102


class SidedRecord(Protocol):
    """The part of an `EncounterRecord` that is looked at."""

    @property
    def wall_anchor_ns(self) -> int: ...  # noqa: D102
    @property
    def error_ns(self) -> int: ...  # noqa: D102
    @property
    def node_a(self) -> int: ...  # noqa: D102
    @property
    def node_b(self) -> int: ...  # noqa: D102
    @property
    def sides(self) -> Sequence[Side]: ...  # noqa: D102


def make_own_spans(records: Sequence[SidedRecord]) -> IntArray:
    """Return `N_NUMBERS` rows of numbers, shape (8, m); a side whose numbers cannot be meant counts as not told."""
    spans = np.zeros((2, 4, len(records)), dtype=np.int64)
    spans[:, :2] = -1
    told = [
        (place, int(side.node != low), own.boot, own.start_ms, own.end_ms, side.t_start_ns, record.wall_anchor_ns, error)
        for place, record in enumerate(records)
        for low, high in (_in_order(record.node_a, record.node_b),)
        for side in record.sides
        if (own := side.own_clock) is not msgspec.UNSET and side.node in {low, high}
        for error in (record.error_ns if side.error_ns is None else side.error_ns,)
    ]
    if told:
        try:
            numbers = np.array(told, dtype=np.int64).T
        except OverflowError:
            numbers = np.array([one for one in told if max(map(abs, one)) < _MAX_INTEGER], dtype=np.int64).reshape(-1, 8).T
        _put(numbers, into=spans)
    return spans.reshape(N_NUMBERS, -1)


def _in_order(one: int, other: int) -> tuple[int, int]:
    return (one, other) if one < other else (other, one)


def _put(numbers: IntArray, *, into: IntArray) -> None:
    """Put what can be meant where it belongs."""
    place, axis, boot, start_ms, end_ms, start_ns, anchor_ns, error_ns = numbers
    begin_ns = start_ns.astype(np.float64) + anchor_ns  # as floats: a sum of any two numbers does not overflow
    is_meant = (boot >= 0) & (boot <= _MAX_BOOT) & (start_ms >= 0) & (start_ms <= end_ms) & (start_ms < PLACES_A_LIFE)
    is_meant &= (begin_ns >= 0) & (begin_ns < _MAX_WALL_NS)
    place, axis, boot, start_ms, end_ms, start_ns, anchor_ns, error_ns = numbers[:, is_meant]
    first, last = (boot * PLACES_A_LIFE + np.minimum(ms, PLACES_A_LIFE - 1) for ms in (start_ms, end_ms))
    zero_ns = start_ns + anchor_ns - start_ms * NS_PER_MS
    for number, values in enumerate((first, last, zero_ns, np.clip(error_ns, 0, _MAX_ERROR_NS))):
        into[axis, number, place] = values
