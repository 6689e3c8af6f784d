"""How insects move: every parameter of walk, walls, stops, company and mishaps, checked once.

A hazard is a rate per second of an event that strikes without memory; 0 switches it off.
"""

import math
from dataclasses import dataclass, fields, replace
from enum import StrEnum

from simulator.errors import ParameterError

_BISECTIONS = 200
_MOST_APART = 100.0


class WallLaw(StrEnum):
    """What a free leg that ends at a wall is followed by."""

    UNIFORM = "uniform"
    """A direction uniform in angle over the half-plane that points away: more insects near walls than elsewhere."""
    COSINE = "cosine"
    """Lambert's law, density of the angle to the normal cos / 2: the stationary density is uniform."""
    MIRROR = "mirror"
    """The angle of incidence: the stationary density is uniform."""
    FOLLOW = "follow"
    """The insect goes along the wall until it departs ([Jea03])."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionParameters:
    """Parameters of the correlated random walk of [Dir16] eq. (1), and of what else insects do.

    Parameters
    ----------
    speed
        v_m, away from walls [length/s].
    mean_leg
        l*, the mean length of a straight leg [length].
    persistence
        Mean cosine of the turning angle between legs (wrapped Cauchy distribution): 0 for isotropic turns, less than 1.
    levy_exponent
        None for exponential legs; else mu > 1 of a power law p(l) ~ l^-mu, cut off at ``longest_leg`` and scaled to ``mean_leg``.
    longest_leg
        Where the power law is cut off [length]; None for a hundred mean legs.
    wall_law
        What happens at walls.
    wall_speed
        Along walls [length/s]; None for ``speed``.
    exit_hazard
        Of leaving a followed wall [1/s].
    departure_median_deg, departure_log_sd
        Angle between wall and way off it: log-normal, its median [deg] and the standard deviation of its logarithm.
    stop_hazard, wall_stop_hazard
        Of stopping in the open and at a wall [1/s].
    short_rest_s, long_rest_s, long_rest_share
        Rests are exponential: mean of the short and of the long ones [s], and the share of the long ones.
    contact_radius
        Insects this close touch each other [length]; 0: never.
    contact_turns
        Walking insects turn away from a touch, uniformly over the half-plane.
    company_stop_gain, company_rest_gain
        For each insect touched, the stop hazard grows by this share, and so does the mean rest.
    mishap_hazard, mishap_rest_s
        Of getting stuck or overturned while walking [1/s], and how long that lasts on average [s].
    rescue_probability
        That a walking insect that touches a stuck one frees it.
    death_hazard
        Of dying [1/s].
    loss_hazard
        Of losing the backpack [1/s].
    battery_life_s, battery_spread
        When a backpack's battery is flat [s]: None for never; uniform within this share to either side.

    References
    ----------
    [Jea03] R. Jeanson et al., "A model of animal movements in a bounded space", J. Theor. Biol. 225, 2003.
    """

    speed: float
    mean_leg: float
    persistence: float = 0.0
    levy_exponent: float | None = None
    longest_leg: float | None = None
    wall_law: WallLaw = WallLaw.UNIFORM
    wall_speed: float | None = None
    exit_hazard: float = 0.0
    departure_median_deg: float = 36.6
    departure_log_sd: float = 0.0
    stop_hazard: float = 0.0
    wall_stop_hazard: float = 0.0
    short_rest_s: float = 0.0
    long_rest_s: float = 0.0
    long_rest_share: float = 0.0
    contact_radius: float = 0.0
    contact_turns: bool = False
    company_stop_gain: float = 0.0
    company_rest_gain: float = 0.0
    mishap_hazard: float = 0.0
    mishap_rest_s: float = 0.0
    rescue_probability: float = 0.0
    death_hazard: float = 0.0
    loss_hazard: float = 0.0
    battery_life_s: float | None = None
    battery_spread: float = 0.0

    def __post_init__(self) -> None:
        for name in ("speed", "mean_leg"):
            _need(name, getattr(self, name), at_least=0.0, is_open=True)
        for name in ("longest_leg", "wall_speed", "battery_life_s"):
            if getattr(self, name) is not None:
                _need(name, getattr(self, name), at_least=0.0, is_open=True)
        self._check_wall_speed()
        for one in fields(self):
            if one.name.endswith(("_hazard", "_gain", "_rest_s", "_log_sd", "_radius")):
                _need(one.name, getattr(self, one.name), at_least=0.0)
        for name in ("long_rest_share", "rescue_probability", "battery_spread"):
            _need(name, getattr(self, name), at_least=0.0, at_most=1.0)
        _need("persistence", self.persistence, at_least=0.0, at_most=0.999)
        _need("departure_median_deg", self.departure_median_deg, at_least=0.0, at_most=180.0, is_open=True)
        if self.levy_exponent is not None:
            _need("levy_exponent", self.levy_exponent, at_least=1.0, at_most=20.0, is_open=True)
            if self.cut_off < 2.0 * self.mean_leg:
                raise ParameterError(name="longest_leg", got=self.cut_off, wanted=f"at least two mean legs, {2.0 * self.mean_leg:g}")
        if (self.stop_hazard or self.wall_stop_hazard) and not self.mean_rest_s:
            raise ParameterError(name="short_rest_s", got=self.short_rest_s, wanted="a mean rest above 0 where insects stop by themselves")
        if self.mishap_hazard and not self.mishap_rest_s:
            raise ParameterError(name="mishap_rest_s", got=self.mishap_rest_s, wanted="a mean time above 0 where insects get stuck")
        if self.contact_turns and not self.contact_radius:
            raise ParameterError(name="contact_radius", got=self.contact_radius, wanted="a radius above 0 where insects turn at a touch")

    def idle(self) -> tuple[str, ...]:
        """Return the names of what is set and yet has no effect, because something that it needs is not."""
        stops = self.stop_hazard or (self.wall_stop_hazard and self.wall_law is WallLaw.FOLLOW)
        needs = {
            "wall_speed": self.wall_law is WallLaw.FOLLOW,
            "exit_hazard": self.wall_law is WallLaw.FOLLOW,
            "departure_log_sd": self.wall_law is WallLaw.FOLLOW and self.exit_hazard,
            "wall_stop_hazard": self.wall_law is WallLaw.FOLLOW,
            "longest_leg": self.levy_exponent is not None,
            "short_rest_s": stops,
            "long_rest_s": stops and self.long_rest_share,
            "long_rest_share": stops,
            "company_stop_gain": self.contact_radius and stops,
            "company_rest_gain": self.contact_radius and stops,
            "mishap_rest_s": self.mishap_hazard,
            "rescue_probability": self.contact_radius and self.mishap_hazard,
            "battery_spread": self.battery_life_s is not None,
        }
        return tuple(name for name, has_effect in needs.items() if getattr(self, name) and not has_effect)

    @property
    def cut_off(self) -> float:
        """Length of the longest leg of a power law [length]."""
        return 100.0 * self.mean_leg if self.longest_leg is None else self.longest_leg

    @property
    def mean_rest_s(self) -> float:
        """Mean natural rest of an insect alone [s]."""
        return (1.0 - self.long_rest_share) * self.short_rest_s + self.long_rest_share * self.long_rest_s

    @property
    def shortest_leg(self) -> float:
        """The least leg of the power law whose mean is ``mean_leg`` [length]; ``mean_leg`` itself for exponential legs."""
        if self.levy_exponent is None:
            return self.mean_leg
        low, high = 0.0, self.mean_leg
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            low, high = (middle, high) if _mean_of_power_law(self.levy_exponent, middle, self.cut_off) < self.mean_leg else (low, middle)
        return high

    def faster(self, factor: float) -> "MotionParameters":
        """Return the motion of insects ``factor`` times as fast: speeds and hazards times it, rests shorter, batteries as they are."""
        hazards = {one.name: getattr(self, one.name) * factor for one in fields(self) if one.name.endswith("_hazard")}
        rests = {one.name: getattr(self, one.name) / factor for one in fields(self) if one.name.endswith("_rest_s")}
        wall_speed = None if self.wall_speed is None else self.wall_speed * factor
        return replace(self, speed=self.speed * factor, wall_speed=wall_speed, **hazards, **rests)

    def _check_wall_speed(self) -> None:
        low, high = self.speed / _MOST_APART, self.speed * _MOST_APART
        if self.wall_speed is not None and not low <= self.wall_speed <= high:
            wanted = f"{low:g} to {high:g}, a hundredth to a hundred times the speed"
            raise ParameterError(name="wall_speed", got=self.wall_speed, wanted=wanted)


def _mean_of_power_law(exponent: float, shortest: float, longest: float) -> float:
    """Mean of p(l) ~ l^-mu between two lengths: a ratio of two integrals, each with its logarithmic case."""

    def integral(power: float) -> float:
        ratio = math.log(longest / shortest)
        return ratio if power == 0.0 else math.expm1(power * ratio) / power

    return shortest * integral(2.0 - exponent) / integral(1.0 - exponent)


def _need(name: str, got: float, *, at_least: float, at_most: float = math.inf, is_open: bool = False) -> None:
    fits = math.isfinite(got) and at_least <= got <= at_most and not (is_open and got == at_least)
    if not fits:
        if at_most == math.inf:
            wanted = "a positive finite number" if is_open else "a finite number, not negative"
        else:
            wanted = f"a number {'above' if is_open else 'from'} {at_least:g}, at most {at_most:g}"
        raise ParameterError(name=name, got=got, wanted=wanted)
