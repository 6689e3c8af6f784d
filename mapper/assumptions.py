"""What a map of a log rests on, whether the log shows that it holds, and what follows where it does not."""

from collections.abc import Iterator, Sequence

from firmware_protocol.units import NS_PER_S
from mapper.confidence import ACROSS_PARTS, MUCH_APART
from mapper.contact_statistics import ContactStatistics, follows_lines, gathers, has_fine_times, keeps_company, shows_fineness
from mapper.reading import ProximityLog
from mapper.types import KNOWN_PLACES, Assumption, DataVerdict, MapResult, Standing

_FEWEST_WALKING = 10  # with as many, an obstacle of 2 m in 5 m x 5 m is not found in an hour (docs/feasibility.md)
_FEWEST_ENCOUNTERS = 15.0
_FEWEST_LANDMARKS = 3
_NS_PER_DAY = 86_400 * NS_PER_S
_OF_STRENGTH = ("rssi", "signal", "strength", "lqi")
_SHOWN_WARNINGS = 3


def judge_assumptions(log: ProximityLog, result: MapResult, standing: Standing, statistics: ContactStatistics) -> tuple[Assumption, ...]:
    """Judge what the map of a log rests on, in a fixed order; the last says whether the count of holes can be trusted."""
    judged = [
        Assumption(name="columns", holds=True, text=log.form),
        _clean_rows(log),
        _stands_still(result, standing),
        *_of_numbers(statistics),
        _one_component(result, statistics),
        _no_silence(statistics),
        *_of_movement(statistics),
        _fine_times(log, statistics),
        *_strength_is_used(log),
        _known_speed(result),
        Assumption(
            name=KNOWN_PLACES,
            holds=False,
            text="where the map lies is not known: it may be turned and mirrored, and fits no plan before places in it are known (--pins)",
        ),
    ]
    return (*judged, _hole_count(judged, result.data))


def _clean_rows(log: ProximityLog) -> Assumption:
    if not log.warnings:
        return Assumption(name="clean_rows", holds=True, text="every row was read as it stands")
    more = f"; and {len(log.warnings) - _SHOWN_WARNINGS} more" if len(log.warnings) > _SHOWN_WARNINGS else ""
    return Assumption(
        name="clean_rows", holds=False, text="rows were not taken as they stand: " + "; ".join(log.warnings[:_SHOWN_WARNINGS]) + more
    )


def _stands_still(result: MapResult, standing: Standing) -> Assumption:
    n_places = sum(part.n_landmarks for part in result.components)
    if n_places == 0:
        text = f"no node stands still, so distances measure time as much as place: {standing.reason}"
        return Assumption(name="stands_still", holds=False, text=text)
    if n_places < _FEWEST_LANDMARKS:
        text = f"nodes stand still at {n_places} places only; {_FEWEST_LANDMARKS} are needed to tell places apart by their distances"
        return Assumption(name="stands_still", holds=False, text=text)
    return Assumption(name="stands_still", holds=True, text=f"nodes stand still at {n_places} places: {standing.reason}")


def _of_numbers(statistics: ContactStatistics) -> Iterator[Assumption]:
    n, often = statistics.n_walking, statistics.encounters_of_walking
    few = f"{n} nodes walk; with fewer than {_FEWEST_WALKING} only large obstacles show, and only after long"
    yield Assumption(name="enough_nodes", holds=n >= _FEWEST_WALKING, text=few if n < _FEWEST_WALKING else f"{n} nodes walk")
    if often < _FEWEST_ENCOUNTERS:
        text = f"a walking node has {often:.3g} encounters; below {_FEWEST_ENCOUNTERS:g} distances are a guess: record for longer"
        yield Assumption(name="enough_encounters", holds=False, text=text)
    else:
        yield Assumption(name="enough_encounters", holds=True, text=f"a walking node has {often:.3g} encounters")


def _one_component(result: MapResult, statistics: ContactStatistics) -> Assumption:
    if result.n_components == 1:
        return Assumption(name="one_component", holds=True, text="every encounter is joined to every other by nodes that walked")
    text = f"the encounters fall into {result.n_components} components that no node joins: how they lie to each other is not known"
    if statistics.periods > 1:
        text += f"; they are of {statistics.periods} periods without a node in common, such as days with other visitors: map each by itself"
    return Assumption(name="one_component", holds=False, text=text)


def _no_silence(statistics: ContactStatistics) -> Assumption:
    silences = statistics.silences_ns
    if not silences:
        return Assumption(name="no_silence", holds=True, text="no time without contacts is longer than chance explains")
    text = (
        f"{_times(len(silences))} nobody meets anybody for up to {_span(max(silences))}, as over a night: this counts as time on the "
        "way, though nobody may have walked; map the times before and after by themselves (--from-s, --until-s)"
    )
    return Assumption(name="no_silence", holds=False, text=text)


