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

PLACES_A_LIFE: Final = 1 << 32
_MAX_BOOT: Final = 0xFFFF
_NOT_TOLD: Final = (-1, -1, 0, 0)
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
    told = [
        (*_numbers_of(record, min(record.node_a, record.node_b)), *_numbers_of(record, max(record.node_a, record.node_b)))
        for record in records
    ]
    return np.array(told, dtype=np.int64).reshape(-1, N_NUMBERS).T


def _numbers_of(record: SidedRecord, node: int) -> tuple[int, int, int, int]:
    for side in record.sides:
        own = side.own_clock
        if side.node != node or isinstance(own, msgspec.UnsetType):
            continue
        boot, start_ms, end_ms = own.boot, own.start_ms, own.end_ms
        start_ns = side.t_start_ns + record.wall_anchor_ns
        if 0 <= boot <= _MAX_BOOT and 0 <= start_ms <= end_ms and start_ms < PLACES_A_LIFE and 0 <= start_ns < _MAX_WALL_NS:
            error_ns = record.error_ns if side.error_ns is None else side.error_ns
            first, last = (boot * PLACES_A_LIFE + min(ms, PLACES_A_LIFE - 1) for ms in (start_ms, end_ms))
            return first, last, start_ns - start_ms * NS_PER_MS, max(0, min(error_ns, _MAX_ERROR_NS))
    return _NOT_TOLD
