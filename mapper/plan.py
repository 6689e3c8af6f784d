"""A planned sortie: the arena's size, the swarm, how the insects walk, and how long. Checked once, here."""

from dataclasses import dataclass
from math import isfinite, pi, sqrt

from firmware_protocol.errors import ConfigurationError

# Own choice, the middle of the 10 to 20 % that [Dir16] IV makes landmarks.
DEFAULT_LANDMARK_SHARE = 0.15
# More than can be told apart on the air (WIRE_FORMAT.md: node numbers of 16 bits), and more than any count below needs.
MAX_BIOBOTS = 65_535
# Of the lengths, the speed and the time: beyond these a unit was mistaken.
_LEAST, _GREATEST = 1e-9, 1e12
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A sortie as planned; lengths are in any one unit, called m here. ``make_plan`` makes one that is valid.

    Parameters
    ----------
    area, perimeter
        Free area [m^2], and length of all its walls, obstacles' included [m].
    biobots, landmarks
        How many there are, landmarks included; and how many of them stand still.
    speed, mean_leg
        v_m [m/s] and l* [m] of those that walk.
    detection_radius
        r_d: nearer than this is an encounter [m].
    duration_s
        Time from the moment the landmarks are set [s].
    """

    area: float
    perimeter: float
    biobots: int
    landmarks: int
    speed: float
    mean_leg: float
    detection_radius: float
    duration_s: float

    @property
    def movers(self) -> int:
        """How many walk."""
        return self.biobots - self.landmarks

    @property
    def side(self) -> float:
        """Side of the square of the same area [m]."""
        return sqrt(self.area)

    @property
    def path(self) -> float:
        """What each mover walks in all [m]."""
        return self.speed * self.duration_s


def make_plan(
    *,
    side: float | None,
    area: float | None,
    perimeter: float | None,
    biobots: int | None,
    landmarks: int | None,
    speed: float | None,
    mean_leg: float | None,
    detection_radius: float | None,
    duration_s: float | None,
) -> Plan:
    """Check the numbers of a sortie and make a plan of them.

    Parameters
    ----------
    side, area
        Of the arena, one of the two [m], [m^2]; a side means a square.
    perimeter
        Length of all walls [m]; None for those of a square.
    landmarks
        None takes 15 % of the biobots.

    Raises
    ------
    ConfigurationError
        All that is wrong, a line for each value with the limit and what to do; None is a value that was not given.
    """
    faults = [
        *_check_quantity("--side", side, "m", optional=True),
        *_check_quantity("--area", area, "m²", optional=True),
        *_check_quantity("--perimeter", perimeter, "m", optional=True),
        *_check_quantity("--speed", speed, "m/s"),
        *_check_quantity("--mean-leg", mean_leg, "m"),
        *_check_quantity("--detection-radius", detection_radius, "m"),
        *_check_quantity("--time", duration_s, "s"),
        *_check_swarm(biobots, landmarks),
    ]
    if (side is None) == (area is None):
        faults.append(f"{'neither --side nor --area is' if side is None else 'both --side and --area are'} given; give one of the two")
    if faults or biobots is None or speed is None or mean_leg is None or detection_radius is None or duration_s is None:
        raise ConfigurationError(faults)
    size = side * side if side is not None else area or 0.0
    walls = 4.0 * sqrt(size) if perimeter is None else perimeter
    faults = _check_shape(size, walls, detection_radius=detection_radius)
    if faults:
        raise ConfigurationError(faults)
    return Plan(
        area=size,
        perimeter=walls,
        biobots=biobots,
        landmarks=default_landmarks(biobots) if landmarks is None else landmarks,
        speed=speed,
        mean_leg=mean_leg,
        detection_radius=detection_radius,
        duration_s=duration_s,
    )


def default_landmarks(biobots: int) -> int:
    """Say how many of the biobots stand still if nothing else is said: 15 %, at least one."""
    return max(1, round(DEFAULT_LANDMARK_SHARE * biobots))


def check_obstacle(obstacle: float | None, plan: Plan) -> None:
    """Refuse an obstacle that cannot stand in the arena.

    Raises
    ------
    ConfigurationError
        Its side [m] is not a positive number below the side of the arena.
    """
    faults = _check_quantity("--obstacle", obstacle, "m", optional=True)
    if obstacle is not None and not faults and obstacle >= plan.side:
        faults = [
            f"--obstacle is {obstacle:g} m; wanted less than {plan.side:.4g} m, the side of the arena; give the obstacle's side in metres"
        ]
    if faults:
        raise ConfigurationError(faults)


def _check_quantity(flag: str, value: float | None, unit: str, *, optional: bool = False) -> list[str]:
    if (value is None and optional) or (value is not None and isfinite(value) and _LEAST <= value <= _GREATEST):
        return []
    got = "not given" if value is None else f"{value:g}"
    return [f"{flag} is {got}; wanted a number of {unit} from {_LEAST:g} to {_GREATEST:g}; give it in {unit}"]


def _check_swarm(biobots: int | None, landmarks: int | None) -> list[str]:
    if biobots is None:
        return ["--biobots is not given; give how many there are, landmarks included"]
    if not 2 <= biobots <= MAX_BIOBOTS:
        return [f"--biobots is {biobots}; wanted 2 to {MAX_BIOBOTS}, landmarks included; with fewer than two nobody meets"]
    if landmarks is not None and not 0 <= landmarks < biobots:
        return [
            f"--landmarks is {landmarks}; wanted 0 to {biobots - 1}, of {biobots} biobots at least one that walks; give fewer landmarks"
        ]
    return []


def _check_shape(area: float, perimeter: float, *, detection_radius: float) -> list[str]:
    least = 2.0 * sqrt(pi * area)  # the isoperimetric inequality: of all outlines of one area the circle is the shortest
    if perimeter < least * (1.0 - _ROUNDING):
        return [f"--perimeter is {perimeter:g} m; wanted at least {least:.4g} m, that of a disc of {area:g} m²; add up all walls in metres"]
    width = 2.0 * area / perimeter  # of a corridor of this area and perimeter; half the side of a square
    if detection_radius > width * (1.0 + _ROUNDING):
        limit = f"wanted at most {width:.4g} m, twice area over perimeter"
        next_step = "whoever sees from wall to wall resolves nothing: give a smaller radius or a larger arena"
        return [f"--detection-radius is {detection_radius:g} m; {limit}; {next_step}"]
    return []
