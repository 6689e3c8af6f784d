"""What a run is made of: motion, ranges and the run's own parameters."""

import math
from dataclasses import dataclass
from typing import Annotated

import msgspec

from simulator.errors import ParameterError
from simulator.radio_keys import RadioKeys

# Beyond this, a float of seconds rounds more coarsely than insects keep away from walls.
_MAX_TIME_S = 1e7


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionParameters:
    """Parameters of the correlated random walk, [Dir16] eq. (1).

    Parameters
    ----------
    speed
        v_m [length/s].
    mean_leg
        l*, the mean length of a straight leg [length].
    """

    speed: float
    mean_leg: float

    def __post_init__(self) -> None:
        _need_positive(speed=self.speed, mean_leg=self.mean_leg)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranges:
    """How far biobots notice each other.

    Parameters
    ----------
    detection
        r_d: nearer than this, and in sight, is an encounter [length].
    communication
        r_c: nearer than this is a radio neighbour [length]; not less than r_d.
    """

    detection: float
    communication: float

    def __post_init__(self) -> None:
        _need_positive(detection=self.detection, communication=self.communication)
        if self.communication < self.detection:
            raise ParameterError(name="communication", got=self.communication, wanted=f"at least the detection radius, {self.detection!r}")


def _need_positive(**values: float) -> None:
    for name, got in values.items():
        if not (math.isfinite(got) and got > 0):
            raise ParameterError(name=name, got=got, wanted="a positive finite number")


class WorldConfig(RadioKeys, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which world to make: the part of the configuration that every command shares.

    A seed, and a scenario or an arena, must be given before a world is made; what else is not given comes from the preset.

    Attributes
    ----------
    scenario, arena
        Name of a scenario, or path of a GeoJSON file: one of them.
    preset
        Name of a preset.
    biobots, landmarks
        How many; without ``landmarks``, the preset's share of the biobots.
    dispersion_s
        Time walked before the landmarks are set [s].
    duration_s
        Time walked after that [s].
    speed, mean_leg, detection_radius, communication_radius
        In the preset's unit of length; a detection radius given alone scales the communication radius with it.
    seed
        0 to 2^64 - 1.
    """

    seed: Annotated[int, msgspec.Meta(ge=0)] | None = None
    scenario: str | None = None
    arena: str | None = None
    preset: str = "paper-units"
    biobots: Annotated[int, msgspec.Meta(ge=1, le=100_000)] | None = None
    landmarks: Annotated[int, msgspec.Meta(ge=0, le=100_000)] | None = None
    dispersion_s: Annotated[float, msgspec.Meta(ge=0, le=_MAX_TIME_S)] | None = None
    duration_s: Annotated[float, msgspec.Meta(gt=0, le=_MAX_TIME_S)] | None = None
    speed: Annotated[float, msgspec.Meta(gt=0)] | None = None
    mean_leg: Annotated[float, msgspec.Meta(gt=0)] | None = None
    detection_radius: Annotated[float, msgspec.Meta(gt=0)] | None = None
    communication_radius: Annotated[float, msgspec.Meta(gt=0)] | None = None

    def __post_init__(self) -> None:
        problems = []
        if self.scenario is not None and self.arena is not None:
            problems.append(f"both scenario ({self.scenario}) and arena ({self.arena}) are given; give one of them")
        if self.seed is not None and self.seed >= 2**64:
            problems.append(f"seed is {self.seed}; wanted 0 to 2^64 - 1")
        numbers = ("dispersion_s", "duration_s", "speed", "mean_leg", "detection_radius", "communication_radius")
        problems += [
            f"{name} is {value!r}; wanted a finite number"
            for name in numbers
            if (value := getattr(self, name)) is not None and not math.isfinite(value)
        ]
        if problems:
            raise ValueError("; ".join(problems))


class RunConfig(WorldConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of ``biobot-sim run``.

    Attributes
    ----------
    out
        Directory for the results.
    force
        Write into a directory that is not empty, replacing files of an earlier run.
    position_samples
        At how many instants, evenly from start to end, all positions are written.
    """

    out: str | None = None
    force: bool = False
    position_samples: Annotated[int, msgspec.Meta(ge=2, le=100_000)] = 201
