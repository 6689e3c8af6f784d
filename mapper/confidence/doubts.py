"""What in the contacts is unlike the runs on which a map's probabilities were checked."""

from typing import Final

from mapper.confidence.sufficiency import ACROSS_PARTS, MUCH_APART, Doubt
from mapper.contact_statistics import ContactStatistics, has_fine_times, shows_fineness, walks_at_random

_MUCH_OVERLAP: Final = 0.1
"""Of all rows: two that meet twice at once are a fault of the log."""


def doubt_repeats(statistics: ContactStatistics) -> tuple[Doubt, ...]:
    """Doubt encounters that are told twice, once by either side, a little differently."""
    if statistics.overlapping <= _MUCH_OVERLAP:
        return ()
    share = f"{statistics.overlapping:.0%} of the encounters begin while another one of the same two lasts"
    return (Doubt(reason=f"{share}, as where each side tells of it in a row of its own: they count twice", remedy="join them: --gap-s 0"),)


def doubt_movement(statistics: ContactStatistics) -> tuple[Doubt, ...]:
    """Doubt a map whose nodes do not move as in those runs."""
    if walks_at_random(statistics):
        return ()
    repeats = doubt_repeats(statistics)
    if repeats:
        return repeats
    if statistics.apart > MUCH_APART:
        return (
            Doubt(reason="the nodes meet in parts that have no meeting in common: no run that was checked has that", remedy=ACROSS_PARTS),
        )
    return (
        Doubt(
            reason="the nodes do not walk at random: the probabilities were checked on random walkers only",
            remedy="make the nodes cross the open places, by steering or a lure: more time alone does not help",
        ),
    )


def doubt_times(statistics: ContactStatistics, *, tick_ns: int) -> tuple[Doubt, ...]:
    """Doubt a map of a log with long silences, or whose times are told too coarsely; ``tick_ns``: as finely as the log tells them."""
    found = []
    if statistics.silences_ns:
        found.append(
            Doubt(
                reason="nobody meets anybody for long, as over a night, which counts as time on the way: no run that was checked has that",
                remedy="map the times before and after by themselves (--from-s, --until-s)",
            )
        )
    if not has_fine_times(statistics, tick_ns=tick_ns) and not shows_fineness(statistics):
        found.append(
            Doubt(
                reason="the encounters are too few to see how finely times are told, and whether anybody walks", remedy="record for longer"
            )
        )
    elif not has_fine_times(statistics, tick_ns=tick_ns):
        found.append(
            Doubt(
                reason="times are told too coarsely to tell walking from standing: no run that was checked has that",
                remedy="record times more finely",
            )
        )
    return tuple(found)
