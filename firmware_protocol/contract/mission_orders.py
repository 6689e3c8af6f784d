"""What an operator orders the mission to do, and what the gateway answers (CONTRACT.md §4)."""

from enum import Enum
from typing import Annotated

import msgspec

from firmware_protocol.contract.commands import CommandId, OperatorName
from firmware_protocol.contract.records import MissionPhase, Struct
from firmware_protocol.first_use import prepare
from firmware_protocol.units import Nanoseconds, NodeId


class MissionAction(Enum):
    """What is ordered; the phases are those of [Dir16] IV."""

    START = "start"
    """Begin with dispersion: from idle, or anew once it is done."""
    PAUSE = "pause"
    """Command nobody until it is resumed. Biobots go on as they are."""
    RESUME = "resume"
    """Go on where it was paused."""
    SELECT = "select"
    """End dispersion now, and choose the landmarks."""
    REDISPERSE = "redisperse"
    """Let the landmarks walk again, and choose others after a dispersion."""
    FINISH = "finish"
    """The mission is done. Landmarks stay where they are."""
    SHOW = "show"
    """Change nothing; tell how it stands."""


class MissionOrder(Struct, frozen=True, kw_only=True):
    """An order, sent as a query to ``orders/{gateway}``; answered with a MissionAnswer. A known id is answered again, not obeyed again."""

    order_id: CommandId
    action: MissionAction
    operator: OperatorName
    issued_wall_ns: Nanoseconds
    ttl_ms: Annotated[int, msgspec.Meta(ge=1, le=60_000)] = 5_000


class MissionAnswer(Struct, frozen=True, kw_only=True):
    """How the mission stands after an order, or why the order was not taken."""

    order_id: str
    gateway: str
    is_taken: bool
    phase: MissionPhase
    landmarks: tuple[NodeId, ...] = ()
    reason: str = ""
    round: int = 0
    """Dispersions of this mission so far."""
    remaining_s: float | None = None
    """Until the phase ends by itself; None: it does not, or not by time."""
    possible: tuple[MissionAction, ...] = ()
    """Orders that would be taken now."""


prepare(MissionOrder, MissionAnswer)
