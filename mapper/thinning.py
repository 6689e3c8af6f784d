"""Which of many things that were made over time are kept: all of the newest, and fewer the older they are. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Rung:
    """Of what is older than ``beyond_s``, one in each ``every_s`` is kept, counted from 1970."""

    beyond_s: int
    every_s: int


def make_ladder(*, all_s: int, minutes_s: int, ten_minutes_s: int) -> tuple[Rung, ...]:
    """Keep all of the newest, then one a minute, then one in ten, then one an hour; each until so long ago, ascending [s]."""
    return (Rung(beyond_s=all_s, every_s=60), Rung(beyond_s=minutes_s, every_s=600), Rung(beyond_s=ten_minutes_s, every_s=3600))


def choose_kept(walls_ns: Sequence[int], *, now_ns: int, ladder: Sequence[Rung]) -> list[bool]:
    """Say which are kept: of each period of its rung the first, and the newest of all.

    Parameters
    ----------
    walls_ns
        When they were made, ascending.
    ladder
        Ascending in both; each ``every_s`` a multiple of the one before.

    Notes
    -----
    Choosing now and later keeps what choosing later alone keeps, but for the newest of now.
    """
    kept: list[bool] = []
    last: tuple[int, int] | None = None
    for wall_ns in walls_ns:
        age_s = (now_ns - wall_ns) / _NS_PER_S
        every_s = max((rung.every_s for rung in ladder if age_s > rung.beyond_s), default=0)
        period = None if not every_s else (every_s, wall_ns // (every_s * _NS_PER_S))
        kept.append(period is None or period != last)
        last = period
    if kept:
        kept[-1] = True
    return kept
