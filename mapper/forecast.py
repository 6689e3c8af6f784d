"""What to expect of a plan, now and later, what to change about it, and how a recording compares."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from mapper import feasibility
from mapper.durations import duration_text
from mapper.plan import MAX_BIOBOTS, Plan
from mapper.resolution import (
    EVEN_CHANCE,
    USUAL_CHANCE,
    Law,
    chance_found,
    chance_of_false_hole,
    count_deviation,
    largest_checked,
    outside_ranges,
    side_found,
    time_to_find,
)

_TIMES = (1.0, 2.0, 4.0)
# Of a normal distribution, 9 in 10 lie within so many deviations.
_NINE_IN_TEN = 1.645
# A change that moves neither the side nor a chance by this share is not worth telling.
_WORTH_TELLING = 0.02
_HOPELESS_ENCOUNTERS = 20.0  # no run with fewer was mapped
_OFTEN = 0.2
_USUAL_OBSTACLE = 0.2  # of the side, where no obstacle is asked for


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlook:
    """What to expect of a plan with one duration.

    Parameters
    ----------
    encounters, least_encounters, most_encounters
        Expected number, and between what limits it is in 9 of 10 runs.
    encounters_per_mover
        For each biobot that walks.
    even_side, usual_side
        Side of the square obstacle found in 50 % and in 80 % of maps [m]; inf without landmarks.
    chance_found
        That the obstacle of the forecast is found.
    chance_of_false_hole
        That the map of an empty arena shows a hole.
    chance_connected
        That every biobot is joined to every other by encounters.
    """

    plan: Plan
    encounters: float
    least_encounters: float
    most_encounters: float
    encounters_per_mover: float
    even_side: float
    usual_side: float
    chance_found: float
    chance_of_false_hole: float
    chance_connected: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One thing done otherwise, and what is to be expected then."""

    name: str
    outlook: Outlook


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """All that is foretold of a plan.

    Parameters
    ----------
    outlooks
        With the plan's time, twice and four times it.
    changes
        What helps, the best first.
    obstacle
        Side of the obstacle asked for [m]; where none was, a fifth of the arena's side.
    obstacle_s, obstacle_biobots
        How long it takes until it is found in 80 % of maps [s], and how many biobots do it in the plan's time, landmarks in proportion;
        None for never.
    largest_side
        The largest obstacle in the runs, in this arena [m]: of larger ones nothing is known.
    connected_s, landmarks_met_s
        How long until all are joined, and until every landmark has met three movers, in 9 of 10 runs [s]; None for never.
    extrapolated
        What lies outside the runs behind the laws.
    warnings
        What makes the plan doubtful.
    """

    outlooks: tuple[Outlook, ...]
    changes: tuple[Change, ...]
    obstacle: float
    obstacle_s: float | None
    obstacle_biobots: int | None
    largest_side: float
    connected_s: float | None
    landmarks_met_s: float | None
    extrapolated: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def plan(self) -> Plan:
        """The plan itself."""
        return self.outlooks[0].plan


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A recording beside its plan: ``radius`` [m] is the detection radius that would give its count, None if none does."""

    encounters: int
    duration_s: float
    expected: float
    least: float
    most: float
    radius: float | None


def forecast(plan: Plan, law: Law, *, obstacle: float | None = None) -> Forecast:
    """Foretell what comes of a plan; ``obstacle`` is the side of a square one that matters [m]."""
    wanted = _USUAL_OBSTACLE * plan.side if obstacle is None else obstacle
    outlooks = tuple(_look(replace(plan, duration_s=times * plan.duration_s), law, obstacle=wanted) for times in _TIMES)
    return Forecast(
        outlooks=outlooks,
        changes=tuple(_choose_changes(outlooks[0], law, obstacle=wanted)),
        obstacle=wanted,
        obstacle_s=time_to_find(plan, law, obstacle=wanted),
        obstacle_biobots=_biobots_to_find(plan, law, obstacle=wanted),
        largest_side=largest_checked(plan, law),
        connected_s=feasibility.time_until(plan, lambda later: feasibility.chance_connected(later) >= 0.9),
        landmarks_met_s=feasibility.time_until(plan, lambda later: feasibility.chance_landmarks_met(later, by=3) >= 0.9)
        if plan.landmarks
        else None,
        extrapolated=outside_ranges(plan, law),
        warnings=tuple(_warn(outlooks[0], largest=largest_checked(plan, law))),
    )


def compare_recording(plan: Plan, law: Law, *, encounters: int, duration_s: float) -> Comparison:
    """Compare the count of a recording with what its plan foretells for as long a time [s]."""
    outlook = _look(replace(plan, duration_s=duration_s), law, obstacle=_USUAL_OBSTACLE * plan.side)
    low, high = 0.0, 2.0 * plan.area / plan.perimeter

    def expects_enough(radius: float) -> bool:
        return feasibility.expected_encounters(replace(outlook.plan, detection_radius=radius)) >= encounters

    radius = None
    if expects_enough(high):
        for _ in range(60):
            middle = (low + high) / 2.0
            low, high = (low, middle) if expects_enough(middle) else (middle, high)
        radius = high
    return Comparison(
        encounters=encounters,
        duration_s=duration_s,
        expected=outlook.encounters,
        least=outlook.least_encounters,
        most=outlook.most_encounters,
        radius=radius,
    )


def _look(plan: Plan, law: Law, *, obstacle: float) -> Outlook:
    mean = feasibility.expected_encounters(plan)
    margin = _NINE_IN_TEN * count_deviation(plan, law)
    return Outlook(
        plan=plan,
        encounters=mean,
        least_encounters=max(0.0, mean - margin),
        most_encounters=mean + margin,
        encounters_per_mover=feasibility.encounters_per_mover(plan),
        even_side=side_found(plan, law, chance=EVEN_CHANCE),
        usual_side=side_found(plan, law, chance=USUAL_CHANCE),
        chance_found=chance_found(plan, law, obstacle=obstacle),
        chance_of_false_hole=chance_of_false_hole(plan, law),
        chance_connected=feasibility.chance_connected(plan),
    )


def _choose_changes(now: Outlook, law: Law, *, obstacle: float) -> Iterator[Change]:
    """Try each change by itself and tell those that help: smaller obstacles, or fewer holes that are not there."""
    tried = [Change(name=name, outlook=_look(plan, law, obstacle=obstacle)) for name, plan in _variants(now.plan)]
    for change in sorted(tried, key=lambda one: (one.outlook.usual_side, one.outlook.chance_of_false_hole)):
        then = change.outlook
        is_finer = then.usual_side < min(now.usual_side * (1.0 - _WORTH_TELLING), now.plan.side)
        is_as_fine = then.usual_side <= min(now.usual_side * (1.0 + _WORTH_TELLING), now.plan.side)
        is_cleaner = is_as_fine and then.chance_of_false_hole < now.chance_of_false_hole - _WORTH_TELLING
        if is_finer or is_cleaner:
            yield change


def _variants(plan: Plan) -> Iterator[tuple[str, Plan]]:
    landmarks = 2 * plan.landmarks or 2
    if 2 * plan.biobots <= MAX_BIOBOTS:
        name = f"twice the biobots ({2 * plan.biobots}, landmarks {2 * plan.landmarks})"
        yield name, replace(plan, biobots=2 * plan.biobots, landmarks=2 * plan.landmarks)
    yield "twice the time", replace(plan, duration_s=2.0 * plan.duration_s)
    most = max(plan.landmarks, plan.biobots // 2)  # half the swarm: more was never run
    if min(landmarks, most) > plan.landmarks:
        yield f"more landmarks ({min(landmarks, most)} of {plan.biobots})", replace(plan, landmarks=min(landmarks, most))
    for factor, word in ((2.0, "twice"), (0.5, "half")):
        radius = factor * plan.detection_radius
        if radius <= 2.0 * plan.area / plan.perimeter:
            yield f"{word} the detection radius ({radius:.3g} m)", replace(plan, detection_radius=radius)
    yield f"a straighter walk (mean leg {2.0 * plan.mean_leg:.3g} m)", replace(plan, mean_leg=2.0 * plan.mean_leg)


def _biobots_to_find(plan: Plan, law: Law, *, obstacle: float) -> int | None:
    """Find how many biobots do it in the plan's time, landmarks in proportion."""
    if plan.landmarks == 0:
        return None

    def suffices(biobots: int) -> bool:
        landmarks = min(biobots - 1, max(1, round(biobots * plan.landmarks / plan.biobots)))
        return chance_found(replace(plan, biobots=biobots, landmarks=landmarks), law, obstacle=obstacle) >= USUAL_CHANCE

    low, high = 1, 2
    while not suffices(high):
        if high == MAX_BIOBOTS:
            return None
        low, high = high, min(2 * high, MAX_BIOBOTS)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if suffices(middle) else (middle, high)
    return high


def _warn(now: Outlook, *, largest: float) -> Iterator[str]:
    plan = now.plan
    if now.encounters < _HOPELESS_ENCOUNTERS:
        yield f"hopeless: about {now.encounters:.2g} encounters in the whole time, and no map comes of that; are the units right?"
    if plan.landmarks == 0:
        yield "no landmarks: without biobots that stand still no size of obstacle is known to be found; give --landmarks"
    elif now.usual_side > largest:
        yield f"no obstacle of a size that was checked (up to {largest:.3g} m) is found in 80 % of maps"
    if now.chance_of_false_hole > _OFTEN:
        yield f"{now.chance_of_false_hole:.0%} of maps show a hole that is not there: take one hole more or less for nothing"
    if plan.duration_s < feasibility.mixing_s(plan):
        needed = duration_text(feasibility.mixing_s(plan))
        yield f"a biobot needs {needed} to get about the arena, longer than the time: places that none began near stay empty"
    if plan.perimeter > 1.5 * 4.0 * plan.side:
        yield "the walls are much longer than a square's: sizes were checked in squares alone"
