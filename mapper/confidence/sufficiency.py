"""Say whether the data are enough for what a map says; if not, why, and what would help."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from mapper.certainty import sure_text
from mapper.durations import duration_text
from mapper.types import DataVerdict, HoleCount

WANTED_ENCOUNTERS: Final = 15
"""Encounters that each biobot should have had."""
WANTED_LANDMARKS: Final = 5
WANTED_WALKERS: Final = 10
SURE_ENOUGH: Final = 0.8
"""How likely the number of holes should be right."""
LEAST_WELL_SEEN: Final = 0.2
"""How large a share of the points should be well seen."""
MUCH_APART: Final = 0.1
"""The share of encounters in other components than the largest from which that is told."""
ACROSS_PARTS: Final = (
    "see whether there is a way between the parts: if so, walk on until biobots take it; if not, they are separate rooms, which no walking "
    "joins: map each by itself"
)
"""What to do about parts of which no biobot of one met any of the other."""
_LIKELY = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Doubt:
    """What makes a map's probabilities worth little, though there may be encounters enough: why, and what would help."""

    reason: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What decides whether data are enough.

    Parameters
    ----------
    encounters_each
        Encounters of a biobot, on average.
    n_walkers
        Biobots that do not stand by command all the time, in the largest component.
    n_landmarks
        Places where a landmark stood, in the largest component.
    n_components, apart
        Components, and the share of all encounters that are in others than the largest.
    count
        How sure the number of holes is.
    well_seen
        Share of the points that are well seen.
    span_s
        From the first encounter's beginning to the last one's end [s].
    has_moved_on
        Landmarks stood elsewhere later: the swarm saw parts of the place one after the other.
    doubts
        What is unlike the runs that the probabilities were checked on.
    """

    encounters_each: float
    n_landmarks: int
    n_walkers: int
    n_components: int
    apart: float
    count: HoleCount
    well_seen: float
    span_s: float
    has_moved_on: bool
    doubts: tuple[Doubt, ...]


def judge_data(facts: Facts) -> DataVerdict:
    """Judge the data of a map; the gravest reason comes first."""
    found = [
        reason
        for judge in (_unlike_those_checked, _few_encounters, _few_landmarks, _few_walkers, _apart, _unsure, _badly_seen)
        for reason in judge(facts)
    ]
    remedies = dict.fromkeys(remedy for _, remedy in found)
    return DataVerdict(is_enough=not found, reasons=tuple(reason for reason, _ in found), remedies=tuple(remedies))


def describe_count(count: HoleCount) -> str:
    """Tell how sure a number of holes is, and what else it may be: ``55 % sure; 1: 30 %, 3: 10 %``, or ``not known (0: 32 %, 1: 30 %)``."""
    others = sorted(
        ((p, n) for n, p in enumerate(count.probabilities) if p >= _LIKELY and not (count.is_known and n == count.value)),
        key=lambda pair: -pair[0],
    )
    listed = ", ".join(f"{number}: {probability:.0%}" for probability, number in others[:3])
    if not count.is_known:
        return f"not known ({listed})"
    return sure_text(count.probability) + (f"; {listed}" if listed else "")


def holes_text(value: int, count: HoleCount | None) -> str:
    """Tell a number of holes for a title: ``b1 = 2 (93 % sure)``, or ``b1 not known``."""
    if count is None:
        return f"b1 = {value}"
    return f"b1 = {value} ({count.probability:.0%} sure)" if count.is_known else "b1 not known"


def _unlike_those_checked(facts: Facts) -> Iterator[tuple[str, str]]:
    for doubt in facts.doubts:
        yield doubt.reason, doubt.remedy


def _few_encounters(facts: Facts) -> Iterator[tuple[str, str]]:
    if facts.encounters_each >= WANTED_ENCOUNTERS:
        return
    more_s = facts.span_s * (WANTED_ENCOUNTERS / facts.encounters_each - 1.0)
    walk = f"walk {duration_text(more_s)} more, at the rate so far" if more_s > 0 else "walk on"
    yield f"{facts.encounters_each:.2g} encounters per biobot; {WANTED_ENCOUNTERS} are wanted", walk


def _few_landmarks(facts: Facts) -> Iterator[tuple[str, str]]:
    n = facts.n_landmarks
    if n >= WANTED_LANDMARKS:
        return
    counted = "no landmark" if n == 0 else "1 landmark" if n == 1 else f"{n} landmarks"
    remedy = f"let {WANTED_LANDMARKS - n} more biobots stand still, better 10-20 % of all"
    yield f"{counted} in the largest component; {WANTED_LANDMARKS} are wanted", remedy


def _few_walkers(facts: Facts) -> Iterator[tuple[str, str]]:
    if facts.n_walkers < WANTED_WALKERS:
        yield (
            f"only {facts.n_walkers} biobots walk; {WANTED_WALKERS} are wanted",
            f"let {WANTED_WALKERS - facts.n_walkers} more biobots walk",
        )


def _apart(facts: Facts) -> Iterator[tuple[str, str]]:
    if facts.apart > MUCH_APART:
        share = f"{facts.apart:.0%} of the encounters are not joined to the largest of {facts.n_components} components by any biobot"
        reason = f"{share}: the parts have no meeting in common"
        yield reason, ACROSS_PARTS


def _unsure(facts: Facts) -> Iterator[tuple[str, str]]:
    if facts.count.probability >= SURE_ENOUGH or not facts.count.is_known or facts.doubts:
        # What makes it unknown, or unsure whatever is recorded, has been told.
        return
    if facts.has_moved_on:
        walk = "stay longer at each place, or pass it twice"
    elif facts.span_s <= 0 or facts.encounters_each < WANTED_ENCOUNTERS:
        walk = "let more biobots walk"
    else:
        walk = f"walk {duration_text(facts.span_s)} more for twice the encounters, or let more biobots walk"
    yield f"the number of holes is only {describe_count(facts.count)}", walk


def _badly_seen(facts: Facts) -> Iterator[tuple[str, str]]:
    if facts.well_seen < LEAST_WELL_SEEN:
        reason = f"{1.0 - facts.well_seen:.0%} of the points are badly seen: their distances may be wrong by more than a tenth of the map"
        yield reason, "let more biobots stand still, spread over the place, and walk on"
