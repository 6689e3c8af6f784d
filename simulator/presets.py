"""Presets: full sets of parameters, each value with its source; among them the two readings of the units that [Dir16] printed.

[Dir16] VI prints v_m = 0.1 m/s, l* = 0.30 m, r_d = 1 cm, 150 biobots, 200 s and an arena of 50 m x 50 m. Those numbers together
give about two encounters in the whole run, so they cannot be the ones used. ``paper-50cm`` keeps every number printed for a
biobot and takes the arena as 50 cm; ``paper-units`` keeps the 50 and takes speed and radius as 1.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
[Jea03]: R. Jeanson et al., "A model of animal movements in a bounded space", J. Theor. Biol. 225, 2003 (values after a secondary
transcription; the primary was not at hand).
[Jea05]: R. Jeanson et al., "Self-organized aggregation in cockroaches", Anim. Behav. 69, 2005 (abstract).
[Eri15]: J. C. Erickson et al., "Effective stimulus parameters for directed locomotion in Madagascar hissing cockroach biobot",
PLoS ONE 10, 2015.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from simulator.config import Ranges
from simulator.errors import ScenarioError
from simulator.motion import MotionParameters, WallLaw


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
    scenario
        Arena that goes with it where none is named; None where there is no such.
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
    scenario: str | None = None
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
        "jeanson-larva": Preset(
            name="jeanson-larva",
            summary="first-instar Blattella germanica in a dish of 11 cm: walls followed, natural stops [Jea03]",
            unit="m",
            side=0.11,
            motion=MotionParameters(
                speed=0.011,
                mean_leg=0.0232,
                wall_law=WallLaw.FOLLOW,
                wall_speed=0.0106,
                exit_hazard=0.12,
                departure_median_deg=36.6,
                departure_log_sd=math.log(2.14),
                stop_hazard=0.03,
                wall_stop_hazard=0.08,
                short_rest_s=5.87,
                long_rest_s=700.0,
                long_rest_share=0.07,
                contact_radius=0.003,
                contact_turns=True,
                company_stop_gain=1.0,
                company_rest_gain=1.0,
            ),
            ranges=Ranges(detection=0.01, communication=0.03),
            biobots=30,
            landmarks=5,
            duration_s=1800.0,
            dispersion_s=60.0,
            scenario="disc",
            sources=MappingProxyType(
                {
                    "side": "11 cm: from memory of [Jea03], not confirmed",
                    "speed": "11.0 mm/s in the central zone [Jea03]",
                    "mean_leg": "transport mean free path 23.2 mm [Jea03], walked with isotropic turns (equal diffusion)",
                    "wall_law": "larvae follow walls [Jea03]",
                    "wall_speed": "10.6 mm/s in the peripheral zone [Jea03]",
                    "exit_hazard": "0.12 /s [Jea03]",
                    "departure_median_deg": "log-normal, geometric mean 36.6 degrees [Jea03]",
                    "departure_log_sd": "log-normal, geometric standard deviation 2.14 [Jea03]",
                    "stop_hazard": "0.03 /s in the central zone [Jea03]",
                    "wall_stop_hazard": "0.08 /s in the peripheral zone [Jea03]",
                    "short_rest_s": "mean 5.87 s [Jea03]",
                    "long_rest_s": "mean 700 s [Jea03]",
                    "long_rest_share": "7 % of stops [Jea03]",
                    "contact_radius": "3 mm, the length of an antenna [Jea03]",
                    "contact_turns": "own choice: larvae turn away from a touch",
                    "company_stop_gain": "own choice; that stopping grows with neighbours is [Jea05], its table was not at hand",
                    "company_rest_gain": "own choice; that rests grow with neighbours is [Jea05], its table was not at hand",
                    "detection": "own choice: 1 cm, as [Dir16] prints",
                    "communication": "own choice: 3 cm, for about 9 neighbours each, so that there are hops to count",
                    "biobots": "own choice",
                    "landmarks": "own choice: a sixth",
                    "duration_s": "own choice: half an hour",
                    "dispersion_s": "own choice: a minute, twenty crossings of a mean free path",
                }
            ),
        ),
        "hisser-field": Preset(
            name="hisser-field",
            summary="forty Gromphadorhina portentosa with backpacks in a room of 5 m for an hour",
            unit="m",
            side=5.0,
            motion=MotionParameters(
                speed=0.04,
                mean_leg=0.5,
                stop_hazard=0.01,
                short_rest_s=5.87,
                long_rest_s=120.0,
                long_rest_share=0.07,
                contact_radius=0.06,
                contact_turns=True,
                mishap_hazard=1.0 / 7200.0,
                mishap_rest_s=300.0,
                rescue_probability=0.5,
            ),
            ranges=Ranges(detection=0.5, communication=1.5),
            biobots=40,
            landmarks=8,
            duration_s=3600.0,
            dispersion_s=120.0,
            sources=MappingProxyType(
                {
                    "side": "own choice: a room of 5 m x 5 m, between the arenas of published trials",
                    "speed": "4 cm/s; 3.9 to 5.6 cm/s under stimulation [Eri15], free walking not published",
                    "mean_leg": "own choice: 0.5 m, a tenth of the side; not published",
                    "stop_hazard": "assumption: a third of the larva's in the open [Jea03]",
                    "short_rest_s": "the larva's, mean 5.87 s [Jea03]; the hisser's is not published",
                    "long_rest_s": "assumption: two minutes, of an animal kept awake by its pack",
                    "long_rest_share": "the larva's, 7 % [Jea03]",
                    "contact_radius": "6 cm, the length of the body",
                    "contact_turns": "own choice: insects turn away from a touch",
                    "mishap_hazard": "assumption: once in two hours of walking",
                    "mishap_rest_s": "assumption: five minutes until it frees itself",
                    "rescue_probability": "assumption; that neighbours free stuck ones was seen in swarm trials (Nat. Commun. 2024)",
                    "detection": "0.5 m: what beacons once a second at 4 cm/s can tell; 0.25 m works too",
                    "communication": "own choice: 1.5 m, for about 11 neighbours each, so that there are hops to count",
                    "biobots": "own choice: 20 to 60 make sense",
                    "landmarks": "own choice: a fifth",
                    "duration_s": "own choice: an hour",
                    "dispersion_s": "own choice: two minutes, one crossing of the room",
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
