"""Commands as they were given to the gate, what it told of them, and the lives of the gateway in which that was."""

from contextvars import ContextVar
from dataclasses import dataclass, field

from firmware_protocol.contract.commands import CommandStage, StimulationAction, StimulationRequest


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """What was so when a request was given.

    Parameters
    ----------
    age_ns
        How long ago it was issued, by the gateway's wall clock.
    is_known, can_send
        The gateway knew the biobot; the radio that heard it last was up.
    is_commander_there
        Or it named none.
    n_known
        Biobots that the gateway knew.
    """

    age_ns: int
    is_known: bool
    can_send: bool
    is_commander_there: bool
    n_known: int


@dataclass(slots=True, eq=False, kw_only=True)
class Call:
    """A request given to the gate, at an instant of true time, and the stages that its giver heard.

    ``is_new``: the same had not been asked before. ``given`` is None where the gateway was killed before it took it.
    """

    number: int
    request: StimulationRequest
    life: Life
    given_ns: int
    is_new: bool
    given: Given | None = None
    stages: list[tuple[int, CommandStage]] = field(default_factory=list)

    @property
    def last(self) -> CommandStage | None:
        """The newest stage."""
        return self.stages[-1][1] if self.stages else None


STOPS = frozenset({StimulationAction.STOP, StimulationAction.STOP_ALL})

CURRENT_CALL: ContextVar[Call | None] = ContextVar("CURRENT_CALL", default=None)
"""The call on whose behalf the gate acts: tasks that it begins inherit it. None: on nobody's."""
