"""What a run is made of: ranges, and the configuration of a run."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec

from simulator.errors import ParameterError
from simulator.motion import MotionParameters, WallLaw
from simulator.radios.radio_keys import BEACON_KEYS, RadioKeys

# Beyond this, a float of seconds rounds more coarsely than insects keep away from walls.
_MAX_TIME_S = 1e7


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
            raise ParameterError(
                name="communication radius", got=self.communication, wanted=f"at least the detection radius, {self.detection!r}"
            )


def _need_positive(**values: float) -> None:
    for name, got in values.items():
        if not (math.isfinite(got) and got > 0):
            raise ParameterError(name=name, got=got, wanted="a positive finite number")


_RADIO_DEFAULTS = {one.name: one.default for one in msgspec.structs.fields(RadioKeys)}

_Hazard = Annotated[float, msgspec.Meta(ge=0, le=1e6)] | None
_Positive = Annotated[float, msgspec.Meta(gt=0)] | None
_Share = Annotated[float, msgspec.Meta(ge=0, le=1)] | None
_Gain = Annotated[float, msgspec.Meta(ge=0)] | None


class MotionConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How insects move, where it is to differ from the preset; every key is that of ``simulator.motion.MotionParameters``.

    Keys
    ----
    persistence
        Mean cosine of the turning angle between legs: 0 for isotropic turns.
    levy_exponent, longest_leg
        Legs follow a power law with this exponent, cut off at this length; without an exponent they are exponential.
    wall_law
        What insects do at walls. uniform: they leave in any direction; cosine, mirror: so that they are everywhere alike; follow: they
        go along the wall until they depart.
    wall_speed, exit_hazard
        Speed along a followed wall [length/s], and how often it is left [per second].
    departure_median_deg, departure_log_sd
        Angle between wall and way off it: log-normal, its median [deg] and the standard deviation of its logarithm.
    stop_hazard, wall_stop_hazard
        How often insects stop by themselves, in the open and at a followed wall [per second].
    short_rest_s, long_rest_s, long_rest_share
        Mean of the short and of the long rests [s], and the share of the long ones.
    contact_radius, contact_turns
        Insects this close touch each other [length], and turn away from it.
    company_stop_gain, company_rest_gain
        For each insect touched, the stop hazard grows by this share, and so does the mean rest.
    mishap_hazard, mishap_rest_s, rescue_probability
        How often a walking insect gets stuck or overturned [per second], for how long on average [s], and how likely another that touches
        it frees it.
    death_hazard, loss_hazard
        How often an insect dies, and how often it loses its backpack [per second].
    battery_life_s, battery_spread
        When a backpack's battery is flat [s], uniform within this share to either side; without it never.
    """

    persistence: Annotated[float, msgspec.Meta(ge=0, le=0.999)] | None = None
    levy_exponent: Annotated[float, msgspec.Meta(gt=1, le=20)] | None = None
    longest_leg: _Positive = None
    wall_law: WallLaw | None = None
    wall_speed: _Positive = None
    exit_hazard: _Hazard = None
    departure_median_deg: Annotated[float, msgspec.Meta(gt=0, le=180)] | None = None
    departure_log_sd: _Gain = None
    stop_hazard: _Hazard = None
    wall_stop_hazard: _Hazard = None
    short_rest_s: _Gain = None
    long_rest_s: _Gain = None
    long_rest_share: _Share = None
    contact_radius: _Gain = None
    contact_turns: bool | None = None
    company_stop_gain: _Gain = None
    company_rest_gain: _Gain = None
    mishap_hazard: _Hazard = None
    mishap_rest_s: _Gain = None
    rescue_probability: _Share = None
    death_hazard: _Hazard = None
    loss_hazard: _Hazard = None
    battery_life_s: _Positive = None
    battery_spread: _Share = None

    def over(self, preset: MotionParameters) -> MotionParameters:
        """Return a preset's motion with what is given here in place of it. Raises ParameterError where the two do not fit."""
        given = {name: value for name in self.__struct_fields__ if (value := getattr(self, name)) is not None}
        return replace(preset, **given)


