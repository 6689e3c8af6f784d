"""Presets: full sets of parameters, among them the two readings of the units that [Dir16] printed.

[Dir16] VI prints v_m = 0.1 m/s, l* = 0.30 m, r_d = 1 cm, 150 biobots, 200 s and an arena of 50 m x 50 m. Those numbers together
give about two encounters in the whole run, so they cannot be the ones used. ``paper-50cm`` keeps every number printed for a
biobot and takes the arena as 50 cm; ``paper-units`` keeps the 50 and takes speed and radius as 1.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from simulator.config import MotionParameters, Ranges
from simulator.errors import ScenarioError


@dataclass(frozen=True, slots=True, kw_only=True)
class Preset:
    """A full set of parameters, with where each comes from.

    Parameters
    ----------
    unit
        Name of the length unit of every length in it.
    side
        Side of the square arena of the scenarios [length].
    biobots, landmarks
        How many biobots, and how many of them become landmarks.
    duration_s
        Time from the moment the landmarks are set to the end [s].
    dispersion_s
        Time walked before that moment [s].
    sources
        Field name to source.
    """

    name: str
    summary: str
    unit: str
    side: float
    motion: MotionParameters
    ranges: Ranges
    biobots: int
    landmarks: int
    duration_s: float
    dispersion_s: float
    sources: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


# [Dir16] VI prints one radius only. With r_c = r_d a biobot has 0.2 neighbours on average, too few for hops to be counted;
# with 8 r_d it has 12.
_COMMUNICATION_PER_DETECTION = 8.0

_PRINTED = "as printed, [Dir16] VI"
_COMMON_SOURCES = {
    "biobots": _PRINTED,
    "landmarks": _PRINTED,
    "duration_s": _PRINTED,
    "communication": "8 detection radii: own choice, for about 12 neighbours each",
    "dispersion_s": "own choice; places are drawn uniformly, so a walk of 10 s is enough to mix headings",
}

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "paper-units": Preset(
            name="paper-units",
            summary="[Dir16] with the arena's 50 as printed, unit speed and unit radius; about 2,100 encounters",
            unit="unit",
            side=50.0,
            motion=MotionParameters(speed=1.0, mean_leg=10.0),
            ranges=Ranges(detection=1.0, communication=_COMMUNICATION_PER_DETECTION),
            biobots=150,
            landmarks=20,
            duration_s=200.0,
            dispersion_s=10.0,
            sources=MappingProxyType(
                _COMMON_SOURCES
                | {
                    "side": "the number printed in [Dir16] VI, its unit left open",
                    "speed": "own reading: 1 unit/s",
                    "mean_leg": "own reading: 10 units",
                    "detection": "own reading: 1 unit",
                }
            ),
        ),
        "paper-50cm": Preset(
            name="paper-50cm",
            summary="[Dir16] with every number of a biobot as printed, in an arena of 50 cm; about 20,000 encounters",
            unit="m",
            side=0.5,
            motion=MotionParameters(speed=0.1, mean_leg=0.30),
            ranges=Ranges(detection=0.01, communication=_COMMUNICATION_PER_DETECTION * 0.01),
            biobots=150,
            landmarks=20,
            duration_s=200.0,
            dispersion_s=10.0,
            sources=MappingProxyType(
                _COMMON_SOURCES
                | {
                    "side": "own reading: 50 cm, where [Dir16] VI prints 50 m",
                    "speed": _PRINTED,
                    "mean_leg": _PRINTED,
                    "detection": _PRINTED,
                }
            ),
        ),
    }
)

DEFAULT_PRESET = "paper-units"


def find_preset(name: str) -> Preset:
    """Return the preset of this name, or raise ScenarioError."""
    if name not in PRESETS:
        raise ScenarioError(kind="preset", got=name, known=tuple(PRESETS))
    return PRESETS[name]
