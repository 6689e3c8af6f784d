"""How sure a map is: of each hole, of their number, of its distances, of its regions, and whether the data are enough."""

from mapper.confidence.assess import LEAST_CLAIMED, LEAST_CLAIMED_OF_OTHERS, MapAgain, add_verdict, gather_evidence, judge_components
from mapper.confidence.evidence import Evidence
from mapper.confidence.model import Model, Models, load_models
from mapper.confidence.sufficiency import (
    SURE_ENOUGH,
    WANTED_ENCOUNTERS,
    WANTED_LANDMARKS,
    WANTED_WALKERS,
    describe_count,
)

__all__ = [
    "LEAST_CLAIMED",
    "LEAST_CLAIMED_OF_OTHERS",
    "SURE_ENOUGH",
    "WANTED_ENCOUNTERS",
    "WANTED_LANDMARKS",
    "WANTED_WALKERS",
    "Evidence",
    "MapAgain",
    "Model",
    "Models",
    "add_verdict",
    "describe_count",
    "gather_evidence",
    "judge_components",
    "load_models",
]
