"""Commands as they were given to the gate, what it told of them, and the lives of the gateway in which that was."""

from contextvars import ContextVar
from dataclasses import dataclass, field

from firmware_protocol.contract.commands import CommandStage, StimulationRequest


@dataclass(slots=True, eq=False, kw_only=True)
class Life:
    """One process of the gateway, from its start to its SIGKILL, in true time."""

    number: int
    boot_ns: int
    """When its machine's monotonic clock showed nothing."""
    begin_ns: int
    end_ns: int | None = None

    @property
    def is_over(self) -> bool:
        """It was killed."""
        return self.end_ns is not None


@dataclass(slots=True, eq=False, kw_only=True)
class Call:
    """A request given to the gate, at an instant of true time, and the stages that its giver heard.

    ``age_ns``: how long ago it was issued, by the gateway's wall clock as it was then. ``was_known``: the gateway knew the biobot.
    ``was_commander_there``: or it named none. ``is_new``: the same had not been asked before.
    ``can_send``: the radio that heard its biobot last was up.
    """

    number: int
    request: StimulationRequest
    life: Life
    given_ns: int
    age_ns: int
    was_known: bool
    is_new: bool
    can_send: bool
    was_commander_there: bool
    stages: list[tuple[int, CommandStage]] = field(default_factory=list)

    @property
    def last(self) -> CommandStage | None:
        """The newest stage."""
        return self.stages[-1][1] if self.stages else None


CURRENT_CALL: ContextVar[Call | None] = ContextVar("CURRENT_CALL", default=None)
"""The call on whose behalf the gate acts: tasks that it begins inherit it. None: on nobody's."""
