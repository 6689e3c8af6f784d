"""What happens in a world: modes that change, encounters that begin and end, backpacks that fall silent."""

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


class SilenceReason(StrEnum):
    """Why a backpack is heard no more."""

    LOST = "lost"
    BATTERY = "battery"
    DEATH = "death"


@dataclass(frozen=True, slots=True, kw_only=True)
class BackpackSilenced:
    """From ``t_s`` [s] on a biobot's backpack is off for good: it senses, sends and obeys nothing more."""

    t_s: float
    id: int
    reason: SilenceReason


Event = ModeChanged | EncounterBegan | EncounterEnded | BackpackSilenced
