"""What happens in a world: modes that change, encounters that begin and end, backpacks that fall silent."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class Mode(StrEnum):
    """What an insect does: walk a correlated random walk, or stand still ([Dir16] III.A)."""

    CRW = "CRW"
    S = "S"


class Cause(StrEnum):
    """Who decided on a mode: the base station, or the insect itself."""

    COMMAND = "command"
    NATURAL = "natural"


class SilenceReason(StrEnum):
    """Why a backpack is heard no more."""

    LOST = "lost"
    BATTERY = "battery"


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


@dataclass(frozen=True, slots=True, kw_only=True)
class BackpackSilenced:
    """A biobot's backpack went off for good at ``t_s`` [s]; its open encounters ended then."""

    t_s: float
    id: int
    reason: SilenceReason


Event = ModeChanged | EncounterBegan | EncounterEnded | BackpackSilenced


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncounterTable:
    """Encounters as columns, for runs with many; arrays of shape (k,).

    Parameters
    ----------
    id1, id2
        The two biobots, ``id1 < id2``.
    t_start_s, t_end_s
        From when to when [s].
    """

    id1: NDArray[np.int64]
    id2: NDArray[np.int64]
    t_start_s: NDArray[np.float64]
    t_end_s: NDArray[np.float64]

    def __len__(self) -> int:
        return self.id1.size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Happenings:
    """What happened in a stretch of time: encounters that ended as columns, all else, but for beginnings, as events in order of time."""

    ended: EncounterTable
    changes: list[ModeChanged | BackpackSilenced]