class WorldConfig(RadioKeys, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which world to make: the part of the configuration that every command shares.

    A seed, and a scenario or an arena, must be given before a world is made; what else is not given comes from the preset.

    Keys
    ----
    scenario, arena
        Name of a scenario, or path of a GeoJSON, SVG or PNG file: one of them.
    arena_scale
        Length of a unit of the arena file, of a pixel for PNG [length].
    arena_simplify
        Leave out corners of the arena file, moving walls by at most this [length].
    arena_then
        ``SECONDS:FILE`` each: from so many seconds after the landmarks are set, the arena is that of another file.
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
    motion
        How insects move, where it is to differ from the preset.
    """

    seed: Annotated[int, msgspec.Meta(ge=0)] | None = None
    scenario: str | None = None
    arena: str | None = None
    arena_scale: Annotated[float, msgspec.Meta(gt=0)] = 1.0
    arena_simplify: Annotated[float, msgspec.Meta(gt=0)] | None = None
    arena_then: tuple[str, ...] = ()
    preset: str = "paper-units"
    biobots: Annotated[int, msgspec.Meta(ge=1, le=100_000)] | None = None
    landmarks: Annotated[int, msgspec.Meta(ge=0, le=100_000)] | None = None
    dispersion_s: Annotated[float, msgspec.Meta(ge=0, le=_MAX_TIME_S)] | None = None
    duration_s: Annotated[float, msgspec.Meta(gt=0, le=_MAX_TIME_S)] | None = None
    speed: Annotated[float, msgspec.Meta(gt=0)] | None = None
    mean_leg: Annotated[float, msgspec.Meta(gt=0)] | None = None
    detection_radius: Annotated[float, msgspec.Meta(gt=0)] | None = None
    communication_radius: Annotated[float, msgspec.Meta(gt=0)] | None = None
    motion: MotionConfig = MotionConfig()

    def __post_init__(self) -> None:
        problems = []
        if self.scenario is not None and self.arena is not None:
            problems.append(f"both scenario ({self.scenario}) and arena ({self.arena}) are given; give one of them")
        if self.seed is not None and self.seed >= 2**64:
            problems.append(f"seed is {self.seed}; wanted 0 to 2^64 - 1")
        if self.arena is None and (self.arena_scale != 1.0 or self.arena_simplify is not None or self.arena_then):
            problems.append("arena_scale, arena_simplify or arena_then is given without an arena; give arena FILE, or leave them out")
        times_s = []
        for text in self.arena_then:
            try:
                times_s.append(parse_arena_then(text)[0])
            except ValueError as error:
                problems.append(str(error))
        if sorted(set(times_s)) != times_s:
            problems.append(f"arena_then has the times {times_s}; wanted each later than the one before")
        numbers = (
            "arena_scale",
            "arena_simplify",
            "dispersion_s",
            "duration_s",
            "speed",
            "mean_leg",
            "detection_radius",
            "communication_radius",
        )
        problems += [
            f"{name} is {value!r}; wanted a finite number"
            for name in numbers
            if (value := getattr(self, name)) is not None and not math.isfinite(value)
        ]
        if problems:
            raise ValueError("; ".join(problems))


def parse_arena_then(text: str) -> tuple[float, str]:
    """Take ``SECONDS:FILE`` apart.

    Raises
    ------
    ValueError
        It has no colon, or no finite positive number before it.
    """
    seconds, _, file = text.partition(":")
    try:
        at_s = float(seconds)
    except ValueError:
        at_s = math.nan
    if not (file and math.isfinite(at_s) and at_s > 0):
        msg = f"arena_then has {text!r}; wanted SECONDS:FILE, with a positive number of seconds"
        raise ValueError(msg)
    return at_s, file


class RunConfig(WorldConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of ``biobot-sim run``.

    Keys
    ----
    out
        Directory for the results.
    force
        Write into a directory that is not empty, replacing files of an earlier run.
    position_samples
        At how many instants, evenly from start to end, all positions are written.
    snapshot
        File in which the run is kept so that ``biobot-sim resume`` can take it up after a signal.
    snapshot_every_s
        Also write it whenever this much of the run's time has passed [s].
    watch
        Show the insects in the terminal while they walk.
    watch_speed
        Let so many seconds of the run pass in one of ours, instead of as many as can; asks for ``watch``.
    """

    out: str | None = None
    force: bool = False
    snapshot: str | None = None
    snapshot_every_s: Annotated[float, msgspec.Meta(gt=0)] | None = None
    watch: bool = False
    watch_speed: Annotated[float, msgspec.Meta(gt=0, le=1e6)] | None = None
    position_samples: Annotated[int, msgspec.Meta(ge=2, le=100_000)] = 201

    def __post_init__(self) -> None:
        super().__post_init__()
        idle = [name for name in BEACON_KEYS if getattr(self, name) != _RADIO_DEFAULTS[name]]
        if self.sensing == "ideal" and idle:
            msg = f"{', '.join(idle)}: of no use where sensing is ideal; give --sensing beacon, or leave it out"
            raise ValueError(msg)
        if self.snapshot_every_s is not None and self.snapshot is None:
            msg = "snapshot_every_s is given without snapshot, the file to write; give --snapshot FILE"
            raise ValueError(msg)
