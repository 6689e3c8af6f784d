"""What the virtual backpacks of the bench firmware must report: `firmware_protocol/c/bench/bb_bench_encounters.c` once more, in Python."""

from dataclasses import dataclass
from itertools import combinations

SEED = 1
N_NODES = 12
N_MEETINGS = 40
FIRST_MS = 50_000
PERIOD_MS = 15_000
_MASK = 0xFFFFFFFF


@dataclass(frozen=True, slots=True, kw_only=True)
class Meeting:
    """Both sides' reports joined; on bench time, which all backpacks share."""

    low: int
    high: int
    start_ms: int
    duration_ms: int


def all_meetings() -> list[Meeting]:
    """Return what must be journaled, by pair and then by time."""
    return [_meeting(low, high, number) for low, high in combinations(range(1, N_NODES + 1), 2) for number in range(N_MEETINGS)]


def _meeting(low: int, high: int, number: int) -> Meeting:
    draw = _mix(SEED << 24 ^ number << 16 ^ low << 8 ^ high)
    start_ms = FIRST_MS + number * PERIOD_MS + draw % 4096
    return Meeting(low=low, high=high, start_ms=start_ms, duration_ms=1000 + (draw >> 12) % 2048)


def _mix(x: int) -> int:
    """Return the finalizer of MurmurHash3."""
    x ^= x >> 16
    x = x * 0x85EBCA6B & _MASK
    x ^= x >> 13
    x = x * 0xC2B2AE35 & _MASK
    return x ^ x >> 16
