"""What happens in a world: modes that change, encounters that begin and end."""

from dataclasses import dataclass
from enum import StrEnum


class Mode(StrEnum):
    """What an insect does: walk a correlated random walk, or stand still ([Dir16] III.A)."""

    CRW = "CRW"
    S = "S"


class Cause(StrEnum):
    """Who decided on a mode: the base station, or the insect itself."""

    COMMAND = "command"
    NATURAL = "natural"


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeChanged:
    """A biobot went into ``mode`` at ``t_s`` [s]."""

    t_s: float
    id: int
    mode: Mode
    cause: Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterBegan:
    """Two biobots came within the detection radius, in sight of each other; ``id1 < id2``."""

    t_s: float
    id1: int
    id2: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterEnded:
    """They parted at ``t_end_s`` [s], having met at ``t_start_s`` [s]; ``id1 < id2``."""

    t_start_s: float
    t_end_s: float
    id1: int
    id2: int


Event = ModeChanged | EncounterBegan | EncounterEnded
