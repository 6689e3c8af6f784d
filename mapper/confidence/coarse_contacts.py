"""Where nodes notice each other from so far that a map of the place cannot show what stands between them."""

from typing import Final

from mapper.confidence.evidence import Evidence, reach_of
from mapper.confidence.sufficiency import WANTED_ENCOUNTERS, Doubt

MOST_OF_REACH: Final = 0.1
"""An encounter's median length over the time across the map. The 321 of the first 451 runs of training that had encounters enough had 0.074
at most, where the detection radius is a twentieth of the arena's side; hissing cockroaches with a tenth have 0.12 to 0.19."""
COARSE_SHARE: Final = 0.5
"""How far the model of the number of holes is not believed there (own choice): one big obstacle is found, of several too few."""
_MOST_CHECKED: Final = 0.07


def doubt_reach(evidence: Evidence, *, encounters_each: float) -> tuple[Doubt, ...]:
    """Doubt a map across which one encounter lasts for long; with few encounters the map is small for want of them, which is told anyway.

    Parameters
    ----------
    evidence
        Of the largest component.
    encounters_each
        Encounters of a biobot, on average.
    """
    reach = reach_of(evidence.part)
    if encounters_each < WANTED_ENCOUNTERS or evidence.track.median_duration <= MOST_OF_REACH * reach:
        return ()
    share = f"{evidence.track.median_duration / reach:.0%}"
    return (
        Doubt(
            reason=f"an encounter lasts {share} of the time across the map: biobots notice each other past obstacles, and lengths come out "
            f"much too short; no run that was checked has more than {_MOST_CHECKED:.0%}",
            remedy="count two as met only when they are closer, as by a stronger signal, or use the map for a larger place",
        ),
    )