def _of_movement(statistics: ContactStatistics) -> Iterator[Assumption]:
    uneven = statistics.unevenness
    if uneven is None:
        yield Assumption(
            name="even_meetings", holds=None, text="whether nodes move at random cannot be seen with so few or so many of them"
        )
    elif keeps_company(statistics) and statistics.apart > MUCH_APART:
        text = (
            f"how often pairs meet varies {uneven:.3g} times as much as by chance, for the nodes fall into parts that have no meeting in "
            f"common: {ACROSS_PARTS}"
        )
        yield Assumption(name="even_meetings", holds=False, text=text)
    elif keeps_company(statistics):
        text = (
            f"nodes do not move at random: how often pairs meet varies {uneven:.3g} times as much as by chance (walkers: 1 to 4), "
            "as where they keep company or to their own places"
        )
        yield Assumption(name="even_meetings", holds=False, text=text)
    else:
        text = f"pairs meet as evenly as walkers in an arena do: it varies {uneven:.3g} times as much as by chance"
        yield Assumption(name="even_meetings", holds=True, text=text)
    others = statistics.at_once
    if gathers(statistics):
        text = (
            f"nodes meet in groups: an encounter has {others:.3g} others with its two at once, {statistics.at_once_by_chance:.2g} would be "
            "chance; a gathering counts as many encounters"
        )
        yield Assumption(name="few_at_once", holds=False, text=text)
    else:
        text = f"the two of an encounter are with {others:.2g} others at once"
        yield Assumption(name="few_at_once", holds=True, text=text)
    alike = statistics.alike_lengths
    if alike is None:
        text = "whether nodes follow walls cannot be seen with so few encounters, or times so coarse"
        yield Assumption(name="free_ways", holds=None, text=text)
    elif follows_lines(statistics):
        text = (
            f"nodes go along lines, such as walls: {alike:.0%} more encounters than usual last equally long; the open between is not walked"
        )
        yield Assumption(name="free_ways", holds=False, text=text)
    else:
        yield Assumption(name="free_ways", holds=True, text="encounters last as long as those of nodes that cross an open place do")


def _fine_times(log: ProximityLog, statistics: ContactStatistics) -> Assumption:
    grid_ns = max(log.tick_ns, statistics.grid_ns)
    told = f"times are known to {_span(grid_ns)}, and a walking node meets another every {_span(round(statistics.interval_ns))}"
    if not shows_fineness(statistics):
        text = "whether times are told finely enough cannot be seen with so few encounters"
        return Assumption(name="fine_times", holds=None, text=text)
    if not has_fine_times(statistics, tick_ns=log.tick_ns):
        return Assumption(name="fine_times", holds=False, text=f"{told}: what is walked in less cannot be told from standing")
    return Assumption(name="fine_times", holds=True, text=told)


def _strength_is_used(log: ProximityLog) -> Iterator[Assumption]:
    columns = [name for name in log.ignored_columns if any(word in name.casefold() for word in _OF_STRENGTH)]
    if columns and not log.is_own:
        text = f"column {columns[0]!r} is not used, so contacts from far count as those from near; leave weak rows out where they are many"
        yield Assumption(name="equal_contacts", holds=None, text=text)


def _known_speed(result: MapResult) -> Assumption:
    if result.length_unit == "s":
        text = "the walking speed is not known, so lengths are seconds of walking; --speed-mps makes metres of them"
        return Assumption(name="known_speed", holds=False, text=text)
    return Assumption(name="known_speed", holds=True, text=f"lengths are metres at {result.recipe.speed_mps:g} m/s")


def _hole_count(judged: Sequence[Assumption], data: DataVerdict | None) -> Assumption:
    needed = {"stands_still", "enough_nodes", "enough_encounters", "no_silence", "even_meetings", "few_at_once", "free_ways", "fine_times"}
    broken = [one.name for one in judged if one.name in needed and one.holds is False]
    if not broken and data is not None and not data.is_enough:
        return Assumption(name="hole_count", holds=False, text="the count of holes is not to be trusted yet: the data are not enough")
    if not broken:
        return Assumption(name="hole_count", holds=True, text="nothing in the log speaks against the count of holes")
    return Assumption(name="hole_count", holds=False, text=f"the count of holes is not to be trusted: see {', '.join(broken)}")


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"


def _span(time_ns: int) -> str:
    """Tell a length of time in its own unit."""
    for unit, size in (("days", _NS_PER_DAY), ("h", 3600 * NS_PER_S), ("min", 60 * NS_PER_S), ("s", NS_PER_S), ("ms", 10**6)):
        if time_ns >= 2 * size:
            return f"{time_ns / size:.3g} {unit}"
    return f"{time_ns} ns"
