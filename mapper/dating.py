"""When an encounter was, of which several records tell: badly dated ones are set right by a biobot's own clock first. Pure.

A side that two records have in common is at the same ticks of its biobot's clock in both. Where one of them has that clock within 0.1 s
and the other has not (a gateway that has hardly heard the biobot yet), or where the two contradict each other (a gateway whose wall clock
is wrong, and not set right yet), the one is believed: the other is moved to where the same tick is by it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from mapper.own_spans import PLACES_A_LIFE, SETTLED_NS, ZEROS

SAME_LIFE_NS: Final = 86_400_000_000_000
"""Two gateways' wall clocks tell the begin of one life of a backpack no further apart [ns]; a count of starts that was lost and begins
anew gives other lives the same numbers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DatedRecord:
    """A record's interval and error [ns], and `own_spans.N_NUMBERS` numbers. Of records dated equally well the first gateway's decides."""

    begin: int
    end: int
    error: int
    gateway: str
    own: tuple[int, ...]

    def sides(self) -> "list[_Side | None]":
        """Return how each of the two dates it; None: it has not told, or on no own clock."""
        by_axis = (self.own[:4], self.own[4:])
        return [_Side(first // PLACES_A_LIFE, zero, error) if first >= 0 else None for first, _, zero, error in by_axis]


class _Side(NamedTuple):
    """The life of a backpack, when its clock showed 0 [ns] and how wrong that may be [ns]."""

    life: int
    zero: int
    error: int

    def is_of_life_of(self, other: "_Side") -> bool:
        return self.life == other.life and abs(self.zero - other.zero) <= SAME_LIFE_NS


def agree(records: Iterable[DatedRecord]) -> tuple[int, int]:
    """Return begin and end of the encounter that at least one record tells of."""
    placed: list[DatedRecord] = []
    for record in sorted(records, key=_trust):
        placed.append(_move(record, placed))
    begin = _agreed((one.begin, one.error) for one in placed)
    return begin, max(begin, -_agreed((-one.end, one.error) for one in placed))


def _trust(record: DatedRecord) -> tuple[int, str, int, int, tuple[int, ...]]:
    """Order records by how well their worse side is dated, all that are dated well alike."""
    worst = max((side.error for side in record.sides() if side is not None), default=0)
    return (worst if worst > SETTLED_NS else 0), record.gateway, record.begin, record.end, record.own


def _move(record: DatedRecord, placed: Sequence[DatedRecord]) -> DatedRecord:
    """Put a record where the first of those that are better known has it, if it may be wrong or is."""
    sides = record.sides()
    is_known = {side.error <= SETTLED_NS for side in sides if side is not None}
    if len(is_known) > 1:
        return record  # its better side dates it
    for other in placed:
        for side, theirs in zip(sides, other.sides(), strict=True):
            if side is None or theirs is None or not side.is_of_life_of(theirs):
                continue
            later = theirs.zero - side.zero
            may_be_wrong = side.error > max(SETTLED_NS, theirs.error)
            if may_be_wrong or abs(later) > 2 * SETTLED_NS + side.error + theirs.error:
                return DatedRecord(
                    begin=record.begin + later,
                    end=record.end + later,
                    error=max(0, record.error - side.error) + min(side.error, theirs.error),
                    gateway=record.gateway,
                    own=tuple(number + later if place in ZEROS else number for place, number in enumerate(record.own)),
                )
    return record


def _agreed(told: Iterable[tuple[int, int]]) -> int:
    """Return the middle of what the earliest instant, and those after it that can agree with it, allow; each is given with its error."""
    (instant, error), *others = sorted(told)
    earliest, latest = instant - error, instant + error
    for instant, error in others:
        if max(earliest, instant - error) <= min(latest, instant + error):
            earliest, latest = max(earliest, instant - error), min(latest, instant + error)
    return (earliest + latest) // 2
