"""How long the map's lengths really are: a factor from the walking model, with its error.

A length on the map is a time walked, and that differs from the distance in two ways. Insects do not walk straight, so the way is longer;
how much, the links tell, once they are settled in the plane: of a persistent walk of a time t with mean leg l the mean squared
displacement is 2 l^2 (s - 1 + exp(-s)), s = t / l [Fue20], and over t^2 that is the straightness used here. And whoever comes near a
landmark is at its place, so that its disc is crossed in no time; what share of the arena those discs are is what share of the time they
are visited.
The more encounters there are, the straighter the shortest of all ways. How much each counts is fitted to simulated runs.

[Fue20]: see REFERENCES.md.
"""

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from mapper.encounter_graph import EncounterGraph
from mapper.placement import Placement
from mapper.types import Evidence, Scale

# A share of discs from which a path would hardly take any time.
_LEAST_LEFT = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleLaw:
    """log factor = constant + straightness log(R) + encounters log(min(N, enough)) - discs log(1 - per_disc A), of the `Evidence` R, N, A.

    ``error``: two thirds of the runs it was fitted to are nearer than that, in the logarithm. ``ranges`` of log(R), log(N) and A in those
    runs: beyond, the nearest value within is taken.
    """

    constant: float
    straightness: float
    encounters: float
    discs: float
    enough: float
    per_disc: float
    error: float
    ranges: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


def gather_evidence(graph: EncounterGraph, placement: Placement, *, contact: float, n_views: float) -> Evidence:
    """Measure what the scale follows from.

    Parameters
    ----------
    contact
        How long encounters last, their median [ticks].
    """
    links = graph.links
    is_inside = placement.is_placed[links.sources] & placement.is_placed[links.targets]
    times = links.times[is_inside]
    squared = ((placement.xy[links.targets[is_inside]] - placement.xy[links.sources[is_inside]]) ** 2).sum(axis=1)
    is_long = times >= np.median(times)
    at_landmarks = float(graph.multiplicity[graph.landmarks].sum()) * contact
    return Evidence(
        straightness=float(squared[is_long].sum() / (times[is_long] ** 2).sum()),
        n_encounters=graph.n_encounters / n_views,
        disc_share=at_landmarks / float(links.times.sum()),
    )


def estimate_scale(evidence: Evidence, law: ScaleLaw) -> Scale:
    """Return the factor by which lengths on the map are to be multiplied."""
    given = (np.log(max(evidence.straightness, 1e-9)), np.log(evidence.n_encounters), evidence.disc_share)
    log_straightness, log_encounters, discs = (float(np.clip(value, *span)) for value, span in zip(given, law.ranges, strict=True))
    log_factor = (
        law.constant
        + law.straightness * log_straightness
        + law.encounters * min(log_encounters, float(np.log(law.enough)))
        - law.discs * float(np.log(max(_LEAST_LEFT, 1.0 - law.per_disc * discs)))
    )
    return Scale(factor=float(np.exp(log_factor)), error=law.error, evidence=evidence)


@cache
def load_scale_law() -> ScaleLaw:
    """Read the law that the package ships."""
    entry = json.loads(resources.files("mapper").joinpath("data", "scale.json").read_text(encoding="utf-8"))
    low, middle, high = ((float(least), float(greatest)) for least, greatest in entry["ranges"])
    names = ("constant", "straightness", "encounters", "discs", "enough", "per_disc", "error")
    return ScaleLaw(**{name: float(entry[name]) for name in names}, ranges=(low, middle, high))
