"""What in the contacts is unlike the runs on which a map's probabilities were checked."""

from mapper.confidence.sufficiency import Doubt
from mapper.contact_statistics import ContactStatistics, has_fine_times, walks_at_random


def doubt_movement(statistics: ContactStatistics) -> tuple[Doubt, ...]:
    """Doubt a map whose nodes do not move as in those runs."""
    if walks_at_random(statistics):
        return ()
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
    if not has_fine_times(statistics, tick_ns=tick_ns):
        found.append(
            Doubt(
                reason="times are told too coarsely to tell walking from standing: no run that was checked has that",
                remedy="record times more finely",
            )
        )
    return tuple(found)
