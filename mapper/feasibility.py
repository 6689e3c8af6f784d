"""How many encounters to expect of a plan, and what follows from the theory of gases and of random walks alone.

What is fitted to simulated runs, the size of obstacles that a map shows, is in `mapper.resolution`.

[Dir16]: see REFERENCES.md. [Fue20]: R. Fürth, "Die Brownsche Bewegung bei Berücksichtigung einer Persistenz der
Bewegungsrichtung", Zeitschrift für Physik 2, 1920: the mean squared displacement of a persistent walk.
[Ker39]: R. Kershner, "The number of circles covering a set", American Journal of Mathematics 61, 1939. [Erd60]: P. Erdős, A. Rényi, "On the
evolution of random graphs", 1960: a random graph is connected as soon as nobody is alone.
"""

from collections.abc import Callable
from dataclasses import replace
from math import comb, exp, expm1, inf, pi, sqrt

from mapper.plan import Plan

_PLACES = 60  # halvings of an interval of times: exact to rounding
FURTHEST = 1e6
"""So many times a plan's own time are looked ahead."""


def wall_share(plan: Plan) -> float:
    """Say what share of their detection circles biobots keep in a box, whose walls cut those near them.

    Notes
    -----
    The mean over the arena of the share of a circle of radius r that is inside is, for any rectangle of perimeter P and sides above r,
    1 - P r / (pi A) + r^2 / (pi A): a place at distance h < r of a wall loses arccos(h / r) / pi, whose integral over h is r / pi, and each
    of four right angles counts r^2 / (4 pi) twice. It is the rate at which pairs of a uniform gas come within r, over that without
    walls: 2.5 % less for r at a fiftieth of a square's side, 12.4 % less at a tenth.
    """
    radius = plan.detection_radius
    return 1.0 - (plan.perimeter - radius) * radius / (pi * plan.area)


def encounter_rate(plan: Plan) -> float:
    """Return how many encounters begin in a second [1/s].

    Notes
    -----
    The kinetic gas in two dimensions. Two that walk meet at rate 2 r u / A, u = 4 v / pi their mean relative speed; a walker and a
    landmark at 2 r v / A. Turning changes neither as long as the insects are spread evenly.
    """
    movers, landmarks = plan.movers, plan.landmarks
    pairs = 4.0 * movers * (movers - 1) / pi + 2.0 * landmarks * movers
    return plan.speed * plan.detection_radius * pairs / plan.area * wall_share(plan)


def together_at_once(plan: Plan) -> float:
    """Return how many pairs, not both landmarks, are within the radius at any one time: those encounters have begun when the time begins.

    Notes
    -----
    Each pair with the share of the arena's area that a disc of radius r keeps within the walls: ``wall_share`` integrated over the radius.
    """
    radius, movers = plan.detection_radius, plan.movers
    pairs = movers * (movers - 1) / 2.0 + movers * plan.landmarks
    kept = 1.0 - (2.0 * plan.perimeter / 3.0 - radius / 2.0) * radius / (pi * plan.area)
    return pairs * pi * radius**2 / plan.area * kept


def expected_encounters(plan: Plan) -> float:
    """Return how many encounters to expect in the plan's time."""
    return encounter_rate(plan) * plan.duration_s + together_at_once(plan)


def encounters_per_mover(plan: Plan) -> float:
    """Return how many encounters each walking biobot has in the plan's time, at its beginning not counted."""
    pairs = 8.0 * (plan.movers - 1) / pi + 2.0 * plan.landmarks
    return plan.path * plan.detection_radius * pairs / plan.area * wall_share(plan)


def free_path(plan: Plan) -> float:
    """Return how far a biobot walks between two encounters [m]; inf for one that is alone."""
    met = encounters_per_mover(plan)
    return plan.path / met if met > 0 else inf


def path_inflation(plan: Plan) -> float:
    """Say how many times longer the way between two encounters of one biobot is than the beeline, root mean square.

    Notes
    -----
    Of a walk of length s with exponential legs of mean l the mean squared displacement is 2 l^2 (s / l - 1 + exp(-s / l)) [Fue20]. It tells
    what the insects do, not what the map shows: shortest paths choose the straightest of many walks, so a map of many encounters is
    stretched less.
    """
    path = free_path(plan)
    legs = path / plan.mean_leg
    if legs < 1e-4:  # the first terms of the series, where the difference below has no digits left
        return 1.0 + legs / 6.0
    return inf if path == inf else legs / sqrt(2.0 * (legs + expm1(-legs)))


def crossing_s(plan: Plan) -> float:
    """Return how long a straight walk across the arena takes [s]."""
    return plan.side / plan.speed


def mixing_s(plan: Plan) -> float:
    """Return how long it takes until a biobot may be anywhere, whatever place it began at [s].

    Notes
    -----
    The slowest mode of diffusion between walls a side L apart decays in L^2 / (pi^2 D), with D = v l* / 2 for exponential legs in any
    direction; no walk is faster than the straight one.
    """
    diffusivity = plan.speed * plan.mean_leg / 2.0
    return max(crossing_s(plan), plan.area / (pi**2 * diffusivity))


def encounter_spacing(plan: Plan) -> float:
    """Return the side of the square that one encounter has for itself [m]; inf without encounters."""
    expected = expected_encounters(plan)
    return sqrt(plan.area / expected) if expected > 0 else inf


def landmark_cover_radius(plan: Plan) -> float:
    """Return the least covering radius that the landmarks can have [m]: some place is at least this far from all of them.

    Notes
    -----
    The best that n discs can do is the hexagonal lattice, sqrt(2 A / (3 sqrt(3) n)) [Ker39]. Half the delta_l of [Dir16].
    """
    return sqrt(2.0 * plan.area / (3.0 * sqrt(3.0) * plan.landmarks)) if plan.landmarks else inf


def chance_connected(plan: Plan) -> float:
    """Say how likely it is that every biobot is joined to every other by encounters.

    Notes
    -----
    That of nobody being alone [Erd60]: a biobot has met nobody with probability exp(-encounters).
    """
    alone_mover = plan.movers * exp(-encounters_per_mover(plan))
    alone_landmark = plan.landmarks * exp(-visits_per_landmark(plan))
    return exp(-alone_mover - alone_landmark)


def visits_per_landmark(plan: Plan) -> float:
    """Return how many encounters each landmark has in the plan's time."""
    return 2.0 * plan.path * plan.detection_radius * plan.movers / plan.area * wall_share(plan)


def chance_landmarks_met(plan: Plan, *, by: int) -> float:
    """Say how likely it is that each landmark has met at least ``by`` different movers; 0 if there are not so many."""
    missing = exp(-visits_per_landmark(plan) / plan.movers)
    few = sum(comb(plan.movers, k) * (1.0 - missing) ** k * missing ** (plan.movers - k) for k in range(min(by, plan.movers + 1)))
    return max(0.0, 1.0 - few) ** plan.landmarks


def time_until(plan: Plan, is_so: Callable[[Plan], bool]) -> float | None:
    """Find the least duration with which something is so that stays so once it is [s]; None if not in a million times the plan's."""
    low, high = 0.0, plan.duration_s
    while not is_so(replace(plan, duration_s=high)):
        low, high = high, 2.0 * high
        if high > FURTHEST * plan.duration_s:
            return None
    for _ in range(_PLACES):
        middle = (low + high) / 2.0
        if middle > 0.0 and is_so(replace(plan, duration_s=middle)):
            high = middle
        else:
            low = middle
    return high
