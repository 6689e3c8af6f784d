"""Which orders are possible in each phase, and in which phases the mission commands (docs/mission.md has the table). Pure."""

from firmware_protocol.contract.mission_orders import MissionAction
from firmware_protocol.contract.records import MissionPhase
from gateway.mission.steps import MissionState

_P, _A = MissionPhase, MissionAction
POSSIBLE: dict[MissionPhase, tuple[MissionAction, ...]] = {
    _P.IDLE: (_A.START,),
    _P.DISPERSION: (_A.PAUSE, _A.SELECT, _A.FINISH),
    _P.LANDMARK_SELECTION: (_A.PAUSE, _A.REDISPERSE, _A.FINISH),
    _P.EXPLORATION: (_A.PAUSE, _A.REDISPERSE, _A.FINISH),
    _P.PAUSED: (_A.RESUME, _A.FINISH),
    _P.DONE: (_A.START,),
}
"""Orders that are taken in each phase."""

COMMANDING = {_P.DISPERSION, _P.LANDMARK_SELECTION, _P.EXPLORATION}
"""Phases in which the mission commands biobots."""


def name_of(state: MissionState) -> str:
    """Return how a phase is called to people."""
    return f"paused in {state.interrupted.value}" if state.interrupted else state.phase.value
