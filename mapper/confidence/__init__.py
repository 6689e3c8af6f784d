"""How sure a map is: of each hole, of their number, of its distances, of its regions, and whether the data are enough."""

from mapper.confidence.assess import LEAST_CLAIMED, MapAgain, add_verdict, gather_evidence, judge_components
from mapper.confidence.doubts import doubt_movement, doubt_repeats, doubt_times
from mapper.confidence.evidence import Evidence
from mapper.confidence.model import Model, Models, load_models
from mapper.confidence.sufficiency import (
    ACROSS_PARTS,
    MUCH_APART,
    SURE_ENOUGH,
    WANTED_ENCOUNTERS,
    WANTED_LANDMARKS,
    WANTED_WALKERS,
    Doubt,
    describe_count,
    holes_text,
)

__all__ = [
    "ACROSS_PARTS",
    "LEAST_CLAIMED",
    "MUCH_APART",
    "SURE_ENOUGH",
    "WANTED_ENCOUNTERS",
    "WANTED_LANDMARKS",
    "WANTED_WALKERS",
    "Doubt",
    "Evidence",
    "MapAgain",
    "Model",
    "Models",
    "add_verdict",
    "describe_count",
    "doubt_movement",
    "doubt_repeats",
    "doubt_times",
    "gather_evidence",
    "holes_text",
    "judge_components",
    "load_models",
]
